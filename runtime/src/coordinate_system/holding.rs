//! What interrupts a run and lets it go on: feed hold, the interlock, single block, a lost broker (`bus`).
//!
//! Single block ends each block with its own stop. Blocks that were planned ahead when it is switched on keep their
//! path: each is passed and held at its end point where it stops there, else right behind its joint, on the path.

use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::state::{Execution, Lock, Reason};
use tandem_interp::Modal;
use tandem_model::alarm::COMPENSATION_REFUSED;
use tandem_servo::Control;

use super::CoordinateSystem;
use super::preparation::{Phase, Then};
use crate::journal::Event;

/// Whether the motion of a run is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Held {
    No,
    /// Decelerating on the path.
    Holding(Cause),
    AtRest(Cause),
}

/// What holds a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    /// The hold command.
    Operator,
    SingleBlock,
    Interlock,
    /// The connection to the MQTT broker is lost.
    BusLoss,
    /// Back trace has come to its end.
    WayBackEnded,
}

impl Cause {
    /// The state word at rest, and its reason.
    pub fn state(self) -> (Execution, Option<Reason>) {
        match self {
            Cause::Operator => (Execution::FeedHold, None),
            Cause::SingleBlock => (Execution::Interrupted, Some(Reason::SingleBlock)),
            Cause::BusLoss => (Execution::FeedHold, Some(Reason::BusLost)),
            Cause::Interlock => (Execution::Interrupted, Some(Reason::Interlock)),
            Cause::WayBackEnded => (Execution::FeedHold, Some(Reason::BackTraceEnd)),
        }
    }
}

/// Single block of one run.
#[derive(Debug, Default)]
pub(super) struct Steps {
    /// Items of a block have been taken, and the block has not ended.
    pub in_block: bool,
    /// Segments up to this one were planned before single block was switched on.
    planned_ahead: u64,
    /// The servo is told to hold behind the running block, and has not said that it does.
    armed: bool,
}

impl CoordinateSystem {
    /// Feed hold. True when there is nothing to wait for: no run, or it rests.
    pub(super) fn hold(&mut self, cause: Cause) -> bool {
        let Some(run) = &mut self.run else { return true };
        if matches!(run.phase, Phase::Paused(_)) || matches!(run.held, Held::AtRest(_)) {
            return true;
        }
        if run.held == Held::No {
            run.held = Held::Holding(cause);
            self.servo.control(Control::Hold);
        }
        false
    }

    pub(super) fn resume(&mut self) {
        self.go_forward();
        let Some(run) = &mut self.run else { return };
        if let Phase::Paused(_) = run.phase {
            run.phase = Phase::Interpret;
            run.steps.in_block = false;
        } else {
            run.held = Held::No;
            self.servo.control(Control::Resume);
            self.put_out_queued();
            self.hold_after_planned_block();
        }
        self.shared.record(self.number, Event::Resume);
    }

    /// The servo has come to rest under feed hold.
    pub(super) fn held(&mut self) {
        let Some(run) = &mut self.run else { return };
        match run.held {
            Held::Holding(cause) => run.held = Held::AtRest(cause),
            Held::AtRest(_) => {}
            Held::No if run.steps.armed => run.held = Held::AtRest(Cause::SingleBlock),
            // Single block was switched off when the hold behind the block had begun.
            Held::No => self.servo.control(Control::Resume),
        }
        run.steps.armed = false;
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
            let within = if self.pipeline.is_anywhere(Modal::compensates) {
                Some("cutter compensation")
            } else if self.pipeline.is_anywhere(Modal::in_fixed_cycle) {
                Some("a tapping cycle")
            } else {
                None
            };
            if let Some(within) = within {
                let text = format!(
                    "single block cannot be switched on within {within}, nor before one that is already read; wait \
                     for its end"
                );
                return Err(Refusal::new(RefusalCode::NotAllowed, text));
            }
        }
        self.inputs.single_block = on;
        if on && self.single_block_waits() {
            return Ok(());
        }
        if on {
            self.stop_behind_what_is_planned();
        } else if let Some(run) = &mut self.run
            && std::mem::take(&mut run.steps.armed)
        {
            self.servo.control(Control::HoldAfterBlock(false));
        }
        Ok(())
    }

    /// What is planned ends at rest, and each of its blocks is held at its end; the interpreter waits.
    pub(super) fn stop_behind_what_is_planned(&mut self) {
        let Some(run) = &self.run else { return };
        match run.phase {
            Phase::Interpret => self.stand_still_then(Then::Interpret),
            Phase::Standstill(Then::BlockEnd) => return,
            _ => {}
        }
        let moves = self.is_moving();
        if let Some(run) = &mut self.run
            && moves
        {
            run.steps.planned_ahead = self.pipeline.last_segment();
            run.steps.in_block = !self.pipeline.interpreter.is_between_blocks();
            if run.held == Held::No {
                self.hold_after_planned_block();
            }
        }
    }

    /// What was interpreted before single block was switched on, and is planned only now, is held as well.
    pub(super) fn plan_ahead_of_single_block(&mut self) {
        if let Some(run) = &mut self.run
            && self.inputs.single_block
        {
            run.steps.planned_ahead = self.pipeline.last_segment();
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
        !self.pipeline.ready.is_empty() || self.servo.finished_segment < self.pipeline.last_segment()
    }

    /// At a standstill: the block that was to be held behind has ended, whatever the servo has told so far. True when
    /// the run is interrupted by that.
    pub(super) fn planned_block_ended(&mut self) -> bool {
        let Some(run) = &mut self.run else { return false };
        if !std::mem::take(&mut run.steps.armed) {
            return false;
        }
        run.held = Held::AtRest(Cause::SingleBlock);
        self.servo.control(Control::HoldAfterBlock(false));
        true
    }

    /// A block has ended with its own stop.
    pub(super) fn block_ended(&mut self) {
        if !self.inputs.single_block {
            return;
        }
        // behind M98 the program that it calls has not begun
        let begun = self.pipeline.interpreter.call_stack();
        let origin = begun.filter(|at| at.line > 0).last();
        if let Some(origin) = origin {
            self.view.update(|place| place.executing = origin);
        }
        if self.pipeline.interpreter.modal().compensates() {
            let text = "single block is on, and cutter compensation cannot be stopped between blocks";
            return self.raise_entry(&COMPENSATION_REFUSED, text, origin);
        }
        if let Some(run) = &mut self.run {
            run.held = Held::AtRest(Cause::SingleBlock);
        }
        let event = Event::Stop {
            m: None,
            reason: origin.map(|_| Reason::SingleBlock),
            program: origin.map(|at| at.program),
            line: origin.map(|at| at.line),
        };
        self.shared.record(self.number, event);
    }
}
