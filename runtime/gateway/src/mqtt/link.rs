//! The connection to the broker: one client for each, so that nothing depends on what the library remembers.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use plc_api::hub::{Filter, Subscription};
use plc_api::server::{ServedPort, ServerNotice};
use plc_api::transport::backoff::Backoff;
use plc_api::types::Timestamp;
use plc_api::types::machine::Presence;
use plc_api::types::message::{Message, Payload};
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::wire::mqtt::decode;
use tokio::sync::mpsc;
use tokio::time::{Instant, Interval};
use tokio_util::sync::CancellationToken;
use tracing::{info, warn};

use super::Parts;
use super::dispatch::Dispatch;
use super::outbox::{Handed, Outbox, Parcel};
use super::wire::{self, Heard, Lost, Version, Will, Wire};
use crate::broker_address::{BrokerAddress, Refused};
use crate::contract::topics::{inbound_topics, is_inbound};
use crate::metrics::{Metrics, add};
use crate::position::{every, is_position};

/// Bytes of one message; a larger one is dropped with a warning. Reason: the embedded broker retains no more.
const MESSAGE_MAX: usize = 256 * 1024;
/// Tries over MQTT 5 that a broker that has spoken it may hang up on before 3.1.1 is tried.
const HANG_UPS_MAX: u32 = 10;
/// A connection that held this long starts the waits anew.
const STABLE: Duration = Duration::from_secs(5);

/// The MQTT end's task.
pub(super) struct Link {
    port: Arc<dyn ServedPort>,
    parts: LinkParts,
    outbox: Outbox,
    positions_due: Interval,
    subscription: Option<Subscription>,
    dispatch: Dispatch,
    replies: mpsc::Receiver<Message>,
    refused: mpsc::Receiver<Refused>,
    metrics: Arc<Metrics>,
    stop: CancellationToken,
    connections: u64,
    speaks_5: bool,
    // tries over MQTT 5 in a row that the broker did not answer
    hang_ups: u32,
    told_connected: bool,
}

struct LinkParts {
    root: String,
    client_id: String,
    at: BrokerAddress,
}

/// What a connection has found out of its broker.
struct Session {
    wire: Wire,
    version: Version,
    /// Bytes of a packet that the broker takes; 0 before it has answered.
    packet_max: usize,
    told_refused: bool,
}

/// Why a connection ended.
enum End {
    Stopped,
    Lost(Lost),
}

/// Anything that happens to a connection.
enum Happening {
    Mqtt(Result<Heard, Lost>),
    Said(Option<Arc<Message>>),
    PositionsDue,
    Reply(Arc<Message>),
    Refused(Refused),
    Stop,
}

impl Link {
    pub(super) fn new(parts: Parts, stop: CancellationToken) -> Self {
        let (dispatch, replies) = Dispatch::new(Arc::clone(&parts.port), Arc::clone(&parts.metrics));
        Self {
            subscription: Some(parts.port.subscribe(Filter::All)),
            parts: LinkParts {
                client_id: super::client_id(&parts.settings, &parts.machine),
                at: parts.at,
                root: parts.root,
            },
            port: parts.port,
            outbox: Outbox::default(),
            positions_due: every(parts.position_interval),
            dispatch,
            replies,
            refused: parts.refused,
            metrics: parts.metrics,
            stop,
            connections: 0,
            speaks_5: false,
            hang_ups: 0,
            told_connected: true,
        }
    }

    /// Connects, again and again, until it is stopped.
    pub(super) async fn run(mut self) {
        let mut backoff = Backoff::default();
        loop {
            let begun = Instant::now();
            let end = self.connection().await;
            self.metrics.mqtt_connected.store(false, Ordering::Relaxed);
            let End::Lost(Lost { why, .. }) = end else {
                return;
            };
            self.tell_bus(false);
            if begun.elapsed() >= STABLE {
                backoff.reset();
            }
            let wait = backoff.next_wait();
            warn!(
                "no connection to the MQTT broker: {why}; next try in {} ms",
                wait.as_millis()
            );
            if self.absorb(wait).await {
                return;
            }
        }
    }

    /// Keeps what is said while there is no connection. True when stopped.
    async fn absorb(&mut self, time: Duration) -> bool {
        let until = Instant::now() + time;
        loop {
            let happening = tokio::select! {
                () = tokio::time::sleep_until(until) => return false,
                happening = self.happening(None) => happening,
            };
            match happening {
                Happening::Stop => return true,
                other => self.keep(other).await,
            }
        }
    }

