//! The embedded MQTT broker, in memory only. With tokens a user is the name of a token, and its password the token;
//! without, it listens on the loopback only and lets everyone in. Only the runtime itself says state.
//!
//! Every setting of the broker is set here, since its defaults listen on all addresses and write files.
//! It refuses what no broker of ours may hold: a command, claim or set with the retain flag, which would be carried
//! out again at a later start.

mod sessions;

use std::collections::HashMap;
use std::future::Future;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use mqtt5::broker::auth::AuthResult;
use mqtt5::broker::config::{AuthConfig, AuthMethod, RateLimitConfig, StorageBackend, StorageConfig};
use mqtt5::broker::events::{
    BrokerEventHandler, ClientConnectEvent, ClientDisconnectEvent, ClientPublishEvent, PublishAction,
};
use mqtt5::broker::storage::ClientSession;
use mqtt5::broker::{AuthProvider, BrokerConfig, BrokerShutdownHandle, MqttBroker, ResourceLimits};
use mqtt5::packet::connect::ConnectPacket;
use mqtt5::types::ReasonCode;
use parking_lot::Mutex;
use subtle::ConstantTimeEq;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::task::AbortOnDropHandle;
use tracing::warn;

use crate::access::topics::{may_publish, may_say, may_subscribe};
use crate::access::{LiveTokens, Rate, User, random_secret};
use crate::broker_address::{BrokerAddress, Refused, reachable};
use crate::contract::topics::is_inbound;
use crate::error::GatewayError;
use crate::settings::{MQTT_LISTEN, listen_error};
use sessions::{Admitted, REMEMBERED_MAX, Sessions};

/// Clients that may be connected; more are refused.
const CLIENTS_MAX: usize = 256;
/// New connections within [`CONNECTING_TIME`], which the library gives each to say who it is: so many sockets at most
/// hold nobody yet. With the clients and those of HTTP they stay below the 1024 files that a process may have open.
const CONNECTING_MAX: u32 = 400;
const CONNECTING_TIME: Duration = Duration::from_secs(10);
/// Bytes of one packet. Reason: the largest message, `birth`, stays far below.
const PACKET_MAX: usize = 1024 * 1024;
/// Subscriptions of one client.
const SUBSCRIPTIONS_MAX: usize = 1024;
/// Retained messages. Reason: 8 coordinate systems of 15 topics fit 30 times.
const RETAINED_MAX: usize = 4096;
/// Bytes of one retained message.
const RETAINED_SIZE_MAX: usize = 256 * 1024;
/// How long the broker remembers a client that went; messages for it wait in memory.
const SESSION_EXPIRY: Duration = Duration::from_hours(1);
/// Messages that wait for one client; more are dropped by the broker.
const QUEUED_MAX: usize = 1000;
/// Bytes that wait for one client.
const QUEUED_BYTES_MAX: usize = 8 * 1024 * 1024;
/// Time to stop; then its task is ended.
const STOP_MAX: Duration = Duration::from_secs(2);

/// Messages of one client: at once, and a second after that. More are taken later, which the client feels as a slow
/// broker: over MQTT 3.1.1 one that is refused would be lost without a word. Reason: one process may serve 8 coordinate
/// systems of 200 M codes a second, each with a claim and a reset.
const CLIENT_BURST: u32 = 10_000;
const CLIENT_PER_SECOND: u32 = 5000;

/// Protocol version of MQTT 5 in its CONNECT packet.
const MQTT_5: u8 = 5;

/// User of the runtime's own connection. No token has this name.
const RUNTIME_USER: &str = "$runtime";

/// Whom the broker lets in, and what is kept from it.
pub(crate) struct BrokerAccess {
    /// Topic root of the machine, with its last slash.
    pub(crate) root: String,
    /// Client id of the runtime's own connection, which nobody else may use.
    pub(crate) runtime_client_id: String,
    /// Users; `None`: everyone.
    pub(crate) tokens: Option<LiveTokens>,
}

/// The embedded broker while it runs.
#[derive(Debug)]
pub(crate) struct Broker {
    addr: SocketAddr,
    handle: Handle,
    secret: String,
    task: JoinHandle<()>,
    // ends sessions of tokens that count no more
    _watch: Option<AbortOnDropHandle<()>>,
}

struct Handle(BrokerShutdownHandle);

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("BrokerShutdownHandle")
    }
}

