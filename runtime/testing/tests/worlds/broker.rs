//! A model of an MQTT broker and of the network between the broker and its clients. The model guarantees only
//! what MQTT guarantees.
//!
//! Messages of one connection arrive in order; the order between connections is random. Messages with quality
//! of service 1 arrive at least once. When a connection breaks, the last messages in transit in each
//! direction are lost. The broker publishes a will when it notices the loss, and sends retained messages at
//! each subscription. A broker that ends forgets all sessions, and possibly the retained messages.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::transport::backoff::Backoff;
use rumqttc::{LastWill, Publish, QoS};
use tandem_gateway::{BrokerStamp, Connect, ConnectionLoss, Event, Version, Wire};
use tandem_testing::simulated_disk::SimulatedDisk;
use tokio::sync::{Notify, mpsc};
use tokio::time::Instant;

use super::random::Random;
use super::trace::Trace;

/// Random delays and duplicates of the network.
#[derive(Debug, Clone)]
pub(super) struct Network {
    /// Longest delay of a message, ms.
    pub delay_ms: u64,
    /// Percentage of messages with quality of service 1 that are delivered twice.
    pub duplicates: u64,
}

#[derive(Debug)]
enum DeliveryStep {
    Connected(u64),
    /// A message from this client arrives at the broker.
    Arrived(u64, ModelMessage),
    /// An event arrives at this client.
    Delivered(u64, Event),
    Will(ModelMessage),
}

#[derive(Debug, Clone)]
struct ModelMessage {
    topic: String,
    payload: Vec<u8>,
    qos: u8,
    retain: bool,
}

#[derive(Debug)]
struct Connection {
    client_id: String,
    filters: Vec<String>,
    will: Option<ModelMessage>,
    events: mpsc::UnboundedSender<Result<Event, ConnectionLoss>>,
    // Arrival times of the newest message: from the client (`up`) and to the client (`down`).
    up: Instant,
    down: Instant,
    is_up: bool,
}

#[derive(Debug)]
struct State {
    random: Random,
    network: Network,
    is_up: bool,
    is_calm: bool,
    connections: BTreeMap<u64, Connection>,
    retained: BTreeMap<String, Vec<u8>>,
    steps: BTreeMap<(Instant, u64), DeliveryStep>,
    count: u64,
}

/// The broker, as its clients and the faults use it.
#[derive(Debug, Clone)]
pub(super) struct ModelBroker {
    state: Arc<Mutex<State>>,
    wake: Arc<Notify>,
    trace: Trace,
}

impl ModelBroker {
    /// Starts the broker, and the task that delivers messages.
    pub fn start(random: Random, network: Network, trace: Trace) -> Self {
        let broker = Self {
            state: Arc::new(Mutex::new(State {
                random,
                network,
                is_up: true,
                is_calm: false,
                connections: BTreeMap::new(),
                retained: BTreeMap::new(),
                steps: BTreeMap::new(),
                count: 0,
            })),
            wake: Arc::default(),
            trace,
        };
        let delivering = broker.clone();
        tokio::spawn(async move { delivering.deliver().await });
        broker
    }

    async fn deliver(&self) {
        loop {
            let next = self.state.lock().steps.keys().next().map(|(at, _)| *at);
            match next {
                None => self.wake.notified().await,
                Some(at) if at > Instant::now() => {
                    tokio::select! {
                        biased;
                        () = tokio::time::sleep_until(at) => {}
                        () = self.wake.notified() => {}
                    }
                }
                Some(_) => {
                    let step = self.state.lock().steps.pop_first();
                    if let Some((_, step)) = step {
                        self.execute_step(step);
                    }
                    // Lets the recipient of this message run before the next delivery.
                    tokio::task::yield_now().await;
                }
            }
        }
    }

    fn execute_step(&self, step: DeliveryStep) {
        let mut state = self.state.lock();
        match step {
            DeliveryStep::Connected(number) => state.connected(number),
            DeliveryStep::Arrived(number, message) => state.arrived(Some(number), &message),
            DeliveryStep::Will(message) => state.arrived(None, &message),
            DeliveryStep::Delivered(number, event) => {
                if let Some(connection) = state.connections.get(&number) {
                    if let Event::Published { publish, .. } = &event {
                        let text = String::from_utf8_lossy(&publish.payload);
                        let (client, topic) = (&connection.client_id, &publish.topic);
                        self.trace.line(format_args!(
                            "to {client}: {topic} {} {}",
                            publish.retain,
                            without_instance(&text)
                        ));
                    }
                    // The client may have disconnected, so a failure is ignored.
                    let _ = connection.events.send(Ok(event));
                }
            }
        }
    }

    /// Cuts all connections of a client, or of all clients if `client_id` is `None`.
    pub fn cut(&self, client_id: Option<&str>) {
        let mut state = self.state.lock();
        let cut = state
            .connections
            .iter()
            .filter(|(_, connection)| client_id.is_none_or(|client_id| connection.client_id == client_id));
        let numbers: Vec<u64> = cut.map(|(number, _)| *number).collect();
        for number in numbers {
            state.cut(number, true);
        }
        drop(state);
        self.wake.notify_one();
    }

