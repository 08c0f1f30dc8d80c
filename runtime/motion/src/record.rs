//! What has been put out: kept so that it can be planned anew from where the motion is, with another override or the
//! other way round (back trace).

use std::collections::VecDeque;

use tandem_model::profile::{Law, PathPlace, Profile};

use crate::block::RampedBlock;
use crate::look_ahead::{LookAhead, Passage};

/// Segments kept behind the motion: how far back trace goes.
pub(crate) const PASSED_MAX: usize = 10_000;

/// Segments kept at all; the oldest are forgotten.
const SEGMENTS_MAX: usize = 65_536;

/// Segments put out, in order; those of a G500 chain as they were before look-ahead.
#[derive(Debug, Clone, Default)]
pub(crate) struct Record {
    entries: VecDeque<Entry>,
    /// There is no way back into this segment and those before it.
    barrier: u64,
}

/// A segment that has been put out.
#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "blocks are moved here by the ten thousand: none of them is allocated"
)]
pub(crate) enum Entry {
    /// A block of a G500 chain, paced by look-ahead.
    Paced(RampedBlock),
    /// A block of a G501 chain.
    Ramped(RampedBlock),
    /// Not in a chain.
    Alone(Box<Profile>),
}

impl Entry {
    fn segment(&self) -> u64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.segment,
            Entry::Alone(profile) => profile.segment,
        }
    }

    /// Plan time at its end, s.
    fn plan_s(&self) -> f64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.plan_s,
            Entry::Alone(profile) => profile.duration_s,
        }
    }

    /// As planned, before look-ahead.
    fn profile(&self) -> Profile {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.profile(),
            Entry::Alone(profile) => Profile::clone(profile),
        }
    }
}

impl Record {
    pub(crate) fn clear(&mut self) {
        self.entries.clear();
    }

    /// Adds segments.
    pub(crate) fn extend(&mut self, entries: impl ExactSizeIterator<Item = Entry>) {
        let too_many = (self.entries.len() + entries.len()).saturating_sub(SEGMENTS_MAX);
        self.entries.drain(..too_many.min(self.entries.len()));
        self.entries.extend(entries);
    }

    /// Adds a segment.
    pub(crate) fn push(&mut self, entry: Entry) {
        self.extend(std::iter::once(entry));
    }

    /// The motion has passed this segment.
    pub(crate) fn passed(&mut self, segment: u64) {
        let is_too_far_behind = |first_kept: &Entry| first_kept.segment() <= segment;
        while self.entries.get(PASSED_MAX).is_some_and(is_too_far_behind) {
            self.entries.pop_front();
        }
    }

    /// There is no way back past the end of this segment.
    pub(crate) fn bar(&mut self, segment: u64) {
        self.barrier = segment;
    }

    /// Index of the segment that holds a place or comes behind it, and plan time within it, s.
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

