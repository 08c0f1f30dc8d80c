//! Messages for a slow reader: the latest value of each state, and all events in order, up to a limit.
//!
//! If a value of a state is unread, the latest value of the state replaces it at its position. Therefore
//! `m_code/pending` precedes the output that `pending` announces. A value never overtakes an event that
//! explains its state ([`Topic::explains`]): the cancel of an output precedes the `pending` that no longer
//! shows the output.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use crate::types::message::Message;
use crate::types::topic::Topic;

/// Largest number of unread events of one reader. Reason: this is more than twice the notices, results and
/// cancels of 64 open outputs in each of 8 coordinate systems.
pub const EVENTS_MAX: usize = 4096;

/// An entry of a [`Queue`]: a value of a state, or an event.
pub trait QueueEntry {
    /// Returns the topic of the entry. An entry without a topic is an event.
    fn topic(&self) -> Option<&Topic>;
}

impl QueueEntry for Arc<Message> {
    fn topic(&self) -> Option<&Topic> {
        Some(&self.topic)
    }
}

/// Unread entries of one reader, in order.
#[derive(Debug)]
pub struct Queue<T> {
    // may contain one value of a state before each event that explains this state
    entries: VecDeque<T>,
    // number of the first entry; each further entry has the next number
    first: u64,
    // for each state: the number of its unread value, if no event that explains the state follows this value
    replaceable: HashMap<Topic, u64>,
    events: usize,
    dropped: u64,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self {
            entries: VecDeque::new(),
            first: 0,
            replaceable: HashMap::new(),
            events: 0,
            dropped: 0,
        }
    }
}

impl<T: QueueEntry> Queue<T> {
    /// Appends an entry. A value of a state instead replaces the unread value of this state, unless an event
    /// that explains the state follows that unread value. If [`EVENTS_MAX`] events are unread, a further
    /// event drops the oldest event. Returns false if the entry has replaced another entry. The call finds
    /// the unread value without a search through the entries.
    pub fn put(&mut self, entry: T) -> bool {
        if let Some(state) = state_of(&entry) {
            if let Some(place) = self.index_of(state) {
                self.entries[place] = entry;
                return false;
            }
            self.replaceable
                .insert(state.clone(), self.number(self.entries.len()));
        } else {
            if self.events == EVENTS_MAX {
                self.drop_oldest_event();
            }
            if let Some(state) = explained_by(&entry) {
                self.replaceable.remove(&state);
            }
            self.events += 1;
        }
        self.entries.push_back(entry);
        true
    }

    /// Returns the next unread entry without removing the entry.
    pub fn front(&self) -> Option<&T> {
        self.entries.front()
    }

    /// Removes and returns the next entry.
    pub fn pop_front(&mut self) -> Option<T> {
        let entry = self.entries.pop_front()?;
        match state_of(&entry) {
            Some(state) if self.replaceable.get(state) == Some(&self.first) => {
                self.replaceable.remove(state);
            }
            Some(_) => {}
            None => self.events -= 1,
        }
        self.first += 1;
        Some(entry)
    }

    /// Removes and returns all entries, in order.
    pub fn take_all(&mut self) -> VecDeque<T> {
        self.first = self.number(self.entries.len());
        self.replaceable.clear();
        self.events = 0;
        std::mem::take(&mut self.entries)
    }

    /// Returns the number of events that were dropped so far because they were not read in time.
    pub fn dropped_events(&self) -> u64 {
        self.dropped
    }

    fn number(&self, place: usize) -> u64 {
        self.first + place as u64
    }

    /// Returns the index of the unread value that a new value of this state may replace.
    fn index_of(&self, state: &Topic) -> Option<usize> {
        let number = self.replaceable.get(state)?;
        usize::try_from(number - self.first).ok()
    }

    fn drop_oldest_event(&mut self) {
        let Some(place) = self.entries.iter().position(|entry| state_of(entry).is_none()) else {
            return;
        };
        let explained = self.entries.get(place).and_then(explained_by);
        self.remove(place);
        self.events -= 1;
        self.dropped += 1;
        // if a later value of the explained state exists, the earlier value is obsolete; otherwise the
        // earlier value may be replaced, unless another event explains the state
        let Some(state) = explained else { return };
        let mut values = (0..self.entries.len()).filter(|&at| self.entries[at].topic() == Some(&state));
        let Some(before) = values.next().filter(|before| *before < place) else {
            return;
        };
        if values.next().is_some() {
            self.remove(before);
        } else if !(self.entries.iter()).any(|other| explained_by(other).as_ref() == Some(&state)) {
            self.replaceable.insert(state, self.number(before));
        }
    }

    /// Removes an entry that `replaceable` does not contain. The numbers of the entries before it increase by
    /// one.
    fn remove(&mut self, place: usize) {
        let removed = self.number(place);
        self.entries.remove(place);
        for number in self.replaceable.values_mut() {
            *number += u64::from(*number < removed);
        }
        self.first += 1;
    }
}

fn state_of(entry: &impl QueueEntry) -> Option<&Topic> {
    entry.topic().filter(|topic| topic.is_state())
}