    /// Ends the broker, and starts it again after this time.
    pub async fn die(&self, time: Duration) {
        {
            let mut state = self.state.lock();
            state.is_up = false;
            let numbers: Vec<u64> = state.connections.keys().copied().collect();
            for number in numbers {
                state.cut(number, false);
            }
            state.steps.clear();
            if state.random.percent(50) {
                state.retained.clear();
            }
        }
        tokio::time::sleep(time).await;
        self.state.lock().is_up = true;
    }

    /// Ends all faults, so that none occurs from now on.
    pub fn calm(&self) {
        let mut state = self.state.lock();
        (state.is_up, state.is_calm) = (true, true);
        state.network.duplicates = 0;
        state.network.delay_ms = 5;
    }

    /// Returns true if all faults have been ended.
    pub fn is_calm(&self) -> bool {
        self.state.lock().is_calm
    }

    fn open(&self, client_id: &str, will: Option<ModelMessage>) -> ModelWire {
        let (events, inbox) = mpsc::unbounded_channel();
        let mut state = self.state.lock();
        state.count += 1;
        let (number, now) = (state.count, Instant::now());
        if state.is_up {
            let connection = Connection {
                client_id: client_id.to_owned(),
                filters: Vec::new(),
                will,
                events,
                up: now,
                down: now,
                is_up: false,
            };
            state.connections.insert(number, connection);
            let at = now + state.delay();
            state.push(at, DeliveryStep::Connected(number));
        } else {
            let _ = events.send(Err(lost("connection refused")));
        }
        drop(state);
        self.wake.notify_one();
        ModelWire {
            broker: self.clone(),
            number,
            inbox,
            process_disk: None,
        }
    }
}

/// Removes the random instance of a sequence program from a text, because it differs between runs of one
/// seed.
fn without_instance(text: &str) -> String {
    let mut parts = text.split(r#""instance":"i-"#);
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, after| text + after.get(12..).unwrap_or_default())
}

fn lost(why: &str) -> ConnectionLoss {
    ConnectionLoss {
        why: why.to_owned(),
        version_unknown: false,
    }
}

impl State {
    fn delay(&mut self) -> Duration {
        let longest = self.network.delay_ms;
        self.random.ms(0, longest)
    }

    fn push(&mut self, at: Instant, step: DeliveryStep) {
        self.count += 1;
        self.steps.insert((at, self.count), step);
    }

    /// Schedules an event for a client; events of one connection keep their order.
    fn send(&mut self, number: u64, event: Event) {
        let delay = self.delay();
        if let Some(connection) = self.connections.get_mut(&number) {
            let at = (Instant::now() + delay).max(connection.down);
            connection.down = at;
            self.push(at, DeliveryStep::Delivered(number, event));
        }
    }

    fn connected(&mut self, number: u64) {
        let Some(connection) = self.connections.get_mut(&number) else {
            return;
        };
        connection.is_up = true;
        let client_id = connection.client_id.clone();
        // The broker ends an earlier connection of the same client.
        let same = |(other, connection): (&u64, &Connection)| {
            (*other < number && connection.client_id == client_id).then_some(*other)
        };
        let older: Vec<u64> = self.connections.iter().filter_map(same).collect();
        for other in older {
            self.cut(other, true);
        }
        self.send(number, Event::Connected { packet_max: 1 << 20 });
    }

    fn arrived(&mut self, from: Option<u64>, message: &ModelMessage) {
        if message.retain && message.payload.is_empty() {
            self.retained.remove(&message.topic);
        } else if message.retain {
            self.retained
                .insert(message.topic.clone(), message.payload.clone());
        }
        let times = 1 + u8::from(message.qos > 0 && self.random.percent(self.network.duplicates));
        for _ in 0..times {
            self.fan_out(message);
        }
        if let Some(number) = from.filter(|_| message.qos > 0) {
            self.send(number, Event::Acknowledged { refused: None });
        }
    }

    fn fan_out(&mut self, message: &ModelMessage) {
        let wanting = self.connections.iter().filter(|(_, connection)| {
            (connection.filters.iter()).any(|filter| rumqttc::matches(&message.topic, filter))
        });
        let numbers: Vec<u64> = wanting.map(|(number, _)| *number).collect();
        for number in numbers {
            self.send(number, published(message, message.retain));
        }
    }

    fn subscribe(&mut self, number: u64, filters: Vec<String>) {
        let fits = |topic: &str| filters.iter().any(|filter| rumqttc::matches(topic, filter));
        let kept: Vec<ModelMessage> = (self.retained.iter())
            .filter(|(topic, _)| fits(topic))
            .map(|(topic, payload)| ModelMessage {
                topic: topic.clone(),
                payload: payload.clone(),
                qos: 1,
                retain: true,
            })
            .collect();
        if let Some(connection) = self.connections.get_mut(&number) {
            connection.filters.extend(filters);
        }
        for message in kept {
            self.send(number, published(&message, true));
        }
    }

