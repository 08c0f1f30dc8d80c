//! Record of the output profiles, from which the planner can plan them again ([`crate::replan`]).

use std::collections::VecDeque;

use tandem_model::profile::{Law, PathPlace, Profile};

use crate::block::PlannedBlock;

/// Number of passed segments that are kept, which is the reach of back trace.
pub(crate) const PASSED_MAX: usize = 10_000;

/// Number of old segments that are dropped at a time. Reason: dropping a single segment costs a cache miss.
const FORGOTTEN_AT_ONCE: usize = 128;

/// Number of segments by which the record grows. Reason: doubling the record would waste memory.
const ROOM: usize = 2048;

/// Maximum number of segments kept; the oldest segments are dropped.
const SEGMENTS_MAX: usize = 65_536;

/// Output segments in order. Blocks of a G500 chain are kept in their form before look-ahead.
#[derive(Debug, Clone, Default)]
pub(crate) struct Record {
    entries: VecDeque<Entry>,
    /// The last segment that backward motion cannot enter.
    barrier: u64,
    /// The farthest position at which backward motion has begun. Dwells before this position are not
    /// repeated.
    turned_at: Option<PathPlace>,
}

/// An output segment.
#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "blocks are moved here by the ten thousand: none of them is allocated"
)]
pub(crate) enum Entry {
    /// A block of a G500 chain, paced by look-ahead. It can be passed in both directions.
    Paced(PlannedBlock),
    /// A rapid or a dwell with G500. It can be passed in both directions.
    Alone(Box<Profile>),
    /// A block of a G501 chain. It can be passed forward only.
    Ramped(PlannedBlock),
    /// Any other segment outside of chains. It can be passed forward only.
    OneWay(Box<Profile>),
}

impl Entry {
    pub(crate) fn segment(&self) -> u64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.segment,
            Entry::Alone(profile) | Entry::OneWay(profile) => profile.segment,
        }
    }

    /// Returns the plan time at the end of the entry, s.
    pub(crate) fn plan_s(&self) -> f64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.plan_s(),
            Entry::Alone(profile) | Entry::OneWay(profile) => profile.duration_s,
        }
    }

    /// Returns true if the entry can be passed backward.
    fn is_reversible(&self) -> bool {
        matches!(self, Entry::Paced(_) | Entry::Alone(_))
    }

    /// Returns true if the entry is a dwell that can be passed backward.
    pub(crate) fn is_dwell(&self) -> bool {
        matches!(self, Entry::Alone(profile) if matches!(profile.law, Law::Rest { .. }))
    }
}

impl Record {
    pub(crate) fn clear(&mut self) {
        self.entries.clear();
        self.turned_at = None;
    }

    /// Adds segments.
    pub(crate) fn extend(&mut self, entries: impl ExactSizeIterator<Item = Entry>) {
        let too_many = (self.entries.len() + entries.len()).saturating_sub(SEGMENTS_MAX);
        self.entries.drain(..too_many.min(self.entries.len()));
        if self.entries.capacity() < self.entries.len() + entries.len() {
            self.entries.reserve_exact(entries.len().max(ROOM));
        }
        let first_new = self.entries.len();
        self.entries.extend(entries);
        self.assert_consecutive(first_new);
    }

    /// Asserts in debug builds that segment numbers are consecutive from the entry before `first_new` on; backward
    /// in a back trace.
    fn assert_consecutive(&self, first_new: usize) {
        let new = || {
            self.entries
                .range(first_new.saturating_sub(1)..)
                .map(Entry::segment)
        };
        debug_assert!(
            new()
                .zip(new().skip(1))
                .all(|(one, next)| one.abs_diff(next) == 1),
            "the record has a gap: {:?}",
            new().collect::<Vec<_>>()
        );
    }

    /// Adds a segment.
    pub(crate) fn push(&mut self, entry: Entry) {
        self.extend(std::iter::once(entry));
    }

