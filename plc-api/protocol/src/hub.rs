//! The hub: the latest value of each state topic, and bounded subscriptions to all topics.
//!
//! Publishing never waits for a subscriber. A slow subscriber receives the latest value of each state topic,
//! and all events up to a limit. Beyond this limit the oldest events are dropped, and
//! [`Subscription::dropped_events`] counts them (see [`queue`](crate::queue)). Data that must not be lost is
//! therefore also published as a state: open outputs in `m_code/pending`, alarms in `alarm/active`.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, Weak};

use tokio::sync::Notify;

use crate::lock::lock;
use crate::queue::Queue;
use crate::types::message::{Message, Payload};
use crate::types::output::HandlerPresence;
use crate::types::topic::{CsTopic, Topic};

/// Topics of a subscription.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Filter {
    /// Every topic.
    #[default]
    All,
    /// These topics.
    Topics(Vec<Topic>),
    /// Topics that a handler needs: presence, birth, presence of handlers, handler results, and pending,
    /// output, result, cancel and validate of every coordinate system.
    Handshake,
    /// Replies to commands.
    Replies,
}

impl Filter {
    fn matches(&self, topic: &Topic) -> bool {
        match self {
            Filter::All => true,
            Filter::Topics(topics) => topics.contains(topic),
            Filter::Replies => matches!(topic, Topic::Reply(_)),
            Filter::Handshake => match topic {
                Topic::Presence | Topic::Birth | Topic::HandlerPresence(_) | Topic::HandlerResult(_) => true,
                Topic::CoordinateSystem(_, topic) => matches!(
                    topic,
                    CsTopic::Pending
                        | CsTopic::Output(_)
                        | CsTopic::Result(_)
                        | CsTopic::Cancel(_)
                        | CsTopic::Validate(_)
                ),
                Topic::Heartbeat
                | Topic::AlarmEvent
                | Topic::AlarmActive
                | Topic::Reply(_)
                | Topic::Io(_)
                | Topic::Variables
                | Topic::Tools
                | Topic::StoredData => false,
            },
        }
    }
}

/// Last values of the state topics, and the subscribers. Clones are handles to the same hub.
#[derive(Debug, Clone, Default)]
pub struct Hub {
    inner: Arc<Mutex<HubInner>>,
}

#[derive(Debug, Default)]
struct HubInner {
    states: BTreeMap<Topic, Arc<Message>>,
    subscribers: Vec<Weak<Subscriber>>,
}

#[derive(Debug)]
struct Subscriber {
    filter: Filter,
    waiting: Mutex<SubscriberQueue>,
    notify: Notify,
}

#[derive(Debug, Default)]
struct SubscriberQueue {
    queue: Queue<Arc<Message>>,
    closed: bool,
}

impl Hub {
    /// Creates an empty hub.
    pub fn new() -> Self {
        Self::default()
    }

    /// Stores the message if its topic is a state, and passes it to the subscribers of its topic.
    pub fn publish(&self, message: Message) {
        lock(&self.inner).publish(&Arc::new(message));
    }

    /// Publishes a state if its payload has changed. `message` creates the message from the topic, the next
    /// revision and the payload. During this call no other message is published.
    ///
    /// Returns the last message of the topic, and true if this call has published that message.
    pub fn publish_change(
        &self,
        topic: Topic,
        payload: Payload,
        message: impl FnOnce(Topic, u64, Payload) -> Message,
    ) -> (Arc<Message>, bool) {
        let mut inner = lock(&self.inner);
        let last = inner.states.get(&topic);
        if let Some(last) = last.filter(|last| last.payload == payload) {
            return (Arc::clone(last), false);
        }
        let rev = last.and_then(|last| last.rev).unwrap_or(0);
        let message = Arc::new(message(topic, rev + 1, payload));
        inner.publish(&message);
        (message, true)
    }

    /// Returns the last message of a state topic, or `None` if none was published.
    pub fn read(&self, topic: &Topic) -> Option<Arc<Message>> {
        lock(&self.inner).states.get(topic).cloned()
    }

    /// Returns the last message of every state topic.
    pub fn states(&self) -> Vec<Arc<Message>> {
        lock(&self.inner).states.values().cloned().collect()
    }

    /// Returns the last presence of each handler that has announced itself, by handler id.
    pub(crate) fn handlers(&self) -> BTreeMap<String, HandlerPresence> {
        let states = self.states();
        let presence = |message: &Arc<Message>| match (&message.topic, &message.payload) {
            (Topic::HandlerPresence(id), Payload::HandlerPresence(presence)) => {
                Some((id.clone(), presence.clone()))
            }
            _ => None,
        };
        states.iter().filter_map(presence).collect()
    }

    /// Removes the value of a state topic.
    pub fn forget(&self, topic: &Topic) {
        lock(&self.inner).states.remove(topic);
    }

    /// Creates a subscription. Its first messages are the current values of its state topics.
    pub fn subscribe(&self, filter: Filter) -> Subscription {
        let mut inner = lock(&self.inner);
        let mut waiting = SubscriberQueue::default();
        for state in inner.states.values() {
            if filter.matches(&state.topic) {
                waiting.queue.put(Arc::clone(state));
            }
        }
        let subscriber = Arc::new(Subscriber {
            filter,
            waiting: Mutex::new(waiting),
            notify: Notify::new(),
        });
        inner.subscribers.push(Arc::downgrade(&subscriber));
        Subscription { subscriber }
    }

