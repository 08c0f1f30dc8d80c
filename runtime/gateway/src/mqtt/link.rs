//! The connection to the broker: one client for each, so that nothing depends on what the library remembers.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use plc_api::hub::{Filter, Subscription};
use plc_api::port::Port;
use plc_api::types::Timestamp;
use plc_api::types::machine::Presence;
use plc_api::types::message::{Message, Payload};
use plc_api::types::request::Request;
use plc_api::types::topic::Topic;
use rumqttc::{
    AsyncClient, ConnectionError, Event, EventLoop, LastWill, MqttOptions, NetworkOptions, Packet, Publish,
    QoS, SubscribeFilter, SubscribeReasonCode,
};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;
use tracing::{info, warn};

use super::Parts;
use super::dispatch::Dispatch;
use super::inbound;
use super::outbox::{Handed, Outbox, Parcel};
use crate::broker::Refused;
use crate::contract::topics::INBOUND;
use crate::metrics::{Metrics, add};
use crate::position::Positions;

/// Pings after this long without traffic; the broker publishes the will after one and a half of it.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// Time to connect, s.
const CONNECT_TIMEOUT_S: u64 = 5;
/// Bytes of a packet that comes in. Reason: more than a broker may carry ends the connection, so it is generous.
const PACKET_IN_MAX: usize = 8 * 1024 * 1024;
/// Bytes of a packet that goes out.
const PACKET_OUT_MAX: usize = 1024 * 1024;
/// Bytes of one message; a larger one is dropped with a warning. Reason: the embedded broker retains no more.
const MESSAGE_MAX: usize = 256 * 1024;
/// Publishes that wait in the client library.
const CHANNEL: usize = 64;
/// Wait before the second try to connect; doubles up to [`BACKOFF_MAX`].
const BACKOFF_MIN: Duration = Duration::from_millis(100);
const BACKOFF_MAX: Duration = Duration::from_secs(5);
/// A connection that held this long starts the waits anew.
const STABLE: Duration = Duration::from_secs(5);

/// The MQTT end's task.
pub(super) struct Link {
    port: Arc<dyn Port>,
    parts: LinkParts,
    outbox: Outbox,
    positions: Positions,
    subscription: Option<Subscription>,
    dispatch: Dispatch,
    replies: mpsc::Receiver<Message>,
    refused: mpsc::Receiver<Refused>,
    metrics: Arc<Metrics>,
    stop: CancellationToken,
    connections: u64,
    told_connected: bool,
}

struct LinkParts {
    root: String,
    options: MqttOptions,
    // an external broker says nothing of the retain flag of live messages over 3.1.1
    clear_commands: bool,
}

/// Why a connection ended.
enum End {
    Stopped,
    Lost(String),
}

/// Anything that happens to a connection.
enum Happening {
    Mqtt(Result<Event, ConnectionError>),
    Said(Option<Arc<Message>>),
    Positions(Vec<Arc<Message>>),
    Reply(Message),
    Refused(Refused),
    Stop,
}

impl Link {
    pub(super) fn new(parts: Parts, stop: CancellationToken) -> Self {
        let (dispatch, replies) = Dispatch::new(Arc::clone(&parts.port), Arc::clone(&parts.metrics));
        Self {
            subscription: Some(parts.port.subscribe(Filter::All)),
            parts: LinkParts {
                options: options(&parts),
                clear_commands: parts.settings.embedded_listen.is_none(),
                root: parts.root,
            },
            port: parts.port,
            outbox: Outbox::default(),
            positions: Positions::new(parts.position_interval),
            dispatch,
            replies,
            refused: parts.refused,
            metrics: parts.metrics,
            stop,
            connections: 0,
            told_connected: true,
        }
    }

