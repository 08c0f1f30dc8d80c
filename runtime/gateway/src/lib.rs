//! The servers of the sequence-control interface: MQTT, REST, WebSocket and HMI.
//!
//! They depend on `plc_protocol` only and serve any [`ServedPort`]: the runtime's, or that of a test. [`Gateway::start`] opens
//! the listeners. Everything over HTTP starts in `http`, everything over MQTT in `mqtt`.

mod access;
mod account_slots;
mod arrivals;
mod broker;
mod broker_address;
mod certificate;
mod connection_slots;
mod contract;
mod error;
mod exposed_settings;
mod files;
mod hmi;
mod hmi_dir;
mod http;
mod machine;
mod metrics;
mod mqtt;
mod mqtt_socket;
mod mtconnect;
mod origin;
mod peer_machines;
mod position;
mod presence_ages;
mod problem;
mod process;
mod publisher;
mod registrations;
mod rest;
mod server;
mod server_state;
mod settings;
mod shares;
mod socket_limits;
mod tls;
mod unread;
mod urgent_slots;
mod websocket;

#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use plc_protocol::server::ServedPort;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use access::http::Access;
use access::{LiveTokens, Users};
use broker::{Broker, BrokerAccess};
use broker_address::{BrokerAddress, RefusedMessage};
use connection_slots::SlotLimits;
use files::ConnectionLimits;
use machine::Machine;
use peer_machines::{Listener, PeerMachines};
use server::LimitedListener;
use server_state::{MqttServer, ServerState};
use settings::bind;
use tls::LiveTls;

pub use access::{
    NewToken, Role, TokenError, Tokens, certificate_entry, mosquitto_acl, new_token, pin_entry,
};
pub use error::GatewayError;
pub use mqtt::{BrokerStamp, Connect, ConnectionLoss, Event, MqttEnd, Version, Wire};
pub use process::Usage;
pub use settings::{GatewaySettings, HTTP_LISTEN, HmiSettings, MQTT_LISTEN, MqttSettings, MtconnectSettings};
pub use tandem_mtconnect::Version as MtconnectVersion;
pub use tls::ServerTls;

/// Longest time for running HTTP requests to end at a shutdown; then they are aborted.
const HTTP_STOP_MAX: Duration = Duration::from_secs(2);

