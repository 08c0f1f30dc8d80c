//! The stages of one coordinate system in sequence: interpreter, path, motion. Pure: the task requests items from it.

use std::collections::VecDeque;
use std::sync::Arc;

use plc_protocol::types::state::CallSite;
use tandem_interp::{Dialect, Inputs, Interpreter, Modal, ModalState};
use tandem_model::flow::{
    Action, Block, Compensation, Item, MultiBlock, Segment, SegmentEnd, SegmentMotion, TapLeg,
};
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, AxisVector, MachinePosition, Origin};
use tandem_motion::{Planner, Replan, speed_limit};
use tandem_path::PathStage;
use tandem_syntax::NcProgram;

use super::line_search::{LineArrival, LineEntry};
use super::notes::{Notes, StateAfterSegment};
use crate::planned::{OnPlan, PlannedMotion};

/// Stages of a coordinate system, and the profiles that are ready for the servo.
#[derive(Debug)]
pub(crate) struct Pipeline {
    pub interpreter: Interpreter,
    pub path: PathStage,
    /// Items that were interpreted while the end point of a G31 was unknown, in order.
    pub set_aside: VecDeque<SetAside>,
    pub planner: Planner,
    segments: Vec<Segment>,
    /// Planned profiles that are not in the servo's queue yet.
    pub ready: VecDeque<Profile>,
    /// Changes of state and starts of blocks whose motion has not started.
    notes: Notes,
    /// State of the last noted change.
    last: StateAfterSegment,
    /// State in force for the motion that runs now.
    pub in_force: StateAfterSegment,
    /// Step number (counted by the interpreter) of the programmed block noted last.
    noted_step: Option<u64>,
    /// True if the tool will be in a thread (tapping) at the end of all motion planned so far.
    pub in_thread: bool,
    /// Function that is called with each plan, and the settings of the coordinate system for that function.
    watched: Option<(OnPlan, Box<CoordinateSystemSettings>)>,
}

/// State in force between two runs: modal state, path stage with its transform, and their published values.
#[derive(Debug)]
pub(crate) struct InForce {
    modal: ModalState,
    path: PathStage,
    change: StateAfterSegment,
}

/// Item that waits to be passed to the path stage until a G31 has ended.
#[derive(Debug)]
pub(crate) struct SetAside {
    block: Option<Block>,
    modal: Modal,
    stack: Arc<[CallSite]>,
    step: u64,
}

impl Pipeline {
    /// Creates a pipeline for a machine that rests at position `at`.
    pub fn new(settings: &CoordinateSystemSettings, dialect: &'static Dialect, at: MachinePosition) -> Self {
        let interpreter = Interpreter::new(settings, dialect);
        let path = PathStage::new(settings, at);
        let last = StateAfterSegment {
            after_segment: 0,
            modal: interpreter.modal().clone(),
            transform: *path.transform(),
            stack: Arc::default(),
        };
        Self {
            interpreter,
            path,
            set_aside: VecDeque::new(),
            planner: Planner::new(settings),
            segments: Vec::new(),
            ready: VecDeque::new(),
            notes: Notes::default(),
            in_force: last.clone(),
            last,
            noted_step: None,
            in_thread: false,
            watched: None,
        }
    }

    /// Replaces all stages after a fault in a stage, with the machine at position `at`. Segment numbers continue, and
    /// the operator's dry run stays as set.
    pub fn renew(
        &mut self,
        settings: &CoordinateSystemSettings,
        dialect: &'static Dialect,
        at: MachinePosition,
    ) {
        let is_dry_run = self.path.is_dry_run();
        let (last_segment, watched) = (self.planner.last_segment(), self.watched.take());
        let mut new = Self::new(settings, dialect, at);
        std::mem::swap(&mut new.planner, &mut self.planner);
        new.planner.renew(settings);
        new.path.set_dry_run(is_dry_run);
        new.watched = watched;
        new.last.after_segment = last_segment;
        new.in_force = new.last.clone();
        *self = new;
    }

    /// Calls `on_plan` with every plan from now on.
    pub fn watch(&mut self, on_plan: OnPlan, settings: &CoordinateSystemSettings) {
        self.watched = Some((on_plan, Box::new(settings.clone())));
    }

