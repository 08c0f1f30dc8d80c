//! Messages of an external broker that have arrived and are not handled yet.
//!
//! A connection delivers all messages one after the other. So that hold, stop and abort do not wait for the messages
//! before them, the queue reads ahead and decides on arrival which requests are urgent. The order of arrival is kept for
//! [`ORDER_WAIT_MAX`]; then an urgent request overtakes the messages before it, and the commands to move among these are
//! rejected.

use std::collections::VecDeque;
use std::sync::Arc;

use futures_util::FutureExt as _;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::wire::mqtt::{Inbound, decode};
use rumqttc::Publish;
use tokio::time::Instant;

use super::wire::{BrokerStamp, ConnectionLoss, Event, Wire};
use crate::arrivals::{Arrivals, ORDER_WAIT_MAX, may_be_urgent};
use crate::urgent_slots::UrgentKind;

/// Largest number of messages that are read ahead. At the limit, the oldest message is handled before the next one is
/// read. Reason: more than the 128 requests that a user may leave unanswered, of each of 8 coordinate systems.
const WAITING_MAX: usize = 4096;

/// Largest number of bytes of messages that are read ahead; the last message may exceed it. Reason: as for one packet.
const WAITING_BYTES_MAX: usize = 8 << 20;

/// A message that waits.
#[derive(Debug)]
struct WaitingMessage {
    publish: Publish,
    named: BrokerStamp,
}

impl WaitingMessage {
    fn bytes(&self) -> usize {
        self.publish.topic.len() + self.publish.payload.len()
    }
}

/// An urgent request that waits for the messages before it.
#[derive(Debug)]
struct UrgentMessage {
    message: WaitingMessage,
    /// Its number in the order of arrival.
    number: u64,
    /// When it overtakes the messages before it.
    due: Instant,
    /// Coordinate system of a hold, stop or abort; `None` for the end of a jog and for alarms.
    halts: Option<CoordinateSystemNumber>,
}

/// The queue of one connection.
#[derive(Debug)]
pub(super) struct ArrivalQueue {
    root: String,
    arrivals: Arc<Arrivals>,
    waiting: VecDeque<WaitingMessage>,
    urgent: VecDeque<UrgentMessage>,
    bytes: usize,
    /// The event that ends the connection; it is returned after all messages.
    end: Option<Result<Event, ConnectionLoss>>,
}

impl ArrivalQueue {
    /// Creates the queue of a connection; `root` is the machine's root of all topics, with its last slash.
    pub(super) fn new(root: &str, arrivals: Arc<Arrivals>) -> Self {
        Self {
            root: root.to_owned(),
            arrivals,
            waiting: VecDeque::new(),
            urgent: VecDeque::new(),
            bytes: 0,
            end: None,
        }
    }

    /// Returns the next event of a connection: an urgent request before earlier messages. Cancel-safe.
    pub(super) async fn next(&mut self, wire: &mut impl Wire) -> Result<Event, ConnectionLoss> {
        loop {
            if let Some(event) = self.read_ahead(wire) {
                return Ok(event);
            }
            if let Some(message) = self.take_next() {
                self.bytes -= message.bytes();
                let WaitingMessage { publish, named } = message;
                return Ok(Event::Published { publish, named });
            }
            if let Some(end) = self.end.take() {
                return end;
            }
            match wire.next().await {
                Ok(Event::Published { publish, named }) => self.arrive(publish, named),
                other => return other,
            }
        }
    }

    /// Queues the messages that have arrived, up to the limits. Returns an event that is not a message; such an event
    /// needs no order.
    fn read_ahead(&mut self, wire: &mut impl Wire) -> Option<Event> {
        while self.end.is_none() && self.has_room() {
            match wire.next().now_or_never()? {
                Ok(Event::Published { publish, named }) => self.arrive(publish, named),
                end @ (Err(_) | Ok(Event::Disconnected)) => self.end = Some(end),
                Ok(event) => return Some(event),
            }
        }
        None
    }

    fn has_room(&self) -> bool {
        self.waiting.len() + self.urgent.len() < WAITING_MAX && self.bytes < WAITING_BYTES_MAX
    }

    fn arrive(&mut self, publish: Publish, mut named: BrokerStamp) {
        let (kind, number) = (self.urgent_kind(&publish), self.arrivals.next());
        named.arrival = Some(number).filter(|_| kind.is_none());
        let message = WaitingMessage { publish, named };
        self.bytes += message.bytes();
        match kind {
            None => self.waiting.push_back(message),
            Some((cs, kind)) => self.urgent.push_back(UrgentMessage {
                message,
                number,
                due: Instant::now() + ORDER_WAIT_MAX,
                halts: kind.is_verb().then_some(cs),
            }),
        }
    }

    /// Returns the kind and the coordinate system of an urgent request; `None` for every other message.
    fn urgent_kind(&self, publish: &Publish) -> Option<(CoordinateSystemNumber, UrgentKind)> {
        let path = publish.topic.strip_prefix(&self.root)?;
        if publish.retain || !may_be_urgent(path) {
            return None;
        }
        match decode(path, &publish.payload, false) {
            Inbound::Ask {
                request,
                urgent: true,
            } => UrgentKind::of_request(request.request()),
            _ => None,
        }
    }