    /// One connection, from the first try to its end: over MQTT 5, and at once over 3.1.1 where the broker does not
    /// speak 5. A broker that has spoken 5 before has likely been stopped where it hangs up: it gets more tries.
    async fn connection(&mut self) -> End {
        let lost = match self.connection_over(Version::V5).await {
            End::Lost(lost) if lost.version_unknown => lost,
            end => return end,
        };
        self.hang_ups += 1;
        if self.speaks_5 && self.hang_ups < HANG_UPS_MAX {
            return End::Lost(lost);
        }
        info!(
            "the MQTT broker does not speak MQTT 5 ({}); trying 3.1.1",
            lost.why
        );
        self.connection_over(Version::V3_1_1).await
    }

    async fn connection_over(&mut self, version: Version) -> End {
        let offline = self.offline().await;
        let will = Will {
            topic: format!("{}{}", self.parts.root, Topic::Presence.path()),
            payload: offline.to_json(),
        };
        let mut session = Session {
            wire: Wire::open(&self.parts.client_id, &self.parts.at, will, version),
            version,
            packet_max: 0,
            told_refused: false,
        };
        loop {
            if session.packet_max > 0 {
                self.publish(&session);
            }
            match self.happening(Some(&mut session.wire)).await {
                Happening::Mqtt(Ok(heard)) => self.hear(heard, &mut session).await,
                Happening::Mqtt(Err(lost)) => return End::Lost(lost),
                Happening::Stop => {
                    if session.packet_max > 0 {
                        self.goodbye(session, offline).await;
                    }
                    return End::Stopped;
                }
                other => self.keep(other).await,
            }
        }
    }

