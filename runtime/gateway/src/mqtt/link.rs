//! Keeps a connection to the broker, each with a new client, so that nothing depends on the library's memory.

use std::future::{Future, poll_fn};
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::server::ServerNotice;
use plc_protocol::types::Timestamp;
use plc_protocol::types::handler::REFRESHES;
use plc_protocol::types::machine::{BrokerInUse, Presence};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::mqtt::decode;
use rumqttc::{LastWill, Publish, QoS};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, Interval};
use tokio_util::sync::CancellationToken;
use tracing::{info, warn};

use super::arrival_queue::ArrivalQueue;
use super::dispatch::{Arrival, Dispatch};
use super::link_session::LinkSession;
use super::outbox::{Outbox, Parcel, PublishOutcome, expiry_s};
use super::urgent_replies::Reader;
use super::wire::{self, BrokerStamp, Connect, ConnectionLoss, Event, Version, Wire};
use super::{Parts, client_id, message, publisher_of};
use crate::broker_address::RefusedMessage;
use crate::contract::topics::{inbound_filters, is_inbound};
use crate::position::{every, is_position};
use crate::publisher::Publisher;

/// Largest number of bytes of one message; a larger one is dropped with a warning. Reason: the embedded broker retains
/// no larger one.
const MESSAGE_MAX: usize = 256 * 1024;
/// Largest number of messages that are sent before received ones are checked. Reason: a request must not wait for a
/// backlog of events.
const SENT_AT_ONCE_MAX: usize = 64;
/// Largest number of attempts over MQTT 5 at which a broker that has spoken it may hang up before 3.1.1 is tried.
const HANG_UPS_MAX: u32 = 10;
/// After a connection of this duration the delays between attempts start afresh.
const STABLE: Duration = Duration::from_secs(5);

/// The MQTT task.
pub(super) struct Link<C> {
    parts: Parts,
    /// Connector to the broker.
    at: C,
    outbox: Outbox,
    positions_due: Interval,
    subscription: Option<Subscription>,
    dispatch: Dispatch,
    /// Results of requests that the port has rejected.
    results: mpsc::Receiver<Message>,
    stop: CancellationToken,
    // the source of wakeups that is checked first
    turn: usize,
    connections: u64,
    // current node of the broker, tried or used
    node: usize,
    // connections that have ended since the last one that was stable
    failures: usize,
    speaks_5: bool,
    // attempts over MQTT 5 in a row that the broker did not answer
    hang_ups: u32,
    // the connection state last reported to the port
    reported_connected: bool,
    // presences published since all states were last published
    presences: u32,
    /// Task that marks pending outputs as redelivered.
    redelivering: Option<JoinHandle<()>>,
}

/// Anything that wakes the task.
enum Wakeup {
    Mqtt(Result<Event, ConnectionLoss>),
    Message(Option<Arc<Message>>),
    PositionsDue,
    PresenceEnded,
    Redelivered,
    Refused(RefusedMessage),
    Result(Box<Message>),
    Stop,
}

impl<C: Connect> Link<C> {
    pub(super) fn new(parts: Parts, at: C, stop: CancellationToken) -> Self {
        let (dispatch, results) = Dispatch::new(
            parts.machine.clone(),
            Arc::clone(&parts.metrics),
            parts.clients.clone(),
            Arc::clone(&parts.arrivals),
            parts.clients.is_none() && !parts.settings.accept_unverified_senders,
        );
        Self {
            outbox: Outbox::default(),
            positions_due: every(parts.position_interval),
            subscription: Some(parts.machine.subscribe(Filter::All)),
            dispatch,
            results,
            parts,
            at,
            stop,
            turn: 0,
            connections: 0,
            node: 0,
            failures: 0,
            speaks_5: false,
            hang_ups: 0,
            reported_connected: true,
            presences: 0,
            redelivering: None,
        }
    }

