//! The runtime's own connection to its embedded broker: messages pass to and from the router unchanged, without a
//! socket, packets or acknowledgements.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;

use mqtt5::QoS;
use mqtt5::broker::router::{
    DeliveryLanes, LaneReceivers, MessageRouter, SubscriptionRequest, TakeoverNotice,
};
use mqtt5::broker::storage::{QueueHandle, QueuedMessage};
use mqtt5::packet::publish::PublishPacket;
use parking_lot::Mutex;
use rumqttc::{LastWill, Publish};
use tokio::sync::oneshot;
use tokio::time::Instant;

use super::wire::{BrokerStamp, Connect, ConnectionLoss, Event, Version, Wire};
use crate::arrivals::{ARRIVAL, EXECUTED};
use crate::broker::{Exchange, IN_TRANSIT_MAX, PACKET_MAX};

/// Largest number of pending orders; further ones are refused until there is room.
const ORDERS_MAX: usize = 64;

/// Largest number of messages taken at a time from the backlog, which holds those that found the queue full.
const BACKLOG_MAX: usize = 32;

/// User properties in which the broker names the publisher of a message and its client id. It overwrites those of a
/// client.
const SENDER: &str = "x-mqtt-sender";
const CLIENT_ID: &str = "x-mqtt-client-id";

/// The embedded broker as the runtime reaches it.
pub(crate) struct Inside(pub(crate) Exchange);

impl Connect for Inside {
    type Wire = InsideWire;

    fn open(&self, _node: usize, client_id: &str, will: Option<LastWill>, _: Version) -> InsideWire {
        let (lanes, come) = DeliveryLanes::channel(IN_TRANSIT_MAX);
        let (displace, displaced) = oneshot::channel();
        InsideWire {
            exchange: self.0.clone(),
            client_id: client_id.into(),
            connection: 0,
            will,
            orders: Mutex::new([Order::Connect(lanes, displace)].into()),
            work: None,
            read: VecDeque::new(),
            come,
            backlog: self.0.router.queue_handle(client_id),
            displaced,
            is_turn_of_read: false,
        }
    }
}

/// Order of the runtime to its broker.
enum Order {
    Connect(DeliveryLanes, oneshot::Sender<TakeoverNotice>),
    Subscribe(Vec<String>),
    Publish(PublishPacket),
    Disconnect,
}

/// Result of an order.
enum Done {
    /// An event for the runtime.
    Event(Event),
    /// The connection is established; its number in the router.
    Connected(u64),
    /// Retained messages of a subscription.
    Read(Vec<PublishPacket>),
    Nothing,
}

type Work = Pin<Box<dyn Future<Output = Done> + Send>>;

/// A connection of the runtime to its broker. Dropping it without a DISCONNECT publishes its will.
pub(crate) struct InsideWire {
    exchange: Exchange,
    client_id: Arc<str>,
    /// Number of the connection; 0 before it is connected.
    connection: u64,
    /// Removed by a DISCONNECT.
    will: Option<LastWill>,
    orders: Mutex<VecDeque<Order>>,
    /// The order being executed; it survives a cancelled `next`.
    work: Option<Work>,
    /// Messages that come before the queued ones.
    read: VecDeque<PublishPacket>,
    come: LaneReceivers,
    /// Messages that found the queue full.
    backlog: QueueHandle,
    displaced: oneshot::Receiver<TakeoverNotice>,
    /// Reading messages and executing orders take turns, so that neither delays the other.
    is_turn_of_read: bool,
}

impl InsideWire {
    /// Queues an order. Returns `false` when there is no room.
    fn order(&self, order: Order) -> bool {
        let mut orders = self.orders.lock();
        let has_room = orders.len() < ORDERS_MAX;
        if has_room {
            orders.push_back(order);
        }
        has_room
    }

    /// Returns the oldest message.
    fn try_read(&mut self) -> Option<Event> {
        let first = self.read.pop_front();
        let publish = first.or_else(|| self.come.try_recv().ok().map(|come| come.publish))?;
        Some(published(publish))
    }

    /// Reads messages from the backlog: they are later than all in the queue.
    async fn read_backlog(&mut self) {
        let taken = self.backlog.take(BACKLOG_MAX).await;
        self.read
            .extend(taken.iter().map(QueuedMessage::to_publish_packet));
        self.backlog.finish_drain();
        if !self.backlog.is_empty() {
            self.backlog.notify();
        }
    }