    async fn happening(&mut self, wire: Option<&mut Wire>) -> Happening {
        let heard = async {
            match wire {
                Some(wire) => wire.next().await,
                None => std::future::pending().await,
            }
        };
        let said = async {
            match &mut self.subscription {
                Some(subscription) => subscription.next().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = self.stop.cancelled() => Happening::Stop,
            heard = heard => Happening::Mqtt(heard),
            message = said => Happening::Said(message),
            _ = self.positions_due.tick() => Happening::PositionsDue,
            Some(reply) = self.replies.recv() => Happening::Reply(Arc::new(reply)),
            Some(refused) = self.refused.recv() => Happening::Refused(refused),
        }
    }

    /// Everything but the connection itself.
    async fn keep(&mut self, happening: Happening) {
        match happening {
            Happening::Said(Some(message)) => {
                // presence of handlers comes in over MQTT, and would come back for ever
                if !matches!(message.topic, Topic::HandlerPresence(_)) && !is_position(&message.topic) {
                    self.outbox.put(message);
                }
            }
            // the port has closed: nothing more is said, the connection stays until the stop
            Happening::Said(None) => self.subscription = None,
            Happening::PositionsDue => self.put_positions().await,
            Happening::Reply(reply) => self.outbox.put(reply),
            Happening::Refused((topic, payload)) => self.take(&topic, &payload, true).await,
            Happening::Mqtt(_) | Happening::Stop => {}
        }
        let lost = self.outbox.take_lost();
        if lost > 0 {
            add(&self.metrics.mqtt_events_lost, lost);
            warn!("the MQTT broker is too slow or away: {lost} events were dropped; states are kept");
        }
    }

    /// Positions are no retained state but a stream, which goes on at rest: who comes later needs to know them, too.
    async fn put_positions(&mut self) {
        let birth = self.port.read(&Topic::Birth).await;
        let Some(Payload::Birth(birth)) = birth.as_ref().map(|message| &message.payload) else {
            return;
        };
        for system in &birth.coordinate_systems {
            let topic = Topic::cs(system.number, CsTopic::Position);
            if let Some(position) = self.port.read(&topic).await {
                self.outbox.put(position);
            }
        }
    }

    /// On every connection: subscribe, and say everything that is retained; after the first one also the outputs
    /// whose notices may be lost.
    fn connected(&mut self, wire: &Wire) {
        self.connections += 1;
        self.metrics.mqtt_connected.store(true, Ordering::Relaxed);
        add(&self.metrics.mqtt_connections, 1);
        let root = &self.parts.root;
        if !wire.subscribe(inbound_topics().map(|topic| format!("{root}{}", topic.filter()))) {
            warn!(
                "the MQTT client takes no subscriptions; nothing can be commanded over MQTT until it reconnects"
            );
        }
        self.outbox.connected();
        self.tell_bus(true);
        if self.connections > 1 {
            self.port.notice(ServerNotice::Reconnected);
        }
    }

    /// Tells the machine when the connection has gone or come back.
    fn tell_bus(&mut self, connected: bool) {
        if self.told_connected != connected {
            self.told_connected = connected;
            self.port.notice(ServerNotice::BusLink { connected });
        }
    }

    fn publish(&mut self, session: &Session) {
        let (root, metrics) = (&self.parts.root, &self.metrics);
        self.outbox.send(|parcel| {
            let (path, retain, qos, payload) = match parcel {
                Parcel::Message(message) => {
                    let topic = &message.topic;
                    (topic.path(), topic.is_retained(), topic.qos(), message.to_json())
                }
                Parcel::Clear(path) => (path.clone(), true, 1, String::new()),
            };
            let topic = format!("{root}{path}");
            let fits = payload.len() <= MESSAGE_MAX && wire::fits(&topic, &payload, session.packet_max);
            if path.contains(['+', '#', '\0']) || !fits {
                warn!(
                    "message on {path:.200} dropped: {} bytes, and at most {MESSAGE_MAX} on a topic without wildcards \
                     in a packet of {} bytes",
                    payload.len(),
                    session.packet_max
                );
                return Handed::Never;
            }
            if session.wire.publish(topic, qos, retain, payload) {
                add(&metrics.mqtt_published, 1);
                Handed::Over
            } else {
                Handed::Full
            }
        });
    }

    async fn hear(&mut self, heard: Heard, session: &mut Session) {
        match heard {
            Heard::Connected { packet_max } => {
                session.packet_max = packet_max;
                self.speaks_5 = session.version == Version::V5;
                self.hang_ups = 0;
                info!("connected to the MQTT broker over {}", session.version);
                self.connected(&session.wire);
            }
            Heard::Published(publish) => self.incoming(publish, session.version).await,
            Heard::Acknowledged { refused } => {
                self.outbox.acknowledged();
                if let Some(reason) = refused.filter(|_| !session.told_refused) {
                    session.told_refused = true;
                    warn!(
                        "the MQTT broker refuses a message ({reason}); its access rules must allow the runtime to \
                         write below {}",
                        self.parts.root
                    );
                }
            }
            Heard::SubscriptionRefused => warn!(
                "the MQTT broker refuses a subscription; its access rules must allow the runtime to read"
            ),
            Heard::Disconnected => {}
        }
    }

    async fn incoming(&mut self, publish: wire::Inbound, version: Version) {
        // empty: a retained topic that was cleared, by us or by its sender
        if publish.payload.is_empty() {
            return;
        }
        let Some(path) = publish.topic.strip_prefix(&self.parts.root) else {
            return;
        };
        if is_inbound(path) && (publish.retain || is_to_clear(path, version)) {
            self.outbox.clear(path.to_owned());
        }
        self.take(&publish.topic, &publish.payload, publish.retain).await;
    }

    async fn take(&mut self, topic: &str, payload: &[u8], retained: bool) {
        add(&self.metrics.mqtt_received, 1);
        if let Some(path) = topic.strip_prefix(&self.parts.root) {
            self.dispatch.take(decode(path, payload, retained)).await;
        }
    }

    /// Presence of a runtime that has gone.
    async fn offline(&self) -> Message {
        let presence = self.port.read(&Topic::Presence).await;
        let presence = match presence.as_deref().map(|message| &message.payload) {
            Some(Payload::Presence(presence)) => presence.clone(),
            _ => Presence::default(),
        };
        Message {
            topic: Topic::Presence,
            boot_id: self.port.boot_id(),
            ts: Timestamp::from_system_time(std::time::SystemTime::now()),
            rev: None,
            payload: Payload::Presence(Presence {
                online: false,
                ..presence
            }),
        }
    }

    /// Says what is still to be said, at last that the runtime has gone, and disconnects.
    async fn goodbye(&mut self, mut session: Session, mut offline: Message) {
        while let Some(message) = self.subscription.as_mut().and_then(Subscription::try_next) {
            self.keep(Happening::Said(Some(message))).await;
        }
        offline.ts = Timestamp::from_system_time(std::time::SystemTime::now());
        self.outbox.put(Arc::new(offline));
        self.publish(&session);
        while !self.outbox.is_empty() {
            match session.wire.next().await {
                Ok(Heard::Acknowledged { .. }) => self.outbox.acknowledged(),
                Ok(_) => {}
                Err(_) => return,
            }
            self.publish(&session);
        }
        if session.wire.disconnect() {
            while !matches!(session.wire.next().await, Ok(Heard::Disconnected) | Err(_)) {}
        }
    }
}

/// Over 3.1.1 a live message does not show its retain flag, so that every command is cleared.
fn is_to_clear(path: &str, version: Version) -> bool {
    version == Version::V3_1_1 && (path.contains("/command/") || path.contains("/lease/"))
}