    /// Connects again and again until it is stopped: to one node of the broker after the other, with a wait after each round.
    pub(super) async fn run(mut self) {
        let mut backoff = self.at.backoff();
        loop {
            let begun = Instant::now();
            let end = self.connection().await;
            self.parts.metrics.mqtt_connected.set(0);
            let Err(ConnectionLoss { why, .. }) = end else {
                return;
            };
            self.parts.metrics.broker.record_loss();
            self.dispatch.on_lost();
            self.report_bus(false);
            if begun.elapsed() >= STABLE {
                backoff.reset();
                self.failures = 0;
            }
            let tried = self.shown();
            self.failures += 1;
            self.node = (self.node + 1) % self.at.nodes();
            if !self.failures.is_multiple_of(self.at.nodes()) {
                warn!(
                    "no connection to the MQTT broker{tried}: {why}; next try{}",
                    self.shown()
                );
                continue;
            }
            let wait = backoff.next_wait();
            let wait_ms = wait.as_millis();
            warn!(
                "no connection to the MQTT broker{tried}: {why}; next try{} in {wait_ms} ms",
                self.shown()
            );
            if self.is_stopped_within(wait).await {
                return;
            }
        }
    }

    /// Returns the node as messages name it.
    fn shown(&self) -> String {
        let address = self.at.address(self.node);
        address.map_or_else(String::new, |address| format!(" at {address}"))
    }

    /// Waits without a connection and queues the messages to be published.
    async fn is_stopped_within(&mut self, time: Duration) -> bool {
        let until = Instant::now() + time;
        loop {
            let wakeup = tokio::select! {
                biased;
                () = tokio::time::sleep_until(until) => return false,
                wakeup = self.next_wakeup(None) => wakeup,
            };
            match wakeup {
                Wakeup::Stop => return true,
                other => self.on_wakeup(other).await,
            }
        }
    }

    /// Serves one connection, from the first attempt until the connection ends or the runtime stops. If the broker does
    /// not know MQTT 5, the link tries MQTT 3.1.1 at once. If the broker has spoken MQTT 5 before, it was probably
    /// shutting down: the link tries MQTT 3.1.1 only after [`HANG_UPS_MAX`] attempts.
    async fn connection(&mut self) -> Result<(), ConnectionLoss> {
        let lost = match self.connection_over(Version::V5).await {
            Err(lost) if lost.version_unknown => lost,
            end => return end,
        };
        self.hang_ups += 1;
        if self.speaks_5 && self.hang_ups < HANG_UPS_MAX {
            return Err(lost);
        }
        let why = &lost.why;
        info!("the MQTT broker does not speak MQTT 5 ({why}); trying 3.1.1");
        self.connection_over(Version::V3_1_1).await
    }

    async fn connection_over(&mut self, version: Version) -> Result<(), ConnectionLoss> {
        let offline = self.offline().await;
        let topic = format!("{}{}", self.parts.root, Topic::Presence.path());
        let will = LastWill::new(topic, offline.to_json(), QoS::AtLeastOnce, true);
        let client_id = client_id(&self.parts.settings, &self.parts.machine_name);
        let mut session = LinkSession {
            wire: self.at.open(self.node, &client_id, Some(will), version),
            arrived: self.arrival_queue(),
            version,
            packet_max: 0,
            silent_since: None,
            warned_of_refusal: false,
        };
        loop {
            let goes_on = session.packet_max > 0 && self.publish(&mut session).await;
            let wakeup = tokio::select! {
                biased;
                wakeup = self.next_wakeup(Some(&mut session)) => wakeup,
                () = std::future::ready(()), if goes_on => continue,
            };
            match wakeup {
                Wakeup::Mqtt(event) => self.on_event(event?, &mut session).await,
                Wakeup::Stop => {
                    if session.packet_max > 0 {
                        self.finish(session, offline).await;
                    }
                    return Ok(());
                }
                other => self.on_wakeup(other).await,
            }
        }
    }

    /// Returns the queue of a new connection to an external broker.
    fn arrival_queue(&self) -> Option<ArrivalQueue> {
        let Parts {
            clients,
            root,
            arrivals,
            ..
        } = &self.parts;
        let is_external = clients.is_none();
        is_external.then(|| ArrivalQueue::new(root, Arc::clone(arrivals)))
    }

