//! State shared by all HTTP handlers.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use plc_api::types::machine::Birth;
use plc_api::types::message::{Message, Payload};
use plc_api::types::request::Answer;
use plc_api::types::topic::Topic;
use plc_api::wire::problem::Problem as Details;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::access::http::Access;
use crate::broker::Entrance;
use crate::machine::{Authorized, Machine};
use crate::metrics::Metrics;
use crate::neighbours::Neighbours;
use crate::problem::Problem;
use crate::settings::{HmiSettings, MqttSettings};

/// Concurrent requests that carry a whole program; more wait. Reason: each may hold 64 MiB.
pub(crate) const LARGE_REQUESTS_MAX: usize = 4;

/// Commands over REST without an answer yet; more get 503. They continue when their client disconnects.
const COMMANDS_MAX: usize = 256;

/// The same for hold, stop and abort.
const URGENT_COMMANDS_MAX: usize = 64;

/// Open `WebSocket` connections; more get 503.
pub(crate) const WEBSOCKETS_MAX: usize = 64;

/// The MQTT broker, as others reach it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct MqttServer {
    /// `None`: the embedded one, at the host of HTTP.
    pub(crate) host: Option<String>,
    pub(crate) port: u16,
    /// Over TLS.
    pub(crate) is_private: bool,
}

impl MqttServer {
    /// The embedded broker at this address, or the first node of the external one of the settings.
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
pub(crate) struct Shared {
    pub(crate) machine: Machine,
    pub(crate) http_addr: SocketAddr,
    /// `http`, or `https` with a certificate.
    pub(crate) scheme: &'static str,
    pub(crate) mqtt_server: MqttServer,
    pub(crate) access: Access,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) position_interval: Duration,
    pub(crate) large_requests: Semaphore,
    pub(crate) websockets: Arc<Semaphore>,
    pub(crate) open_commands: Arc<Semaphore>,
    pub(crate) urgent_commands: Arc<Semaphore>,
    pub(crate) tasks: TaskTracker,
    pub(crate) stop: CancellationToken,
    pub(crate) hmi: HmiSettings,
    /// Other machines.
    pub(crate) neighbours: Arc<Neighbours>,
    /// The embedded broker, for clients over WebSocket.
    pub(crate) entrance: Option<Entrance>,
    commands: AtomicU64,
    connections: AtomicU64,
}

impl Shared {
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
            large_requests: Semaphore::new(LARGE_REQUESTS_MAX),
            websockets: Arc::new(Semaphore::new(WEBSOCKETS_MAX)),
            open_commands: Arc::new(Semaphore::new(COMMANDS_MAX)),
            urgent_commands: Arc::new(Semaphore::new(URGENT_COMMANDS_MAX)),
            tasks: TaskTracker::new(),
            stop,
            hmi: HmiSettings::default(),
            neighbours: Neighbours::new("", Vec::new(), false),
            entrance: None,
            commands: AtomicU64::new(1),
            connections: AtomicU64::new(1),
        }
    }

    /// The same with what a machine builder has added to the HMI.
    pub(crate) fn with_hmi(self, hmi: HmiSettings) -> Self {
        Self { hmi, ..self }
    }

    /// The same with other machines.
    pub(crate) fn with_neighbours(self, neighbours: Arc<Neighbours>) -> Self {
        Self { neighbours, ..self }
    }

    /// The same, to be shared, with a broker that clients reach over WebSocket.
    pub(crate) fn with_entrance(self, entrance: Option<Entrance>) -> Arc<Self> {
        Arc::new(Self { entrance, ..self })
    }

    /// A name of a `WebSocket` that is new in this boot.
    pub(crate) fn next_connection(&self) -> String {
        let number = self.connections.fetch_add(1, Ordering::Relaxed);
        format!("websocket-{number}")
    }

    /// A command id that is new in this boot.
    pub(crate) fn next_command_id(&self) -> String {
        let number = self.commands.fetch_add(1, Ordering::Relaxed);
        format!("rest-{}-{number}", self.machine.boot_id())
    }

    /// The value of a state topic.
    pub(crate) async fn read(&self, topic: &Topic) -> Result<Arc<Message>, Problem> {
        self.machine
            .read(topic)
            .await
            .ok_or_else(|| Problem::not_found(format!("this machine has no {}", topic.path())))
    }

    /// The description of the machine.
    pub(crate) async fn birth(&self) -> Result<Birth, Problem> {
        let message = self.read(&Topic::Birth).await?;
        match &message.payload {
            Payload::Birth(birth) => Ok(birth.clone()),
            _ => Err(unexpected()),
        }
    }

    /// Makes a request of the machine.
    pub(crate) async fn ask(&self, authorized: Authorized) -> Result<Answer, Problem> {
        self.machine.carry_out(authorized).await.map_err(Problem::from)
    }
}

/// The problem of an answer that does not belong to its request, which is a fault of the port.
pub(crate) fn unexpected() -> Problem {
    Details::unexpected().into()
}