    fn work(&mut self, order: Order) -> Work {
        let exchange = self.exchange.clone();
        let router = Arc::clone(&exchange.router);
        let client_id = Arc::clone(&self.client_id);
        match order {
            Order::Connect(lanes, displace) => {
                let backlog = Arc::clone(&self.backlog);
                Box::pin(async move {
                    let name = (*client_id).to_owned();
                    let registered = router
                        .register_session(name, lanes, backlog, displace, true)
                        .await;
                    Done::Connected(registered.generation)
                })
            }
            Order::Subscribe(filters) => Box::pin(subscribe(router, client_id, filters)),
            Order::Publish(publish) => Box::pin(async move {
                // it is delivered in any case; for it, clients that do not read are closed
                exchange.make_room(publish.payload.len());
                let now = Instant::now();
                router
                    .route_message_with_deadline(&publish, Some(&client_id), now)
                    .await;
                match publish.qos {
                    QoS::AtMostOnce => Done::Nothing,
                    _ => Done::Event(Event::Acknowledged { refused: None }),
                }
            }),
            Order::Disconnect => {
                self.will = None;
                let connection = self.connection;
                Box::pin(async move {
                    router.release_client(&client_id, connection, false).await;
                    Done::Event(Event::Disconnected)
                })
            }
        }
    }
}

/// Subscribes, and reads the retained messages.
async fn subscribe(router: Arc<MessageRouter>, client_id: Arc<str>, filters: Vec<String>) -> Done {
    let mut retained = Vec::new();
    for filter in filters {
        let request = SubscriptionRequest::new(&*client_id, &*filter, QoS::AtLeastOnce);
        if router
            .subscribe(request.with_retain_as_published(true))
            .await
            .is_err()
        {
            return Done::Event(Event::SubscriptionRefused);
        }
        retained.extend(router.get_retained_messages(&filter).await);
    }
    Done::Read(retained)
}

impl Wire for InsideWire {
    async fn next(&mut self) -> Result<Event, ConnectionLoss> {
        loop {
            if let Some(work) = &mut self.work {
                let done = work.await;
                self.work = None;
                match done {
                    Done::Event(event) => return Ok(event),
                    Done::Connected(connection) => {
                        self.connection = connection;
                        return Ok(Event::Connected {
                            packet_max: PACKET_MAX,
                        });
                    }
                    Done::Read(retained) => self.read.extend(retained),
                    Done::Nothing => {}
                }
            }
            if std::mem::take(&mut self.is_turn_of_read)
                && let Some(event) = self.try_read()
            {
                return Ok(event);
            }
            let order = self.orders.get_mut().pop_front();
            if let Some(order) = order {
                self.is_turn_of_read = true;
                self.work = Some(self.work(order));
                continue;
            }
            if let Some(event) = self.try_read() {
                return Ok(event);
            }
            // the queue is older than the backlog
            tokio::select! {
                biased;
                _ = &mut self.displaced => return Err(ConnectionLoss {
                    why: "another client has its id".to_owned(),
                    version_unknown: false,
                }),
                Some(come) = self.come.recv() => return Ok(published(come.publish)),
                () = self.backlog.notified() => self.read_backlog().await,
            }
        }
    }

    fn subscribe(&self, filters: impl Iterator<Item = String>) -> bool {
        self.order(Order::Subscribe(filters.collect()))
    }

    fn publish(&self, topic: String, qos: u8, retain: bool, payload: String, expiry_s: Option<u32>) -> bool {
        let qos = match qos {
            0 => QoS::AtMostOnce,
            _ => QoS::AtLeastOnce,
        };
        let payload = self.exchange.count(payload.into());
        let mut publish = PublishPacket::new(topic, payload, qos);
        publish.retain = retain;
        if let Some(expiry_s) = expiry_s {
            publish.properties.set_message_expiry_interval(expiry_s);
        }
        self.order(Order::Publish(publish))
    }

    fn disconnect(&self) -> bool {
        self.order(Order::Disconnect)
    }
}

impl Drop for InsideWire {
    fn drop(&mut self) {
        let (Some(will), Ok(executor)) = (self.will.take(), tokio::runtime::Handle::try_current()) else {
            return;
        };
        let router = Arc::clone(&self.exchange.router);
        let (client_id, connection) = (Arc::clone(&self.client_id), self.connection);
        let mut publish = PublishPacket::new(will.topic, will.message, QoS::AtLeastOnce);
        publish.retain = will.retain;
        let ending = async move {
            router.release_client(&client_id, connection, false).await;
            router.route_message(&publish, Some(&client_id)).await;
        };
        executor.spawn(
            self.exchange
                .supervisor
                .contained("last will of the link", ending),
        );
    }
}

