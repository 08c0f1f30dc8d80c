//! What the broker has still to be told. The client library forgets what is unacknowledged when a session is gone,
//! so it is kept here until then: of each state the last value, of events all in their order. Pure: no I/O.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use plc_api::types::message::Message;
use plc_api::types::topic::Topic;

/// Events that wait for the broker; more drop the oldest. Reason: 64 open outputs with notice, result and cancel in
/// each of 8 coordinate systems, twice over; open outputs themselves stand in `m_code/pending`, which is a state.
pub(super) const EVENTS_MAX: usize = 4096;

/// One publish.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Parcel {
    /// A message of the port.
    Message(Arc<Message>),
    /// An empty retained message, which clears the topic of this path.
    Clear(String),
}

/// What became of a parcel that was to be handed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Handed {
    /// The client library has it.
    Over,
    /// The client library is full: later.
    Full,
    /// No broker can take it: it is dropped.
    Never,
}

#[derive(Debug)]
enum Item {
    // the value is looked up when its turn comes
    State(Topic),
    Event(Parcel),
}

/// Everything that is to be published, and what has been without an acknowledgement yet.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    // last value of each retained state
    states: BTreeMap<Topic, Arc<Message>>,
    queue: VecDeque<Item>,
    // states that stand in the queue
    queued: BTreeSet<Topic>,
    events: usize,
    lost: u64,
    // handed over with QoS 1, oldest first; None: a state, which is published again anyway
    unacknowledged: VecDeque<Option<Parcel>>,
}

impl Outbox {
    /// Takes a message. A state that waits already keeps its place in the queue with the new value: so `pending`
    /// stays before the output that it announced.
    pub(super) fn put(&mut self, message: Arc<Message>) {
        if !message.topic.is_state() {
            self.put_event(Parcel::Message(message));
            return;
        }
        let topic = message.topic.clone();
        self.states.insert(topic.clone(), message);
        self.queue_state(topic);
    }

    /// Clears a retained topic at the broker.
    pub(super) fn clear(&mut self, path: String) {
        self.put_event(Parcel::Clear(path));
    }

    fn put_event(&mut self, parcel: Parcel) {
        if self.events == EVENTS_MAX {
            if let Some(place) = self.queue.iter().position(|item| matches!(item, Item::Event(_))) {
                self.queue.remove(place);
                self.lost += 1;
            }
        } else {
            self.events += 1;
        }
        self.queue.push_back(Item::Event(parcel));
    }

    fn queue_state(&mut self, topic: Topic) {
        if self.queued.insert(topic.clone()) {
            self.queue.push_back(Item::State(topic));
        }
    }

    /// Hands over, in order, as long as `publish` takes.
    pub(super) fn send(&mut self, mut publish: impl FnMut(&Parcel) -> Handed) {
        while let Some(item) = self.queue.front() {
            let parcel = match item {
                Item::State(topic) => self.states.get(topic).cloned().map(Parcel::Message),
                Item::Event(parcel) => Some(parcel.clone()),
            };
            let handed = parcel.as_ref().map_or(Handed::Never, &mut publish);
            if handed == Handed::Full {
                return;
            }
            let over = handed == Handed::Over;
            match self.queue.pop_front() {
                Some(Item::State(topic)) => {
                    self.queued.remove(&topic);
                    if over && topic.qos() > 0 {
                        self.unacknowledged.push_back(None);
                    }
                }
                Some(Item::Event(parcel)) => {
                    self.events -= 1;
                    if over {
                        self.unacknowledged.push_back(Some(parcel));
                    }
                }
                None => {}
            }
        }
    }

    /// The broker has acknowledged the oldest.
    pub(super) fn acknowledged(&mut self) {
        self.unacknowledged.pop_front();
    }

    /// True when nothing waits and all is acknowledged.
    pub(super) fn is_empty(&self) -> bool {
        self.queue.is_empty() && self.unacknowledged.is_empty()
    }

