//! The server ends of the sequence-control interface: MQTT, REST, WebSocket and HMI.
//!
//! They depend on `plc_api` only and serve any [`ServedPort`]: the runtime's, or that of a test. [`Gateway::start`] opens
//! the listeners. Everything over HTTP starts in `http`, everything over MQTT in `mqtt`.

mod access;
mod broker;
mod broker_address;
mod contract;
mod error;
mod hmi;
mod hmi_dir;
mod http;
mod machine;
mod metrics;
mod mqtt;
mod mqtt_socket;
mod mtconnect;
mod neighbours;
mod opened;
mod origin;
mod places;
mod position;
mod presence_ages;
mod problem;
mod process;
mod rest;
mod server;
mod settings;
mod shared;
mod tls;
mod websocket;

#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use plc_api::server::ServedPort;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use access::http::Access;
use access::{LiveTokens, Users};
use broker::{Broker, BrokerAccess};
use broker_address::{BrokerAddress, Refused};
use machine::Machine;
use neighbours::{Listener, Neighbours};
use server::LimitedListener;
use settings::bind;
use shared::{MqttServer, Shared};
use tls::LiveTls;

pub use access::{
    NewToken, Role, TokenError, Tokens, certificate_entry, mosquitto_acl, new_token, pin_entry,
};
pub use error::GatewayError;
pub use mqtt::{Connect, Event, Lost, MqttEnd, Named, Version, Wire};
pub use process::Usage;
pub use settings::{GatewaySettings, HTTP_LISTEN, HmiSettings, MQTT_LISTEN, MqttSettings, MtconnectSettings};
pub use tandem_mtconnect::Version as MtconnectVersion;
pub use tls::ServerTls;

/// Time for running HTTP requests to end at a shutdown; then they are aborted.
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

/// The embedded broker, where there is one.
fn start_broker(
    settings: &GatewaySettings,
    root: &str,
    (users, machine): (Option<Users>, Machine),
    tls: Option<LiveTls>,
    refused: mpsc::Sender<Refused>,
) -> Result<Option<Broker>, GatewayError> {
    let Some(address) = settings.mqtt_address()? else {
        return Ok(None);
    };
    let access = BrokerAccess {
        root: root.to_owned(),
        runtime_client_id: mqtt::client_id(&settings.mqtt, &settings.machine),
        users,
        machine,
    };
    Broker::start(address, access, tls, refused).map(Some)
}

/// The MQTT end, at the embedded broker where there is one.
fn start_mqtt(parts: mqtt::Parts, broker: Option<&Broker>) -> Result<MqttEnd, GatewayError> {
    Ok(if let Some(broker) = broker {
        MqttEnd::start(parts, mqtt::Inside(broker.exchange()))
    } else {
        let at = BrokerAddress::of_settings(&parts.settings)?;
        MqttEnd::start(parts, at)
    })
}

impl Gateway {
    /// Starts all server ends. When it returns, HTTP and the embedded broker are ready; an external broker is connected
    /// as soon as it is there.
    ///
    /// # Errors
    /// A setting cannot be used, or a port is taken; nothing is left running.
    #[allow(
        clippy::unused_async,
        reason = "it starts tasks, so that it must be called in an executor"
    )]
    pub async fn start(
        port: Arc<dyn ServedPort>,
        settings: GatewaySettings,
    ) -> Result<Gateway, GatewayError> {
        settings.problems().into_iter().next().map_or(Ok(()), Err)?;
        let machine = Machine::new(Arc::<dyn ServedPort>::clone(&port));
        let address = settings.http_address()?;
        let listener = bind(HTTP_LISTEN, address)?;
        let http_addr = listener.local_addr().unwrap_or(address);
        let root = settings.mqtt.root(&settings.machine);
        let (refused_sender, refused) = mpsc::channel(mqtt::REFUSED_MAX);
        let tokens = settings.tokens.clone().map(LiveTokens::follow);
        let users = tokens.clone().map(Users::new);
        let tls = settings.live_tls(tokens.clone())?;
        let broker = start_broker(
            &settings,
            &root,
            (users.clone(), machine.clone()),
            tls.clone(),
            refused_sender,
        )?;
        let addresses = settings.hmi.machines.clone();
        let neighbours = Neighbours::new(&settings.machine, addresses, broker.is_none());
        let position_interval = settings.position_interval();
        let stop = CancellationToken::new();
        let mtconnect = mtconnect::start(&settings, port, &stop).await?;
        let shared = Shared::new(
            machine.clone(),
            http_addr,
            if tls.is_some() { "https" } else { "http" },
            MqttServer::new(broker.as_ref().map(Broker::addr), &settings.mqtt, tls.is_some()),
            Access::new(users).open_to(&settings.allow_origins),
            position_interval,
            stop.clone(),
        )
        .with_hmi(settings.hmi)
        .with_neighbours(Arc::clone(&neighbours))
        .with_entrance(broker.as_ref().and_then(|broker| broker.entrance(&settings.mqtt)));
        if broker.is_none() {
            let listener = Listener::beside(&settings.mqtt, &settings.machine, neighbours, stop.clone())?;
            shared.tasks.spawn(listener.run());
        }
        let parts = mqtt::Parts {
            machine,
            // an external broker has users of its own
            tokens: tokens.filter(|_| broker.is_some()),
            clients: broker.as_ref().map(Broker::sessions),
            settings: settings.mqtt,
            machine_name: settings.machine,
            root,
            position_interval,
            refused,
            metrics: Arc::clone(&shared.metrics),
        };
        let mqtt = start_mqtt(parts, broker.as_ref())?;
        let http = tokio::spawn(server::serve(
            LimitedListener::new(listener),
            http::router(Arc::clone(&shared), mtconnect.as_ref()),
            tls,
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

    /// The address of REST, WebSocket and HMI.
    pub fn http_addr(&self) -> SocketAddr {
        self.http_addr
    }

    /// The address of the embedded broker; `None` with an external broker.
    pub fn mqtt_addr(&self) -> Option<SocketAddr> {
        self.broker.as_ref().map(Broker::addr)
    }

    /// Reads the token file again now; one that cannot be used changes nothing, and is logged. Without tokens nothing happens.
    pub fn read_tokens_again(&self) {
        if let Some(users) = self.shared.access.users() {
            users.tokens.read_again();
        }
    }

    /// Publishes on MQTT that the runtime is offline, lets requests end, and stops all server ends, within about 5 s.
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
