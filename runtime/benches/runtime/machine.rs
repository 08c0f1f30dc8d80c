//! The machine that is measured: one coordinate system of three axes, with all server ends on free ports.

use std::future::Future;

use plc_api::Plc;
use tandem_gateway::{Gateway, GatewaySettings, MqttSettings};
use tandem_runtime::{Config, Runtime};
use tempfile::TempDir;

/// One coordinate system of three axes.
pub const CONFIG: &str = r#"
[machine]
name = "bench"

[[motor]]
number = 1
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[motor]]
number = 2
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[motor]]
number = 3
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[coordinate_system]]
number = 1
axes = { X = 1, Y = 2, Z = 3 }
"#;

/// The runtime, its server ends, and the folder that it keeps its programs in.
pub struct Machine {
    pub runtime: Runtime,
    pub gateway: Gateway,
    _folder: TempDir,
}

impl Machine {
    /// Starts it in real time, with a broker of its own.
    pub async fn start() -> anyhow::Result<Machine> {
        Machine::start_at(MqttSettings {
            embedded_listen: Some("127.0.0.1:0".to_owned()),
            ..MqttSettings::default()
        })
        .await
    }

    /// The same with these settings of MQTT.
    pub async fn start_at(mqtt: MqttSettings) -> anyhow::Result<Machine> {
        let (runtime, folder) = alone(CONFIG).await?;
        let settings = GatewaySettings {
            machine: "bench".to_owned(),
            http_listen: "127.0.0.1:0".to_owned(),
            mqtt,
            ..GatewaySettings::default()
        };
        let gateway = Gateway::start(runtime.served_port(), settings).await?;
        Ok(Machine {
            runtime,
            gateway,
            _folder: folder,
        })
    }

    /// The machine in this process.
    pub fn in_process(&self) -> Plc {
        Plc::in_process(self.runtime.port())
    }

    /// The machine over its embedded broker.
    pub async fn over_mqtt(&self) -> anyhow::Result<Plc> {
        let broker = self
            .gateway
            .mqtt_addr()
            .ok_or_else(|| anyhow::anyhow!("there is no embedded broker"))?;
        Ok(Plc::connect(&format!("mqtt://{broker}/bench")).await?)
    }

    /// Stops it in order.
    pub async fn stop(self) {
        self.runtime.shutdown().await;
        self.gateway.shutdown().await;
    }
}

/// A runtime without server ends, in real time, and the folder that it keeps its programs in.
pub async fn alone(config: &str) -> anyhow::Result<(Runtime, TempDir)> {
    let folder = tempfile::tempdir()?;
    let runtime = Runtime::start(Config::from_toml(config, folder.path())?).await?;
    Ok((runtime, folder))
}

/// Runs a future as `tandem serve` runs: on as many threads as there are processors.
pub fn in_real_time(part: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?
        .block_on(part)
}
