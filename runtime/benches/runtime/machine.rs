//! The measured machine: one coordinate system of three axes, with all server ends on free ports.

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

/// The runtime, its server ends, and its data folder.
pub struct Machine {
    pub runtime: Runtime,
    pub gateway: Gateway,
    _folder: TempDir,
}

impl Machine {
    /// Starts the machine in real time, with its embedded broker.
    pub async fn start() -> anyhow::Result<Machine> {
        Machine::start_at(MqttSettings {
            embedded_listen: Some("127.0.0.1:0".to_owned()),
            ..MqttSettings::default()
        })
        .await
    }

    /// Starts the machine with these MQTT settings.
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

    /// Connects to the machine in this process.
    pub fn in_process(&self) -> Plc {
        Plc::in_process(self.runtime.port())
    }

    /// Connects to the machine over its embedded broker.
    pub async fn over_mqtt(&self) -> anyhow::Result<Plc> {
        let broker = self
            .gateway
            .mqtt_addr()
            .ok_or_else(|| anyhow::anyhow!("there is no embedded broker"))?;
        Ok(Plc::connect(&format!("mqtt://{broker}/bench")).await?)
    }

    /// Stops the machine in order.
    pub async fn stop(self) {
        self.runtime.shutdown().await;
        self.gateway.shutdown().await;
    }
}

/// A runtime without server ends, in real time, and its data folder.
pub async fn alone(config: &str) -> anyhow::Result<(Runtime, TempDir)> {
    let folder = tempfile::tempdir()?;
    let runtime = Runtime::start(Config::from_toml(config, folder.path())?).await?;
    Ok((runtime, folder))
}

/// Runs a future as `tandem serve` does: with one thread for each processor.
pub fn in_real_time(part: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?
        .block_on(part)
}