impl Broker {
    /// Starts the broker. Commands with the retain flag go to `refused`, as far as there is room.
    pub(crate) async fn start(
        address: SocketAddr,
        access: BrokerAccess,
        refused: mpsc::Sender<Refused>,
    ) -> Result<Broker, GatewayError> {
        let secret = random_secret()?;
        let guard = Arc::new(Guard {
            access,
            secret: secret.clone(),
            refused,
            rates: Mutex::default(),
            sessions: Sessions::default(),
        });
        let broker = match MqttBroker::with_config(config(address, Arc::clone(&guard))).await {
            Ok(broker) => broker,
            Err(error) => return Err(why_not(address, &error).await),
        };
        broker.resource_monitor().update_limits(limits());
        let addr = broker.local_addr().unwrap_or(address);
        let watch = guard.access.tokens.clone().map(|tokens| {
            let watch = Arc::clone(&guard).end_revoked(addr, tokens);
            AbortOnDropHandle::new(tokio::spawn(watch))
        });
        let mut broker = broker.with_auth_provider(guard);
        let handle = Handle(broker.shutdown_handle());
        let mut ready = broker.ready_receiver();
        let task = tokio::spawn(async move {
            if let Err(error) = broker.run().await {
                warn!("the embedded MQTT broker has ended: {error}");
            }
        });
        // false only when its task has ended already, which is logged there
        let _ = ready.wait_for(|ready| *ready).await;
        Ok(Broker {
            addr,
            handle,
            secret,
            task,
            _watch: watch,
        })
    }

    /// Where it listens.
    pub(crate) fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// Where and as whom the runtime's own end comes in.
    pub(crate) fn address(&self) -> BrokerAddress {
        BrokerAddress {
            host: reachable(self.addr.ip()).to_string(),
            port: self.addr.port(),
            credentials: Some((RUNTIME_USER.to_owned(), self.secret.clone())),
            transport: rumqttc::Transport::tcp(),
        }
    }

    /// Closes all connections and stops.
    pub(crate) async fn stop(mut self) {
        self.handle.0.shutdown();
        if tokio::time::timeout(STOP_MAX, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }
}

/// The broker says its errors as text only: asks the system itself why it cannot listen.
async fn why_not(address: SocketAddr, error: &impl std::fmt::Display) -> GatewayError {
    match TcpListener::bind(address).await {
        Err(source) => listen_error(MQTT_LISTEN, address, source),
        Ok(_) => GatewayError::Broker(error.to_string()),
    }
}

/// True for a client whose session outlives its connection.
fn outlives(connect: &ConnectPacket) -> bool {
    ClientSession::expiry_from_connect(connect) != Some(0)
}

/// Limits of connections. Those of messages are the [`Guard`]'s own.
fn limits() -> ResourceLimits {
    ResourceLimits {
        max_connections: CLIENTS_MAX,
        max_connections_per_ip: CLIENTS_MAX,
        max_message_rate_per_client: 0,
        max_bandwidth_per_client: 0,
        max_connection_rate: CONNECTING_MAX,
        rate_limit_window: CONNECTING_TIME,
    }
}

fn config(address: SocketAddr, guard: Arc<Guard>) -> BrokerConfig {
    let auth = AuthConfig {
        allow_anonymous: true,
        auth_method: AuthMethod::None,
        rate_limit: RateLimitConfig {
            enabled: false,
            ..RateLimitConfig::default()
        },
        ..AuthConfig::default()
    };
    let storage = StorageConfig::new()
        .with_backend(StorageBackend::Memory)
        .with_persistence(true)
        .with_cleanup_interval(Duration::from_mins(1))
        .with_max_queued_messages_per_client(QUEUED_MAX)
        .with_max_queued_bytes_per_client(QUEUED_BYTES_MAX);
    BrokerConfig {
        bind_addresses: vec![address],
        max_clients: CLIENTS_MAX,
        session_expiry_interval: SESSION_EXPIRY,
        max_packet_size: PACKET_MAX,
        topic_alias_maximum: 64,
        retain_available: true,
        maximum_qos: 2,
        wildcard_subscription_available: true,
        subscription_identifier_available: true,
        shared_subscription_available: true,
        max_subscriptions_per_client: SUBSCRIPTIONS_MAX,
        max_retained_messages: RETAINED_MAX,
        max_retained_message_size: RETAINED_SIZE_MAX,
        client_channel_capacity: QUEUED_MAX,
        server_keep_alive: None,
        auth_config: auth,
        tls_config: None,
        websocket_config: None,
        websocket_tls_config: None,
        quic_config: None,
        cluster_listener_config: None,
        storage_config: storage,
        sys_topics_enabled: false,
        max_outbound_rate_per_client: 0,
        max_message_rate_per_client: 0,
        max_bandwidth_per_client: 0,
        bridges: Vec::new(),
        load_balancer: None,
        event_handler: Some(guard),
        ..BrokerConfig::default()
    }
}

/// Lets users in, to their topics only, and refuses commands with the retain flag.
struct Guard {
    access: BrokerAccess,
    secret: String,
    refused: mpsc::Sender<Refused>,
    // by client id; at most as many as may be connected
    rates: Mutex<HashMap<Arc<str>, Arc<Rate>>>,
    sessions: Sessions,
}

/// Who speaks on a connection.
enum Speaker {
    Runtime,
    User(User),
}

impl Guard {
    /// Who a user id of [`Guard::authenticate`] is; `None` for one that is not known.
    fn speaker(&self, user_id: Option<&str>) -> Option<Speaker> {
        match (user_id, &self.access.tokens) {
            (Some(RUNTIME_USER), _) => Some(Speaker::Runtime),
            (_, None) => Some(Speaker::User(User::anyone())),
            (Some(name), Some(tokens)) => tokens.now().user_named(name).map(Speaker::User),
            (None, Some(_)) => None,
        }
    }

