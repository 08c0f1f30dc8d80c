//! A Mosquitto started by the bench.

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;
use plc_api::Plc;
use tandem_gateway::MqttSettings;
use tempfile::NamedTempFile;

/// A broker on a free port, without delays of small packets; ends when it is dropped.
pub struct Mosquitto {
    process: Child,
    port: u16,
    _config: NamedTempFile,
}

impl Mosquitto {
    pub fn start() -> anyhow::Result<Mosquitto> {
        let free = TcpListener::bind("127.0.0.1:0")?;
        let port = free.local_addr()?.port();
        drop(free);
        let config = NamedTempFile::new()?;
        let text =
            format!("user root\nlistener {port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\n");
        std::fs::write(config.path(), text)?;
        let start = |program: &str| {
            let mut command = Command::new(program);
            command.arg("-c").arg(config.path()).stderr(Stdio::null()).spawn()
        };
        let process = start("mosquitto")
            .or_else(|_| start("/usr/sbin/mosquitto"))
            .context("mosquitto is not installed; `apt-get install mosquitto`")?;
        let broker = Mosquitto {
            process,
            port,
            _config: config,
        };
        let end = Instant::now() + Duration::from_secs(10);
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            anyhow::ensure!(Instant::now() < end, "mosquitto does not listen");
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(broker)
    }

    /// Returns a machine's settings for this broker.
    pub fn settings(&self) -> MqttSettings {
        MqttSettings {
            embedded_listen: None,
            brokers: vec![("127.0.0.1".to_owned(), self.port)],
            ..MqttSettings::default()
        }
    }

    /// Connects to the machine `bench` over this broker.
    pub async fn connect(&self) -> anyhow::Result<Plc> {
        Ok(Plc::connect(&format!("mqtt://127.0.0.1:{}/bench", self.port)).await?)
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
