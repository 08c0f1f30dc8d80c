//! Messages for a slow reader: the latest value of each state, and all events in order, up to a limit.
//!
//! The latest value of a state replaces an unread one, so `m_code/pending` comes before the output that it announces.
//! It never overtakes an event that explains it ([`Topic::explains`]): the cancel of an output comes before the
//! `pending` that no longer shows it.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::types::message::Message;
use crate::types::topic::Topic;

/// Unread events of one reader. Reason: twice 64 open outputs, each with a notice, a result and a cancel, in each of 8
/// coordinate systems.
pub const EVENTS_MAX: usize = 4096;

/// An entry of a [`Queue`].
pub trait Entry {
    /// Its topic; without one it is an event.
    fn topic(&self) -> Option<&Topic>;
}

impl Entry for Arc<Message> {
    fn topic(&self) -> Option<&Topic> {
        Some(&self.topic)
    }
}

/// Unread entries in order.
#[derive(Debug)]
pub struct Queue<T> {
    // also one value of a state before each event that explains it
    entries: VecDeque<T>,
    events: usize,
    lost: u64,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self {
            entries: VecDeque::new(),
            events: 0,
            lost: 0,
        }
    }
}

impl<T: Entry> Queue<T> {
    /// Appends an entry. The value of a state replaces an unread one instead, unless an event that explains it follows.
    /// Beyond [`EVENTS_MAX`] the oldest event is dropped. False if an entry was replaced.
    pub fn put(&mut self, entry: T) -> bool {
        if is_state(&entry) {
            if let Some(place) = self.place_of(entry.topic()) {
                *place = entry;
                return false;
            }
        } else if self.events == EVENTS_MAX {
            self.drop_oldest_event();
        } else {
            self.events += 1;
        }
        self.entries.push_back(entry);
        true
    }

    /// The next entry.
    pub fn front(&self) -> Option<&T> {
        self.entries.front()
    }

    /// Takes the next entry.
    pub fn take(&mut self) -> Option<T> {
        let entry = self.entries.pop_front()?;
        self.events -= usize::from(!is_state(&entry));
        Some(entry)
    }

    /// Takes all entries.
    pub fn take_all(&mut self) -> VecDeque<T> {
        self.events = 0;
        std::mem::take(&mut self.entries)
    }

    /// Events dropped so far because they were not read in time.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// The unread value of this state behind the last event that explains it.
    fn place_of(&mut self, state: Option<&Topic>) -> Option<&mut T> {
        let newest_first = self.entries.iter_mut().rev();
        newest_first
            .take_while(|other| explained_by(*other).as_ref() != state)
            .find(|other| other.topic() == state)
    }

    fn drop_oldest_event(&mut self) {
        let Some(place) = self.entries.iter().position(|entry| !is_state(entry)) else {
            return;
        };
        let event = self.entries.remove(place);
        self.lost += 1;
        // the value before it of a state that it explains is obsolete if there is one after it
        let Some(state) = event.as_ref().and_then(explained_by) else {
            return;
        };
        let mut values = (0..self.entries.len()).filter(|&at| self.entries[at].topic() == Some(&state));
        if let (Some(before), Some(_)) = (values.next(), values.next())
            && before < place
        {
            self.entries.remove(before);
        }
    }
}

fn is_state(entry: &impl Entry) -> bool {
    entry.topic().is_some_and(Topic::is_state)
}

fn explained_by(entry: &impl Entry) -> Option<Topic> {
    entry.topic().and_then(Topic::explains)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::topic::CsTopic;

    /// A value of a topic.
    #[derive(Debug, PartialEq)]
    struct Said(Topic, u32);

    impl Entry for Said {
        fn topic(&self) -> Option<&Topic> {
            Some(&self.0)
        }
    }

    fn pending(value: u32) -> Said {
        Said(Topic::cs(1, CsTopic::Pending), value)
    }

    fn cancel(value: u32) -> Said {
        Said(Topic::cs(1, CsTopic::Cancel(5)), value)
    }

    fn output(value: u32) -> Said {
        Said(Topic::cs(1, CsTopic::Output(5)), value)
    }

    fn read(said: impl IntoIterator<Item = Said>) -> (Vec<Said>, u64) {
        let mut queue = Queue::default();
        for entry in said {
            queue.put(entry);
        }
        let read = std::iter::from_fn(|| queue.take()).collect();
        (read, queue.lost())
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

    #[test]
    fn taking_makes_room_for_events() {
        let mut queue = Queue::default();
        for n in 0..3 * u32::try_from(EVENTS_MAX).unwrap() {
            queue.put(output(n));
            assert_eq!(queue.take(), Some(output(n)));
        }
        assert_eq!((queue.front(), queue.lost()), (None, 0));
    }
}