    /// Ends the sessions of tokens that count no more, whenever there are other tokens.
    async fn end_revoked(self: Arc<Self>, broker: SocketAddr, mut tokens: LiveTokens) {
        let credentials = (RUNTIME_USER.to_owned(), self.secret.clone());
        let broker = SocketAddr::new(reachable(broker.ip()), broker.port());
        loop {
            tokens.changed().await;
            for (client_id, session) in self.sessions.revoked(&tokens.now()) {
                sessions::end(broker, &credentials, &client_id, session).await;
            }
        }
    }

    /// The user id of a connection that may come in.
    fn let_in(
        &self,
        connect: &ConnectPacket,
        address: SocketAddr,
    ) -> Result<Option<String>, (ReasonCode, String)> {
        let password = connect.password.as_deref().unwrap_or_default();
        let name = connect.username.as_deref();
        if name == Some(RUNTIME_USER) {
            return if bool::from(password.ct_eq(self.secret.as_bytes())) {
                Ok(name.map(ToOwned::to_owned))
            } else {
                Err(self.wrong(address, "that user is the runtime's own"))
            };
        }
        if connect.client_id == self.access.runtime_client_id {
            let text = "that client id is the runtime's own".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        let user = match &self.access.tokens {
            None => None,
            Some(tokens) => match tokens.now().user_of(password) {
                Some(user) if user.name.as_deref() == name => Some(user),
                _ => {
                    let text = "user and password are not name and token of a [[token]]";
                    return Err(self.wrong(address, text));
                }
            },
        };
        let session = self.sessions.of(&connect.client_id);
        let name_of = |user: Option<User>| user.and_then(|user| user.name);
        if session.is_some_and(|session| name_of(session.user) != name_of(user.clone())) {
            // a second connection of one client id ends the first
            let text = "its client id is in use by another user".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        match &connect.will {
            // a machine must not start because an HMI has gone
            Some(will) if self.is_inbound(&will.topic) => {
                let text = format!(
                    "its will on {} is a command; a will may be a presence",
                    will.topic
                );
                Err((ReasonCode::NotAuthorized, text))
            }
            Some(will) if !self.may_publish(name_of(user.clone()).as_deref(), &will.topic) => {
                let text = format!("it may not publish its will on {}", will.topic);
                Err((ReasonCode::NotAuthorized, text))
            }
            _ if !self.sessions.remember(&connect.client_id, outlives(connect)) => {
                let text = format!(
                    "the broker remembers {REMEMBERED_MAX} clients that may be away; take a clean session"
                );
                Err((ReasonCode::QuotaExceeded, text))
            }
            _ => {
                let name = name_of(user.clone());
                let speaks_5 = connect.protocol_version == MQTT_5;
                self.sessions
                    .admit(&connect.client_id, Admitted { user, speaks_5 });
                Ok(name)
            }
        }
    }

    /// The refusal of a wrong password; beyond the rate of its address another one.
    fn wrong(&self, address: SocketAddr, text: &str) -> (ReasonCode, String) {
        if self.sessions.count_wrong(address.ip()) {
            (ReasonCode::BadUsernameOrPassword, text.to_owned())
        } else {
            (ReasonCode::ConnectionRateExceeded, String::new())
        }
    }

    fn is_inbound(&self, topic: &str) -> bool {
        topic.strip_prefix(&self.access.root).is_some_and(is_inbound)
    }

    fn may_publish(&self, user_id: Option<&str>, topic: &str) -> bool {
        match self.speaker(user_id) {
            Some(Speaker::Runtime) => true,
            Some(Speaker::User(user)) => may_publish(&user, &self.access.root, topic),
            None => false,
        }
    }

    /// True for a message that the broker must not carry; then it is dealt with.
    fn keeps_back(&self, event: &ClientPublishEvent) -> bool {
        let user_id = event.user_id.as_deref();
        if !self.may_publish(user_id, &event.topic) {
            warn!("MQTT message on {} of {user_id:?} refused: its role", event.topic);
            return true;
        }
        if event.retain && !event.payload.is_empty() && self.is_inbound(&event.topic) {
            // when nobody takes them any more, refusing without a word is enough
            let _ = self
                .refused
                .try_send((event.topic.to_string(), event.payload.to_vec()));
            return true;
        }
        let path = event.topic.strip_prefix(&self.access.root);
        let (Some(Speaker::User(user)), Some(path)) = (self.speaker(user_id), path) else {
            return false;
        };
        match may_say(&user, path, &event.payload) {
            Ok(()) => false,
            Err(text) => {
                warn!("MQTT message on {} refused: {text}", event.topic);
                true
            }
        }
    }

    fn rate_of(&self, client_id: &Arc<str>) -> Arc<Rate> {
        let mut rates = self.rates.lock();
        let new = || Arc::new(Rate::new(CLIENT_BURST, CLIENT_PER_SECOND));
        Arc::clone(rates.entry(Arc::clone(client_id)).or_insert_with(new))
    }
}

type Answer<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

impl BrokerEventHandler for Guard {
    fn on_client_publish(&self, event: ClientPublishEvent) -> Answer<'_, PublishAction> {
        Box::pin(async move {
            // the runtime's own messages wait for nobody
            if event.user_id.as_deref() != Some(RUNTIME_USER) {
                let wait = self.rate_of(&event.client_id).owe();
                if !wait.is_zero() {
                    tokio::time::sleep(wait).await;
                }
            }
            if self.keeps_back(&event) {
                PublishAction::Handled
            } else {
                PublishAction::Continue
            }
        })
    }

    fn on_client_connect(&self, event: ClientConnectEvent) -> Answer<'_, ()> {
        let name = event.user_id.clone();
        self.sessions
            .connect(event, || match self.speaker(name.as_deref()) {
                Some(Speaker::User(user)) => Some(user),
                Some(Speaker::Runtime) | None => None,
            });
        Box::pin(std::future::ready(()))
    }