    /// Ends all subscriptions: each returns its unread messages, then `None`.
    pub fn close(&self) {
        for subscriber in lock(&self.inner)
            .subscribers
            .drain(..)
            .filter_map(|weak| weak.upgrade())
        {
            lock(&subscriber.waiting).closed = true;
            subscriber.notify.notify_one();
        }
    }
}

impl HubInner {
    fn publish(&mut self, message: &Arc<Message>) {
        if message.topic.is_state() {
            match self.states.get_mut(&message.topic) {
                Some(last) => *last = Arc::clone(message),
                None => {
                    self.states.insert(message.topic.clone(), Arc::clone(message));
                }
            }
        }
        self.subscribers.retain(|subscriber| {
            let Some(subscriber) = subscriber.upgrade() else {
                return false;
            };
            if subscriber.filter.matches(&message.topic) {
                subscriber.put(Arc::clone(message));
            }
            true
        });
    }
}

impl Subscriber {
    fn put(&self, message: Arc<Message>) {
        let is_more = lock(&self.waiting).queue.put(message);
        if is_more {
            self.notify.notify_one();
        }
    }
}

/// A subscription, with the messages that the subscriber has not read yet.
#[derive(Debug)]
pub struct Subscription {
    subscriber: Arc<Subscriber>,
}

impl Subscription {
    /// Waits for the next message and returns it; returns `None` if the hub is closed. Cancellation safe.
    pub async fn next(&mut self) -> Option<Arc<Message>> {
        loop {
            if let Some(message) = self.try_next() {
                return Some(message);
            }
            if lock(&self.subscriber.waiting).closed {
                return None;
            }
            self.subscriber.notify.notified().await;
        }
    }

    /// Returns the next message, or `None` if no message is unread.
    pub fn try_next(&mut self) -> Option<Arc<Message>> {
        lock(&self.subscriber.waiting).queue.pop_front()
    }

    /// Returns the number of events that were dropped so far because they were not read in time.
    pub fn dropped_events(&self) -> u64 {
        lock(&self.subscriber.waiting).queue.dropped_events()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::EVENTS_MAX;
    use crate::types::output::{Cancel, CancelReason};
    use crate::types::state::Switch;
    use crate::types::{BootId, Timestamp};

    fn message(topic: CsTopic, payload: Payload) -> Message {
        let (boot_id, ts) = (BootId("b".into()), Timestamp::default());
        Message {
            topic: Topic::cs(1, topic),
            boot_id,
            ts,
            rev: None,
            payload,
        }
    }

    fn switch(value: bool) -> Message {
        message(CsTopic::OptionalStop, Payload::Switch(Switch { value }))
    }

    fn cancel(seq: u64) -> Message {
        message(
            CsTopic::Cancel(5),
            Payload::Cancel(Cancel {
                seq,
                reason: CancelReason::Stop,
            }),
        )
    }

    fn read_all(subscription: &mut Subscription) -> Vec<Message> {
        std::iter::from_fn(|| subscription.try_next())
            .map(|message| (*message).clone())
            .collect()
    }

    #[test]
    fn a_slow_subscriber_gets_the_latest_state_and_every_event_in_order() {
        let hub = Hub::new();
        let mut subscription = hub.subscribe(Filter::All);
        for message in [switch(true), cancel(1), switch(false), cancel(2)] {
            hub.publish(message);
        }
        let right = [switch(false), cancel(1), cancel(2)];
        assert_eq!(read_all(&mut subscription), right);
    }

    #[test]
    fn a_new_subscriber_starts_with_the_values_of_now() {
        let hub = Hub::new();
        hub.publish(switch(true));
        hub.publish(cancel(1));
        let mut subscription = hub.subscribe(Filter::All);
        assert_eq!(subscription.try_next().map(|m| (*m).clone()), Some(switch(true)));
        assert!(subscription.try_next().is_none());
    }

    #[test]
    fn events_that_nobody_reads_are_bounded_and_counted() {
        let hub = Hub::new();
        let mut subscription = hub.subscribe(Filter::All);
        for seq in 0..EVENTS_MAX as u64 + 3 {
            hub.publish(cancel(seq));
        }
        assert_eq!(subscription.dropped_events(), 3);
        let first = subscription.try_next().map(|m| (*m).clone());
        assert_eq!(first, Some(cancel(3)));
    }

    #[test]
    fn unchanged_state_is_not_republished_and_a_change_gets_the_next_revision() {
        let hub = Hub::new();
        let publish = |value| {
            let Message { topic, payload, .. } = switch(value);
            let (message, is_new) = hub.publish_change(topic, payload, |topic, rev, payload| Message {
                topic,
                rev: Some(rev),
                payload,
                ..switch(value)
            });
            (message.rev, is_new)
        };
        let mut subscription = hub.subscribe(Filter::All);
        assert_eq!(publish(true), (Some(1), true));
        assert_eq!(publish(true), (Some(1), false));
        assert_eq!(read_all(&mut subscription).len(), 1);
        assert_eq!(publish(false), (Some(2), true));
        assert_eq!(publish(true), (Some(3), true));
    }

    #[tokio::test]
    async fn closing_ends_a_subscription_after_its_last_message() {
        let hub = Hub::new();
        let mut subscription = hub.subscribe(Filter::Topics(vec![Topic::cs(1, CsTopic::Cancel(5))]));
        hub.publish(switch(true));
        hub.publish(cancel(9));
        hub.close();
        assert!(subscription.next().await.is_some());
        assert!(subscription.next().await.is_none());
    }
}
