//! The embedded MQTT broker, in memory only. With tokens, user and password are name and token; without, it listens on
//! the loopback only and admits everyone. Only the runtime publishes states.
//!
//! Every setting of the library is set here, because its defaults listen on all addresses and write files. Commands,
//! claims and settings with the retain flag are rejected: otherwise they would be executed again at the next start.

mod accept;
mod guard;
mod guarded_stream;
mod packet_monitor;
mod retained;
mod sessions;
mod socket;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use mqtt5::broker::config::StorageConfig;
use mqtt5::broker::router::MessageRouter;
use mqtt5::broker::storage::QueueLimits;
use mqtt5::broker::{BrokerConfig, DynamicStorage, MemoryBackend};
use plc_protocol::supervisor::Supervisor;
use tokio::sync::{broadcast, mpsc};
use tokio_util::task::{AbortOnDropHandle, TaskTracker};

use crate::access::Users;
use crate::arrivals::Arrivals;
use crate::broker_address::RefusedMessage;
use crate::certificate::ClientCertificate;
use crate::connection_slots::{ConnectionSlots, SlotLimits};
use crate::error::GatewayError;
use crate::machine::Machine;
use crate::settings::{MQTT_LISTEN, MqttSettings, bind};
use crate::tls::LiveTls;
use crate::urgent_slots::ExecuteUrgent;
pub(crate) use accept::SLOT_LIMITS;
use accept::{BrokerServer, Counts};
use guard::Guard;
pub(crate) use sessions::Sessions;
pub(crate) use socket::SocketBytes;

/// Largest number of connected clients; further ones are rejected.
const CLIENTS_MAX: usize = SLOT_LIMITS.known;
/// Largest number of bytes of one packet. Reason: the largest message, `birth`, stays far below.
pub(crate) const PACKET_MAX: usize = 1024 * 1024;
/// Largest number of subscriptions of one client.
const SUBSCRIPTIONS_MAX: usize = 1024;
/// Largest number of bytes of the topic filter of a subscription; a longer one is rejected. Reason: the broker keeps it
/// as long as the session.
const FILTER_BYTES_MAX: usize = 512;
/// Largest number of bytes of one retained message.
const RETAINED_SIZE_MAX: usize = 256 * 1024;
/// How long the broker remembers an absent client; messages for it wait in memory.
const SESSION_EXPIRY: Duration = Duration::from_hours(1);
/// Largest number of messages queued for one client; beyond this limit the oldest are dropped.
const QUEUED_MAX: usize = 1000;
/// Largest number of bytes queued for one client: 160 MiB for all connected and remembered clients.
const QUEUED_BYTES_MAX: usize = 512 * 1024;
/// Largest number of messages in transit to one connected client, for each quality of service. Further ones wait; those
/// of quality 0 are dropped.
pub(crate) const IN_TRANSIT_MAX: usize = 128;
/// Largest number of unfinished messages of quality 2 of one client; a further one ends its connection.
const UNFINISHED_MAX: u16 = 256;
/// Largest number of unacknowledged messages to one client. Reason: the library keeps a second copy of each, as long as
/// the session.
const UNACKNOWLEDGED_MAX: u16 = 32;
/// Time limit for stopping; then the task is aborted.
const STOP_MAX: Duration = Duration::from_secs(2);

/// Protocol version of MQTT 5 in its CONNECT packet.
const MQTT_5: u8 = 5;

/// Rules for the admission of clients.
pub(crate) struct BrokerAccess {
    /// Topic root of the machine, with its last slash.
    pub(crate) root: String,
    /// Client id of the runtime's own connection; other clients may not use it.
    pub(crate) runtime_client_id: String,
    /// Users. `None` admits every client with all rights.
    pub(crate) users: Option<Users>,
    /// Receives notes on rejected requests.
    pub(crate) machine: Machine,
}

/// The embedded broker while it runs.
pub(crate) struct Broker {
    addr: SocketAddr,
    stop: broadcast::Sender<()>,
    clients: TaskTracker,
    sessions: Arc<Sessions>,
    exchange: Exchange,
    entrance: WebSocketListener,
    _hall: AbortOnDropHandle<()>,
}