    fn on_client_disconnect(&self, event: ClientDisconnectEvent) -> Answer<'_, ()> {
        let mut rates = self.rates.lock();
        rates.remove(&event.client_id);
        drop(rates);
        self.sessions.disconnect(&event.client_id);
        Box::pin(std::future::ready(()))
    }
}

impl AuthProvider for Guard {
    fn authenticate<'a>(
        &'a self,
        connect: &'a ConnectPacket,
        address: SocketAddr,
    ) -> Answer<'a, mqtt5::Result<AuthResult>> {
        let result = match self.let_in(connect, address) {
            Ok(Some(user)) => AuthResult::success_with_user(user),
            Ok(None) => AuthResult::success(),
            // beyond the rate nothing is logged, so that nobody fills the log
            Err((code @ ReasonCode::ConnectionRateExceeded, _)) => AuthResult::fail(code),
            Err((code, text)) => {
                warn!(
                    "MQTT client {:.64} at {address} refused: {text}",
                    connect.client_id
                );
                AuthResult::fail(code)
            }
        };
        Box::pin(std::future::ready(Ok(result)))
    }

    // An acknowledgement that says "not authorized" is for clients of MQTT 5 alone: over 3.1.1 the same bytes are an
    // error of protocol, on which a client connects again and says the message again. From those, `keeps_back` keeps it.
    fn authorize_publish<'a>(
        &'a self,
        client_id: &str,
        user: Option<&'a str>,
        topic: &'a str,
    ) -> Answer<'a, bool> {
        let speaks_5 = self
            .sessions
            .of(client_id)
            .is_some_and(|session| session.speaks_5);
        Box::pin(std::future::ready(!speaks_5 || self.may_publish(user, topic)))
    }

    fn authorize_subscribe<'a>(&'a self, _: &str, user: Option<&'a str>, _: &'a str) -> Answer<'a, bool> {
        let may = match self.speaker(user) {
            Some(Speaker::Runtime) => true,
            Some(Speaker::User(user)) => may_subscribe(&user),
            None => false,
        };
        Box::pin(std::future::ready(may))
    }
}
