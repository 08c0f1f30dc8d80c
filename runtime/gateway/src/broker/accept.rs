//! Accepts clients: each connection takes a slot, and has its own event handler and access check.

use std::future::ready as now;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use mqtt5::QoS;
use mqtt5::broker::auth::AuthResult;
use mqtt5::broker::client_handler::ClientHandler;
use mqtt5::broker::events::{
    BrokerEventHandler, ClientConnectEvent, ClientDisconnectEvent, ClientPublishEvent, PublishAction,
};
use mqtt5::broker::router::MessageRouter;
use mqtt5::broker::storage::{DynamicStorage, StorageBackend};
use mqtt5::broker::sys_topics::BrokerStats;
use mqtt5::broker::transport::BrokerTransport;
use mqtt5::broker::{AuthProvider, BrokerConfig, ResourceLimits, ResourceMonitor};
use mqtt5::packet::connect::ConnectPacket;
use mqtt5::packet::publish::PublishPacket;
use mqtt5::types::ReasonCode;
use parking_lot::Mutex;
use plc_protocol::supervisor::Supervisor;
use plc_protocol::wire::row::ParsedRequest;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{broadcast, oneshot};
use tokio::time::Instant;
use tokio_util::either::Either;
use tokio_util::task::TaskTracker;
use tracing::warn;

use super::guard::{Answer, Guard, PublishDecision, clearing};
use super::guarded_stream::{ClientTransport, GuardedStream};
use super::packet_monitor::{ExactlyOnce, HEAD_BYTES_MAX, PacketMonitor, USER_PUBLISH_BYTES_MAX};
use super::socket::SocketBytes;
use crate::access::{AuthenticatedUser, CloseReason};
use crate::arrivals::{ARRIVAL, EXECUTED};
use crate::certificate::ClientCertificate;
use crate::connection_slots::{ACCEPT_RETRY, ConnectionSlot, ConnectionSlots, SlotLimits};
use crate::tls::{AcceptedClient, LiveTls};
use crate::urgent_slots::ExecuteUrgent;

/// Connection slots. A client becomes known when it is authenticated, and is then never evicted. Reason for the total:
/// together with HTTP it stays below the 1024 files that a process may have open.
pub(crate) const SLOT_LIMITS: SlotLimits = SlotLimits {
    all: 448,
    of_one: 128,
    unauthenticated: 192,
    known: 256,
};

/// How often expired sessions and messages are removed.
const CLEAN_INTERVAL: Duration = Duration::from_mins(1);

/// State shared by all connections.
pub(super) struct BrokerServer {
    pub(super) config: BrokerConfig,
    pub(super) guard: Arc<Guard>,
    pub(super) router: Arc<MessageRouter>,
    pub(super) storage: Arc<DynamicStorage>,
    /// If set, clients use TLS.
    pub(super) tls: Option<LiveTls>,
    pub(super) stop: broadcast::Sender<()>,
    pub(super) clients: TaskTracker,
    pub(super) slots: Arc<ConnectionSlots>,
    pub(super) counts: Counts,
    pub(super) supervisor: Supervisor,
}

/// An accepted connection that is not authenticated yet.
struct PendingConnection {
    transport: ClientTransport,
    address: SocketAddr,
    certificate: Option<ClientCertificate>,
    /// False if the client uses no TLS although the machine has a certificate. The broker rejects the connection
    /// with this reason.
    is_open: bool,
}

/// Counters and limits that the library requires. They limit nothing here; the guard does.
pub(super) struct Counts {
    stats: Arc<BrokerStats>,
    monitor: Arc<ResourceMonitor>,
}

impl Counts {
    pub(super) fn new() -> Self {
        Self {
            stats: Arc::new(BrokerStats::new()),
            monitor: Arc::new(ResourceMonitor::new(no_limits())),
        }
    }
}

