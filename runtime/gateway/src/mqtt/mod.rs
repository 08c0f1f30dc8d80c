//! The MQTT end: publishes the messages of the port, and makes requests of the messages that come in.
//!
//! [`link`] keeps the connection to the broker, [`wire`] is one connection over one version of MQTT, [`inside`] one to the
//! embedded broker, [`outbox`] holds what is still to be published, and [`dispatch`] makes requests of the port. The port never
//! waits for any of them.

mod dispatch;
mod inside;
mod link;
mod outbox;
mod wire;

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use plc_api::server::ServedPort;
use plc_api::types::Timestamp;
use plc_api::types::message::{Message, Payload};
use plc_api::types::topic::Topic;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::access::{LiveTokens, User};
use crate::broker::Sessions;
use crate::broker_address::Refused;
use crate::machine::Machine;
use crate::metrics::Metrics;
use crate::settings::{GatewaySettings, MqttSettings};
pub(crate) use inside::Inside;
use link::Link;
pub use wire::{Connect, Event, Lost, Named, Version, Wire};

/// Messages refused by the embedded broker that wait for a reply.
pub(crate) const REFUSED_MAX: usize = 64;

/// Time to publish the rest and to disconnect.
const STOP_MAX: Duration = Duration::from_secs(2);

/// Client id of the runtime at its broker. It contains the prefix, so that machines with the same name do not disconnect
/// each other.
pub(crate) fn client_id(settings: &MqttSettings, machine: &str) -> String {
    if settings.client_id.is_empty() {
        match settings.prefix.as_str() {
            "" => format!("tandem-{machine}"),
            prefix => format!("tandem-{}-{machine}", prefix.replace('/', "-")),
        }
    } else {
        settings.client_id.clone()
    }
}

/// What the MQTT end needs.
pub(crate) struct Parts {
    pub(crate) machine: Machine,
    pub(crate) settings: MqttSettings,
    pub(crate) machine_name: String,
    /// Users of the embedded broker; `None`: whoever the broker lets in may do everything.
    pub(crate) tokens: Option<LiveTokens>,
    /// Clients of the embedded broker.
    pub(crate) clients: Option<Arc<Sessions>>,
    /// Root of all topics, with its last slash.
    pub(crate) root: String,
    pub(crate) position_interval: Duration,
    pub(crate) refused: mpsc::Receiver<Refused>,
    pub(crate) metrics: Arc<Metrics>,
}

/// Who has published a message.
#[derive(Debug)]
enum Publisher {
    User {
        user: User,
        from: Option<IpAddr>,
        client_id: Option<String>,
    },
    /// A name whose token counts no more, or nobody that the broker names.
    Unknown { name: String, client_id: Option<String> },
}

impl Publisher {
    /// The publisher that the broker names.
    fn of(parts: &Parts, named: &Named) -> Self {
        let clients = parts.clients.as_ref();
        let from = clients.and_then(|clients| clients.address_of(named.client_id.as_deref()?));
        let user = match &parts.tokens {
            None => Some(User::Anyone),
            Some(tokens) => named
                .user
                .as_deref()
                .and_then(|name| tokens.now().user_named(name)),
        };
        let client_id = clients.and(named.client_id.clone());
        match user {
            Some(user) => Publisher::User {
                user,
                from,
                client_id,
            },
            None => Publisher::Unknown {
                name: named.user.clone().unwrap_or_default(),
                client_id,
            },
        }
    }

    /// Its MQTT client id, where the embedded broker says it.
    fn client_id(&self) -> Option<&str> {
        match self {
            Publisher::User { client_id, .. } | Publisher::Unknown { client_id, .. } => client_id.as_deref(),
        }
    }
}

/// A message of this boot, from now.
fn message(machine: &Machine, topic: Topic, payload: Payload) -> Message {
    Message {
        topic,
        boot_id: machine.boot_id(),
        ts: Timestamp::from_system_time(machine.time()),
        rev: None,
        payload,
    }
}

/// The MQTT end of a machine while it runs.
#[derive(Debug)]
pub struct MqttEnd {
    stop: CancellationToken,
    task: JoinHandle<()>,
}

impl MqttEnd {
    /// Serves a machine over connections of your own.
    pub fn over<C: Connect>(port: Arc<dyn ServedPort>, settings: &GatewaySettings, connect: C) -> Self {
        let (_, refused) = mpsc::channel(1);
        let parts = Parts {
            machine: Machine::new(port),
            settings: settings.mqtt.clone(),
            machine_name: settings.machine.clone(),
            tokens: None,
            clients: None,
            root: settings.mqtt.root(&settings.machine),
            position_interval: Duration::from_millis(settings.position_interval_ms),
            refused,
            metrics: Arc::default(),
        };
        Self::start(parts, connect)
    }

    pub(crate) fn start<C: Connect>(parts: Parts, at: C) -> Self {
        let stop = CancellationToken::new();
        let task = tokio::spawn(Link::new(parts, at, stop.clone()).run());
        Self { stop, task }
    }

    /// Publishes that the runtime is offline, disconnects and stops.
    pub async fn stop(mut self) {
        self.stop.cancel();
        if tokio::time::timeout(STOP_MAX, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }

    /// Ends without disconnecting, as if the runtime were killed.
    pub fn crash(self) {
        self.task.abort();
    }
}