    /// Returns the first wakeup that is ready. The sources take turns in coming first, so that none delays another.
    async fn next_wakeup(&mut self, session: Option<&mut LinkSession<C::Wire>>) -> Wakeup {
        let presence_ended = async {
            self.dispatch.wait_for_expiry().await;
            Wakeup::PresenceEnded
        };
        let event = async {
            match session {
                Some(session) => Wakeup::Mqtt(session.next().await),
                None => std::future::pending().await,
            }
        };
        let message = async {
            match &mut self.subscription {
                Some(subscription) => Wakeup::Message(subscription.next().await),
                None => std::future::pending().await,
            }
        };
        let positions_due = async {
            self.positions_due.tick().await;
            Wakeup::PositionsDue
        };
        let refused = async {
            match self.parts.refused.recv().await {
                Some(refused) => Wakeup::Refused(refused),
                None => std::future::pending().await,
            }
        };
        let result = async {
            match self.results.recv().await {
                Some(result) => Wakeup::Result(Box::new(result)),
                None => std::future::pending().await,
            }
        };
        let redelivered = async {
            match &mut self.redelivering {
                // a task that has panicked marks nothing
                Some(redelivering) => drop(redelivering.await),
                None => std::future::pending().await,
            }
            Wakeup::Redelivered
        };
        let mut sources: [Pin<&mut (dyn Future<Output = Wakeup> + Send)>; 7] = [
            pin!(event),
            pin!(message),
            pin!(positions_due),
            pin!(refused),
            pin!(result),
            pin!(presence_ended),
            pin!(redelivered),
        ];
        self.turn = (self.turn + 1) % sources.len();
        sources.rotate_left(self.turn);
        let first = poll_fn(|context| {
            let mut ready = sources.iter_mut().map(|source| source.as_mut().poll(context));
            ready.find(Poll::is_ready).unwrap_or(Poll::Pending)
        });
        tokio::select! {
            biased;
            () = self.stop.cancelled() => Wakeup::Stop,
            wakeup = first => wakeup,
        }
    }

    /// Handles everything except events of the connection.
    async fn on_wakeup(&mut self, wakeup: Wakeup) {
        match wakeup {
            Wakeup::Message(Some(message)) => self.put(message),
            Wakeup::Redelivered => self.release_pending(),
            // the port has closed: nothing more to publish, but the connection stays until the stop
            Wakeup::Message(None) => self.subscription = None,
            Wakeup::PositionsDue => self.put_positions().await,
            Wakeup::PresenceEnded => {
                for (path, gone) in self.dispatch.expire_presences().await {
                    self.outbox.retain(path, gone);
                }
            }
            Wakeup::Refused((topic, payload)) => {
                // rejected as a request because of the retain flag, whoever published it
                let publisher = Publisher::Unknown {
                    name: String::new(),
                    client_id: None,
                };
                let arrival = Arrival {
                    retain: true,
                    number: None,
                    is_named: true,
                };
                self.handle_message(publisher, &topic, &payload, arrival).await;
            }
            Wakeup::Result(result) => self.outbox.put(Arc::from(result)),
            Wakeup::Mqtt(_) | Wakeup::Stop => {}
        }
        let lost = self.outbox.take_dropped_count();
        if lost > 0 {
            self.parts.metrics.mqtt_events_lost.inc_by(lost);
            warn!("the MQTT broker is too slow or offline: {lost} events were dropped; states are kept");
        }
    }

    fn put(&mut self, message: Arc<Message>) {
        // handlers publish presences over MQTT, so they would return in an endless loop
        let is_of_lane = self.parts.urgent_replies.is_urgent(&message, Reader::Link);
        if matches!(message.topic, Topic::HandlerPresence(_)) || is_position(&message.topic) || is_of_lane {
            return;
        }
        let is_presence = message.topic == Topic::Presence;
        self.outbox.put(message);
        if is_presence {
            self.on_presence();
        }
    }

    /// Releases held notices: all pending outputs are published as redelivered, so no older `m_code/pending` follows.
    fn release_pending(&mut self) {
        self.redelivering = None;
        while let Some(message) = self.subscription.as_mut().and_then(Subscription::try_next) {
            self.put(message);
        }
        self.outbox.release();
    }