    /// Returns the interpreter's next item and passes its block to the planner. After a G31 the block is set aside
    /// instead, because it starts where the G31 ends.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Result<Item, Alarm> {
        let item = self.interpreter.next(inputs);
        if let Ok(item) = &item {
            self.hand_on(item)?;
        }
        item
    }

    fn hand_on(&mut self, item: &Item) -> Result<(), Alarm> {
        if self.is_behind_skip() {
            self.set_aside(item);
            return Ok(());
        }
        self.note_change();
        if let Item::Block(block) = item {
            self.note_block(self.interpreter.steps());
            self.block(block)?;
            if let Action::Transform(_) = &block.action {
                self.note_change();
            }
        }
        Ok(())
    }

    /// Returns true while the start point of the next block is unknown: a G31 runs, or blocks after a G31 are still set
    /// aside.
    pub fn is_behind_skip(&self) -> bool {
        self.path.is_skipping() || !self.set_aside.is_empty()
    }

    fn set_aside(&mut self, item: &Item) {
        let block = match item {
            Item::Block(block) => Some(block.clone()),
            _ => None,
        };
        let before = self.set_aside.back().map_or(&self.last.stack, |last| &last.stack);
        let stack = if callers(&self.interpreter).eq(before.iter().cloned()) {
            Arc::clone(before)
        } else {
            callers(&self.interpreter).collect()
        };
        self.set_aside.push_back(SetAside {
            block,
            modal: self.interpreter.modal().clone(),
            stack,
            step: self.interpreter.steps(),
        });
    }

    /// After a G31 has ended, passes the block of the first item that was set aside to the planner. An alarm discards
    /// the items after it. Returns `None` if no item is set aside, or if the G31 still runs.
    pub fn next_set_aside(&mut self) -> Option<Result<(), Alarm>> {
        if self.path.is_skipping() {
            return None;
        }
        let item = self.set_aside.pop_front()?;
        let mut planned = Ok(());
        if let Some(block) = &item.block {
            self.record_change(&item.modal, &item.stack);
            self.note_block(item.step);
            planned = self.block(block);
        }
        self.record_change(&item.modal, &item.stack);
        if planned.is_err() {
            self.set_aside.clear();
        }
        Some(planned)
    }

    fn block(&mut self, block: &Block) -> Result<(), Alarm> {
        if let Action::Tap(tap) = &block.action {
            self.in_thread = tap.leg == TapLeg::In;
        }
        let result = self.path.push(block, &mut self.segments);
        self.plan(result)
    }

    /// Plans all motion that is certain, so that it ends at rest. The program waits and continues later.
    pub fn flush(&mut self) -> Result<(), Alarm> {
        self.path.flush(&mut self.segments);
        self.plan(Ok(()))?;
        self.end_chain();
        Ok(())
    }

    /// Plans all motion that is certain before an alarm. Discards blocks that cutter compensation still holds back.
    pub fn finish(&mut self) -> Result<(), Alarm> {
        let result = self.path.finish(&mut self.segments);
        let planned = self.plan(result);
        self.end_chain();
        planned
    }

    /// Returns true while cutter compensation forbids a wait or an end: from G41 or G42 to the lead-out after G40.
    pub fn is_compensating(&self) -> bool {
        self.path.is_compensating() || self.interpreter.modal().compensation != Compensation::Off
    }

    // Blocks before a refused block are still planned: their motion runs to its end before the alarm is raised. After a
    // segment that cannot be planned, nothing moves.
    fn plan(&mut self, result: Result<(), Alarm>) -> Result<(), Alarm> {
        let planned = self.segments.iter().try_for_each(|segment| {
            let known = self.ready.len();
            let first = self.planner.last_segment() + 1;
            self.notes.settle(segment.serial, first);
            self.planner.push(segment, &mut self.ready)?;
            if let Some(watched) = &self.watched {
                report_segment(watched, self.planner.last_segment(), segment);
                report_profiles(watched, self.ready.iter().skip(known));
            }
            Ok(())
        });
        self.segments.clear();
        if planned.is_err() {
            self.path.restart(self.path.position());
        }
        planned.and(result)
    }

    fn end_chain(&mut self) {
        let known = self.ready.len();
        self.planner.flush(&mut self.ready);
        if let Some(watched) = &self.watched {
            report_profiles(watched, self.ready.iter().skip(known));
        }
    }

    fn note_change(&mut self) {
        let modal = self.interpreter.modal();
        if *modal == self.last.modal
            && *self.path.transform() == self.last.transform
            && callers(&self.interpreter).eq(self.last.stack.iter().cloned())
        {
            return;
        }
        let (modal, stack) = (modal.clone(), callers(&self.interpreter).collect());
        self.record_change(&modal, &stack);
    }

    fn record_change(&mut self, modal: &Modal, stack: &Arc<[CallSite]>) {
        let transform = *self.path.transform();
        if *modal == self.last.modal && transform == self.last.transform && *stack == self.last.stack {
            return;
        }
        self.last = StateAfterSegment {
            after_segment: self.next_segment() - 1,
            modal: modal.clone(),
            transform,
            stack: Arc::clone(stack),
        };
        self.notes.change(self.next_motion(), self.last.clone());
    }

    /// Returns the number that the path stage will give the motion of the next block.
    fn next_motion(&self) -> u64 {
        self.path.last_serial() + 1
    }

    /// Returns the number of the next block's first segment. With cutter compensation the number is approximate.
    pub fn next_segment(&self) -> u64 {
        self.planner.last_segment() + self.path.held_back() as u64 + 1
    }

    /// Notes the start of a programmed block. The blocks that a fixed cycle produces in one step are one start.
    fn note_block(&mut self, step: u64) {
        if self.noted_step != Some(step) {
            self.notes.block(self.next_motion());
        }
        self.noted_step = Some(step);
    }

    /// Returns true if a programmed block begins with `segment`. Called when that segment starts to run.
    pub fn begins_block(&mut self, segment: u64) -> bool {
        self.notes.begins_block(segment)
    }

    /// Takes the next change that applies before `segment` starts to run, in order, and makes it the state in force.
    pub fn changed_before(&mut self, segment: u64) -> Option<StateAfterSegment> {
        let change = self.notes.changed_before(segment)?;
        self.in_force = change.clone();
        Some(change)
    }

    /// Returns the first match of `pick` in the modal states of the running motion, next block and prepared blocks.
    pub fn anywhere<T>(&self, pick: impl Fn(&Modal) -> Option<T>) -> Option<T> {
        let near = [&self.in_force.modal, self.interpreter.modal()].into_iter();
        let ahead = self.notes.changes().map(|change| &change.modal);
        let aside = self.set_aside.iter().map(|item| &item.modal);
        near.chain(ahead).chain(aside).find_map(pick)
    }

    /// Returns the start position of the next block; `None` while a G31 makes the position unknown.
    pub fn counts_from(&self) -> Option<MachinePosition> {
        (!self.is_behind_skip()).then(|| self.path.counts_from())
    }

    /// Begins a program at line 1 from rest, in the start-up modal state; with `goes_on` in the current modal state.
    pub fn start(&mut self, program: Arc<NcProgram>, number: u16, epoch: u32, goes_on: bool) {
        self.restart(epoch, self.path.position(), goes_on);
        if goes_on {
            self.interpreter.start_in_modal(program, number);
        } else {
            self.interpreter.start(program, number);
        }
        self.in_force.modal = self.interpreter.modal().clone();
        self.last = self.in_force.clone();
    }

    /// Makes the interpreter read numbers as at start-up: in the unit of the settings, and as positions.
    pub fn read_as_at_start_up(&mut self) {
        self.interpreter.read_as_at_start_up();
        self.in_force.modal = self.interpreter.modal().clone();
        self.last = self.in_force.clone();
    }

    /// Returns the state in force between two runs.
    pub fn in_force_at_rest(&self) -> InForce {
        InForce {
            modal: self.interpreter.modal_state(),
            path: self.path.clone(),
            change: self.in_force.clone(),
        }
    }

    /// Restores a state that was in force before. The machine rests at its current position.
    pub fn restore(&mut self, before: InForce, epoch: u32) {
        let at = self.path.position();
        self.restart(epoch, at, true);
        self.interpreter.restore(before.modal);
        self.path.restore_transform(at, &before.path);
        self.in_force = StateAfterSegment {
            after_segment: self.planner.last_segment(),
            ..before.change
        };
        self.last = self.in_force.clone();
    }

    /// Begins in the state at a line. The caller must call [`Pipeline::enter`] before the first block.
    pub fn start_from(&mut self, entry: LineEntry, epoch: u32) -> LineArrival {
        let LineEntry { interpreter, arrival } = entry;
        self.restart(epoch, self.path.position(), false);
        self.in_force = StateAfterSegment {
            after_segment: self.next_segment() - 1,
            modal: interpreter.modal().clone(),
            transform: *arrival.path.transform(),
            stack: callers(&interpreter).collect(),
        };
        self.last = self.in_force.clone();
        self.interpreter = interpreter;
        arrival
    }

    /// Plans the approach to the start of the line, and lets the next block start there.
    ///
    /// # Errors
    /// Returns an error if the approach cannot be planned.
    pub fn enter(&mut self, arrival: LineArrival) -> Result<(), Alarm> {
        let mut from = self.path.position();
        let is_dry_run = self.path.is_dry_run();
        for step in arrival.approach_from(from) {
            self.segments.push(Segment {
                origin: arrival.target,
                motion: SegmentMotion::Rapid {
                    from: from.0,
                    to: step.0,
                },
                end: SegmentEnd::ExactStop,
                multi_block: MultiBlock::Off,
                serial: 0,
            });
            self.notes.block_at(self.next_segment());
            self.plan(Ok(()))?;
            from = step;
        }
        self.end_chain();
        self.path = arrival.path;
        self.path.set_dry_run(is_dry_run);
        Ok(())
    }

    /// Discards all prepared motion. The machine rests at `at`, and later profiles carry `epoch`. The transform ends,
    /// or is kept with `goes_on`.
    pub fn restart(&mut self, epoch: u32, at: MachinePosition, goes_on: bool) {
        self.ready.clear();
        self.set_aside.clear();
        self.segments.clear();
        self.notes.clear();
        self.last = self.in_force.clone();
        self.noted_step = None;
        self.in_thread = false;
        self.planner.restart(epoch);
        if goes_on {
            self.path.skipped_to(at);
        } else {
            self.path.restart(at);
        }
    }

    /// Replaces the planned motion by a new plan. The caller must not have sent any motion to the servo since the plan
    /// was made.
    pub fn adopt(&mut self, mut new: Replan) {
        self.ready = std::mem::take(&mut new.profiles);
        self.planner.adopt(new);
    }

    /// Plans a motion by hand: each motor moves independently to its machine position, with the rapid limits in
    /// `settings`.
    pub fn jog(&mut self, settings: &CoordinateSystemSettings, to: AxisVector) -> Result<(), Alarm> {
        let from = self.path.position().0;
        let segment = Segment {
            origin: Origin::default(),
            motion: SegmentMotion::Rapid { from, to },
            end: SegmentEnd::ExactStop,
            multi_block: MultiBlock::Off,
            serial: 0,
        };
        let own = self.planner.settings().clone();
        self.planner.set_settings(settings);
        self.notes.block_at(self.next_segment());
        let pushed = self.planner.push(&segment, &mut self.ready);
        self.planner.set_settings(&own);
        self.path.skipped_to(MachinePosition(to));
        pushed
    }
}

