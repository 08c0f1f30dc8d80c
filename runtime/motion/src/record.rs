//! What has been put out: kept so that it can be planned anew from where the motion is, with another override or the
//! other way round (back trace).

use std::collections::VecDeque;

use tandem_model::profile::{Law, PathPlace, Profile};

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

#[derive(Debug, Clone)]
struct Entry {
    profile: Profile,
    is_paced: bool,
}

impl Record {
    pub(crate) fn clear(&mut self) {
        self.entries.clear();
    }

    /// Adds a segment; one of a G500 chain is paced by look-ahead.
    pub(crate) fn push(&mut self, profile: Profile, is_paced: bool) {
        if self.entries.len() >= SEGMENTS_MAX {
            self.entries.pop_front();
        }
        self.entries.push_back(Entry { profile, is_paced });
    }

    /// The motion has passed this segment.
    pub(crate) fn passed(&mut self, segment: u64) {
        let passed = self.behind(segment);
        self.entries.drain(..passed.saturating_sub(PASSED_MAX));
    }

    /// There is no way back past the end of this segment.
    pub(crate) fn bar(&mut self, segment: u64) {
        self.barrier = segment;
    }

    /// Index of the first segment behind this one.
    fn behind(&self, segment: u64) -> usize {
        self.entries
            .partition_point(|entry| entry.profile.segment <= segment)
    }

    /// Index of the segment that holds a place or comes behind it, and plan time within it, s.
    fn find(&self, place: PathPlace) -> (usize, f64) {
        let at = self
            .entries
            .partition_point(|entry| entry.profile.segment < place.segment);
        match self.entries.get(at) {
            Some(entry) if entry.profile.segment == place.segment => {
                if place.plan_s < entry.profile.duration_s {
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
            let Profile {
                segment, duration_s, ..
            } = entry.profile;
            if left_s < duration_s && entry.is_paced {
                // Never at its very ends: there the block is another one.
                let plan_s = left_s.max(0.5 * duration_s.min(ahead_s));
                return Some(PathPlace { segment, plan_s });
            }
            left_s = (left_s - duration_s).max(0.0);
        }
        None
    }

    /// Forgets what begins in the segment of this place or behind it, and goes on with another record.
    pub(crate) fn replace(&mut self, from: PathPlace, by: Record) {
        let (first, _) = self.find(from);
        self.entries.truncate(first);
        for Entry { profile, is_paced } in by.entries {
            self.push(profile, is_paced);
        }
    }

    /// Plans what lies behind a place, and then the blocks that look-ahead holds.
    pub(crate) fn replan(&self, from: PathPlace, at_rest: bool, held: &LookAhead) -> Replan {
        let (first, from_s) = self.find(from);
        let mut new = Replan {
            from,
            look_ahead: held.emptied(),
            record: Record::default(),
            profiles: VecDeque::new(),
        };
        let entries = self.entries.range(first.min(self.entries.len())..);
        let recorded = entries.map(|entry| (&entry.profile, entry.is_paced));
        let held = held.blocks().map(|profile| (profile, true));
        for (n, (profile, is_paced)) in recorded.chain(held).enumerate() {
            if !is_paced {
                new.profiles.push_back(profile.clone());
                new.record.push(profile.clone(), false);
                continue;
            }
            let from_s = if n == 0 { from_s } else { 0.0 };
            if n == 0 && at_rest && !begins_at_rest(profile, from_s) {
                new.look_ahead.begin_at_rest(profile.segment);
            }
            let passage = Passage {
                from_s,
                is_backward: false,
            };
            let is_last = profile.exact_stop;
            new.look_ahead.pass(
                profile.clone(),
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
            .is_some_and(|entry| self.goes_back(entry))
    }

    fn goes_back(&self, entry: &Entry) -> bool {
        entry.is_paced && entry.profile.segment > self.barrier
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
        let mut passed = passed.rev().peekable();
        let mut plan_s = Some(plan_s).filter(|plan_s| *plan_s > 0.0);
        while let Some(entry) = passed.next() {
            let profile = &entry.profile;
            if !self.goes_back(entry) {
                break;
            }
            let from_s = plan_s.take().map_or(0.0, |plan_s| profile.duration_s - plan_s);
            if from_s > 0.0 {
                look_ahead.begin_at_rest(profile.segment);
            }
            let goes_on = passed.peek().is_some_and(|next| self.goes_back(next));
            let is_last = !goes_on || begins_at_rest(profile, 0.0);
            let passage = Passage {
                from_s,
                is_backward: true,
            };
            look_ahead.pass(profile.clone(), passage, is_last, &mut record, &mut out);
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

/// True when the path of a block rests at a plan time by itself.
fn begins_at_rest(profile: &Profile, plan_s: f64) -> bool {
    matches!(profile.law, Law::Ramped { begun_s, .. } if begun_s + plan_s == 0.0)
}

/// A new plan from a place on.
#[derive(Debug)]
pub struct Replan {
    pub(crate) from: PathPlace,
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
