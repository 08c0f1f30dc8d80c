//! The embedded MQTT broker, in memory only. With tokens, user and password are name and token; without, it listens on
//! the loopback only and admits everyone. Only the runtime publishes states.
//!
//! Every setting of the library is set here, because its defaults listen on all addresses and write files. Commands,
//! claims and settings with the retain flag are refused: they would be carried out again at the next start.

mod door;
mod line;
mod retained;
mod sessions;
mod socket;

use std::future::{Future, ready};
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use mqtt5::QoS;
use mqtt5::broker::auth::AuthResult;
use mqtt5::broker::config::StorageConfig;
use mqtt5::broker::events::{
    BrokerEventHandler, ClientConnectEvent, ClientDisconnectEvent, ClientPublishEvent, RetainedSetEvent,
};
use mqtt5::broker::router::MessageRouter;
use mqtt5::broker::storage::{ClientSession, QueueLimits};
use mqtt5::broker::{BrokerConfig, DynamicStorage, MemoryBackend};
use mqtt5::packet::connect::ConnectPacket;
use mqtt5::packet::publish::PublishPacket;
use mqtt5::types::ReasonCode;
use plc_api::server::{AccessKind, ServerNotice, ServerTransport};
use plc_api::wire::mqtt::{Inbound, decode};
use plc_api::wire::right::Right;
use tokio::sync::{broadcast, mpsc};
use tokio_util::task::{AbortOnDropHandle, TaskTracker};
use tracing::warn;

use crate::access::topics::{may_publish, may_subscribe};
use crate::access::{Rates, Shown, User, Users};
use crate::broker_address::Refused;
use crate::contract::topics::is_inbound;
use crate::error::GatewayError;
use crate::machine::Machine;
use crate::places::{Place, Places, host_of};
use crate::settings::{MQTT_LISTEN, MqttSettings, bind};
use crate::tls::{Fingerprint, LiveTls};
use door::{Counts, Hall, PLACES, RESERVED};
use line::OnTheWay;
use retained::{Kind, Retained};
pub(crate) use sessions::Sessions;
use sessions::{REMEMBERED_MAX, Session};
pub(crate) use socket::SocketBytes;

/// Clients that may be connected; more are refused.
const CLIENTS_MAX: usize = PLACES.known;
/// Bytes of one packet. Reason: the largest message, `birth`, stays far below.
pub(crate) const PACKET_MAX: usize = 1024 * 1024;
/// Subscriptions of one client.
const SUBSCRIPTIONS_MAX: usize = 1024;
/// Bytes of one retained message.
const RETAINED_SIZE_MAX: usize = 256 * 1024;
/// How long the broker remembers an absent client; messages for it wait in memory.
const SESSION_EXPIRY: Duration = Duration::from_hours(1);
/// Messages that wait for one client; the oldest are dropped for more.
const QUEUED_MAX: usize = 1000;
/// Bytes that wait for one client: 160 MiB for all that are connected or remembered.
const QUEUED_BYTES_MAX: usize = 512 * 1024;
/// Messages on their way to one client that is connected, of each quality of service; more wait, or are dropped with
/// quality 0.
pub(crate) const ON_THE_WAY_MAX: usize = 128;
/// Messages of quality 2 that one client has begun and not finished; more end its connection.
const UNFINISHED_MAX: u16 = 256;
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

/// Who may connect, and as what.
pub(crate) struct BrokerAccess {
    /// Topic root of the machine, with its last slash.
    pub(crate) root: String,
    /// Client id of the runtime's own connection; others may not use it.
    pub(crate) runtime_client_id: String,
    /// Users; `None`: everyone.
    pub(crate) users: Option<Users>,
    /// Hears of what is refused.
    pub(crate) machine: Machine,
}

/// The embedded broker while it runs.
pub(crate) struct Broker {
    addr: SocketAddr,
    stop: broadcast::Sender<()>,
    clients: TaskTracker,
    sessions: Arc<Sessions>,
    exchange: Exchange,
    entrance: Entrance,
    _hall: AbortOnDropHandle<()>,
}

/// Where messages are handed on.
#[derive(Clone)]
pub(crate) struct Exchange {
    guard: Arc<Guard>,
    pub(crate) router: Arc<MessageRouter>,
}

impl Exchange {
    /// The payload as one that counts while it is on its way.
    pub(crate) fn count(&self, payload: Bytes) -> Bytes {
        self.guard.on_the_way.count(payload)
    }

    /// Closes clients that take nothing, where there is no room for so many bytes.
    pub(crate) fn make_room(&self, bytes: usize) {
        self.guard.on_the_way.has_room(bytes);
    }
}

/// Where clients over WebSocket come in.
#[derive(Clone)]
pub(crate) struct Entrance(Arc<Hall>);