fn explained_by(entry: &impl QueueEntry) -> Option<Topic> {
    entry.topic().and_then(Topic::explains)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::topic::CsTopic;

    /// A value of a topic, for tests.
    #[derive(Debug, PartialEq)]
    struct TopicValue(Topic, u32);

    impl QueueEntry for TopicValue {
        fn topic(&self) -> Option<&Topic> {
            Some(&self.0)
        }
    }

    fn pending(value: u32) -> TopicValue {
        TopicValue(Topic::cs(1, CsTopic::Pending), value)
    }

    fn cancel(value: u32) -> TopicValue {
        TopicValue(Topic::cs(1, CsTopic::Cancel(5)), value)
    }

    fn output(value: u32) -> TopicValue {
        TopicValue(Topic::cs(1, CsTopic::Output(5)), value)
    }

    fn read(said: impl IntoIterator<Item = TopicValue>) -> (Vec<TopicValue>, u64) {
        let mut queue = Queue::default();
        for entry in said {
            queue.put(entry);
        }
        let read = std::iter::from_fn(|| queue.pop_front()).collect();
        (read, queue.dropped_events())
    }

    #[test]
    fn the_latest_value_of_a_state_takes_the_place_of_one_that_waits() {
        let (read, _) = read([pending(1), output(1), pending(2)]);
        assert_eq!(read, [pending(2), output(1)]);
    }

    #[test]
    fn no_state_passes_an_event_that_explains_it() {
        let (read, _) = read([
            pending(1),
            output(1),
            cancel(1),
            pending(2),
            output(2),
            pending(3),
        ]);
        assert_eq!(read, [pending(1), output(1), cancel(1), pending(3), output(2)]);
    }

    #[test]
    fn the_oldest_event_goes_first_and_the_value_before_it_with_it() {
        let cancels = (0..=EVENTS_MAX).map(|n| u32::try_from(n).unwrap());
        let said = cancels.flat_map(|n| [pending(n), cancel(n)]);
        let (read, lost) = read(said);
        assert_eq!((read.len(), lost), (2 * EVENTS_MAX, 1));
        assert_eq!(read[..2], [pending(1), cancel(1)]);
    }

    /// Reference model of the queue, which searches the unread entries one by one.
    #[derive(Default)]
    struct ModelQueue(Vec<TopicValue>);

    impl ModelQueue {
        fn put(&mut self, said: TopicValue) {
            let newest_first = self.0.iter_mut().rev();
            let place = newest_first
                .take_while(|other| explained_by(*other).as_ref() != Some(&said.0))
                .find(|other| said.0.is_state() && other.0 == said.0);
            match place {
                Some(place) => *place = said,
                None => self.0.push(said),
            }
            let is_event = |said: &TopicValue| !said.0.is_state();
            if self.0.iter().filter(|said| is_event(said)).count() <= EVENTS_MAX {
                return;
            }
            let oldest = self.0.iter().position(is_event).unwrap();
            let state = explained_by(&self.0.remove(oldest));
            let is_value = |said: &TopicValue| Some(&said.0) == state.as_ref();
            let before = self.0[..oldest].iter().position(is_value);
            if let Some(before) = before.filter(|_| self.0[oldest..].iter().any(is_value)) {
                self.0.remove(before);
            }
        }

        fn pop_front(&mut self) -> Option<TopicValue> {
            (!self.0.is_empty()).then(|| self.0.remove(0))
        }
    }

    #[test]
    fn a_queue_that_runs_full_and_empty_again_keeps_the_rules() {
        for seed in 0..2_u64 {
            let (mut queue, mut waiting) = (Queue::default(), ModelQueue::default());
            let mut random = seed;
            let mut next = || {
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                random >> 33
            };
            for n in 0..2 * u32::try_from(EVENTS_MAX).unwrap() {
                let switch = |value| TopicValue(Topic::cs(1, CsTopic::DryRun), value);
                let said = || match n % 13 {
                    0 | 6 => pending(n),
                    1 => switch(n),
                    4 if seed % 2 == 0 => cancel(n),
                    _ => output(n),
                };
                queue.put(said());
                waiting.put(said());
                // the queue fills up, and is read in bursts
                if next() % 600 == 0 {
                    for _ in 0..next() % 300 {
                        assert_eq!(queue.pop_front(), waiting.pop_front(), "seed {seed}, {n}");
                    }
                }
            }
            assert!(queue.dropped_events() > 0, "seed {seed} never runs full");
            while let Some(said) = waiting.pop_front() {
                assert_eq!(queue.pop_front(), Some(said), "seed {seed}");
            }
            assert_eq!((queue.pop_front(), queue.events), (None, 0), "seed {seed}");
        }
    }

    #[test]
    fn a_state_is_told_once_also_when_the_event_that_explained_it_was_dropped() {
        let outputs = (0..u32::try_from(EVENTS_MAX).unwrap()).map(output);
        let said = [pending(1), cancel(1)].into_iter().chain(outputs);
        let (read, lost) = read(said.chain([pending(2)]));
        assert_eq!((read.len(), lost), (1 + EVENTS_MAX, 1));
        assert_eq!(read[..2], [pending(2), output(0)]);
    }

    #[test]
    fn taking_makes_room_for_events() {
        let mut queue = Queue::default();
        for n in 0..3 * u32::try_from(EVENTS_MAX).unwrap() {
            queue.put(output(n));
            assert_eq!(queue.pop_front(), Some(output(n)));
        }
        assert_eq!((queue.front(), queue.dropped_events()), (None, 0));
    }
}
