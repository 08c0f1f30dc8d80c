//! Observations in order of time: a ring buffer with sequence numbers, and the state at any position in it.

use std::collections::VecDeque;
use std::sync::Arc;

/// Number of observations that are stored.
pub const BUFFER_SIZE: usize = 131_072;

/// Value of an observation.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// The value is unknown.
    Unavailable,
    /// A text, word or number, as written in documents.
    Text(Arc<str>),
    /// Condition: no alarm with this native code is active; without a code, no alarm at all.
    Normal(Option<u16>),
    /// Condition: an alarm is active.
    Active(Arc<ActiveAlarm>),
}

/// An alarm as reported by a condition.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActiveAlarm {
    /// A fault stops the machine, a warning does not.
    pub is_fault: bool,
    /// Alarm number.
    pub native_code: u16,
    /// Text for people.
    pub text: String,
}

/// One observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Sequence number; increases by one with each observation.
    pub sequence: u64,
    /// Time, as RFC 3339.
    pub timestamp: Arc<str>,
    /// Index of the data item.
    pub item: usize,
    /// Observed value.
    pub value: Value,
}

/// The newest observations of one data item: one, or for a condition, one for each active alarm.
type Latest = Vec<Observation>;

/// The ring.
#[derive(Debug)]
pub struct Buffer {
    ring: VecDeque<Observation>,
    size: usize,
    /// Sequence number of the next observation.
    next: u64,
    /// State before the oldest observation in the ring.
    before: Vec<Latest>,
    latest: Vec<Latest>,
}

impl Buffer {
    /// Creates a buffer for a number of data items; each item begins as unavailable, with sequence numbers from 1.
    pub fn new(items: usize, size: usize, timestamp: &Arc<str>) -> Self {
        let mut buffer = Self {
            ring: VecDeque::new(),
            size,
            next: 1,
            before: vec![Latest::new(); items],
            latest: vec![Latest::new(); items],
        };
        (0..items).for_each(|item| buffer.observe(item, Value::Unavailable, timestamp));
        buffer
    }

    /// Adds an observation.
    pub fn observe(&mut self, item: usize, value: Value, timestamp: &Arc<str>) {
        let Some(latest) = self.latest.get_mut(item) else {
            return;
        };
        let observation = Observation {
            sequence: self.next,
            timestamp: Arc::clone(timestamp),
            item,
            value,
        };
        self.next += 1;
        apply(latest, observation.clone());
        self.ring.push_back(observation);
        if self.ring.len() > self.size
            && let Some(oldest) = self.ring.pop_front()
            && let Some(before) = self.before.get_mut(oldest.item)
        {
            apply(before, oldest);
        }
    }

    /// Returns the newest observations of a data item.
    pub fn latest(&self, item: usize) -> &[Observation] {
        self.latest.get(item).map_or(&[], Vec::as_slice)
    }

    /// Returns the sequence number of the oldest observation.
    pub fn first(&self) -> u64 {
        self.ring.front().map_or(self.next, |oldest| oldest.sequence)
    }

    /// Returns the sequence number of the newest observation.
    pub fn last(&self) -> u64 {
        self.next - 1
    }

    /// Returns the sequence number of the next observation.
    pub fn next(&self) -> u64 {
        self.next
    }

    /// Returns the newest observations of each data item.
    pub fn current(&self) -> Vec<Observation> {
        self.latest.iter().flatten().cloned().collect()
    }

    /// Returns the newest observations of each data item at a sequence number.
    pub fn current_at(&self, at: u64) -> Vec<Observation> {
        let mut held = self.before.clone();
        for observation in self.ring.iter().take_while(|one| one.sequence <= at) {
            if let Some(latest) = held.get_mut(observation.item) {
                apply(latest, observation.clone());
            }
        }
        held.into_iter().flatten().collect()
    }

    /// Returns at most `count` observations of wanted data items from a sequence number on, and the next sequence
    /// number.
    pub fn sample(
        &self,
        from: u64,
        count: usize,
        is_wanted: &dyn Fn(usize) -> bool,
    ) -> (Vec<Observation>, u64) {
        let skipped = usize::try_from(from.saturating_sub(self.first())).unwrap_or(usize::MAX);
        let mut found = Vec::new();
        for observation in self.ring.iter().skip(skipped) {
            if !is_wanted(observation.item) {
                continue;
            }
            if found.len() == count {
                return (found, observation.sequence);
            }
            found.push(observation.clone());
        }
        (found, self.next)
    }
}