impl Entrance {
    /// Serves a client until it has gone.
    pub(crate) async fn serve(
        &self,
        bytes: SocketBytes,
        address: SocketAddr,
        certificate: Option<Fingerprint>,
    ) {
        Arc::clone(&self.0)
            .serve_socket(bytes, address, certificate)
            .await;
    }
}

impl Broker {
    /// Starts the broker. Commands with the retain flag go to `refused` while it has room.
    pub(crate) fn start(
        address: SocketAddr,
        access: BrokerAccess,
        tls: Option<LiveTls>,
        refused: mpsc::Sender<Refused>,
    ) -> Result<Broker, GatewayError> {
        let sessions = Arc::<Sessions>::default();
        let guard = Arc::new(Guard {
            access,
            refused,
            rates: Rates::new(CLIENT_BURST, CLIENT_PER_SECOND),
            wrong: Rates::new(WRONG_BURST, WRONG_PER_SECOND),
            sessions: Arc::clone(&sessions),
            retained: Retained::default(),
            on_the_way: OnTheWay::default(),
        });
        let listener = bind(MQTT_LISTEN, address)?;
        let addr = listener.local_addr().unwrap_or(address);
        let queues = QueueLimits {
            max_messages: QUEUED_MAX,
            max_bytes: QUEUED_BYTES_MAX,
        };
        let storage = Arc::new(DynamicStorage::Memory(MemoryBackend::with_queue_limits(queues)));
        let router = MessageRouter::with_storage(Arc::clone(&storage))
            .with_fallback_queue_limits(queues)
            .with_retained_limits(0, RETAINED_SIZE_MAX)
            .with_event_handler(Arc::<Guard>::clone(&guard));
        let router = Arc::new(router);
        let exchange = Exchange {
            guard: Arc::clone(&guard),
            router: Arc::clone(&router),
        };
        let (stop, _) = broadcast::channel(1);
        let clients = TaskTracker::new();
        let hall = Arc::new(Hall {
            config: config(address),
            guard,
            router,
            storage,
            tls,
            stop: stop.clone(),
            clients: clients.clone(),
            places: Places::new(PLACES),
            counts: Counts::new(),
        });
        Ok(Broker {
            addr,
            stop,
            clients,
            sessions,
            exchange,
            entrance: Entrance(Arc::clone(&hall)),
            _hall: AbortOnDropHandle::new(tokio::spawn(hall.run(listener))),
        })
    }

    /// Where clients over WebSocket come in, if the settings let them.
    pub(crate) fn entrance(&self, settings: &MqttSettings) -> Option<Entrance> {
        settings.websocket.then(|| self.entrance.clone())
    }

    /// Its clients.
    pub(crate) fn sessions(&self) -> Arc<Sessions> {
        Arc::clone(&self.sessions)
    }

    /// The address it listens on.
    pub(crate) fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// What the runtime's own connection goes to.
    pub(crate) fn exchange(&self) -> Exchange {
        self.exchange.clone()
    }

    /// Closes all connections and stops.
    pub(crate) async fn stop(self) {
        // an error only if nobody listens any more
        let _ = self.stop.send(());
        self.clients.close();
        let _ = tokio::time::timeout(STOP_MAX, self.clients.wait()).await;
    }
}

/// The user of a connection: with a password, the owner of that token, or of the login that has given it; without, of the
/// certificate that it has shown. With a password the name must be the user's, without one a name that is given.
fn who(users: &Users, connect: &ConnectPacket, certificate: Option<&Fingerprint>) -> Option<Shown> {
    let (name, password) = (connect.username.as_deref(), connect.password.as_deref());
    let shown = users.who(password, certificate)?;
    let is_named = shown.user.name() == name || name.is_none() && password.is_none();
    is_named.then_some(shown)
}

/// What clears a retained topic.
fn clearing(topic: &str) -> PublishPacket {
    let mut clear = PublishPacket::new(topic, Vec::new(), QoS::AtLeastOnce);
    clear.retain = true;
    clear
}

/// True for a client whose session outlives its connection.
fn outlives(connect: &ConnectPacket) -> bool {
    ClientSession::expiry_from_connect(connect) != Some(0)
}

/// Settings of the library for each client.
fn config(address: SocketAddr) -> BrokerConfig {
    let storage = StorageConfig::new()
        .with_persistence(true)
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
        max_retained_message_size: RETAINED_SIZE_MAX,
        client_channel_capacity: ON_THE_WAY_MAX,
        server_receive_maximum: Some(UNFINISHED_MAX),
        server_keep_alive: None,
        storage_config: storage,
        sys_topics_enabled: false,
        ..BrokerConfig::default()
    }
}

/// What becomes of a message.
enum Judged {
    /// It is delivered, after this retained topic is cleared for it.
    Deliver { clear: Option<String> },
    /// It is not, and has been handled.
    Handled,
    /// It is not, because it cannot be kept.
    NotKept,
}