    /// Breaks a connection. Messages from the client that arrive until a random time are delivered, all
    /// others are lost.
    fn cut(&mut self, number: u64, is_noticed: bool) {
        let Some(connection) = self.connections.remove(&number) else {
            return;
        };
        let last = Instant::now() + self.delay();
        let steps = std::mem::take(&mut self.steps);
        self.steps = steps
            .into_iter()
            .filter(|((at, _), step)| match step {
                DeliveryStep::Arrived(from, _) => *from != number || *at <= last,
                DeliveryStep::Delivered(to, _) => *to != number,
                _ => true,
            })
            .collect();
        // The client may have disconnected, so a failure is ignored.
        let _ = connection.events.send(Err(lost("the connection was reset")));
        if let Some(will) = connection.will.filter(|_| is_noticed && connection.is_up) {
            // The will is published immediately or when the keep-alive has expired, but after the messages
            // that have arrived.
            let noticed = last
                + if self.random.percent(60) {
                    self.delay()
                } else {
                    self.random.ms(1000, 8000)
                };
            self.push(noticed.max(last), DeliveryStep::Will(will));
        }
    }
}

fn published(message: &ModelMessage, retain: bool) -> Event {
    let mut publish = Publish::new(message.topic.clone(), QoS::AtLeastOnce, message.payload.clone());
    publish.retain = retain;
    Event::Published {
        publish,
        named: BrokerStamp::default(),
    }
}

/// The connection of one client to the broker.
pub(super) struct ModelWire {
    broker: ModelBroker,
    number: u64,
    inbox: mpsc::UnboundedReceiver<Result<Event, ConnectionLoss>>,
    /// Disk of the runtime's process: only connections of this process end when its disk ends.
    process_disk: Option<SimulatedDisk>,
}

impl ModelWire {
    fn up(&self, message: ModelMessage) -> bool {
        if self.process_disk.as_ref().is_some_and(SimulatedDisk::is_dead) {
            return true;
        }
        let mut state = self.broker.state.lock();
        let delay = state.delay();
        if let Some(connection) = state.connections.get_mut(&self.number) {
            let at = (Instant::now() + delay).max(connection.up);
            connection.up = at;
            state.push(at, DeliveryStep::Arrived(self.number, message));
        }
        drop(state);
        self.broker.wake.notify_one();
        true
    }
}

impl Wire for ModelWire {
    async fn next(&mut self) -> Result<Event, ConnectionLoss> {
        self.inbox
            .recv()
            .await
            .unwrap_or_else(|| Err(lost("it has ended")))
    }

    fn subscribe(&self, filters: impl Iterator<Item = String>) -> bool {
        self.broker.state.lock().subscribe(self.number, filters.collect());
        self.broker.wake.notify_one();
        true
    }

    fn publish(&self, topic: String, qos: u8, retain: bool, payload: String, _expiry_s: Option<u32>) -> bool {
        self.up(ModelMessage {
            topic,
            payload: payload.into_bytes(),
            qos,
            retain,
        })
    }

    fn disconnect(&self) -> bool {
        let mut state = self.broker.state.lock();
        if let Some(connection) = state.connections.get_mut(&self.number) {
            connection.will = None;
        }
        state.send(self.number, Event::Disconnected);
        drop(state);
        self.broker.wake.notify_one();
        true
    }
}

impl Drop for ModelWire {
    fn drop(&mut self) {
        self.broker.state.lock().cut(self.number, true);
        self.broker.wake.notify_one();
    }
}

/// Creates the connection of the runtime to the broker.
#[derive(Debug, Clone)]
pub(super) struct Connector {
    pub broker: ModelBroker,
    pub disk: SimulatedDisk,
    pub seed: u64,
}

impl Connect for Connector {
    type Wire = ModelWire;

    fn open(&self, _: usize, client_id: &str, will: Option<LastWill>, _: Version) -> ModelWire {
        let will = will.map(|will| ModelMessage {
            topic: will.topic,
            payload: will.message.to_vec(),
            qos: 1,
            retain: will.retain,
        });
        let mut wire = self.broker.open(client_id, will);
        wire.process_disk = Some(self.disk.clone());
        wire
    }

    fn backoff(&self) -> Backoff {
        Backoff::seeded(self.seed)
    }
}

impl ModelBroker {
    /// Creates the connection of a client other than the runtime.
    pub fn connect(&self, client_id: &str, will: Option<(String, String)>) -> ModelWire {
        let will = will.map(|(topic, payload)| ModelMessage {
            topic,
            payload: payload.into_bytes(),
            qos: 1,
            retain: true,
        });
        self.open(client_id, will)
    }
}