/// Adds an observation to the newest ones and removes those that it replaces.
fn apply(latest: &mut Latest, observation: Observation) {
    match &observation.value {
        Value::Active(alarm) => {
            let code = alarm.native_code;
            latest.retain(|one| matches!(&one.value, Value::Active(active) if active.native_code != code));
        }
        Value::Normal(Some(code)) => {
            latest.retain(|one| matches!(&one.value, Value::Active(active) if active.native_code != *code));
            if !latest.is_empty() {
                return;
            }
        }
        Value::Normal(None) | Value::Unavailable | Value::Text(_) => latest.clear(),
    }
    latest.push(observation);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Value {
        Value::Text(text.into())
    }

    fn active(native_code: u16) -> Value {
        Value::Active(Arc::new(ActiveAlarm {
            is_fault: true,
            native_code,
            text: String::new(),
        }))
    }

    fn buffer(items: usize, size: usize) -> (Buffer, Arc<str>) {
        let at: Arc<str> = "2026-01-01T00:00:00Z".into();
        (Buffer::new(items, size, &at), at)
    }

    #[test]
    fn sequence_numbers_have_no_gap_over_100000_changes_in_a_short_ring() {
        let (mut buffer, at) = buffer(2, 1000);
        let mut next = buffer.first();
        let mut seen = 0;
        for change in 0..100_000_u32 {
            buffer.observe(0, text(&change.to_string()), &at);
            if change % 700 == 0 || change == 99_999 {
                let (found, goes_on) = buffer.sample(next, usize::MAX, &|_| true);
                for observation in &found {
                    assert_eq!(observation.sequence, next);
                    next += 1;
                }
                assert_eq!(goes_on, next);
                seen += found.len();
            }
        }
        assert_eq!(seen, 100_002, "with the two that were unavailable");
        assert_eq!(
            (buffer.first(), buffer.last(), buffer.next()),
            (99_003, 100_002, 100_003)
        );
    }

    #[test]
    fn what_held_at_a_number_is_known_as_long_as_the_number_is_in_the_ring() {
        let (mut buffer, at) = buffer(2, 3);
        for value in ["a", "b", "c"] {
            buffer.observe(0, text(value), &at);
        }
        // 1 and 2 were dropped from the ring: 2 was the unavailable of item 1
        assert_eq!(buffer.first(), 3);
        let values = |at: u64| -> Vec<_> {
            buffer
                .current_at(at)
                .into_iter()
                .map(|one| (one.sequence, one.value))
                .collect()
        };
        assert_eq!(values(4), [(4, text("b")), (2, Value::Unavailable)]);
        assert_eq!(values(5), [(5, text("c")), (2, Value::Unavailable)]);
        let now: Vec<_> = buffer.current().iter().map(|one| one.sequence).collect();
        assert_eq!(now, [5, 2]);
    }

    #[test]
    fn several_alarms_of_a_condition_are_active_until_each_is_normal() {
        let (mut buffer, at) = buffer(1, 10);
        let codes = |buffer: &Buffer| -> Vec<_> {
            let codes = buffer.latest(0).iter().map(|one| match &one.value {
                Value::Active(alarm) => Some(alarm.native_code),
                _ => None,
            });
            codes.collect()
        };
        buffer.observe(0, Value::Normal(None), &at);
        assert_eq!(codes(&buffer), [None]);
        buffer.observe(0, active(102), &at);
        buffer.observe(0, active(300), &at);
        buffer.observe(0, active(102), &at);
        assert_eq!(codes(&buffer), [Some(300), Some(102)]);
        buffer.observe(0, Value::Normal(Some(300)), &at);
        assert_eq!(codes(&buffer), [Some(102)]);
        buffer.observe(0, Value::Normal(Some(102)), &at);
        assert_eq!(codes(&buffer), [None]);
    }

    #[test]
    fn a_sample_takes_so_many_of_the_wanted_and_says_where_to_go_on() {
        let (mut buffer, at) = buffer(2, 100);
        for value in 0..6_usize {
            buffer.observe(value % 2, text(&value.to_string()), &at);
        }
        let (found, next) = buffer.sample(3, 2, &|item| item == 1);
        assert_eq!(found.iter().map(|one| one.sequence).collect::<Vec<_>>(), [4, 6]);
        assert_eq!(next, 8);
        let (found, next) = buffer.sample(next, 2, &|item| item == 1);
        assert_eq!((found.len(), next), (1, 9));
    }
}
