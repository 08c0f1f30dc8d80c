//! State shared by all HTTP handlers.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::types::machine::Birth;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::request::Answer;
use plc_protocol::types::topic::Topic;
use plc_protocol::wire::problem::Problem as Details;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::access::Account;
use crate::access::http::Access;
use crate::account_slots::{AccountLimits, AccountSlots};
use crate::broker::WebSocketListener;
use crate::machine::{AuthorizedRequest, Machine};
use crate::metrics::Metrics;
use crate::peer_machines::PeerMachines;
use crate::problem::Problem;
use crate::registrations::Registrations;
use crate::settings::{HmiSettings, MqttSettings};
use crate::unread::{LargeRequests, UnreadAnswers};
use crate::urgent_slots::UrgentSlots;

/// Limits of unanswered commands over REST; further ones get 503. An unanswered command continues if its client
/// disconnects.
const COMMAND_LIMITS: AccountLimits = AccountLimits {
    all: 256,
    of_user: 64,
    unreserved: 128,
};

/// Largest number of holds, stops and aborts of one account that wait until they are done (`?wait=1`). A further one is
/// executed, and answered when it is accepted.
const URGENT_WAITS_MAX: usize = 16;

/// Limits of open `WebSocket` connections; more get 503.
pub(crate) const WEBSOCKET_LIMITS: AccountLimits = AccountLimits {
    all: 64,
    of_user: 32,
    unreserved: 40,
};

/// Address of the MQTT broker for clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct MqttServer {
    /// `None` for the embedded broker, which has the host of HTTP.
    pub(crate) host: Option<String>,
    pub(crate) port: u16,
    /// Over TLS.
    pub(crate) is_private: bool,
}

impl MqttServer {
    /// Returns the embedded broker at this address, or the first configured node of the external one.
    pub(crate) fn new(embedded: Option<SocketAddr>, settings: &MqttSettings, is_private: bool) -> Self {
        let (host, port) = match embedded {
            Some(address) => (None, address.port()),
            None => settings
                .brokers
                .first()
                .map_or((None, 0), |(host, port)| (Some(host.clone()), *port)),
        };
        Self {
            host,
            port,
            is_private: if embedded.is_some() {
                is_private
            } else {
                settings.tls.is_some()
            },
        }
    }
}

/// State shared by all HTTP handlers.
pub(crate) struct ServerState {
    pub(crate) machine: Machine,
    pub(crate) http_addr: SocketAddr,
    /// `http`, or `https` with a certificate.
    pub(crate) scheme: &'static str,
    pub(crate) mqtt_server: MqttServer,
    pub(crate) access: Access,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) position_interval: Duration,
    pub(crate) large_requests: LargeRequests,
    /// Large responses that clients have not read.
    pub(crate) unread: UnreadAnswers,
    pub(crate) websockets: AccountSlots,
    pub(crate) open_commands: AccountSlots,
    /// Slots for hold, stop and abort, separate from other commands.
    pub(crate) urgent: UrgentSlots,
    urgent_waits: Mutex<HashMap<Account, Arc<Semaphore>>>,
    pub(crate) tasks: TaskTracker,
    pub(crate) stop: CancellationToken,
    pub(crate) hmi: HmiSettings,
    /// Other machines.
    pub(crate) peer_machines: Arc<PeerMachines>,
    /// Handlers over REST.
    pub(crate) registrations: Registrations,
    /// The embedded broker, for clients over WebSocket.
    pub(crate) entrance: Option<WebSocketListener>,
    commands: AtomicU64,
    connections: AtomicU64,
}