    /// Connects, again and again, until it is stopped.
    pub(super) async fn run(mut self) {
        let mut backoff = BACKOFF_MIN;
        loop {
            let begun = Instant::now();
            let end = self.connection().await;
            self.metrics.mqtt_connected.store(false, Ordering::Relaxed);
            let End::Lost(why) = end else {
                return;
            };
            self.tell_bus(false).await;
            if begun.elapsed() >= STABLE {
                backoff = BACKOFF_MIN;
            }
            let wait = jittered(backoff);
            warn!(
                "no connection to the MQTT broker: {why}; next try in {} ms",
                wait.as_millis()
            );
            backoff = (backoff * 2).min(BACKOFF_MAX);
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

    /// One connection, from the first try to its end.
    async fn connection(&mut self) -> End {
        let mut options = self.parts.options.clone();
        let will = self.offline().await;
        let topic = format!("{}{}", self.parts.root, Topic::Presence.path());
        options.set_last_will(LastWill::new(topic, will.to_json(), QoS::AtLeastOnce, true));
        let (client, eventloop) = AsyncClient::new(options, CHANNEL);
        let (mut events, _poller) = poll(eventloop);
        let mut online = false;
        loop {
            if online {
                self.publish(&client);
            }
            match self.happening(Some(&mut events)).await {
                Happening::Mqtt(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                    online = true;
                    self.connected(&client).await;
                }
                Happening::Mqtt(Ok(event)) => self.event(event).await,
                Happening::Mqtt(Err(error)) => return End::Lost(error.to_string()),
                Happening::Stop => {
                    if online {
                        self.goodbye(&client, &mut events, will).await;
                    }
                    return End::Stopped;
                }
                other => self.keep(other).await,
            }
        }
    }

    async fn happening(
        &mut self,
        events: Option<&mut mpsc::Receiver<Result<Event, ConnectionError>>>,
    ) -> Happening {
        let event = async {
            match events {
                Some(events) => events.recv().await.unwrap_or(Err(ConnectionError::RequestsDone)),
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
            event = event => Happening::Mqtt(event),
            message = said => Happening::Said(message),
            positions = self.positions.due() => Happening::Positions(positions),
            Some(reply) = self.replies.recv() => Happening::Reply(reply),
            Some(refused) = self.refused.recv() => Happening::Refused(refused),
        }
    }

    /// Everything but the connection itself.
    async fn keep(&mut self, happening: Happening) {
        match happening {
            Happening::Said(Some(message)) => {
                // presence of handlers comes in over MQTT, and would come back for ever
                if !matches!(message.topic, Topic::HandlerPresence(_))
                    && let Some(message) = self.positions.keep(message)
                {
                    self.outbox.put(message);
                }
            }
            // the port has closed: nothing more is said, the connection stays until the stop
            Happening::Said(None) => self.subscription = None,
            Happening::Positions(positions) => {
                for position in positions {
                    self.outbox.put(position);
                }
            }
            Happening::Reply(reply) => self.outbox.put(Arc::new(reply)),
            Happening::Refused((topic, payload)) => self.take(&topic, &payload, true).await,
            Happening::Mqtt(_) | Happening::Stop => {}
        }
        let lost = self.outbox.take_lost();
        if lost > 0 {
            add(&self.metrics.mqtt_events_lost, lost);
            warn!("the MQTT broker is too slow or away: {lost} events were dropped; states are kept");
        }
    }

    /// On every connection: subscribe, and say everything that is retained; after the first one also the outputs
    /// whose notices may be lost.
    async fn connected(&mut self, client: &AsyncClient) {
        self.connections += 1;
        self.metrics.mqtt_connected.store(true, Ordering::Relaxed);
        add(&self.metrics.mqtt_connections, 1);
        info!("connected to the MQTT broker");
        let filters = INBOUND.iter().map(|topic| {
            SubscribeFilter::new(format!("{}{}", self.parts.root, topic.filter), QoS::AtLeastOnce)
        });
        if client.try_subscribe_many(filters).is_err() {
            warn!(
                "the MQTT client takes no subscriptions; nothing can be commanded over MQTT until it reconnects"
            );
        }
        self.outbox.connected();
        self.tell_bus(true).await;
        if self.connections > 1 {
            self.dispatch.ask(Request::Republish, false).await;
        }
    }

    /// Tells the machine when the connection has gone or come back.
    async fn tell_bus(&mut self, connected: bool) {
        if self.told_connected != connected {
            self.told_connected = connected;
            let request = Request::BusLink { connected };
            self.dispatch.ask(request, true).await;
        }
    }

    fn publish(&mut self, client: &AsyncClient) {
        let (root, metrics) = (&self.parts.root, &self.metrics);
        self.outbox.send(|parcel| {
            let (path, retain, qos, payload) = match parcel {
                Parcel::Message(message) => {
                    let topic = &message.topic;
                    (topic.path(), topic.is_retained(), topic.qos(), message.to_json())
                }
                Parcel::Clear(path) => (path.clone(), true, 1, String::new()),
            };
            if path.contains(['+', '#', '\0']) || payload.len() > MESSAGE_MAX {
                warn!(
                    "message on {path:.200} dropped: {} bytes, and at most {MESSAGE_MAX} on a topic without wildcards",
                    payload.len()
                );
                return Handed::Never;
            }
            let qos = if qos == 0 { QoS::AtMostOnce } else { QoS::AtLeastOnce };
            match client.try_publish(format!("{root}{path}"), qos, retain, payload) {
                Ok(()) => {
                    add(&metrics.mqtt_published, 1);
                    Handed::Over
                }
                Err(_) => Handed::Full,
            }
        });
    }

    async fn event(&mut self, event: Event) {
        match event {
            Event::Incoming(Packet::Publish(publish)) => self.incoming(&publish).await,
            // brokers acknowledge in the order of publishing (MQTT-4.6.0-2)
            Event::Incoming(Packet::PubAck(_)) => self.outbox.acknowledged(),
            Event::Incoming(Packet::SubAck(ack))
                if ack.return_codes.contains(&SubscribeReasonCode::Failure) =>
            {
                warn!(
                    "the MQTT broker refuses a subscription; its access rules must allow the runtime to read"
                );
            }
            _ => {}
        }
    }

    async fn incoming(&mut self, publish: &Publish) {
        // empty: a retained topic that was cleared, by us or by its sender
        if publish.payload.is_empty() {
            return;
        }
        let Some(path) = publish.topic.strip_prefix(&self.parts.root) else {
            return;
        };
        if inbound::is_inbound(path) && (publish.retain || self.is_to_clear(path)) {
            self.outbox.clear(path.to_owned());
        }
        self.take(&publish.topic, &publish.payload, publish.retain).await;
    }

    fn is_to_clear(&self, path: &str) -> bool {
        self.parts.clear_commands && (path.contains("/command/") || path.contains("/lease/"))
    }

    async fn take(&mut self, topic: &str, payload: &[u8], retained: bool) {
        add(&self.metrics.mqtt_received, 1);
        if let Some(path) = topic.strip_prefix(&self.parts.root) {
            self.dispatch.take(inbound::read(path, payload, retained)).await;
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
    async fn goodbye(
        &mut self,
        client: &AsyncClient,
        events: &mut mpsc::Receiver<Result<Event, ConnectionError>>,
        mut offline: Message,
    ) {
        while let Some(message) = self.subscription.as_mut().and_then(Subscription::try_next) {
            self.keep(Happening::Said(Some(message))).await;
        }
        offline.ts = Timestamp::from_system_time(std::time::SystemTime::now());
        self.outbox.put(Arc::new(offline));
        self.publish(client);
        while !self.outbox.is_empty() {
            match events.recv().await {
                Some(Ok(Event::Incoming(Packet::PubAck(_)))) => self.outbox.acknowledged(),
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return,
            }
            self.publish(client);
        }
        if client.try_disconnect().is_ok() {
            while let Some(Ok(event)) = events.recv().await {
                if matches!(event, Event::Outgoing(rumqttc::Outgoing::Disconnect)) {
                    return;
                }
            }
        }
    }
}

/// Polls the connection in a task of its own: its polling must not be given up half-way.
fn poll(
    mut eventloop: EventLoop,
) -> (
    mpsc::Receiver<Result<Event, ConnectionError>>,
    AbortOnDropHandle<()>,
) {
    let mut network = NetworkOptions::new();
    network.set_tcp_nodelay(true);
    network.set_connection_timeout(CONNECT_TIMEOUT_S);
    eventloop.set_network_options(network);
    let (sender, receiver) = mpsc::channel(CHANNEL);
    let task = tokio::spawn(async move {
        loop {
            let event = eventloop.poll().await;
            // after an error or a goodbye the next poll would connect again
            let last = match &event {
                Ok(event) => matches!(event, Event::Outgoing(rumqttc::Outgoing::Disconnect)),
                Err(_) => true,
            };
            if sender.send(event).await.is_err() || last {
                return;
            }
        }
    });
    (receiver, AbortOnDropHandle::new(task))
}

fn options(parts: &Parts) -> MqttOptions {
    let client_id = super::client_id(&parts.settings, &parts.machine);
    let mut options = MqttOptions::new(client_id, parts.at.host.clone(), parts.at.port);
    options
        .set_transport(parts.at.transport.clone())
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_session(true)
        .set_max_packet_size(PACKET_IN_MAX, PACKET_OUT_MAX);
    if let Some((user, password)) = &parts.at.credentials {
        options.set_credentials(user, password);
    }
    options
}

/// Half to the whole of a wait, so that many runtimes do not come back to a broker at once.
fn jittered(wait: Duration) -> Duration {
    let random = RandomState::new().build_hasher().finish() % 1000;
    let share = 500 + random / 2;
    wait * u32::try_from(share).unwrap_or(1000) / 1000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_is_jittered_between_half_and_whole() {
        for _ in 0..100 {
            let wait = jittered(BACKOFF_MAX);
            assert!(wait >= BACKOFF_MAX / 2 && wait <= BACKOFF_MAX, "{wait:?}");
        }
    }
}