    /// Publishes positions. They are not retained but streamed, also at standstill, for late subscribers.
    async fn put_positions(&mut self) {
        let birth = self.parts.machine.read(&Topic::Birth).await;
        let Some(Payload::Birth(birth)) = birth.as_ref().map(|message| &message.payload) else {
            return;
        };
        for system in &birth.coordinate_systems {
            let topic = Topic::cs(system.number, CsTopic::Position);
            if let Some(position) = self.parts.machine.read(&topic).await {
                self.outbox.put(position);
            }
        }
    }

    /// Publishes every state again, once per period after which the machine is considered offline. Reason: disconnected
    /// nodes of a cluster acknowledge messages that they lose and never exchange later.
    fn on_presence(&mut self) {
        self.presences += 1;
        if self.presences >= REFRESHES {
            self.presences = 0;
            self.outbox.queue_states_again();
        }
    }

    /// Subscribes and publishes everything that is retained, on every connection; after the first one, also the outputs
    /// whose notices may be lost.
    fn on_connected(&mut self, wire: &C::Wire) {
        self.connections += 1;
        let Parts { root, metrics, .. } = &self.parts;
        metrics.mqtt_connected.set(1);
        metrics.mqtt_connections.inc();
        if !wire.subscribe(inbound_filters().map(|filter| format!("{root}{filter}"))) {
            warn!(
                "the MQTT client accepts no subscriptions; no MQTT command is received until it reconnects"
            );
        }
        let is_again = self.connections > 1;
        self.outbox.on_connected(is_again);
        self.redelivering = is_again.then(|| tokio::spawn(self.parts.machine.republish()));
        self.presences = 0;
        self.dispatch.on_connected();
        metrics
            .broker
            .record_connection(self.at.address(self.node).map(|address| BrokerInUse {
                address,
                since: Timestamp::from_system_time(self.parts.machine.time()),
            }));
        self.report_bus(true);
    }

    /// Reports a lost and a restored connection to the machine.
    fn report_bus(&mut self, connected: bool) {
        let broker = self.parts.metrics.broker.in_use();
        if self.reported_connected != connected || broker.is_some() {
            self.reported_connected = connected;
            self.parts
                .machine
                .notice(ServerNotice::BusLink { connected, broker });
        }
    }

    /// Publishes in order, until the client library is full or up to [`SENT_AT_ONCE_MAX`]. Returns `true` if more can
    /// be sent at once. The library writes each message while the next one is prepared.
    async fn publish(&mut self, session: &mut LinkSession<C::Wire>) -> bool {
        let Parts { root, metrics, .. } = &self.parts;
        let mut sent = 0;
        while sent < SENT_AT_ONCE_MAX
            && self.outbox.send_next(|parcel| {
                let handed = hand_over(parcel, root, session);
                metrics
                    .mqtt_published
                    .inc_by(u64::from(handed == PublishOutcome::Accepted));
                handed
            })
        {
            sent += 1;
            tokio::task::yield_now().await;
        }
        if self.outbox.awaits_acknowledgement() {
            session.silent_since.get_or_insert_with(Instant::now);
        }
        sent == SENT_AT_ONCE_MAX
    }

    async fn on_event(&mut self, event: Event, session: &mut LinkSession<C::Wire>) {
        match event {
            Event::Connected { packet_max } => {
                session.packet_max = packet_max;
                self.speaks_5 = session.version == Version::V5;
                self.hang_ups = 0;
                info!("connected to the MQTT broker over {}", session.version);
                self.on_connected(&session.wire);
            }
            Event::Published { publish, named } => {
                self.on_publish(&publish, &named, session.version).await;
                if session.arrived.is_some() {
                    // lets the task that reads the connection run, so that the next urgent request arrives
                    tokio::task::yield_now().await;
                }
            }
            Event::Acknowledged { refused } => {
                self.outbox.on_acknowledged();
                session.silent_since = self.outbox.awaits_acknowledgement().then(Instant::now);
                if let Some(reason) = refused.filter(|_| !session.warned_of_refusal) {
                    session.warned_of_refusal = true;
                    warn!(
                        "the MQTT broker refuses a message ({reason}); its access rules must allow the runtime to \
                         write below {}",
                        self.parts.root
                    );
                }
            }
            Event::SubscriptionRefused => warn!(
                "the MQTT broker refuses a subscription; its access rules must allow the runtime to read"
            ),
            Event::Disconnected => {}
        }
    }

