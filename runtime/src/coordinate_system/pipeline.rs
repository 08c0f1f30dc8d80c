//! The stages of one coordinate system in a row: interpreter, path, motion. Pure; the task pulls it.

use std::collections::VecDeque;
use std::sync::Arc;

use plc_api::types::state::CallSite;
use tandem_interp::{Inputs, Interpreter, Modal};
use tandem_model::flow::{Block, Item, Segment, Transform};
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, MachinePosition};
use tandem_motion::Planner;
use tandem_path::PathStage;
use tandem_syntax::NcProgram;

/// The stages and what they have ready for the servo.
#[derive(Debug)]
pub(super) struct Pipeline {
    pub interpreter: Interpreter,
    path: PathStage,
    planner: Planner,
    segments: Vec<Segment>,
    /// Planned, and not yet in the servo's queue.
    pub ready: VecDeque<Profile>,
    /// What changes after which segment, for those who watch; in order.
    pub changes: VecDeque<Change>,
    last: Change,
}

/// What is in force from the segment after `after_segment` on.
#[derive(Debug, Clone)]
pub(super) struct Change {
    pub after_segment: u64,
    pub modal: Modal,
    pub transform: Transform,
    pub stack: Arc<[CallSite]>,
}

impl Pipeline {
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        let interpreter = Interpreter::new(settings);
        let path = PathStage::new(settings, MachinePosition::default());
        let last = Change {
            after_segment: 0,
            modal: interpreter.modal().clone(),
            transform: *path.transform(),
            stack: Arc::default(),
        };
        Self {
            interpreter,
            path,
            planner: Planner::new(settings),
            segments: Vec::new(),
            ready: VecDeque::new(),
            changes: VecDeque::new(),
            last,
        }
    }

    /// The interpreter's next item; a block has gone on to the planner when this returns.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Result<Item, Alarm> {
        let item = self.interpreter.next(inputs)?;
        if let Item::Block(block) = &item {
            self.note_change();
            self.block(block)?;
        }
        self.note_change();
        Ok(item)
    }

    fn block(&mut self, block: &Block) -> Result<(), Alarm> {
        let result = self.path.push(block, &mut self.segments);
        self.plan(result)
    }

    /// Brings out what is held back: nothing follows soon.
    pub fn flush(&mut self) -> Result<(), Alarm> {
        let result = self.path.flush(&mut self.segments);
        self.plan(result)?;
        self.planner.flush(&mut self.ready)
    }

    // What came before a refused block is planned all the same: it runs to its end before the alarm.
    fn plan(&mut self, result: Result<(), Alarm>) -> Result<(), Alarm> {
        for segment in self.segments.drain(..) {
            self.planner.push(&segment, &mut self.ready)?;
        }
        result
    }

    fn note_change(&mut self) {
        let modal = self.interpreter.modal();
        let transform = self.path.transform();
        let depth = self.interpreter.call_stack().count();
        let callers = || {
            self.interpreter
                .call_stack()
                .take(depth.saturating_sub(1))
                .map(|origin| CallSite {
                    program: origin.program,
                    line: origin.line,
                })
        };
        if *modal == self.last.modal
            && *transform == self.last.transform
            && callers().eq(self.last.stack.iter().cloned())
        {
            return;
        }
        self.last = Change {
            after_segment: self.planner.last_segment() + u64::from(self.path.holds_back()),
            modal: modal.clone(),
            transform: *transform,
            stack: callers().collect(),
        };
        self.changes.push_back(self.last.clone());
    }

    /// After G31: the machine rests here, perhaps short of the target.
    pub fn skipped_to(&mut self, at: MachinePosition) {
        self.path.skipped_to(at);
    }

    /// The segment given out last; the servo reports it when it is finished.
    pub fn last_segment(&self) -> u64 {
        self.planner.last_segment()
    }

    /// Begins a program at its head, where the machine rests, in the start-up modal state.
    pub fn start(&mut self, program: Arc<NcProgram>, number: u16, epoch: u32) {
        self.restart(epoch, self.path.position());
        self.interpreter.start(program, number);
    }

    /// Throws away what is prepared: the machine rests at `at`, and profiles carry `epoch` from here on.
    pub fn restart(&mut self, epoch: u32, at: MachinePosition) {
        self.ready.clear();
        self.segments.clear();
        self.changes.clear();
        self.path.restart(at);
        self.planner.restart(epoch);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use tandem_syntax::{Grammar, parse};

    use super::*;
    use crate::Config;

    #[test]
    fn what_is_in_force_changes_with_the_block_that_moves_though_a_segment_is_held_back() {
        let machine = Config::demo().resolve().unwrap();
        let system = &machine.coordinate_systems[0];
        let (program, found) = parse("G90 G01 X10 F3000\nY10 F6000\nG54 G00 Z5\nM30\n", Grammar::nj());
        assert_eq!(found, []);
        let mut pipeline = Pipeline::new(&system.settings);
        pipeline.start(Arc::new(program), 1, 0);
        let inputs = Inputs {
            programs: &BTreeMap::new(),
            optional_skip: 0,
            work_offsets: &system.work_offsets,
        };
        while !matches!(pipeline.next(&inputs).unwrap(), Item::End(_)) {}
        let in_force_from = |is_it: &dyn Fn(&Change) -> bool| {
            pipeline
                .changes
                .iter()
                .find(|change| is_it(change))
                .map(|change| change.after_segment + 1)
        };
        let feedrate_is = |f: f64| move |change: &Change| (change.modal.feedrate_mm_min - f).abs() < 1e-9;
        assert_eq!(in_force_from(&feedrate_is(3000.0)), Some(1));
        assert_eq!(in_force_from(&feedrate_is(6000.0)), Some(2));
        let rapid = |change: &Change| change.modal.groups().any(|group| group == ("01", "G00"));
        assert_eq!(in_force_from(&rapid), Some(3));
        let offset = |change: &Change| change.transform.work_offset != tandem_model::AxisVector::ZERO;
        assert_eq!(in_force_from(&offset), Some(3));
    }
}
