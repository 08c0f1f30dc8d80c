//! The embedded MQTT broker, in memory only. With tokens, user and password are name and token; without, it listens on
//! the loopback only and admits everyone. Only the runtime publishes states.
//!
//! Every setting of the library is set here, because its defaults listen on all addresses and write files. Commands,
//! claims and settings with the retain flag are refused: they would be carried out again at the next start.

mod sessions;

use std::future::{Future, ready};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use mqtt5::broker::auth::AuthResult;
use mqtt5::broker::config::{AuthConfig, AuthMethod, RateLimitConfig, StorageBackend, StorageConfig};
use mqtt5::broker::events::{
    BrokerEventHandler, ClientConnectEvent, ClientDisconnectEvent, ClientPublishEvent, PublishAction,
};
use mqtt5::broker::router::MessageRouter;
use mqtt5::broker::storage::ClientSession;
use mqtt5::broker::{AuthProvider, BrokerConfig, BrokerShutdownHandle, MqttBroker, ResourceLimits};
use mqtt5::packet::connect::ConnectPacket;
use mqtt5::types::ReasonCode;
use subtle::ConstantTimeEq;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::task::AbortOnDropHandle;
use tracing::warn;

use crate::access::topics::{may_publish, may_subscribe};
use crate::access::{LiveTokens, Rates, User, random_secret};
use crate::broker_address::{BrokerAddress, Refused};
use crate::contract::topics::is_inbound;
use crate::error::GatewayError;
use crate::settings::{MQTT_LISTEN, bind};
use sessions::{REMEMBERED_MAX, Session, Sessions};

/// Clients that may be connected; more are refused.
const CLIENTS_MAX: usize = 256;
/// New connections within [`CONNECTING_TIME`], the time that the library gives each to identify itself. Reason: with all
/// clients of MQTT and HTTP they stay below the 1024 files that a process may have open.
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
/// How long the broker remembers an absent client; messages for it wait in memory.
const SESSION_EXPIRY: Duration = Duration::from_hours(1);
/// Messages that wait for one client; more are dropped by the broker.
const QUEUED_MAX: usize = 1000;
/// Bytes that wait for one client.
const QUEUED_BYTES_MAX: usize = 8 * 1024 * 1024;
/// Time to stop; then its task is ended.
const STOP_MAX: Duration = Duration::from_secs(2);

/// Messages of one client: burst, and rate per second. Further ones are delayed, not refused: over MQTT 3.1.1 a refused
/// message is lost silently. Reason: one process may serve 8 coordinate systems with 200 M codes a second, each with a
/// claim and a reset.
const CLIENT_BURST: u32 = 10_000;
const CLIENT_PER_SECOND: u32 = 5000;

/// Wrong tokens from one address: burst, and rate per second. Further ones are refused as too many.
const WRONG_BURST: u32 = 50;
const WRONG_PER_SECOND: u32 = 10;

/// Protocol version of MQTT 5 in its CONNECT packet.
const MQTT_5: u8 = 5;

/// User of the runtime's own connection. No token has this name.
const RUNTIME_USER: &str = "$runtime";

/// Who may connect, and as what.
pub(crate) struct BrokerAccess {
    /// Topic root of the machine, with its last slash.
    pub(crate) root: String,
    /// Client id of the runtime's own connection; others may not use it.
    pub(crate) runtime_client_id: String,
    /// Users; `None`: everyone.
    pub(crate) tokens: Option<LiveTokens>,
}

/// The embedded broker while it runs.
pub(crate) struct Broker {
    addr: SocketAddr,
    handle: BrokerShutdownHandle,
    secret: String,
    task: JoinHandle<()>,
    // closes the connections of revoked tokens
    _watch: Option<AbortOnDropHandle<()>>,
}