/// Admits users, to their topics only, and refuses commands with the retain flag.
struct Guard {
    access: BrokerAccess,
    refused: mpsc::Sender<Refused>,
    // by client id
    rates: Rates<Arc<str>>,
    // by address
    wrong: Rates<IpAddr>,
    sessions: Arc<Sessions>,
    retained: Retained,
    on_the_way: OnTheWay,
}

impl Guard {
    /// The user with a user id of [`Guard::authenticate`]; `None` for an unknown one.
    fn user(&self, user_id: Option<&str>) -> Option<User> {
        match &self.access.users {
            None => Some(User::Anyone),
            Some(users) => users.tokens.now().user_named(user_id?),
        }
    }

    /// The user id of a connection that is admitted and what it has shown, or why it is refused.
    fn admit(
        &self,
        connect: &ConnectPacket,
        certificate: Option<&Fingerprint>,
        from: SocketAddr,
        place: &Place,
    ) -> Result<(Option<String>, Option<Shown>), (ReasonCode, String)> {
        let client_id = connect.client_id.as_str();
        if client_id == self.access.runtime_client_id {
            let text = "that client id is the runtime's own".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        let shown = match &self.access.users {
            None => User::Anyone.into(),
            Some(users) => who(users, connect, certificate)
                .ok_or_else(|| self.wrong(from, "user and password are not name and token of a [[token]] or of a login, and there is no certificate of a [[certificate]]"))?,
        };
        let user = shown.user.clone();
        let other = self.sessions.of(client_id);
        if other.is_some_and(|other| other.user.as_ref().and_then(User::name) != user.name()) {
            // a second connection of one client id ends the first
            let text = "its client id is in use by another user".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        self.check_will(&user, connect)?;
        let reserved = if user.has(Right::Operate) { 0 } else { RESERVED };
        if !place.know(reserved) {
            let text = format!("{CLIENTS_MAX} clients are connected, which is the limit");
            return Err((ReasonCode::ServerBusy, text));
        }
        place.stay();
        if !self.sessions.remember(client_id, outlives(connect)) {
            let text = format!(
                "the broker remembers {REMEMBERED_MAX} clients that may be away; take a clean session"
            );
            return Err((ReasonCode::QuotaExceeded, text));
        }
        let user_id = user.name().map(ToOwned::to_owned);
        let session = Session {
            from: Some(from.ip()),
            user: Some(user),
            speaks_5: connect.protocol_version == MQTT_5,
            is_revoked: false,
        };
        self.sessions.admit(client_id, session);
        Ok((user_id, Some(shown)))
    }

    /// What keeps a client out because of its will.
    fn check_will(&self, user: &User, connect: &ConnectPacket) -> Result<(), (ReasonCode, String)> {
        let refused_will = match connect.will.as_ref().map(|will| &will.topic) {
            // a machine must not start because an HMI has gone
            Some(topic) if self.is_inbound(topic) => Some(format!(
                "its will on {topic} is a command; a will may be a presence"
            )),
            Some(topic) if !may_publish(user, &self.access.root, topic) => {
                Some(format!("it may not publish its will on {topic}"))
            }
            _ => None,
        };
        if let Some(text) = refused_will {
            return Err((ReasonCode::NotAuthorized, text));
        }
        if let Some(will) = connect.will.as_ref().filter(|will| will.retain)
            && let Err(text) = self
                .retained
                .put(self.kind(&will.topic), &will.topic, will.payload.len())
        {
            self.tell_not_kept(&will.topic, &connect.client_id, &text);
            let text = format!("its will on {} could not be kept: {text}", will.topic);
            return Err((ReasonCode::QuotaExceeded, text));
        }
        Ok(())
    }

    /// The refusal of a wrong password; another one beyond the rate of its address.
    fn wrong(&self, from: SocketAddr, text: &str) -> (ReasonCode, String) {
        match self.wrong.of(&host_of(from.ip())).take() {
            Ok(()) => {
                let (from, over) = (Some(from.ip()), ServerTransport::Mqtt);
                let connect = "CONNECT".to_owned();
                (self.access.machine).note(AccessKind::LoginRefused, None, from, over, connect);
                (ReasonCode::BadUsernameOrPassword, text.to_owned())
            }
            Err(_) => (ReasonCode::ConnectionRateExceeded, String::new()),
        }
    }

    fn is_inbound(&self, topic: &str) -> bool {
        topic.strip_prefix(&self.access.root).is_some_and(is_inbound)
    }

    /// True for a request that passes every queue.
    fn is_urgent(&self, topic: &str, payload: &[u8]) -> bool {
        let path = topic.strip_prefix(&self.access.root);
        path.is_some_and(|path| matches!(decode(path, payload, false), Inbound::Ask { urgent: true, .. }))
    }

    fn may_publish(&self, user_id: Option<&str>, topic: &str) -> bool {
        self.user(user_id)
            .is_some_and(|user| may_publish(&user, &self.access.root, topic))
    }

    /// True for a message that the broker must not deliver; it has been handled.
    fn keeps_back(&self, event: &ClientPublishEvent) -> bool {
        let user_id = event.user_id.as_deref();
        if !self.may_publish(user_id, &event.topic) {
            warn!("MQTT message on {} of {user_id:?} refused: its role", event.topic);
            let from = self.sessions.address_of(&event.client_id);
            let (over, topic) = (ServerTransport::Mqtt, event.topic.to_string());
            (self.access.machine).note(AccessKind::Forbidden, user_id, from, over, topic);
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

impl Guard {
    async fn judge(&self, event: &ClientPublishEvent) -> Judged {
        let wait = self.rates.of(&event.client_id).owe();
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        if self.keeps_back(event) {
            return Judged::Handled;
        }
        if !event.retain {
            return Judged::Deliver { clear: None };
        }
        match self
            .retained
            .put(self.kind(&event.topic), &event.topic, event.payload.len())
        {
            Ok(clear) => Judged::Deliver { clear },
            Err(text) => {
                self.tell_not_kept(&event.topic, &event.client_id, &text);
                Judged::NotKept
            }
        }
    }

    /// Topics below the root that a client may retain are presences.
    fn kind(&self, topic: &str) -> Kind {
        if topic.starts_with(&self.access.root) {
            Kind::Presence
        } else {
            Kind::Other
        }
    }

    /// Tells the operator that messages are not kept; it stands until there is room again.
    fn tell_not_kept(&self, topic: &str, client: &str, text: &str) {
        if !self.retained.is_newly_full() {
            return;
        }
        let text = format!("retained message on {topic:.128} of {client:.64} refused: {text}");
        warn!("{text}");
        self.access.machine.notice(ServerNotice::NotKept(Some(text)));
    }

    fn speaks_5(&self, client_id: &str) -> bool {
        self.sessions
            .of(client_id)
            .is_some_and(|session| session.speaks_5)
    }

    fn authenticate(
        &self,
        connect: &ConnectPacket,
        certificate: Option<&Fingerprint>,
        address: SocketAddr,
        place: &Place,
    ) -> (AuthResult, Option<Shown>) {
        let (user_id, shown) = match self.admit(connect, certificate, address, place) {
            Ok(admitted) => admitted,
            // beyond the rate nothing is logged, so that nobody can fill the log
            Err((code @ ReasonCode::ConnectionRateExceeded, _)) => return (AuthResult::fail(code), None),
            Err((code, text)) => {
                warn!(
                    "MQTT client {:.64} at {address} refused: {text}",
                    connect.client_id
                );
                return (AuthResult::fail(code), None);
            }
        };
        let admitted = user_id.map_or_else(AuthResult::success, AuthResult::success_with_user);
        (admitted, shown)
    }

    // Only clients of MQTT 5 understand an acknowledgement "not authorized". Over 3.1.1 the same bytes are a protocol error,
    // after which the client reconnects and publishes again: there `keeps_back` drops the message. The will of a revoked
    // user is still published: it is how others learn that a handler has gone.
    fn authorize_publish(&self, client_id: &str, user: Option<&str>, topic: &str) -> Answer<'static, bool> {
        let session = self.sessions.of(client_id).unwrap_or_default();
        Box::pin(ready(
            !session.speaks_5 || session.is_revoked || self.may_publish(user, topic),
        ))
    }

    fn authorize_subscribe(&self, user: Option<&str>) -> Answer<'static, bool> {
        Box::pin(ready(self.user(user).as_ref().is_some_and(may_subscribe)))
    }
}

impl BrokerEventHandler for Guard {
    fn on_client_connect(&self, event: ClientConnectEvent) -> Answer<'_, ()> {
        let user = || self.user(event.user_id.as_deref());
        self.sessions.connect(event.client_id, user);
        Box::pin(ready(()))
    }

    fn on_client_disconnect(&self, event: ClientDisconnectEvent) -> Answer<'_, ()> {
        self.sessions.disconnect(&event.client_id);
        Box::pin(ready(()))
    }

    fn on_retained_set(&self, event: RetainedSetEvent) -> Answer<'_, ()> {
        // the states of the runtime have no limit but their own number
        let is_of_runtime = event.topic.starts_with(&self.access.root) && !self.is_inbound(&event.topic);
        if !is_of_runtime {
            let kind = self.kind(&event.topic);
            if self.retained.kept(kind, &event.topic, &event.payload) {
                self.access.machine.notice(ServerNotice::NotKept(None));
            }
        }
        Box::pin(ready(()))
    }
}