    /// A place within a block of a G500 chain, plan time `ahead_s` or more beyond this one; `None`: there is none.
    pub(crate) fn place_ahead(&self, from: PathPlace, ahead_s: f64) -> Option<PathPlace> {
        let (first, at_s) = self.find(from);
        let mut left_s = at_s + ahead_s;
        for entry in self.entries.range(first.min(self.entries.len())..) {
            let whole_s = entry.plan_s();
            if let Entry::Paced(block) = entry
                && left_s < whole_s
            {
                // Never at its very ends: there the block is another one.
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

    /// Forgets what begins in the segment of this place or behind it, and goes on with another record.
    pub(crate) fn replace(&mut self, from: PathPlace, by: Record) {
        let (first, _) = self.find(from);
        self.entries.truncate(first);
        self.extend(by.entries.into_iter());
    }

    /// Plans what lies behind a place, and then the blocks that look-ahead holds.
    pub(crate) fn replan(&self, from: PathPlace, at_rest: bool, held: &LookAhead) -> Replan {
        let (first, from_s) = self.find(from);
        let next = self.entries.get(first).map(Entry::segment);
        let is_within = next == Some(from.segment);
        let mut new = Replan {
            from,
            passed: from.segment.saturating_sub(u64::from(is_within)),
            look_ahead: held.emptied(),
            record: Record::default(),
            profiles: VecDeque::new(),
        };
        let entries = self.entries.range(first.min(self.entries.len())..);
        let held = held.blocks().map(Ok);
        let recorded = entries.map(|entry| match entry {
            Entry::Paced(block) => Ok(block),
            Entry::Ramped(_) | Entry::Alone(_) => Err(entry),
        });
        for (n, block) in recorded.chain(held).enumerate() {
            let block = match block {
                Ok(block) => block,
                Err(entry) => {
                    new.profiles.push_back(entry.profile());
                    new.record.push(entry.clone());
                    continue;
                }
            };
            let from_s = if n == 0 { from_s } else { 0.0 };
            if n == 0 && at_rest && !block.begins_at_rest(from_s) {
                new.look_ahead.begin_at_rest(block.segment);
            }
            let passage = Passage {
                from_s,
                is_backward: false,
            };
            let is_last = block.ends_at_rest();
            new.look_ahead.pass(
                block.clone(),
                passage,
                is_last,
                &mut new.record,
                &mut new.profiles,
            );
        }
        new
    }

    /// True when there is a way back from this place.
    pub(crate) fn has_way_back(&self, from: PathPlace) -> bool {
        let (at, plan_s) = self.find(from);
        let last = (at + usize::from(plan_s > 0.0)).checked_sub(1);
        last.and_then(|last| self.entries.get(last))
            .is_some_and(|entry| self.way_back(entry).is_some())
    }

    /// The block, if there is a way back along it.
    fn way_back<'a>(&self, entry: &'a Entry) -> Option<&'a RampedBlock> {
        match entry {
            Entry::Paced(block) if block.segment > self.barrier => Some(block),
            _ => None,
        }
    }

    /// The way back from a place at rest, as far as there is one; empty: there is none.
    pub(crate) fn retrace(&self, from: PathPlace, held: &LookAhead) -> VecDeque<Profile> {
        let mut look_ahead = held.emptied();
        let mut record = Record::default();
        let mut out = VecDeque::new();
        let (at, plan_s) = self.find(from);
        let passed = self
            .entries
            .range(..(at + usize::from(plan_s > 0.0)).min(self.entries.len()));
        let mut passed = passed.rev().map_while(|entry| self.way_back(entry)).peekable();
        let mut plan_s = Some(plan_s).filter(|plan_s| *plan_s > 0.0);
        while let Some(block) = passed.next() {
            let from_s = plan_s.take().map_or(0.0, |plan_s| block.plan_s - plan_s);
            if from_s > 0.0 {
                look_ahead.begin_at_rest(block.segment);
            }
            let is_last = passed.peek().is_none() || block.begins_at_rest(0.0);
            let passage = Passage {
                from_s,
                is_backward: true,
            };
            look_ahead.pass(block.clone(), passage, is_last, &mut record, &mut out);
        }
        // All of it is known.
        for profile in &mut out {
            if let Law::Paced { pace, .. } = &mut profile.law {
                pace.free_to = u64::MAX;
            }
        }
        out
    }
}

/// A new plan from a place on.
#[derive(Debug)]
pub struct Replan {
    pub(crate) from: PathPlace,
    /// The last segment that lies behind that place.
    pub passed: u64,
    pub(crate) look_ahead: LookAhead,
    pub(crate) record: Record,
    /// What follows that place.
    pub profiles: VecDeque<Profile>,
}

impl Replan {
    /// True when the motion may go on at its place: it can come to rest again within the new plan.
    pub fn can_begin(&self) -> bool {
        self.profiles.back().is_some_and(|last| match &last.law {
            Law::Paced { pace, .. } => pace.free_to >= self.from.segment,
            _ => true,
        })
    }
}