impl BrokerServer {
    /// Accepts clients until it is stopped.
    pub(super) async fn run(self: Arc<Self>, listener: TcpListener) {
        let mut stopped = self.stop.subscribe();
        let mut clean = tokio::time::interval(CLEAN_INTERVAL);
        loop {
            let accepted = tokio::select! {
                accepted = listener.accept() => accepted,
                _ = clean.tick() => {
                    self.clean().await;
                    continue;
                }
                _ = stopped.recv() => return,
            };
            let (stream, address) = match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    warn!("cannot accept an MQTT connection: {error}");
                    tokio::time::sleep(ACCEPT_RETRY).await;
                    continue;
                }
            };
            let Some(place) = self.slots.acquire_slot(address.ip()) else {
                continue;
            };
            // on failure, responses are only slower
            let _ = stream.set_nodelay(true);
            let leave = place.eviction_token();
            let serving = Arc::clone(&self).serve_tcp(stream, address, place);
            let serving = async move {
                tokio::select! {
                    () = serving => {}
                    () = leave.cancelled() => {}
                }
            };
            self.clients
                .spawn(self.supervisor.contained("MQTT connection", serving));
        }
    }

    /// Serves a client over a WebSocket until it disconnects. Returns at once if there is no slot for it.
    pub(super) async fn serve_socket(
        self: Arc<Self>,
        bytes: SocketBytes,
        address: SocketAddr,
        certificate: Option<ClientCertificate>,
    ) {
        let Some(place) = self.slots.acquire_slot(address.ip()) else {
            return;
        };
        let leave = place.eviction_token();
        let clients = self.clients.clone();
        let visitor = PendingConnection {
            transport: Either::Right(Box::new(bytes)),
            address,
            certificate,
            // HTTP and the broker share the certificate, so a WebSocket without TLS exists only without a certificate
            is_open: true,
        };
        let serving = async {
            tokio::select! {
                () = self.serve(visitor, place) => {}
                () = leave.cancelled() => {}
            }
        };
        clients.track_future(serving).await;
    }

    /// Serves a client over TCP until it disconnects.
    async fn serve_tcp(self: Arc<Self>, stream: TcpStream, address: SocketAddr, place: ConnectionSlot) {
        let accepted = match &self.tls {
            None => Ok(AcceptedClient::plain(stream)),
            Some(tls) => tls.accept(stream).await,
        };
        let Ok(accepted) = accepted else {
            return;
        };
        let visitor = PendingConnection {
            is_open: self.tls.is_none() || accepted.is_private(),
            certificate: accepted.certificate,
            transport: Either::Left(accepted.stream),
            address,
        };
        self.serve(visitor, place).await;
    }

    /// Serves one client until it disconnects.
    async fn serve(self: Arc<Self>, visitor: PendingConnection, place: ConnectionSlot) {
        let address = visitor.address;
        let (let_in, connected) = oneshot::channel();
        let line = Arc::new(PacketMonitor::new());
        self.guard.in_transit.add(&line);
        let door = Arc::new(ConnectionGuard {
            is_open: visitor.is_open,
            certificate: visitor.certificate,
            guard: Arc::clone(&self.guard),
            slot: place,
            refused: Arc::default(),
            authenticated: Mutex::default(),
            connected: Mutex::new(Some(let_in)),
            line: Arc::clone(&line),
            router: Arc::clone(&self.router),
        });
        let config = BrokerConfig {
            event_handler: Some(Arc::<ConnectionGuard>::clone(&door)),
            ..self.config.clone()
        };
        let stream = GuardedStream::new(
            visitor.transport,
            address,
            Arc::clone(&door.refused),
            line.clone(),
        );
        let client = ClientHandler::new(
            BrokerTransport::WebSocket(Box::new(stream)),
            address,
            Arc::new(config),
            Arc::clone(&self.router),
            door,
            Some(Arc::clone(&self.storage)),
            Arc::clone(&self.counts.stats),
            Arc::clone(&self.counts.monitor),
            self.stop.subscribe(),
        );
        let mut serving = pin!(client.run());
        let (client_id, ended) = tokio::select! {
            // if the reason for the end matters, the guard has logged it
            _ = &mut serving => {
                self.forget_in_transit(&line).await;
                return;
            }
            ended = self.wait_until_revoked(connected) => ended,
        };
        warn!("MQTT client {client_id:.64} is disconnected: {}", ended.text());
        self.guard.sessions.revoke(&client_id);
        let code = match ended {
            CloseReason::Revoked | CloseReason::Certificate => ReasonCode::NotAuthorized,
            CloseReason::Login => ReasonCode::MaximumConnectTime,
        };
        line.close_connection(self.guard.speaks_5(&client_id).then_some((code, ended.text())));
        let _ = serving.await;
        if self.guard.sessions.connected_client(&client_id).is_none() {
            // from now on no messages are kept for it
            self.router.unregister_client(&client_id).await;
        }
        self.forget_in_transit(&line).await;
    }

    /// Removes the copies of unacknowledged messages that the library keeps for a client, if its session has ended with
    /// its connection.
    async fn forget_in_transit(&self, line: &PacketMonitor) {
        let Some(client_id) = line.client_id() else {
            return;
        };
        let sessions = &self.guard.sessions;
        if sessions.connected_client(&client_id).is_none() && !sessions.is_remembered(&client_id) {
            // fails only with a storage on disk
            let _ = self.storage.remove_all_inflight_messages(&client_id).await;
        }
    }

    /// Waits until the credentials of a client are no longer valid.
    async fn wait_until_revoked(
        &self,
        connected: oneshot::Receiver<ConnectedClient>,
    ) -> (Arc<str>, CloseReason) {
        let (Some(users), Ok((client_id, shown))) = (&self.guard.access.users, connected.await) else {
            return std::future::pending().await;
        };
        let ended = users.wait_until_invalid(&shown).await;
        (client_id, ended)
    }

    async fn clean(&self) {
        if let Err(error) = self.storage.cleanup_expired().await {
            warn!("the embedded MQTT broker cannot remove expired sessions and messages: {error}");
        }
        self.router.sweep_sessions().await;
        for client_id in self.guard.sessions.take_expired() {
            // fails only with a storage on disk
            let _ = self.storage.remove_all_inflight_messages(&client_id).await;
        }
    }
}

