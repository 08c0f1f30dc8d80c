//! What interrupts a run and lets it continue: feed hold, the interlock, single block, a lost broker (`bus`).
//!
//! Single block ends each block with its own stop. Blocks that were planned ahead when it is switched on keep their
//! path: each is passed and held at its end point where it stops there, else right behind its joint, on the path.

use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::state::{Lock, Reason, Transition};
use tandem_interp::Modal;
use tandem_model::alarm::COMPENSATION_REFUSED;
use tandem_servo::Control;

use super::CoordinateSystem;
use super::run_state::{Cause, Phase, RunEvent, Then};
use crate::journal::Event;

impl CoordinateSystem {
    /// Feed hold. True when there is nothing to wait for: no run, or it rests.
    pub(super) fn hold(&mut self, cause: Cause) -> bool {
        self.drive(RunEvent::Hold(cause));
        self.state.transition() != Some(Transition::Holding)
    }

    /// The run continues after a hold: what the hold kept back is done.
    pub(super) fn go_on(&mut self) {
        self.put_out_queued();
        self.hold_after_planned_block();
    }

    /// The servo has come to rest under feed hold.
    pub(super) fn on_servo_held(&mut self) {
        let steps = self.run.as_mut().map(|run| &mut run.steps);
        let behind_block = steps.is_some_and(|steps| std::mem::take(&mut steps.armed));
        self.drive(RunEvent::ServoHeld { behind_block });
    }

    pub(super) fn set_interlock(&mut self, lock: Lock) {
        self.inputs.interlock = lock;
        if self.inputs.interlock.value {
            self.hold(Cause::Interlock);
        }
    }

    /// Refuses what would move while the interlock is on.
    pub(super) fn judge_interlock(&self) -> Result<(), Refusal> {
        if !self.inputs.interlock.value {
            return Ok(());
        }
        let why = &self.inputs.interlock.text;
        let text = format!("the interlock is on: {why}");
        Err(Refusal::new(RefusalCode::StartLocked, text))
    }

    pub(super) fn set_single_block(&mut self, on: bool) -> Result<(), Refusal> {
        if on == self.inputs.single_block {
            return Ok(());
        }
        if on && self.run.is_some() {
            let compensates = |modal: &Modal| modal.compensates().then_some("cutter compensation");
            let cycles = |modal: &Modal| modal.fixed_cycle().map(|cycle| cycle.name);
            let within = self.pipeline.anywhere(compensates);
            if let Some(within) = within.or_else(|| self.pipeline.anywhere(cycles)) {
                let text = format!(
                    "single block cannot be switched on within {within}, nor before one that is already read; wait \
                     for its end"
                );
                return Err(Refusal::new(RefusalCode::NotAllowed, text));
            }
        }
        self.inputs.single_block = on;
        if on {
            if !self.single_block_waits() {
                self.stop_behind_what_is_planned();
            }
        } else if let Some(run) = &mut self.run
            && std::mem::take(&mut run.steps.armed)
        {
            self.servo.control(Control::HoldAfterBlock(false));
        }
        Ok(())
    }

    /// What is planned ends at rest, and each of its blocks is held at its end; the interpreter waits.
    pub(super) fn stop_behind_what_is_planned(&mut self) {
        match self.state.phase() {
            None | Some(Phase::Standstill(Then::BlockEnd)) => return,
            Some(Phase::Interpret) => self.stand_still_then(Then::Interpret),
            Some(_) => {}
        }
        let moves = self.is_moving();
        if let Some(run) = &mut self.run
            && moves
        {
            run.steps.planned_ahead = self.pipeline.planner.last_segment();
            run.steps.in_block = !self.pipeline.interpreter.is_between_blocks();
            if self.state.is_running() {
                self.hold_after_planned_block();
            }
        }
    }

    /// What was interpreted before single block was switched on, and is planned only now, is held as well.
    pub(super) fn plan_ahead_of_single_block(&mut self) {
        if let Some(run) = &mut self.run
            && self.inputs.single_block
        {
            run.steps.planned_ahead = self.pipeline.planner.last_segment();
        }
    }

    fn hold_after_planned_block(&mut self) {
        let Some(run) = &mut self.run else { return };
        if self.inputs.single_block && self.servo.finished_segment < run.steps.planned_ahead {
            run.steps.armed = true;
            self.servo.control(Control::HoldAfterBlock(true));
        }
    }

    /// True while something that was planned has not been moved to its end.
    pub(super) fn is_moving(&self) -> bool {
        !self.pipeline.ready.is_empty() || self.servo.finished_segment < self.pipeline.planner.last_segment()
    }

    /// At a standstill: the block that was to be held behind has ended, whatever the servo has reported so far. True when
    /// the run is interrupted by that.
    pub(super) fn end_planned_block(&mut self) -> bool {
        let Some(run) = &mut self.run else { return false };
        if !std::mem::take(&mut run.steps.armed) {
            return false;
        }
        self.drive(RunEvent::BlockEnded);
        self.servo.control(Control::HoldAfterBlock(false));
        true
    }

    /// A block has ended with its own stop.
    pub(super) fn on_block_ended(&mut self) {
        if !self.inputs.single_block {
            return;
        }
        // behind M98 the program that it calls has not begun
        let begun = self.pipeline.interpreter.call_stack();
        let origin = begun.filter(|at| at.line > 0).last();
        if let Some(origin) = origin {
            self.context.view.update(|place| place.executing = origin);
        }
        if self.pipeline.interpreter.modal().compensates() {
            let text = "single block is on, and cutter compensation cannot be stopped between blocks";
            return self.raise_entry(&COMPENSATION_REFUSED, text, origin);
        }
        self.drive(RunEvent::BlockEnded);
        let event = Event::Stop {
            m: None,
            reason: origin.map(|_| Reason::SingleBlock),
            program: origin.map(|at| at.program),
            line: origin.map(|at| at.line),
        };
        self.context.record(event);
    }
}