/// The running servers of one machine.
pub struct Gateway {
    http_addr: SocketAddr,
    http: JoinHandle<()>,
    shared: Arc<ServerState>,
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

/// Starts the embedded broker, if it is configured.
fn start_broker(
    settings: &GatewaySettings,
    root: &str,
    (users, machine): (Option<Users>, Machine),
    (tls, limits): (Option<LiveTls>, SlotLimits),
    refused: mpsc::Sender<RefusedMessage>,
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
    Broker::start(address, access, tls, refused, limits).map(Some)
}

/// Starts the MQTT task, at the embedded broker if there is one.
fn start_mqtt(parts: mqtt::Parts, broker: Option<&Broker>) -> Result<MqttEnd, GatewayError> {
    Ok(if let Some(broker) = broker {
        MqttEnd::start_inside(parts, broker)
    } else {
        let at = BrokerAddress::of_settings(&parts.settings)?;
        MqttEnd::start(parts, at)
    })
}

/// Opens the listener of HTTP and returns its address.
fn listen(settings: &GatewaySettings) -> Result<(TcpListener, SocketAddr), GatewayError> {
    let address = settings.http_address()?;
    let listener = bind(HTTP_LISTEN, address)?;
    let http_addr = listener.local_addr().unwrap_or(address);
    Ok((listener, http_addr))
}

/// Creates the access control of HTTP.
fn access(users: Option<Users>, settings: &GatewaySettings) -> Access {
    Access::new(users)
        .allow_origins(&settings.allow_origins)
        .stop_without_login(settings.hmi.stop_without_login)
}

/// Starts the listener to machines at the shared broker.
fn start_listener(listener: Listener<BrokerAddress>, shared: &ServerState) {
    let listener = Arc::new(listener);
    let listening = move || {
        let listener = Arc::clone(&listener);
        async move { listener.run().await }
    };
    let supervisor = shared.machine.supervisor();
    shared
        .tasks
        .spawn(supervisor.restarted("listener to other machines", listening));
}

/// Starts the HTTP server.
fn start_http(
    listener: LimitedListener,
    router: Router,
    tls: Option<LiveTls>,
    shared: &ServerState,
) -> JoinHandle<()> {
    let supervisor = shared.machine.supervisor();
    let listener = listener.supervised_by(supervisor.clone());
    let serving = server::serve(listener, router, tls, shared.stop.clone(), server::HEADER_MAX);
    tokio::spawn(supervisor.essential("HTTP server", serving))
}

impl Gateway {
    /// Starts all servers. When it returns, HTTP and the embedded broker are ready; an external broker is connected as
    /// soon as it is available.
    ///
    /// # Errors
    /// Returns an error if a setting cannot be used, or if a port is taken; then no server runs.
    #[allow(
        clippy::unused_async,
        reason = "this function starts tasks and must therefore be called in an executor"
    )]
    pub async fn start(
        port: Arc<dyn ServedPort>,
        settings: GatewaySettings,
    ) -> Result<Gateway, GatewayError> {
        settings.problems().into_iter().next().map_or(Ok(()), Err)?;
        let machine = Machine::new(Arc::<dyn ServedPort>::clone(&port));
        let limits = ConnectionLimits::raise(&machine);
        let (listener, http_addr) = listen(&settings)?;
        let root = settings.mqtt.root(&settings.machine);
        let (refused_sender, refused) = mpsc::channel(mqtt::REFUSED_MAX);
        let tokens = settings.tokens.clone();
        let tokens = tokens.map(|tokens| LiveTokens::follow(tokens, &machine.supervisor()));
        let users = (tokens.clone()).map(|tokens| Users::new(tokens, settings.login_idle));
        let tls = settings.live_tls(tokens.clone(), &machine.supervisor())?;
        let access = access(users.clone(), &settings);
        let broker = start_broker(
            &settings,
            &root,
            (users, machine.clone()),
            (tls.clone(), limits.mqtt),
            refused_sender,
        )?;
        let peers = PeerMachines::new(&settings.machine, settings.hmi.machines.clone(), broker.is_none());
        let websocket = broker.as_ref();
        let websocket = websocket.and_then(|broker| broker.websocket_listener(&settings.mqtt));
        let position_interval = settings.position_interval();
        let stop = CancellationToken::new();
        let mtconnect = mtconnect::start(&settings, port, machine.supervisor(), &stop).await?;
        let shared = ServerState::new(
            machine.clone(),
            http_addr,
            if tls.is_some() { "https" } else { "http" },
            MqttServer::new(broker.as_ref().map(Broker::addr), &settings.mqtt, tls.is_some()),
            access,
            position_interval,
            stop.clone(),
        )
        .with_hmi(settings.hmi)
        .with_peer_machines(Arc::clone(&peers))
        .with_websocket_listener(websocket);
        if broker.is_none() {
            let listener = Listener::for_broker(&settings.mqtt, &settings.machine, peers, stop.clone())?;
            start_listener(listener, &shared);
        }
        let parts = mqtt::Parts {
            machine,
            // an external broker has its own users
            tokens: tokens.filter(|_| broker.is_some()),
            clients: broker.as_ref().map(Broker::sessions),
            settings: settings.mqtt,
            machine_name: settings.machine,
            root,
            position_interval,
            refused,
            metrics: Arc::clone(&shared.metrics),
            arrivals: broker.as_ref().map(Broker::arrivals).unwrap_or_default(),
            urgent_replies: Arc::default(),
        };
        let mqtt = start_mqtt(parts, broker.as_ref())?;
        let router = http::router(shared.watch_registrations(), mtconnect.as_ref());
        let http = start_http(LimitedListener::new(listener, limits.http), router, tls, &shared);
        Ok(Gateway {
            http_addr,
            http,
            shared,
            mqtt,
            broker,
        })
    }

    /// Returns the address of REST, WebSocket and HMI.
    pub fn http_addr(&self) -> SocketAddr {
        self.http_addr
    }

    /// Returns the address of the embedded broker; `None` with an external broker.
    pub fn mqtt_addr(&self) -> Option<SocketAddr> {
        self.broker.as_ref().map(Broker::addr)
    }

    /// Reads the token file again. An invalid file changes nothing, and is logged. Without tokens nothing happens.
    pub fn read_tokens_again(&self) {
        if let Some(users) = self.shared.access.users() {
            users.tokens.read_again();
        }
    }

    /// Publishes on MQTT that the runtime is offline, lets requests end, and stops all servers, within about 5 s.
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