    async fn on_publish(&mut self, publish: &Publish, named: &BrokerStamp, version: Version) {
        // empty: a retained topic was cleared, by the runtime or by its sender; executed: by the urgent lane
        if publish.payload.is_empty() || named.is_executed {
            return;
        }
        let path = publish.topic.strip_prefix(&self.parts.root).unwrap_or_default();
        let speaker = MessageSender::split(path).0;
        let is_named = speaker.is_some();
        let publisher = publisher_of(&self.parts, named, speaker);
        if let Some(path) = publish.topic.strip_prefix(&self.parts.root)
            && is_inbound(path)
            && (publish.retain || version.is_to_clear(path))
        {
            self.outbox.retain(path.to_owned(), String::new());
        }
        let arrival = Arrival {
            retain: publish.retain,
            number: named.arrival,
            is_named,
        };
        self.handle_message(publisher, &publish.topic, &publish.payload, arrival)
            .await;
    }

    async fn handle_message(&mut self, publisher: Publisher, topic: &str, payload: &[u8], arrival: Arrival) {
        let Some(path) = topic.strip_prefix(&self.parts.root) else {
            return;
        };
        self.parts.metrics.mqtt_received.inc();
        let inbound = decode(path, payload, arrival.retain);
        if let Some(reply) = self.dispatch.dispatch_message(publisher, inbound, arrival).await {
            self.outbox.put(Arc::new(reply));
        }
    }

    /// Returns the presence of a runtime that is offline.
    async fn offline(&self) -> Message {
        let machine = &self.parts.machine;
        let mut presence = match machine.read(&Topic::Presence).await.as_deref() {
            Some(Message {
                payload: Payload::Presence(presence),
                ..
            }) => presence.clone(),
            _ => Presence::default(),
        };
        presence.online = false;
        presence.broker = None;
        presence.expires_ms = None;
        message(machine, Topic::Presence, Payload::Presence(presence))
    }

    /// Publishes the remaining messages, then the offline presence, and disconnects.
    async fn finish(&mut self, mut session: LinkSession<C::Wire>, offline: Message) {
        while let Some(message) = self.subscription.as_mut().and_then(Subscription::try_next) {
            self.on_wakeup(Wakeup::Message(Some(message))).await;
        }
        self.outbox.release();
        let offline = message(&self.parts.machine, offline.topic, offline.payload);
        self.outbox.put(Arc::new(offline));
        while self.publish(&mut session).await {}
        while !self.outbox.is_empty() {
            match session.wire.next().await {
                Ok(Event::Acknowledged { .. }) => self.outbox.on_acknowledged(),
                Ok(_) => {}
                Err(_) => return,
            }
            while self.publish(&mut session).await {}
        }
        if session.wire.disconnect() {
            while !matches!(session.wire.next().await, Ok(Event::Disconnected) | Err(_)) {}
        }
    }
}

/// Gives a parcel to the client library.
fn hand_over(parcel: &Parcel, root: &str, session: &LinkSession<impl Wire>) -> PublishOutcome {
    let (path, retain, qos, payload, expiry_s) = match parcel {
        Parcel::Message(message) => {
            let topic = &message.topic;
            let (retain, qos, expiry_s) = (topic.is_retained(), topic.qos(), expiry_s(message));
            (topic.path(), retain, qos, message.to_json(), expiry_s)
        }
        Parcel::Retained(path, payload) => (path.clone(), true, 1, payload.clone(), None),
    };
    let topic = format!("{root}{path}");
    let fits = payload.len() <= MESSAGE_MAX && wire::fits(&topic, &payload, session.packet_max);
    if path.contains(['+', '#', '\0']) || !fits {
        warn!(
            "message on {path:.200} dropped: {} bytes, and at most {MESSAGE_MAX} on a topic without wildcards in a \
             packet of {} bytes",
            payload.len(),
            session.packet_max
        );
        return PublishOutcome::Never;
    }
    if session.wire.publish(topic, qos, retain, payload, expiry_s) {
        PublishOutcome::Accepted
    } else {
        PublishOutcome::Full
    }
}
