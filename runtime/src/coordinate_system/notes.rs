//! Changes and block starts ahead of the motion: noted with their motion, and reported when the segments of that motion
//! run. Cutter compensation decides only later how many segments a motion has.

use std::collections::VecDeque;
use std::sync::Arc;

use plc_api::types::state::CallSite;
use tandem_interp::Modal;
use tandem_model::flow::Transform;

/// State in force after segment `after_segment`.
#[derive(Debug, Clone)]
pub(crate) struct StateAfterSegment {
    pub after_segment: u64,
    pub modal: Modal,
    pub transform: Transform,
    pub stack: Arc<[CallSite]>,
}

/// Notes of one coordinate system, in the order of the program.
#[derive(Debug, Default)]
pub(super) struct Notes {
    /// Changes with the numbers of motions that are not planned yet.
    ahead: VecDeque<(u64, StateAfterSegment)>,
    changes: VecDeque<StateAfterSegment>,
    /// The first motions of programmed blocks that are not planned yet.
    blocks_ahead: VecDeque<u64>,
    /// The first segments of planned blocks that have not begun.
    blocks: VecDeque<u64>,
}

impl Notes {
    /// Notes a change with a motion. There is one change per motion: one that is replaced before the same motion never
    /// comes into force.
    pub fn change(&mut self, motion: u64, change: StateAfterSegment) {
        self.ahead.pop_back_if(|(of, _)| *of == motion);
        self.ahead.push_back((motion, change));
    }

    /// Notes that a programmed block begins with a motion; a block without motion is assigned to the next motion.
    pub fn block(&mut self, motion: u64) {
        if self.blocks_ahead.back() != Some(&motion) {
            self.blocks_ahead.push_back(motion);
        }
    }

    /// Notes that a block begins with a segment.
    pub fn block_at(&mut self, segment: u64) {
        self.blocks.push_back(segment);
    }

    /// Assigns the segment that is planned next to its motion.
    pub fn settle(&mut self, motion: u64, segment: u64) {
        while let Some((_, change)) = self.ahead.pop_front_if(|(of, _)| *of <= motion) {
            let after_segment = segment - 1;
            self.changes
                .pop_back_if(|last| last.after_segment == after_segment);
            self.changes.push_back(StateAfterSegment {
                after_segment,
                ..change
            });
        }
        while self.blocks_ahead.pop_front_if(|of| *of <= motion).is_some() {
            self.blocks.push_back(segment);
        }
    }

    /// Returns true if a programmed block begins with this segment, which begins to run.
    pub fn begins_block(&mut self, segment: u64) -> bool {
        let mut begins = false;
        while self.blocks.pop_front_if(|first| *first <= segment).is_some() {
            begins = true;
        }
        begins
    }

    /// Takes the next change that applies before a segment begins to run, in order; with the highest number, every
    /// noted change.
    pub fn changed_before(&mut self, segment: u64) -> Option<StateAfterSegment> {
        let planned = self.changes.pop_front_if(|change| change.after_segment < segment);
        planned.or_else(|| {
            let ahead = (segment == u64::MAX).then(|| self.ahead.pop_front());
            ahead.flatten().map(|(_, change)| change)
        })
    }

    /// Returns all changes that are not reported yet.
    pub fn changes(&self) -> impl Iterator<Item = &StateAfterSegment> {
        self.changes
            .iter()
            .chain(self.ahead.iter().map(|(_, change)| change))
    }

    /// Discards all notes.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}
