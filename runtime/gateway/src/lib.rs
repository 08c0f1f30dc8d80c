//! Server ends of the sequence-control interface: MQTT, REST, WebSocket, HMI.
//!
//! They know `plc_api` only and serve any [`ServedPort`]: the runtime's, or one of a test. [`Gateway::start`] opens the
//! listeners; from there `rest` leads to every HTTP route, `websocket` and `hmi`, and `mqtt` to the broker.

mod access;
mod broker;
mod broker_address;
mod contract;
mod error;
mod hmi;
mod http;
mod metrics;
mod mqtt;
mod origin;
mod position;
mod problem;
mod rest;
mod server;
mod settings;
mod shared;
mod websocket;

#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use plc_api::server::ServedPort;
use rumqttc::Transport;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use access::LiveTokens;
use access::http::Access;
use broker::{Broker, BrokerAccess};
use broker_address::{BrokerAddress, Refused};
use mqtt::MqttEnd;
use server::LimitedListener;
use settings::{HTTP_LISTEN, MQTT_LISTEN, listen_address, listen_error};
use shared::Shared;

pub use access::{NewToken, Role, TokenError, Tokens, mosquitto_acl, new_token};
pub use error::GatewayError;
pub use settings::{GatewaySettings, MqttSettings};

/// Time for HTTP requests that run to end at a shutdown; then they are cut off.
const HTTP_STOP_MAX: Duration = Duration::from_secs(2);

/// The server ends of one machine while they run.
pub struct Gateway {
    http_addr: SocketAddr,
    http: JoinHandle<()>,
    shared: Arc<Shared>,
    mqtt: MqttEnd,
    broker: Option<Broker>,
}

impl std::fmt::Debug for Gateway {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gateway")
            .field("http_addr", &self.http_addr)
            .field("mqtt_addr", &self.mqtt_addr())
            .finish_non_exhaustive()
    }
}

impl Gateway {
    /// Starts all server ends. When it returns, HTTP and the embedded broker answer; an external broker may still
    /// be away, and is connected when it comes.
    ///
    /// # Errors
    /// A setting cannot be used, or a port is taken; nothing is left running.
    pub async fn start(
        port: Arc<dyn ServedPort>,
        settings: GatewaySettings,
    ) -> Result<Gateway, GatewayError> {
        if let Some(problem) = settings.problems().into_iter().next() {
            return Err(problem);
        }
        let address = listen_address(HTTP_LISTEN, &settings.http_listen, settings.tokens.is_some())?;
        let listener = TcpListener::bind(address)
            .await
            .map_err(|source| listen_error(HTTP_LISTEN, address, source))?;
        let http_addr = listener
            .local_addr()
            .map_err(|source| listen_error(HTTP_LISTEN, address, source))?;
        let transport = match &settings.mqtt.tls {
            None => Transport::tcp(),
            Some(files) => files.transport().map_err(GatewayError::Tls)?,
        };
        let root = settings.mqtt.root(&settings.machine);
        let (refused_sender, refused) = mpsc::channel(mqtt::REFUSED_MAX);
        let tokens = settings.tokens.clone().map(LiveTokens::follow);
        let broker = embedded_broker(&settings, tokens.clone(), refused_sender).await?;
        let at = match &broker {
            Some(broker) => broker.address(),
            None => BrokerAddress::of_settings(&settings.mqtt, transport),
        };
        let position_interval = Duration::from_millis(settings.position_interval_ms);
        let stop = CancellationToken::new();
        let shared = Arc::new(Shared::new(
            Arc::clone(&port),
            http_addr,
            Access::new(tokens),
            position_interval,
            stop.clone(),
        ));
        let mqtt = MqttEnd::start(mqtt::Parts {
            port,
            settings: settings.mqtt,
            machine: settings.machine,
            root,
            at,
            position_interval,
            refused,
            metrics: Arc::clone(&shared.metrics),
        });
        let router = http::router(Arc::clone(&shared));
        let http = tokio::spawn(server::serve(
            LimitedListener::new(listener),
            router,
            stop,
            server::HEADER_MAX,
        ));
        Ok(Gateway {
            http_addr,
            http,
            shared,
            mqtt,
            broker,
        })
    }

    /// Where REST, WebSocket and HMI are served.
    pub fn http_addr(&self) -> SocketAddr {
        self.http_addr
    }

    /// Where the embedded broker listens; `None` with an external broker.
    pub fn mqtt_addr(&self) -> Option<SocketAddr> {
        self.broker.as_ref().map(Broker::addr)
    }

    /// Says goodbye on MQTT, lets requests end, and stops all server ends, within about 5 s.
    pub async fn shutdown(mut self) {
        self.shared.stop.cancel();
        self.shared.tasks.close();
        let http = async {
            let ended = async {
                let _ = (&mut self.http).await;
                self.shared.tasks.wait().await;
            };
            if tokio::time::timeout(HTTP_STOP_MAX, ended).await.is_err() {
                self.http.abort();
            }
        };
        tokio::join!(http, self.mqtt.stop());
        if let Some(broker) = self.broker {
            broker.stop().await;
        }
    }
}

/// The embedded broker, where the settings name one.
async fn embedded_broker(
    settings: &GatewaySettings,
    tokens: Option<LiveTokens>,
    refused: mpsc::Sender<Refused>,
) -> Result<Option<Broker>, GatewayError> {
    let Some(listen) = &settings.mqtt.embedded_listen else {
        return Ok(None);
    };
    let address = listen_address(MQTT_LISTEN, listen, settings.tokens.is_some())?;
    let access = BrokerAccess {
        root: settings.mqtt.root(&settings.machine),
        runtime_client_id: mqtt::client_id(&settings.mqtt, &settings.machine),
        tokens,
    };
    Broker::start(address, access, refused).await.map(Some)
}