    /// After a connection was made: all retained states, then the events that no broker has acknowledged.
    pub(super) fn connected(&mut self) {
        let mut events: VecDeque<_> = self.unacknowledged.drain(..).flatten().collect();
        let waiting = std::mem::take(&mut self.queue);
        events.extend(waiting.into_iter().filter_map(|item| match item {
            Item::Event(parcel) => Some(parcel),
            Item::State(_) => None,
        }));
        self.events = 0;
        self.queued.clear();
        let topics: Vec<_> = self.states.keys().cloned().collect();
        for topic in topics {
            self.queue_state(topic);
        }
        for parcel in events {
            self.put_event(parcel);
        }
    }

    /// Events dropped since this was asked last.
    pub(super) fn take_lost(&mut self) -> u64 {
        std::mem::take(&mut self.lost)
    }
}

#[cfg(test)]
mod tests {
    use plc_api::types::message::Payload;
    use plc_api::types::topic::CsTopic;

    use super::*;
    use plc_api::types::output::{Cancel, CancelReason};
    use plc_api::types::state::Switch;
    use plc_api::types::{BootId, Timestamp};

    fn message(topic: CsTopic, payload: Payload) -> Arc<Message> {
        Arc::new(Message {
            topic: Topic::cs(1, topic),
            boot_id: BootId("b".into()),
            ts: Timestamp::default(),
            rev: None,
            payload,
        })
    }

    fn switch(value: bool) -> Arc<Message> {
        message(CsTopic::DryRun, Payload::Switch(Switch { value }))
    }

    fn cancel(seq: u64) -> Arc<Message> {
        let reason = CancelReason::Stop;
        message(CsTopic::Cancel(5), Payload::Cancel(Cancel { seq, reason }))
    }

    fn send_all(outbox: &mut Outbox) -> Vec<Arc<Message>> {
        let mut sent = Vec::new();
        outbox.send(|parcel| {
            if let Parcel::Message(message) = parcel {
                sent.push(Arc::clone(message));
            }
            Handed::Over
        });
        sent
    }

    #[test]
    fn a_waiting_state_is_sent_once_with_its_last_value_and_in_its_first_place() {
        let mut outbox = Outbox::default();
        for message in [switch(true), cancel(1), switch(false)] {
            outbox.put(message);
        }
        assert_eq!(send_all(&mut outbox), [switch(false), cancel(1)]);
        assert!(!outbox.is_empty(), "nothing is acknowledged yet");
        outbox.acknowledged();
        outbox.acknowledged();
        assert!(outbox.is_empty());
    }

    #[test]
    fn after_a_lost_connection_states_and_unacknowledged_events_are_sent_again() {
        let mut outbox = Outbox::default();
        for message in [switch(true), cancel(1), cancel(2)] {
            outbox.put(message);
        }
        send_all(&mut outbox);
        outbox.acknowledged(); // the state
        outbox.acknowledged(); // cancel 1
        outbox.put(cancel(3));
        outbox.connected();
        assert_eq!(send_all(&mut outbox), [switch(true), cancel(2), cancel(3)]);
    }

    #[test]
    fn events_are_bounded_the_oldest_go_first_and_are_counted() {
        let mut outbox = Outbox::default();
        for seq in 0..EVENTS_MAX as u64 + 2 {
            outbox.put(cancel(seq));
        }
        assert_eq!(outbox.take_lost(), 2);
        assert_eq!(outbox.take_lost(), 0);
        let sent = send_all(&mut outbox);
        assert_eq!(sent.len(), EVENTS_MAX);
        assert_eq!(sent.first(), Some(&cancel(2)));
    }

    #[test]
    fn a_full_channel_stops_the_sending_and_loses_nothing() {
        let mut outbox = Outbox::default();
        outbox.put(cancel(1));
        outbox.put(cancel(2));
        let mut room = 1;
        outbox.send(|_| {
            room -= 1;
            if room >= 0 { Handed::Over } else { Handed::Full }
        });
        assert_eq!(send_all(&mut outbox), [cancel(2)]);
    }

    #[test]
    fn what_no_broker_can_take_is_dropped_and_holds_up_nothing() {
        let mut outbox = Outbox::default();
        outbox.put(switch(true));
        outbox.put(cancel(1));
        outbox.send(|_| Handed::Never);
        assert!(outbox.is_empty(), "no acknowledgement is awaited");
    }
}
