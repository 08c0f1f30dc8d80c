//! The output profiles, kept so that they can be planned again ([`crate::replan`]).

use std::collections::VecDeque;

use tandem_model::profile::{Law, PathPlace, Profile};

use crate::block::RampedBlock;

/// Passed segments that are kept: the reach of back trace.
pub(crate) const PASSED_MAX: usize = 10_000;

/// Older segments are dropped this many at a time: dropping them one by one costs a cache miss each.
const FORGOTTEN_AT_ONCE: usize = 128;

/// The record grows by this many segments at a time: doubling it would waste memory.
const ROOM: usize = 2048;

/// Most segments kept; the oldest are dropped.
const SEGMENTS_MAX: usize = 65_536;

/// Output segments, in order; those of a G500 chain in their form before look-ahead.
#[derive(Debug, Clone, Default)]
pub(crate) struct Record {
    entries: VecDeque<Entry>,
    /// The last segment into which no return is possible.
    barrier: u64,
    /// The farthest place where a return has begun: dwells before it are not repeated.
    turned_at: Option<PathPlace>,
}

/// An output segment.
#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "blocks are moved here by the ten thousand: none of them is allocated"
)]
pub(crate) enum Entry {
    /// A block of a G500 chain, paced by look-ahead: it can be passed either way.
    Paced(RampedBlock),
    /// A rapid or a dwell with G500: it can be passed either way.
    Alone(Box<Profile>),
    /// A block of a G501 chain.
    Ramped(RampedBlock),
    /// Any other segment outside of chains.
    OneWay(Box<Profile>),
}

impl Entry {
    pub(crate) fn segment(&self) -> u64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.segment,
            Entry::Alone(profile) | Entry::OneWay(profile) => profile.segment,
        }
    }

    /// Returns the plan time at its end, s.
    pub(crate) fn plan_s(&self) -> f64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.ramped.plan_s,
            Entry::Alone(profile) | Entry::OneWay(profile) => profile.duration_s,
        }
    }

    /// Returns true if it can be passed backward.
    fn is_reversible(&self) -> bool {
        matches!(self, Entry::Paced(_) | Entry::Alone(_))
    }

    /// Returns true for a time at rest.
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
        self.entries.extend(entries);
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
        // Segments are numbered one after another.
        let behind = (segment + 1).saturating_sub(first);
        let behind = usize::try_from(behind).unwrap_or(usize::MAX);
        let too_many = behind.saturating_sub(PASSED_MAX).min(self.entries.len());
        if too_many >= FORGOTTEN_AT_ONCE {
            self.entries.drain(..too_many);
        }
    }

    /// Prevents a return past the end of this segment.
    pub(crate) fn bar(&mut self, segment: u64) {
        self.barrier = segment;
    }

    /// Returns the index of the segment at a place or after it, and plan time within it, s.
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
                // never exactly at the ends, where the block changes
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

    /// Replaces everything from the segment of this place on by another record.
    pub(crate) fn replace(&mut self, from: PathPlace, by: Record) {
        let (first, _) = self.find(from);
        self.entries.truncate(first);
        self.extend(by.entries.into_iter());
    }

    /// Returns the entries after a place, and plan time within the first, s.
    pub(crate) fn ahead(&self, from: PathPlace) -> (impl Iterator<Item = &Entry>, f64) {
        let (first, from_s) = self.find(from);
        (self.entries.range(first.min(self.entries.len())..), from_s)
    }

    /// Returns the part of a dwell that was already waited, s. In total, a dwell is waited once.
    pub(crate) fn waited_s(&self, entry: &Entry) -> f64 {
        match self.turned_at {
            Some(at) if entry.is_dwell() && entry.segment() < at.segment => entry.plan_s(),
            Some(at) if entry.is_dwell() && entry.segment() == at.segment => at.plan_s.min(entry.plan_s()),
            _ => 0.0,
        }
    }

    /// Returns the entries before a place, in reverse, as far as a return is possible, and plan time within the first,
    /// s.
    pub(crate) fn entries_before(&self, from: PathPlace) -> (impl Iterator<Item = &Entry>, f64) {
        let (at, plan_s) = self.find(from);
        let end = (at + usize::from(plan_s > 0.0)).min(self.entries.len());
        let is_open = |entry: &&Entry| entry.segment() > self.barrier && entry.is_reversible();
        (self.entries.range(..end).rev().take_while(is_open), plan_s)
    }

    /// Returns true if a return from this place is possible.
    pub(crate) fn can_retrace(&self, from: PathPlace) -> bool {
        let (mut behind, _) = self.entries_before(from);
        behind.any(|entry| !entry.is_dwell() && entry.plan_s() > 0.0)
    }

    /// Records that a return begins at this place.
    pub(crate) fn record_turn(&mut self, from: PathPlace) {
        let is_farther = |at: PathPlace| (at.segment, at.plan_s) < (from.segment, from.plan_s);
        if self.turned_at.is_none_or(is_farther) {
            self.turned_at = Some(from);
        }
    }
}