/// Disables the library's limits: the slots limit connections, and the guard limits messages.
fn no_limits() -> ResourceLimits {
    ResourceLimits {
        max_connections: SLOT_LIMITS.all,
        max_connections_per_ip: SLOT_LIMITS.all,
        max_message_rate_per_client: 0,
        max_bandwidth_per_client: 0,
        max_connection_rate: u32::MAX,
        rate_limit_window: Duration::from_secs(1),
    }
}

/// An admitted client: its id and its credentials.
type ConnectedClient = (Arc<str>, AuthenticatedUser);

/// The guard of one connection.
struct ConnectionGuard {
    /// False if the client uses no TLS although the machine has a certificate. The broker rejects the connection
    /// with this reason.
    is_open: bool,
    certificate: Option<ClientCertificate>,
    guard: Arc<Guard>,
    slot: ConnectionSlot,
    refused: Arc<Mutex<Option<u16>>>,
    /// Credentials of the client.
    authenticated: Mutex<Option<AuthenticatedUser>>,
    /// Notified once the client is connected.
    connected: Mutex<Option<oneshot::Sender<ConnectedClient>>>,
    line: Arc<PacketMonitor>,
    router: Arc<MessageRouter>,
}

impl ConnectionGuard {
    /// Delivers a message without waiting for slow subscribers: their messages are queued, and the oldest queued ones
    /// are dropped. The library itself would make the publisher wait.
    async fn deliver(&self, event: ClientPublishEvent) -> PublishAction {
        let Some(mut publish) = self.line.publish() else {
            return PublishAction::Continue;
        };
        let head = self.line.head_bytes(&publish);
        let bytes = publish.payload.len() + head;
        let account = self.guard.account(&event);
        if head > HEAD_BYTES_MAX || !self.guard.in_transit.has_room_for(&account, bytes) {
            return self.refuse(&event);
        }
        if let (QoS::ExactlyOnce, Some(packet_id)) = (publish.qos, publish.packet_id) {
            match self.line.unreleased().deliver(packet_id) {
                ExactlyOnce::New => {}
                ExactlyOnce::Repeated => return PublishAction::Handled,
                ExactlyOnce::Full => return self.refuse(&event),
            }
        }
        self.stamp(&mut publish, &event, head);
        let arrival = self.guard.arrive(&event.topic).to_string();
        publish.properties.add_user_property(ARRIVAL.to_owned(), arrival);
        let now = Instant::now();
        self.router
            .route_message_with_deadline(&publish, Some(&event.client_id), now)
            .await;
        PublishAction::Handled
    }

    /// Writes the broker's own data on the sender into a message, and removes the client's.
    fn stamp(&self, publish: &mut PublishPacket, event: &ClientPublishEvent, head: usize) {
        publish.topic_name = event.topic.to_string();
        let payload = std::mem::take(&mut publish.payload);
        let account = self.guard.account(event);
        publish.payload = (self.guard.in_transit).count_message(payload, head, Some(&account));
        publish.properties.remove_topic_alias();
        publish.properties.inject_sender(event.user_id.as_deref());
        publish.properties.inject_client_id(Some(&event.client_id));
        for name in [ARRIVAL, EXECUTED] {
            publish.properties.remove_user_property_by_key(name);
        }
    }