    /// Takes the next message: an urgent one if no message waits that arrived before it, or if it has waited long enough
    /// for these.
    fn take_next(&mut self) -> Option<WaitingMessage> {
        let first = self.waiting.front().and_then(|message| message.named.arrival);
        let is_next = |urgent: &UrgentMessage| {
            first.is_none_or(|first| first > urgent.number) || Instant::now() >= urgent.due
        };
        if !self.urgent.front().is_some_and(is_next) {
            return self.waiting.pop_front();
        }
        let UrgentMessage {
            message,
            number,
            halts,
            ..
        } = self.urgent.pop_front()?;
        if let Some(cs) = halts {
            self.arrivals.overtake(cs, number);
        }
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use rumqttc::QoS;

    use super::*;

    const ROOT: &str = "tandem/v1/mill-1/";

    /// A connection with events that have arrived; afterwards it is silent.
    struct ScriptedWire(VecDeque<Result<Event, ConnectionLoss>>);

    impl Wire for ScriptedWire {
        async fn next(&mut self) -> Result<Event, ConnectionLoss> {
            match self.0.pop_front() {
                Some(event) => event,
                None => std::future::pending().await,
            }
        }

        fn subscribe(&self, _: impl Iterator<Item = String>) -> bool {
            true
        }

        fn publish(&self, _: String, _: u8, _: bool, _: String, _: Option<u32>) -> bool {
            true
        }

        fn disconnect(&self) -> bool {
            true
        }
    }

    fn command(verb: &str, id: usize) -> Event {
        let payload = format!("{{\"command_id\":\"{id}\",\"client_id\":\"panel\"}}");
        let topic = format!("{ROOT}client/panel/cs/1/command/{verb}");
        Event::Published {
            publish: Publish::new(topic, QoS::AtLeastOnce, payload),
            named: BrokerStamp::default(),
        }
    }

    fn queue() -> (ArrivalQueue, Arc<Arrivals>) {
        let arrivals = Arc::<Arrivals>::default();
        (ArrivalQueue::new(ROOT, Arc::clone(&arrivals)), arrivals)
    }

    /// Returns the verb of the next message, and its number of arrival.
    async fn next(queue: &mut ArrivalQueue, wire: &mut ScriptedWire) -> (String, Option<u64>) {
        match queue.next(wire).await.unwrap() {
            Event::Published { publish, named } => {
                let verb = publish.topic.rsplit('/').next().unwrap().to_owned();
                (verb, named.arrival)
            }
            other => panic!("{other:?}"),
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_stop_overtakes_messages_that_wait_longer_than_20_ms() {
        let (mut queue, arrivals) = queue();
        let flood = (0..1000).map(|id| command("start", id));
        let messages = flood.chain([command("stop", 1000), command("start", 1001)]);
        let mut wire = ScriptedWire(messages.map(Ok).collect());
        let (verb, first) = next(&mut queue, &mut wire).await;
        assert_eq!(verb, "start", "the order of arrival, within 20 ms");
        tokio::time::advance(Duration::from_millis(21)).await;
        assert_eq!(next(&mut queue, &mut wire).await, ("stop".to_owned(), None));
        assert!(arrivals.is_overtaken(1, first.unwrap()));
        let mut overtaken = Vec::new();
        for _ in 0..1000 {
            let (verb, number) = next(&mut queue, &mut wire).await;
            assert_eq!(verb, "start");
            assert!(
                !arrivals.is_overtaken(2, number.unwrap()),
                "another coordinate system"
            );
            overtaken.push(arrivals.is_overtaken(1, number.unwrap()));
        }
        assert_eq!(
            overtaken.iter().filter(|is| **is).count(),
            999,
            "those before the stop"
        );
        assert_eq!(overtaken.last(), Some(&false), "the start after the stop");
    }

    #[tokio::test(start_paused = true)]
    async fn a_hold_keeps_its_order_if_messages_are_handled_within_20_ms() {
        let (mut queue, arrivals) = queue();
        let messages = [command("start", 1), command("hold", 2), command("resume", 3)];
        let mut wire = ScriptedWire(messages.map(Ok).into());
        let mut verbs = Vec::new();
        for _ in 0..3 {
            verbs.push(next(&mut queue, &mut wire).await.0);
        }
        assert_eq!(verbs, ["start", "hold", "resume"]);
        assert!(!arrivals.is_overtaken(1, arrivals.next()));
    }

    #[tokio::test(start_paused = true)]
    async fn read_ahead_is_bounded_and_the_end_follows_all_messages() {
        let (mut queue, _) = queue();
        let lost = || ConnectionLoss {
            why: "gone".to_owned(),
            version_unknown: false,
        };
        let messages = (0..WAITING_MAX + 10).map(|id| command("start", id));
        let mut wire = ScriptedWire(messages.map(Ok).chain([Err(lost())]).collect());
        for _ in 0..WAITING_MAX + 10 {
            assert_eq!(next(&mut queue, &mut wire).await.0, "start");
            assert!(queue.waiting.len() < WAITING_MAX);
        }
        assert_eq!(queue.next(&mut wire).await, Err(lost()));
        assert_eq!(queue.bytes, 0);
        let large = Publish::new(format!("{ROOT}x"), QoS::AtLeastOnce, vec![0; WAITING_BYTES_MAX]);
        queue.arrive(large, BrokerStamp::default());
        assert!(!queue.has_room());
    }
}
