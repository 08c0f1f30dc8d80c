//! A new plan for output profiles, from the current position on the path: for another override, or for
//! backward motion (back trace).

use std::collections::VecDeque;

use tandem_model::profile::{Law, PathPlace, Profile, Stretch};

use crate::look_ahead::{LookAhead, Passage};
use crate::record::{Entry, Record};

/// A new plan that begins at a position on the path.
#[derive(Debug)]
pub struct Replan {
    pub(crate) from: PathPlace,
    /// The last segment before `from`.
    pub passed: u64,
    pub(crate) look_ahead: LookAhead,
    pub(crate) record: Record,
    /// The new profiles, beginning at `from`.
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

    /// Plans the entries after `from`, and then the blocks that look-ahead holds.
    pub(crate) fn forward(record: &Record, held: &LookAhead, from: PathPlace, at_rest: bool) -> Self {
        let (entries, from_s) = record.ahead(from);
        let mut entries = entries.cloned().peekable();
        let is_within = entries.peek().map(Entry::segment) == Some(from.segment);
        let mut new = Self::empty(from, held);
        new.passed = from.segment.saturating_sub(u64::from(is_within));
        let passage = Passage {
            from_s,
            is_backward: false,
        };
        let held = held.blocks().cloned().map(Entry::Paced);
        new.pass_all(record, entries.chain(held), passage, at_rest);
        new
    }

    /// Plans backward motion from `from`, where the machine is at rest. The plan has no profiles if backward
    /// motion is not possible.
    pub(crate) fn backward(record: &Record, held: &LookAhead, from: PathPlace) -> Self {
        let mut new = Self::empty(from, held);
        if !record.can_retrace(from) {
            return new;
        }
        let (behind, plan_s) = record.entries_before(from);
        let mut behind = behind.cloned().peekable();
        let first_s = behind.peek().map_or(0.0, Entry::plan_s);
        let passage = Passage {
            from_s: if plan_s > 0.0 { first_s - plan_s } else { 0.0 },
            is_backward: true,
        };
        new.pass_all(record, behind, passage, true);
        new
    }

    /// Returns true if the motion may continue from `from`, because it can stop within the new plan.
    pub fn can_begin(&self) -> bool {
        self.profiles.back().is_some_and(|last| match &last.law {
            Law::Paced { pace, .. } => pace.free_to >= self.from.segment,
            _ => true,
        })
    }

    /// Plans entries in order: the first entry from its passage on, all other entries whole. In backward
    /// motion the last entry ends at rest even if its path continues. In forward motion more entries may
    /// follow.
    fn pass_all(
        &mut self,
        record: &Record,
        entries: impl Iterator<Item = Entry>,
        first: Passage,
        at_rest: bool,
    ) {
        let mut entries = entries.peekable();
        let mut passage = first;
        let mut begins_at_rest = at_rest;
        while let Some(entry) = entries.next() {
            if std::mem::take(&mut begins_at_rest) && begins_within(&entry, passage) {
                self.look_ahead
                    .begin_at_rest(entry.segment(), passage.is_backward);
            }
            let ends = passage.is_backward && entries.peek().is_none();
            let is_last = ends || passes_to_rest(&entry, passage);
            self.pass(record, entry, passage, is_last);
            passage.from_s = 0.0;
        }
    }

    /// Passes on a segment. If `is_last`, the motion stops at the end of the segment.
    fn pass(&mut self, record: &Record, entry: Entry, passage: Passage, is_last: bool) {
        let alone = match entry {
            Entry::Paced(block) => {
                return self
                    .look_ahead
                    .pass(block, passage, is_last, &mut self.record, &mut self.profiles);
            }
            Entry::Ramped(ref block) => block.profile(),
            Entry::OneWay(ref profile) => Some(Profile::clone(profile)),
            Entry::Alone(ref profile) => Some(profile.over(stretch(record, &entry, passage))),
        };
        self.profiles.extend(alone);
        self.record.push(entry);
    }
}

/// Returns true if the path is at rest where the passage leaves the entry.
fn passes_to_rest(entry: &Entry, passage: Passage) -> bool {
    match entry {
        Entry::Paced(block) if passage.is_backward => block.begins_at_rest(0.0),
        Entry::Paced(block) => block.ends_at_rest(),
        _ => true,
    }
}

/// Returns true if a motion from rest begins at a point where the planned path moves.
fn begins_within(entry: &Entry, passage: Passage) -> bool {
    match entry {
        Entry::Paced(block) if passage.is_backward => passage.from_s > 0.0 || !block.ends_at_rest(),
        Entry::Paced(block) => !block.begins_at_rest(passage.from_s),
        _ => false,
    }
}

/// Returns the stretch of an entry outside of chains. In backward motion, dwells are skipped.
fn stretch(record: &Record, entry: &Entry, passage: Passage) -> Stretch {
    let whole_s = entry.plan_s();
    if passage.is_backward {
        return Stretch {
            from_s: if entry.is_dwell() {
                0.0
            } else {
                whole_s - passage.from_s
            },
            to_s: 0.0,
        };
    }
    Stretch {
        from_s: passage.from_s.max(record.waited_s(entry)),
        to_s: whole_s,
    }
}
