//! What has been put out: kept so that it can be planned anew from where the motion is, with another override or the
//! other way round (back trace).

use std::collections::VecDeque;

use tandem_model::profile::{Law, PathPlace, Profile, Stretch};

use crate::block::RampedBlock;
use crate::look_ahead::{LookAhead, Passage};

/// Segments kept behind the motion: how far back trace goes.
pub(crate) const PASSED_MAX: usize = 10_000;

/// Segments farther behind are forgotten so many at a time. Reason: one by one each is fetched from memory for that.
const FORGOTTEN_AT_ONCE: usize = 128;

/// Room is made for so many segments at a time. Reason: twice the room each time is memory that nothing needs.
const ROOM: usize = 2048;

/// Segments kept at all; the oldest are forgotten.
const SEGMENTS_MAX: usize = 65_536;

/// Segments put out, in order; those of a G500 chain as they were before look-ahead.
#[derive(Debug, Clone, Default)]
pub(crate) struct Record {
    entries: VecDeque<Entry>,
    /// There is no way back into this segment and those before it.
    barrier: u64,
    /// The farthest place where a way back has begun: what was waited before it is not waited again.
    turned_at: Option<PathPlace>,
}

/// A segment that has been put out.
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
    /// What else is in no chain.
    OneWay(Box<Profile>),
}

