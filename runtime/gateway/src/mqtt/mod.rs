//! The MQTT task: publishes the messages of the port, and turns received messages into requests.
//!
//! [`link`] keeps the connection to the broker, [`wire`] is one connection over one version of MQTT, [`inside`] one to
//! the embedded broker, [`arrival_queue`] orders messages of an external one, [`outbox`] holds the messages to be published, and [`dispatch`] passes requests to the port.
//! The port never waits for any of them.

mod arrival_queue;
mod dispatch;
mod inside;
mod link;
mod link_session;
mod outbox;
mod urgent_lane;
mod urgent_replies;
mod wire;

use std::sync::Arc;
use std::time::Duration;

use plc_protocol::server::ServedPort;
use plc_protocol::types::Timestamp;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::topic::Topic;
use plc_protocol::wire::message_sender::MessageSender;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use crate::access::{LiveTokens, User};
use crate::arrivals::Arrivals;
use crate::broker::{Broker, Sessions};
use crate::broker_address::RefusedMessage;
use crate::machine::Machine;
use crate::metrics::Metrics;
use crate::publisher::Publisher;
use crate::settings::{GatewaySettings, MqttSettings};
use crate::urgent_slots::ExecuteUrgent;
pub(crate) use inside::Inside;
use link::Link;
use urgent_lane::UrgentLane;
use urgent_replies::UrgentReplies;
pub use wire::{BrokerStamp, Connect, ConnectionLoss, Event, Version, Wire};

/// Largest number of messages rejected by the embedded broker that wait for a reply.
pub(crate) const REFUSED_MAX: usize = 64;

/// Longest time at a stop to publish the remaining messages and to disconnect.
const STOP_MAX: Duration = Duration::from_secs(2);

/// Returns the client id of the runtime at its broker. It contains the prefix, so that machines with the same name
/// do not disconnect each other.
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

/// Dependencies of the MQTT task.
pub(crate) struct Parts {
    pub(crate) machine: Machine,
    pub(crate) settings: MqttSettings,
    pub(crate) machine_name: String,
    /// Users of the embedded broker. With `None`, every client that the broker admits has all rights.
    pub(crate) tokens: Option<LiveTokens>,
    /// Clients of the embedded broker.
    pub(crate) clients: Option<Arc<Sessions>>,
    /// Root of all topics, with its last slash.
    pub(crate) root: String,
    pub(crate) position_interval: Duration,
    pub(crate) refused: mpsc::Receiver<RefusedMessage>,
    pub(crate) metrics: Arc<Metrics>,
    /// The order in which messages arrived.
    pub(crate) arrivals: Arc<Arrivals>,
    pub(crate) urgent_replies: Arc<UrgentReplies>,
}

/// Returns the publisher that the broker names; with an external broker, the sender that the topic names.
fn publisher_of(parts: &Parts, named: &BrokerStamp, speaker: Option<MessageSender>) -> Publisher {
    let clients = parts.clients.as_ref();
    let from = clients.and_then(|clients| clients.address_of(named.client_id.as_deref()?));
    let user = match &parts.tokens {
        None if clients.is_none() => Some(speaker.map_or(User::Anyone, User::of_topic)),
        None => Some(User::Anyone),
        Some(tokens) => named
            .user
            .as_deref()
            .and_then(|name| tokens.now().user_named(name)),
    };
    let client_id = clients.and(named.client_id.clone());
    Publisher::new(user, named.user.as_deref(), from, client_id)
}

/// Creates a message of this boot with the current time.
fn message(machine: &Machine, topic: Topic, payload: Payload) -> Message {
    Message {
        topic,
        boot_id: machine.boot_id(),
        ts: Timestamp::from_system_time(machine.time()),
        rev: None,
        payload,
    }
}

/// The running MQTT task of a machine.
#[derive(Debug)]
pub struct MqttEnd {
    stop: CancellationToken,
    task: JoinHandle<()>,
    /// The lane of urgent requests through the embedded broker, and the task that publishes its replies.
    _urgent: Option<(Arc<UrgentLane>, AbortOnDropHandle<()>)>,
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
            arrivals: Arc::default(),
            urgent_replies: Arc::default(),
        };
        Self::start(parts, connect)
    }

    pub(crate) fn start<C: Connect>(parts: Parts, at: C) -> Self {
        let stop = CancellationToken::new();
        let supervisor = parts.machine.supervisor();
        let link = Link::new(parts, at, stop.clone());
        let task = tokio::spawn(supervisor.essential("link to the MQTT broker", link.run()));
        Self {
            stop,
            task,
            _urgent: None,
        }
    }

    /// Serves a machine through its embedded broker, with a lane for urgent requests.
    pub(crate) fn start_inside(parts: Parts, broker: &Broker) -> Self {
        let exchange = broker.exchange();
        let lane = Arc::new(UrgentLane::new(
            parts.machine.clone(),
            Arc::clone(&parts.metrics),
            (Arc::clone(&exchange.router), Arc::clone(&parts.arrivals)),
            Arc::clone(&parts.urgent_replies),
            parts.root.clone(),
        ));
        let replies = lane.subscribe();
        let executing: Arc<dyn ExecuteUrgent> = Arc::<UrgentLane>::clone(&lane);
        broker.open_urgent_lane(&executing);
        let replying = Arc::clone(&lane).publish_replies(replies);
        let supervisor = parts.machine.supervisor();
        let replying = tokio::spawn(supervisor.essential("replies to urgent MQTT commands", replying));
        let replying = AbortOnDropHandle::new(replying);
        let end = Self::start(parts, Inside(exchange));
        Self {
            _urgent: Some((lane, replying)),
            ..end
        }
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