impl Broker {
    /// Starts the broker. Commands with the retain flag go to `refused` while it has room.
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
            rates: Rates::new(CLIENT_BURST, CLIENT_PER_SECOND),
            wrong: Rates::new(WRONG_BURST, WRONG_PER_SECOND),
            sessions: Sessions::default(),
        });
        let broker = match MqttBroker::with_config(config(address, Arc::clone(&guard))).await {
            Ok(broker) => broker,
            // the library gives its errors as text only: ask the system why it cannot listen
            Err(error) => {
                let listening = bind(MQTT_LISTEN, address).await.err();
                return Err(listening.unwrap_or_else(|| GatewayError::Broker(error.to_string())));
            }
        };
        broker.resource_monitor().update_limits(limits());
        let addr = broker.local_addr().unwrap_or(address);
        let watch = guard.access.tokens.clone().map(|tokens| {
            let watch = Arc::clone(&guard).close_revoked(broker.router(), tokens);
            AbortOnDropHandle::new(tokio::spawn(watch))
        });
        let mut broker = broker.with_auth_provider(guard);
        let handle = broker.shutdown_handle();
        let mut ready = broker.ready_receiver();
        let task = tokio::spawn(async move {
            if let Err(error) = broker.run().await {
                warn!("the embedded MQTT broker has ended: {error}");
            }
        });
        // an error only if the task has ended already, which it logs
        let _ = ready.wait_for(|ready| *ready).await;
        Ok(Broker {
            addr,
            handle,
            secret,
            task,
            _watch: watch,
        })
    }

    /// The address it listens on.
    pub(crate) fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// Address and credentials of the runtime's own connection.
    pub(crate) fn address(&self) -> BrokerAddress {
        BrokerAddress {
            host: self.local_ip().to_string(),
            port: self.addr.port(),
            credentials: Some((RUNTIME_USER.to_owned(), self.secret.clone())),
            transport: rumqttc::Transport::tcp(),
        }
    }

    /// A broker that listens on every address is reached over the loopback.
    fn local_ip(&self) -> IpAddr {
        match self.addr.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        }
    }

    /// Closes all connections and stops.
    pub(crate) async fn stop(mut self) {
        self.handle.shutdown();
        if tokio::time::timeout(STOP_MAX, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }
}

/// True for a client whose session outlives its connection.
fn outlives(connect: &ConnectPacket) -> bool {
    ClientSession::expiry_from_connect(connect) != Some(0)
}

/// Limits of connections. Messages are limited by the [`Guard`].
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

/// Admits users, to their topics only, and refuses commands with the retain flag.
struct Guard {
    access: BrokerAccess,
    secret: String,
    refused: mpsc::Sender<Refused>,
    // by client id
    rates: Rates<Arc<str>>,
    // by address
    wrong: Rates<IpAddr>,
    sessions: Sessions,
}

impl Guard {
    /// The user with a user id of [`Guard::authenticate`]; `None` for an unknown one, and for the runtime itself.
    fn user(&self, user_id: Option<&str>) -> Option<User> {
        match (&self.access.tokens, user_id) {
            (_, Some(RUNTIME_USER)) => None,
            (None, _) => Some(User::Anyone),
            (Some(tokens), name) => tokens.now().user_named(name?),
        }
    }

    /// Closes the connections of revoked tokens whenever the tokens change.
    async fn close_revoked(self: Arc<Self>, router: Arc<MessageRouter>, mut tokens: LiveTokens) {
        loop {
            tokens.changed().await;
            for (client_id, user) in self.sessions.revoke(&tokens.now()) {
                router.unregister_client(&client_id).await;
                let name = user.name().unwrap_or_default();
                warn!("MQTT client {client_id:.64} of {name} is disconnected: its token counts no more");
            }
        }
    }