impl Entry {
    fn segment(&self) -> u64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.segment,
            Entry::Alone(profile) | Entry::OneWay(profile) => profile.segment,
        }
    }

    /// Plan time at its end, s.
    fn plan_s(&self) -> f64 {
        match self {
            Entry::Paced(block) | Entry::Ramped(block) => block.plan_s,
            Entry::Alone(profile) | Entry::OneWay(profile) => profile.duration_s,
        }
    }

    /// True when it can be passed backward.
    fn has_way_back(&self) -> bool {
        matches!(self, Entry::Paced(_) | Entry::Alone(_))
    }

    /// A time at rest.
    fn is_dwell(&self) -> bool {
        matches!(self, Entry::Alone(profile) if matches!(profile.law, Law::Rest { .. }))
    }

    /// True when the path rests by itself at the end of it that a passage leads to.
    fn passes_to_rest(&self, passage: Passage) -> bool {
        match self {
            Entry::Paced(block) if passage.is_backward => block.begins_at_rest(0.0),
            Entry::Paced(block) => block.ends_at_rest(),
            _ => true,
        }
    }

    /// True when the motion begins at rest on a path that does not rest there by itself.
    fn is_begun_within(&self, passage: Passage) -> bool {
        match self {
            Entry::Paced(block) if passage.is_backward => passage.from_s > 0.0 || !block.ends_at_rest(),
            Entry::Paced(block) => !block.begins_at_rest(passage.from_s),
            _ => false,
        }
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

    /// The motion has passed this segment.
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
        let mut new = Replan::empty(from, held);
        new.passed = from.segment.saturating_sub(u64::from(is_within));
        let entries = self.entries.range(first.min(self.entries.len())..);
        let held = held.blocks().cloned().map(Entry::Paced);
        let passage = Passage {
            from_s,
            is_backward: false,
        };
        self.pass_all(entries.cloned().chain(held), passage, at_rest, &mut new);
        new
    }

    /// Plans entries to be passed one after another, the first one in this way, the others whole. Backward the last of
    /// them ends in rest wherever its path goes on; forward more may follow.
    fn pass_all(
        &self,
        entries: impl Iterator<Item = Entry>,
        first: Passage,
        at_rest: bool,
        new: &mut Replan,
    ) {
        let mut entries = entries.peekable();
        let mut passage = first;
        let mut begins_at_rest = at_rest;
        while let Some(entry) = entries.next() {
            if std::mem::take(&mut begins_at_rest) && entry.is_begun_within(passage) {
                new.look_ahead.begin_at_rest(entry.segment(), passage.is_backward);
            }
            let ends = passage.is_backward && entries.peek().is_none();
            self.pass(entry, passage, ends, new);
            passage.from_s = 0.0;
        }
    }

    /// `ends`: the way ends with it.
    fn pass(&self, entry: Entry, passage: Passage, ends: bool, new: &mut Replan) {
        let is_last = ends || entry.passes_to_rest(passage);
        let alone = match entry {
            Entry::Paced(block) => {
                return new
                    .look_ahead
                    .pass(block, passage, is_last, &mut new.record, &mut new.profiles);
            }
            Entry::Ramped(ref block) => block.profile(),
            Entry::OneWay(ref profile) => Profile::clone(profile),
            Entry::Alone(ref profile) => profile.over(self.stretch(&entry, passage)),
        };
        new.profiles.push_back(alone);
        new.record.push(entry);
    }

    /// Plan time of an entry that is no block of a chain. A dwell is waited once in all, and not on the way back.
    fn stretch(&self, entry: &Entry, passage: Passage) -> Stretch {
        let whole_s = entry.plan_s();
        let is_dwell = entry.is_dwell();
        if passage.is_backward {
            return Stretch {
                from_s: if is_dwell { 0.0 } else { whole_s - passage.from_s },
                to_s: 0.0,
            };
        }
        let waited_s = match self.turned_at {
            Some(at) if is_dwell && entry.segment() < at.segment => whole_s,
            Some(at) if is_dwell && entry.segment() == at.segment => at.plan_s.min(whole_s),
            _ => 0.0,
        };
        Stretch {
            from_s: passage.from_s.max(waited_s),
            to_s: whole_s,
        }
    }

    /// What lies behind a place as far as there is a way back, from there on, and plan time within the first, s.
    fn behind(&self, from: PathPlace) -> (impl Iterator<Item = &Entry>, f64) {
        let (at, plan_s) = self.find(from);
        let end = (at + usize::from(plan_s > 0.0)).min(self.entries.len());
        let is_open = |entry: &&Entry| entry.segment() > self.barrier && entry.has_way_back();
        (self.entries.range(..end).rev().take_while(is_open), plan_s)
    }

    /// True when there is a way back from this place.
    pub(crate) fn has_way_back(&self, from: PathPlace) -> bool {
        let (mut behind, _) = self.behind(from);
        behind.any(|entry| !entry.is_dwell() && entry.plan_s() > 0.0)
    }

    /// The way back from a place at rest, as far as there is one; empty: there is none.
    pub(crate) fn retrace(&mut self, from: PathPlace, held: &LookAhead) -> VecDeque<Profile> {
        let mut back = Replan::empty(from, held);
        if !self.has_way_back(from) {
            return back.profiles;
        }
        let is_farther = |at: PathPlace| (at.segment, at.plan_s) < (from.segment, from.plan_s);
        if self.turned_at.is_none_or(is_farther) {
            self.turned_at = Some(from);
        }
        let (behind, plan_s) = self.behind(from);
        let mut behind = behind.cloned().peekable();
        let first_s = behind.peek().map_or(0.0, Entry::plan_s);
        let passage = Passage {
            from_s: if plan_s > 0.0 { first_s - plan_s } else { 0.0 },
            is_backward: true,
        };
        self.pass_all(behind, passage, true, &mut back);
        back.profiles
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
    fn empty(from: PathPlace, held: &LookAhead) -> Self {
        Self {
            from,
            passed: 0,
            look_ahead: held.emptied(),
            record: Record::default(),
            profiles: VecDeque::new(),
        }
    }

    /// True when the motion may go on at its place: it can come to rest again within the new plan.
    pub fn can_begin(&self) -> bool {
        self.profiles.back().is_some_and(|last| match &last.law {
            Law::Paced { pace, .. } => pace.free_to >= self.from.segment,
            _ => true,
        })
    }
}