/// Returns the program and line of each nested call that is active.
pub(crate) fn callers(interpreter: &Interpreter) -> impl Iterator<Item = CallSite> {
    let depth = interpreter.call_stack().count();
    interpreter
        .call_stack()
        .take(depth.saturating_sub(1))
        .map(|origin| CallSite {
            program: origin.program,
            line: origin.line,
        })
}

fn report_segment(
    (on_plan, settings): &(OnPlan, Box<CoordinateSystemSettings>),
    number: u64,
    segment: &Segment,
) {
    let speed_limit = match &segment.motion {
        SegmentMotion::Feed { path, feed } => speed_limit(settings, path, *feed).ok(),
        _ => None,
    };
    let planned = PlannedMotion::Segment {
        number,
        segment,
        speed_limit,
    };
    on_plan.call(settings.number, planned);
}

fn report_profiles<'a>(
    (on_plan, settings): &(OnPlan, Box<CoordinateSystemSettings>),
    profiles: impl Iterator<Item = &'a Profile>,
) {
    profiles.for_each(|profile| on_plan.call(settings.number, PlannedMotion::Profile(profile)));
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use tandem_config::Config;
    use tandem_model::settings::Tool;
    use tandem_model::{AXES_MAX, Variables};
    use tandem_syntax::{Grammar, parse};

    use super::*;

    /// Runs a test with a pipeline of the demo's mill before the first block of a program. The machine rests at zero.
    fn with_program(text: &str, test: impl FnOnce(&mut Pipeline, &Inputs<'_>)) {
        let machine = Config::demo().resolve().unwrap();
        let system = &machine.coordinate_systems[0];
        let (program, found) = parse(text, Grammar::nj());
        assert_eq!(found, []);
        let mut pipeline = Pipeline::new(&system.settings, system.dialect, MachinePosition::default());
        pipeline.start(Arc::new(program), 1, 0, false);
        let inputs = Inputs {
            programs: &BTreeMap::new(),
            optional_skip: 0,
            work_offsets: &system.work_offsets,
            variables: &Variables::default(),
            tool: Some(Tool::default()),
            tools: &BTreeMap::new(),
            captured: Some([0.0; AXES_MAX]),
            position: Some(AxisVector::ZERO),
        };
        test(&mut pipeline, &inputs);
    }

    #[test]
    fn nothing_moves_behind_a_segment_that_cannot_be_planned() {
        // the second line would take more than 1e9 s; the third line must not be planned as if the second were a stop
        let text = "G90 G01 X10 F3000\nX100 F0.0000001\nX150 F3000\nM30\n";
        with_program(text, |pipeline, inputs| {
            let alarm = loop {
                match pipeline.next(inputs) {
                    Ok(Item::End(_)) => panic!("no alarm"),
                    Ok(_) => {}
                    Err(alarm) => break alarm,
                }
            };
            assert_eq!(alarm.origin.map(|origin| origin.line), Some(2));
            pipeline.finish().unwrap();
            let lines: Vec<u32> = pipeline.ready.iter().map(|profile| profile.origin.line).collect();
            assert_eq!(lines, [1]);
        });
    }

    /// Returns the first segment for which the condition holds, as reported to watchers after the whole program is
    /// planned.
    fn in_force_from(text: &str, is_it: impl Fn(&StateAfterSegment) -> bool) -> Option<u64> {
        let mut found = None;
        with_program(text, |pipeline, inputs| {
            while !matches!(pipeline.next(inputs).unwrap(), Item::End(_)) {}
            pipeline.finish().unwrap();
            let first = pipeline.notes.changes().find(|change| is_it(change));
            found = first.map(|change| change.after_segment + 1);
        });
        found
    }

    fn has_offset(change: &StateAfterSegment) -> bool {
        change.transform.work_offset != AxisVector::ZERO
    }

    #[test]
    fn modal_state_changes_with_the_moving_block_despite_a_held_segment() {
        let text = "G90 G01 X10 F3000\nY10 F6000\nG54 G00 Z5\nM30\n";
        let feedrate_is =
            |f: f64| move |change: &StateAfterSegment| (change.modal.feedrate_mm_min - f).abs() < 1e-9;
        assert_eq!(in_force_from(text, feedrate_is(3000.0)), Some(1));
        assert_eq!(in_force_from(text, feedrate_is(6000.0)), Some(2));
        let rapid = |change: &StateAfterSegment| change.modal.groups().any(|group| group == ("01", "G00"));
        assert_eq!(in_force_from(text, rapid), Some(3));
        assert_eq!(in_force_from(text, has_offset), Some(3));
    }

    #[test]
    fn non_moving_modal_changes_take_the_memory_of_one_change() {
        let text = "G01 X10 F3000\nP1 = 1\nwhile (P1 < 1000) {\nG90 F100\nG91 F[P1]\nG54\nG55\nP1 = P1 + 1\n}\nX20\nM30\n";
        with_program(text, |pipeline, inputs| {
            let mut most = 0;
            while !matches!(pipeline.next(inputs).unwrap(), Item::End(_)) {
                most = most.max(pipeline.notes.changes().count());
            }
            assert_eq!(most, 2, "one for each segment");
            let last = pipeline.notes.changes().last().unwrap();
            assert!((last.modal.feedrate_mm_min - 999.0).abs() < 1e-9, "the newest");
        });
    }

    #[test]
    fn changes_prepared_by_a_stopped_run_are_reported_again_by_the_next_run() {
        with_program("G90 G01 X10 F3000\nX20\nM30\n", |pipeline, inputs| {
            for _ in 0..2 {
                pipeline.next(inputs).unwrap();
                let feedrates = pipeline
                    .notes
                    .changes()
                    .map(|change| change.modal.feedrate_mm_min);
                assert_eq!(feedrates.collect::<Vec<_>>(), [3000.0]);
                let (program, _) = parse("G90 G01 X10 F3000\nM30\n", Grammar::nj());
                pipeline.start(Arc::new(program), 1, 1, false);
                assert!(pipeline.in_force.modal.feedrate_mm_min < 3000.0);
            }
        });
    }

    #[test]
    fn m1c_g500_offset_is_in_force_from_the_next_block_without_chain_end() {
        let text = "G500 G90 G01 X10 F3000\nY10\nG54\nX20\nM30\n";
        assert_eq!(in_force_from(text, has_offset), Some(3));
    }
}