impl ServerState {
    pub(crate) fn new(
        machine: Machine,
        http_addr: SocketAddr,
        scheme: &'static str,
        mqtt_server: MqttServer,
        access: Access,
        position_interval: Duration,
        stop: CancellationToken,
    ) -> Self {
        Self {
            machine,
            http_addr,
            scheme,
            mqtt_server,
            access,
            metrics: Arc::default(),
            position_interval,
            large_requests: LargeRequests::new(),
            unread: UnreadAnswers::default(),
            websockets: AccountSlots::new(WEBSOCKET_LIMITS),
            open_commands: AccountSlots::new(COMMAND_LIMITS),
            urgent: UrgentSlots::default(),
            urgent_waits: Mutex::default(),
            tasks: TaskTracker::new(),
            stop,
            hmi: HmiSettings::default(),
            peer_machines: PeerMachines::new("", Vec::new(), false),
            registrations: Registrations::default(),
            entrance: None,
            commands: AtomicU64::new(1),
            connections: AtomicU64::new(1),
        }
    }

    /// Adds the machine builder's additions to the HMI.
    pub(crate) fn with_hmi(self, hmi: HmiSettings) -> Self {
        Self { hmi, ..self }
    }

    /// Adds the other machines.
    pub(crate) fn with_peer_machines(self, neighbours: Arc<PeerMachines>) -> Self {
        Self {
            peer_machines: neighbours,
            ..self
        }
    }

    /// Adds the broker that clients reach over WebSocket, and shares the result.
    pub(crate) fn with_websocket_listener(self, entrance: Option<WebSocketListener>) -> Arc<Self> {
        Arc::new(Self { entrance, ..self })
    }

    /// Watches the ages of handlers over REST until the server stops. Returns another handle to itself.
    pub(crate) fn watch_registrations(self: &Arc<Self>) -> Arc<Self> {
        let shared = Arc::clone(self);
        let watching = move || {
            let shared = Arc::clone(&shared);
            async move {
                tokio::select! {
                    () = shared.stop.cancelled() => {}
                    () = shared.registrations.watch(&shared.machine) => {}
                }
            }
        };
        let supervisor = self.machine.supervisor();
        self.tasks
            .spawn(supervisor.restarted("watch over handlers over REST", watching));
        Arc::clone(self)
    }

    /// Takes a permit with which an account may wait for one more hold, stop or abort, if there is one.
    pub(crate) fn urgent_wait(&self, account: &Account) -> Option<OwnedSemaphorePermit> {
        let mut by_account = self.urgent_waits.lock();
        by_account.retain(|_, waits| waits.available_permits() < URGENT_WAITS_MAX);
        let new = || Arc::new(Semaphore::new(URGENT_WAITS_MAX));
        let waits = by_account.entry(account.clone()).or_insert_with(new);
        Arc::clone(waits).try_acquire_owned().ok()
    }

    /// Returns a `WebSocket` name that is unique in this boot.
    pub(crate) fn next_connection(&self) -> String {
        let number = self.connections.fetch_add(1, Ordering::Relaxed);
        format!("websocket-{number}")
    }

    /// Returns a command id that is unique in this boot.
    pub(crate) fn next_command_id(&self) -> String {
        let number = self.commands.fetch_add(1, Ordering::Relaxed);
        format!("rest-{}-{number}", self.machine.boot_id())
    }

    /// Returns the value of a state topic.
    pub(crate) async fn read(&self, topic: &Topic) -> Result<Arc<Message>, Problem> {
        self.machine
            .read(topic)
            .await
            .ok_or_else(|| Problem::not_found(format!("this machine has no {}", topic.path())))
    }

    /// Returns the description of the machine.
    pub(crate) async fn birth(&self) -> Result<Birth, Problem> {
        let message = self.read(&Topic::Birth).await?;
        match &message.payload {
            Payload::Birth(birth) => Ok(birth.clone()),
            _ => Err(unexpected()),
        }
    }

    /// Passes a request to the machine.
    pub(crate) async fn ask(&self, authorized: AuthorizedRequest) -> Result<Answer, Problem> {
        self.machine
            .execute_request(authorized)
            .await
            .map_err(Problem::from)
    }
}

/// Returns the problem of an answer that does not belong to its request, which is a fault of the port.
pub(crate) fn unexpected() -> Problem {
    Details::unexpected().into()
}
