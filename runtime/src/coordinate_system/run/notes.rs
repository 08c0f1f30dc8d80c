//! Notes about interpreted blocks whose motion has not started: changes of the modal data, and starts of blocks. Each
//! note belongs to a motion and is reported when the segments of that motion start to run. Reason: cutter compensation
//! decides only later how many segments a motion has.

use std::collections::VecDeque;
use std::sync::Arc;

use plc_protocol::types::state::CallSite;
use tandem_interp::Modal;
use tandem_model::flow::Transform;

/// State that is in force after segment `after_segment`.
#[derive(Debug, Clone)]
pub(crate) struct StateAfterSegment {
    pub after_segment: u64,
    pub modal: Modal,
    pub transform: Transform,
    pub stack: Arc<[CallSite]>,
}

/// Notes of one coordinate system, in the order of the program.
#[derive(Debug, Default)]
pub(crate) struct Notes {
    /// Changes before motions that are not planned yet, each with the number of its motion.
    ahead: VecDeque<(u64, StateAfterSegment)>,
    changes: VecDeque<StateAfterSegment>,
    /// First motion of each programmed block that is not planned yet.
    blocks_ahead: VecDeque<u64>,
    /// First segment of each planned block that has not started.
    blocks: VecDeque<u64>,
}

impl Notes {
    /// Notes a change before a motion. A later change before the same motion replaces it, because the earlier one never
    /// comes into force.
    pub fn change(&mut self, motion: u64, change: StateAfterSegment) {
        self.ahead.pop_back_if(|(of, _)| *of == motion);
        self.ahead.push_back((motion, change));
    }

    /// Notes that a programmed block begins with this motion. A block without motion begins with the next motion.
    pub fn block(&mut self, motion: u64) {
        if self.blocks_ahead.back() != Some(&motion) {
            self.blocks_ahead.push_back(motion);
        }
    }

    /// Notes that a block begins with a segment.
    pub fn block_at(&mut self, segment: u64) {
        self.blocks.push_back(segment);
    }

    /// Assigns the notes up to `motion` to `segment`, the segment that is planned next for this motion.
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

    /// Returns true if a programmed block begins with `segment`. Called when that segment starts to run.
    pub fn begins_block(&mut self, segment: u64) -> bool {
        let mut begins = false;
        while self.blocks.pop_front_if(|first| *first <= segment).is_some() {
            begins = true;
        }
        begins
    }

    /// Takes the next change that applies before `segment` starts to run, in order. With `u64::MAX`, takes the next of
    /// all noted changes.
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