    /// Records that the motion has passed this segment.
    pub(crate) fn passed(&mut self, segment: u64) {
        let Some(first) = self.entries.front().map(Entry::segment) else {
            return;
        };
        // Segment numbers are consecutive (`assert_consecutive`).
        let behind = (segment + 1).saturating_sub(first);
        let behind = usize::try_from(behind).unwrap_or(usize::MAX);
        let too_many = behind.saturating_sub(PASSED_MAX).min(self.entries.len());
        if too_many >= FORGOTTEN_AT_ONCE {
            self.entries.drain(..too_many);
        }
    }

    /// Prevents backward motion into this segment.
    pub(crate) fn bar(&mut self, segment: u64) {
        self.barrier = segment;
    }

    /// Returns the index of the segment that contains a position, or else of the next segment, and the plan
    /// time within it, s.
    fn find(&self, place: PathPlace) -> (usize, f64) {
        let at = self
            .entries
            .partition_point(|entry| entry.segment() < place.segment);
        match self.entries.get(at) {
            Some(entry) if entry.segment() == place.segment => {
                if place.plan_s < entry.plan_s() {
                    (at, place.plan_s.max(0.0))
                } else {
                    (at + 1, 0.0)
                }
            }
            _ => (at, 0.0),
        }
    }

    /// Implements [`Planner::place_ahead`](crate::Planner::place_ahead).
    pub(crate) fn place_ahead(&self, from: PathPlace, ahead_s: f64) -> Option<PathPlace> {
        let (first, at_s) = self.find(from);
        let mut left_s = at_s + ahead_s;
        for entry in self.entries.range(first.min(self.entries.len())..) {
            let whole_s = entry.plan_s();
            if let Entry::Paced(block) = entry
                && left_s < whole_s
            {
                // The position is never exactly at an end of a block, where the segment number changes.
                let plan_s = left_s.max(0.5 * whole_s.min(ahead_s));
                return Some(PathPlace {
                    segment: block.segment,
                    plan_s,
                });
            }
            left_s = (left_s - whole_s).max(0.0);
        }
        None
    }

    /// Replaces all entries from the segment of `from` on by those of another record.
    pub(crate) fn replace(&mut self, from: PathPlace, by: Record) {
        let (first, _) = self.find(from);
        self.entries.truncate(first);
        self.extend(by.entries.into_iter());
    }

    /// Returns the entries after a position, and the plan time within the first entry, s.
    pub(crate) fn ahead(&self, from: PathPlace) -> (impl Iterator<Item = &Entry>, f64) {
        let (first, from_s) = self.find(from);
        (self.entries.range(first.min(self.entries.len())..), from_s)
    }

    /// Returns the part of a dwell that was already waited, s. The waits of a dwell add up to its programmed
    /// time.
    pub(crate) fn waited_s(&self, entry: &Entry) -> f64 {
        match self.turned_at {
            Some(at) if entry.is_dwell() && entry.segment() < at.segment => entry.plan_s(),
            Some(at) if entry.is_dwell() && entry.segment() == at.segment => at.plan_s.min(entry.plan_s()),
            _ => 0.0,
        }
    }

    /// Returns the entries before a position in reverse order, as far as backward motion is possible. Also
    /// returns the plan time within the first entry, s.
    pub(crate) fn entries_before(&self, from: PathPlace) -> (impl Iterator<Item = &Entry>, f64) {
        let (at, plan_s) = self.find(from);
        let end = (at + usize::from(plan_s > 0.0)).min(self.entries.len());
        let is_open = |entry: &&Entry| entry.segment() > self.barrier && entry.is_reversible();
        (self.entries.range(..end).rev().take_while(is_open), plan_s)
    }

    /// Returns true if backward motion from this position is possible.
    pub(crate) fn can_retrace(&self, from: PathPlace) -> bool {
        let (mut behind, _) = self.entries_before(from);
        behind.any(|entry| !entry.is_dwell() && entry.plan_s() > 0.0)
    }

    /// Records that backward motion begins at this position.
    pub(crate) fn record_turn(&mut self, from: PathPlace) {
        let is_farther = |at: PathPlace| (at.segment, at.plan_s) < (from.segment, from.plan_s);
        if self.turned_at.is_none_or(is_farther) {
            self.turned_at = Some(from);
        }
    }
}