    /// Passes an urgent request to the machine; subscribers of its topic receive the message afterwards, if there is room.
    async fn execute_urgent(
        &self,
        event: ClientPublishEvent,
        lane: Arc<dyn ExecuteUrgent>,
        request: ParsedRequest,
    ) -> PublishAction {
        let publish = self.line.publish();
        self.guard.execute_urgent(&event, lane, request).await;
        let publish = publish.map(|publish| (self.line.head_bytes(&publish), publish));
        let may_pass = |(head, publish): &(usize, PublishPacket)| {
            *head <= HEAD_BYTES_MAX && self.guard.in_transit.has_room(publish.payload.len() + head)
        };
        if let Some((head, mut publish)) = publish.filter(may_pass) {
            self.stamp(&mut publish, &event, head);
            publish
                .properties
                .add_user_property(EXECUTED.to_owned(), String::new());
            let now = Instant::now();
            self.router
                .route_message_with_deadline(&publish, Some(&event.client_id), now)
                .await;
        }
        PublishAction::Handled
    }

    /// Records the activity of a login, if the message requests something of the machine.
    fn record_activity(&self, event: &ClientPublishEvent) {
        let authenticated = self.authenticated.lock();
        if let Some(shown) = authenticated.as_ref().filter(|shown| shown.is_login())
            && self.guard.is_activity(&event.topic)
        {
            shown.be_active();
        }
    }

    /// Rejects a message: a client of MQTT 5 gets a reason code in the acknowledgement.
    fn refuse(&self, event: &ClientPublishEvent) -> PublishAction {
        if self.guard.speaks_5(&event.client_id) {
            *self.refused.lock() = event.packet_id;
        }
        PublishAction::Handled
    }
}

impl BrokerEventHandler for ConnectionGuard {
    fn on_client_publish(&self, event: ClientPublishEvent) -> Answer<'_, PublishAction> {
        Box::pin(async move {
            self.record_activity(&event);
            if let Some((lane, request)) = self.guard.urgent(&event) {
                return self.execute_urgent(event, lane, request).await;
            }
            match self.guard.decide_delivery(&event).await {
                PublishDecision::Deliver { clear } => {
                    if let Some(topic) = clear {
                        self.router.route_message(&clearing(&topic), None).await;
                    }
                    self.deliver(event).await
                }
                PublishDecision::Handled => PublishAction::Handled,
                PublishDecision::NotRetained => self.refuse(&event),
            }
        })
    }

    fn on_client_connect(&self, event: ClientConnectEvent) -> Answer<'_, ()> {
        self.line.set_client_id(Arc::clone(&event.client_id));
        if let (Some(let_in), Some(shown)) = (self.connected.lock().take(), self.authenticated.lock().clone())
        {
            // the send fails only if the connection is ending, and then the name of its client is not needed
            let _ = let_in.send((Arc::clone(&event.client_id), shown));
        }
        self.guard.on_client_connect(event)
    }

    fn on_client_disconnect(&self, event: ClientDisconnectEvent) -> Answer<'_, ()> {
        self.guard.on_client_disconnect(event)
    }
}

impl AuthProvider for ConnectionGuard {
    fn authenticate<'a>(
        &'a self,
        connect: &'a ConnectPacket,
        address: SocketAddr,
    ) -> Answer<'a, mqtt5::Result<AuthResult>> {
        if !self.is_open {
            warn!(
                "MQTT client {:.64} at {address} refused: this port accepts only TLS; write mqtts://",
                connect.client_id
            );
            return Box::pin(now(Ok(AuthResult::fail(ReasonCode::NotAuthorized))));
        }
        self.line.set_version(connect.protocol_version);
        let certificate = self.certificate.as_ref();
        let (result, shown) = self.guard.authenticate(connect, certificate, address, &self.slot);
        if let Some(shown) = &shown {
            if shown.user.name().is_some() {
                self.line.set_publish_max(USER_PUBLISH_BYTES_MAX);
            }
            let session = self
                .guard
                .sessions
                .unreleased(&connect.client_id, connect.clean_start);
            self.line.resume(session);
        }
        *self.authenticated.lock() = shown;
        Box::pin(now(Ok(result)))
    }

    fn authorize_publish<'a>(
        &'a self,
        client_id: &str,
        user: Option<&'a str>,
        topic: &'a str,
    ) -> Answer<'a, bool> {
        self.guard.authorize_publish(client_id, user, topic)
    }

    fn authorize_subscribe<'a>(
        &'a self,
        _: &str,
        user: Option<&'a str>,
        filter: &'a str,
    ) -> Answer<'a, bool> {
        self.guard.authorize_subscribe(user, filter)
    }
}