/// Converts a received message; the broker has named its publisher.
fn published(publish: PublishPacket) -> Event {
    let said = |name| (publish.properties.get_user_property_value(name)).map(ToOwned::to_owned);
    let named = BrokerStamp {
        user: said(SENDER),
        client_id: said(CLIENT_ID),
        arrival: said(ARRIVAL).and_then(|number| number.parse().ok()),
        is_executed: said(EXECUTED).is_some(),
    };
    let mut taken = Publish::new(publish.topic_name, rumqttc::QoS::AtLeastOnce, publish.payload);
    taken.retain = publish.retain;
    Event::Published {
        publish: taken,
        named,
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::mpsc;

    use super::*;
    use crate::broker::{Broker, BrokerAccess, SLOT_LIMITS};
    use crate::tests::StubPort;

    const ROOT: &str = "tandem/v1/mill-1/";

    fn broker() -> Broker {
        let (refused, _) = mpsc::channel(1);
        let access = BrokerAccess {
            root: ROOT.into(),
            runtime_client_id: "runtime".into(),
            users: None,
            machine: crate::machine::Machine::new(StubPort::new()),
        };
        Broker::start("127.0.0.1:0".parse().unwrap(), access, None, refused, SLOT_LIMITS).unwrap()
    }

    /// Creates a connection with a will, subscribed to everything.
    async fn connected(inside: &Inside, client_id: &str) -> InsideWire {
        let will = LastWill::new("gone", client_id, rumqttc::QoS::AtLeastOnce, true);
        let mut wire = inside.open(0, client_id, Some(will), Version::V5);
        assert_eq!(
            wire.next().await.unwrap(),
            Event::Connected {
                packet_max: PACKET_MAX
            }
        );
        assert!(wire.subscribe(["#".to_owned()].into_iter()));
        wire
    }

    /// Returns the topic, payload and retain flag of the next message.
    async fn read(wire: &mut InsideWire) -> (String, String, bool) {
        loop {
            if let Event::Published { publish, .. } = wire.next().await.unwrap() {
                let payload = String::from_utf8(publish.payload.to_vec()).unwrap();
                return (publish.topic, payload, publish.retain);
            }
        }
    }

    fn message(topic: &str, payload: &impl ToString) -> PublishPacket {
        PublishPacket::new(topic, payload.to_string(), QoS::AtLeastOnce)
    }

    #[tokio::test]
    async fn messages_keep_the_order_of_their_publisher_when_the_queue_is_full() {
        let inside = Inside(broker().exchange());
        let mut wire = connected(&inside, "runtime").await;
        wire.publish("begin".into(), 1, false, String::new(), None);
        assert_eq!(read(&mut wire).await.0, "begin");
        let count = 3 * IN_TRANSIT_MAX;
        for n in 0..count {
            let now = Instant::now();
            inside
                .0
                .router
                .route_message_with_deadline(&message("n", &n), None, now)
                .await;
            // the client reads a little in the meantime
            if n % 50 == 49 {
                assert_eq!(read(&mut wire).await.1, (n / 50).to_string());
            }
        }
        for n in count / 50..count {
            assert_eq!(read(&mut wire).await.1, n.to_string());
        }
    }

    #[tokio::test]
    async fn retained_messages_arrive_with_the_subscription_before_published_ones() {
        let inside = Inside(broker().exchange());
        let mut retained = message("kept", &"old");
        retained.retain = true;
        inside.0.router.route_message(&retained, None).await;
        let mut wire = connected(&inside, "runtime").await;
        wire.publish("now".into(), 0, false, "new".into(), None);
        assert_eq!(read(&mut wire).await, ("kept".into(), "old".into(), true));
        assert_eq!(read(&mut wire).await, ("now".into(), "new".into(), false));
    }

    #[tokio::test]
    async fn will_is_published_after_a_broken_connection_not_after_a_disconnect() {
        let inside = Inside(broker().exchange());
        let mut other = connected(&inside, "other").await;
        let mut leaves = connected(&inside, "leaves").await;
        assert!(leaves.disconnect());
        while leaves.next().await.unwrap() != Event::Disconnected {}
        drop(leaves);
        drop(connected(&inside, "breaks").await);
        assert_eq!(read(&mut other).await, ("gone".into(), "breaks".into(), true));
    }

    #[tokio::test]
    async fn qos_1_messages_are_acknowledged_with_waiting_messages_in_between() {
        let inside = Inside(broker().exchange());
        let mut wire = connected(&inside, "runtime").await;
        for n in 0..3 {
            wire.publish("own".into(), 1, false, n.to_string(), None);
        }
        let mut acknowledged = 0;
        for n in 0..3 {
            match wire.next().await.unwrap() {
                Event::Acknowledged { refused: None } => acknowledged += 1,
                other => panic!("{other:?}"),
            }
            assert_eq!(read(&mut wire).await.1, n.to_string(), "before the next order");
        }
        assert_eq!(acknowledged, 3);
    }

    #[tokio::test]
    async fn a_full_list_of_orders_takes_no_more_until_they_are_carried_out() {
        let inside = Inside(broker().exchange());
        let mut wire = connected(&inside, "runtime").await;
        let mut published = 0;
        while wire.publish("own".into(), 1, false, String::new(), None) {
            published += 1;
        }
        assert_eq!(published, ORDERS_MAX - 1, "the subscription is one");
        wire.next().await.unwrap();
        assert!(wire.publish("own".into(), 1, false, String::new(), None));
    }
}