    /// The user id of a connection that is admitted, or why it is refused.
    fn admit(
        &self,
        connect: &ConnectPacket,
        from: SocketAddr,
    ) -> Result<Option<String>, (ReasonCode, String)> {
        let password = connect.password.as_deref().unwrap_or_default();
        let name = connect.username.as_deref();
        let client_id = connect.client_id.as_str();
        if name == Some(RUNTIME_USER) {
            if !bool::from(password.ct_eq(self.secret.as_bytes())) {
                return Err(self.wrong(from, "that user is the runtime's own"));
            }
            self.sessions.admit(client_id, Session::default());
            return Ok(name.map(ToOwned::to_owned));
        }
        if client_id == self.access.runtime_client_id {
            let text = "that client id is the runtime's own".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        let user = match &self.access.tokens {
            None => User::Anyone,
            Some(tokens) => (tokens.now().user_of(password))
                .filter(|user| user.name() == name)
                .ok_or_else(|| self.wrong(from, "user and password are not name and token of a [[token]]"))?,
        };
        let other = self.sessions.of(client_id);
        if other.is_some_and(|other| other.user.as_ref().and_then(User::name) != user.name()) {
            // a second connection of one client id ends the first
            let text = "its client id is in use by another user".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        let refused_will = match connect.will.as_ref().map(|will| &will.topic) {
            // a machine must not start because an HMI has gone
            Some(topic) if self.is_inbound(topic) => Some(format!(
                "its will on {topic} is a command; a will may be a presence"
            )),
            Some(topic) if !may_publish(&user, &self.access.root, topic) => {
                Some(format!("it may not publish its will on {topic}"))
            }
            _ => None,
        };
        if let Some(text) = refused_will {
            return Err((ReasonCode::NotAuthorized, text));
        }
        if !self.sessions.remember(client_id, outlives(connect)) {
            let text = format!(
                "the broker remembers {REMEMBERED_MAX} clients that may be away; take a clean session"
            );
            return Err((ReasonCode::QuotaExceeded, text));
        }
        let user_id = user.name().map(ToOwned::to_owned);
        let session = Session {
            user: Some(user),
            speaks_5: connect.protocol_version == MQTT_5,
            is_revoked: false,
        };
        self.sessions.admit(client_id, session);
        Ok(user_id)
    }

    /// The refusal of a wrong password; another one beyond the rate of its address.
    fn wrong(&self, from: SocketAddr, text: &str) -> (ReasonCode, String) {
        match self.wrong.of(&from.ip()).take() {
            Ok(()) => (ReasonCode::BadUsernameOrPassword, text.to_owned()),
            Err(_) => (ReasonCode::ConnectionRateExceeded, String::new()),
        }
    }

    fn is_inbound(&self, topic: &str) -> bool {
        topic.strip_prefix(&self.access.root).is_some_and(is_inbound)
    }

    fn may_publish(&self, user_id: Option<&str>, topic: &str) -> bool {
        let user_may = |user| may_publish(&user, &self.access.root, topic);
        user_id == Some(RUNTIME_USER) || self.user(user_id).is_some_and(user_may)
    }

    /// True for a message that the broker must not deliver; it has been handled.
    fn keeps_back(&self, event: &ClientPublishEvent) -> bool {
        let user_id = event.user_id.as_deref();
        if !self.may_publish(user_id, &event.topic) {
            warn!("MQTT message on {} of {user_id:?} refused: its role", event.topic);
            return true;
        }
        if event.retain && !event.payload.is_empty() && self.is_inbound(&event.topic) {
            // without room it is refused silently
            let _ = self
                .refused
                .try_send((event.topic.to_string(), event.payload.to_vec()));
            return true;
        }
        false
    }
}

type Answer<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

impl BrokerEventHandler for Guard {
    fn on_client_publish(&self, event: ClientPublishEvent) -> Answer<'_, PublishAction> {
        Box::pin(async move {
            // the runtime's own messages are never delayed
            if event.user_id.as_deref() != Some(RUNTIME_USER) {
                let wait = self.rates.of(&event.client_id).owe();
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
        let user = || self.user(event.user_id.as_deref());
        self.sessions.connect(event.client_id, user);
        Box::pin(ready(()))
    }

    fn on_client_disconnect(&self, event: ClientDisconnectEvent) -> Answer<'_, ()> {
        self.sessions.disconnect(&event.client_id);
        Box::pin(ready(()))
    }
}

impl AuthProvider for Guard {
    fn authenticate<'a>(
        &'a self,
        connect: &'a ConnectPacket,
        address: SocketAddr,
    ) -> Answer<'a, mqtt5::Result<AuthResult>> {
        let result = match self.admit(connect, address) {
            Ok(Some(user)) => AuthResult::success_with_user(user),
            Ok(None) => AuthResult::success(),
            // beyond the rate nothing is logged, so that nobody can fill the log
            Err((code @ ReasonCode::ConnectionRateExceeded, _)) => AuthResult::fail(code),
            Err((code, text)) => {
                warn!(
                    "MQTT client {:.64} at {address} refused: {text}",
                    connect.client_id
                );
                AuthResult::fail(code)
            }
        };
        Box::pin(ready(Ok(result)))
    }

    // Only clients of MQTT 5 understand an acknowledgement "not authorized". Over 3.1.1 the same bytes are a protocol error,
    // after which the client reconnects and publishes again: there `keeps_back` drops the message. The will of a revoked
    // user is still published: it is how others learn that a handler has gone.
    fn authorize_publish<'a>(
        &'a self,
        client_id: &str,
        user: Option<&'a str>,
        topic: &'a str,
    ) -> Answer<'a, bool> {
        let session = self.sessions.of(client_id).unwrap_or_default();
        Box::pin(ready(
            !session.speaks_5 || session.is_revoked || self.may_publish(user, topic),
        ))
    }

    fn authorize_subscribe<'a>(&'a self, _: &str, user: Option<&'a str>, _: &'a str) -> Answer<'a, bool> {
        Box::pin(ready(
            user == Some(RUNTIME_USER) || self.user(user).as_ref().is_some_and(may_subscribe),
        ))
    }
}