/// Exchange of messages between clients.
#[derive(Clone)]
pub(crate) struct Exchange {
    guard: Arc<Guard>,
    pub(crate) supervisor: Supervisor,
    pub(crate) router: Arc<MessageRouter>,
}

impl Exchange {
    /// Wraps the payload so that it is counted while in transit.
    pub(crate) fn count(&self, payload: Bytes) -> Bytes {
        self.guard.in_transit.count(payload)
    }

    /// Closes clients that do not read if there is no room for this number of bytes.
    pub(crate) fn make_room(&self, bytes: usize) {
        self.guard.in_transit.has_room(bytes);
    }
}

/// Entrance for clients over WebSocket.
#[derive(Clone)]
pub(crate) struct WebSocketListener(Arc<BrokerServer>);

impl WebSocketListener {
    /// Serves a client until it disconnects.
    pub(crate) async fn serve(
        &self,
        bytes: SocketBytes,
        address: SocketAddr,
        certificate: Option<ClientCertificate>,
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
        refused: mpsc::Sender<RefusedMessage>,
        limits: SlotLimits,
    ) -> Result<Broker, GatewayError> {
        let sessions = Arc::<Sessions>::default();
        let supervisor = access.machine.supervisor();
        let guard = Arc::new(Guard::new(access, refused, Arc::clone(&sessions)));
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
            supervisor: supervisor.clone(),
            router: Arc::clone(&router),
        };
        let (stop, _) = broadcast::channel(1);
        let clients = TaskTracker::new();
        let hall = Arc::new(BrokerServer {
            config: config(address),
            guard,
            router,
            storage,
            tls,
            stop: stop.clone(),
            clients: clients.clone(),
            slots: ConnectionSlots::new(limits),
            counts: Counts::new(),
            supervisor: supervisor.clone(),
        });
        let accepting = supervisor.essential("embedded broker", Arc::clone(&hall).run(listener));
        Ok(Broker {
            addr,
            stop,
            clients,
            sessions,
            exchange,
            entrance: WebSocketListener(Arc::clone(&hall)),
            _hall: AbortOnDropHandle::new(tokio::spawn(accepting)),
        })
    }

    /// Returns the entrance for clients over WebSocket, if the settings enable it.
    pub(crate) fn websocket_listener(&self, settings: &MqttSettings) -> Option<WebSocketListener> {
        settings.websocket.then(|| self.entrance.clone())
    }

    /// Its clients.
    pub(crate) fn sessions(&self) -> Arc<Sessions> {
        Arc::clone(&self.sessions)
    }

    /// Returns the address on which the broker listens.
    pub(crate) fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// Passes urgent requests to this lane from now on, while it exists.
    pub(crate) fn open_urgent_lane(&self, lane: &Arc<dyn ExecuteUrgent>) {
        // a second lane never replaces the first
        let _ = self.exchange.guard.urgent.set(Arc::downgrade(lane));
    }

    /// Returns the order in which the broker receives messages.
    pub(crate) fn arrivals(&self) -> Arc<Arrivals> {
        Arc::clone(&self.exchange.guard.arrivals)
    }

    /// Returns the exchange for the runtime's own connection.
    pub(crate) fn exchange(&self) -> Exchange {
        self.exchange.clone()
    }

    /// Closes all connections and stops.
    pub(crate) async fn stop(self) {
        // fails only if no task is listening
        let _ = self.stop.send(());
        self.clients.close();
        let _ = tokio::time::timeout(STOP_MAX, self.clients.wait()).await;
    }
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
        client_channel_capacity: IN_TRANSIT_MAX,
        server_receive_maximum: Some(UNFINISHED_MAX),
        max_outbound_inflight: UNACKNOWLEDGED_MAX,
        server_keep_alive: None,
        storage_config: storage,
        sys_topics_enabled: false,
        ..BrokerConfig::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Broker {
        /// Returns the sessions and messages that the library keeps.
        pub(crate) fn storage(&self) -> Arc<DynamicStorage> {
            Arc::clone(&self.entrance.0.storage)
        }
    }
}
