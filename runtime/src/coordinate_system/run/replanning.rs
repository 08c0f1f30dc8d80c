//! Replans motion while it runs: for a feed override (G500), and for back trace.
//!
//! The servo changes to the new plan at a point ahead of the motion, or at rest. Until the servo has reported the
//! result, no further motion is prepared, because the old and the new plan must continue with the same block.

use std::collections::VecDeque;

use plc_protocol::types::request::{Refusal, RefusalCode};
use tandem_model::profile::PathPlace;
use tandem_model::settings::LowOverride;
use tandem_motion::Replan;
use tandem_store::journal::Event;

use super::run_state::RunEvent;
use crate::coordinate_system::CoordinateSystem;

/// Time in s from the current motion to the start of a new plan: the duration of planning, with a reserve. The time is
/// doubled each time the servo refuses a plan.
const AHEAD_S: f64 = 0.1;

/// Upper limit in s of the doubled time.
const AHEAD_MAX_S: f64 = 5.0;

/// State of replanning: what the active plan was made for, and requests for new plans.
#[derive(Debug)]
pub(crate) struct Replanning {
    /// Feed override for which the active plan was made, as a factor.
    planned_for: f64,
    ahead_s: f64,
    /// Requests for a new plan that the servo has not answered, in order.
    splices: VecDeque<Splicing>,
    /// Position on the path at which a hold has last stopped the motion.
    held_at: Option<PathPlace>,
    /// True if single block was switched on while the servo had not answered.
    single_block: bool,
}

#[derive(Debug)]
enum Splicing {
    Override { new: Box<Replan>, factor: f64 },
    Turn,
}

impl Default for Replanning {
    fn default() -> Self {
        Self {
            planned_for: 1.0,
            ahead_s: AHEAD_S,
            splices: VecDeque::new(),
            held_at: None,
            single_block: false,
        }
    }
}

impl CoordinateSystem {
    /// Returns the feed override for which motion is planned, as a factor. With `override = "time_base"` it is at least
    /// 1: below, the servo scales the time of the plan. An override of 0 keeps the plan, on which the servo stops.
    fn planned_override(&self) -> f64 {
        let factor = self.inputs.overrides.feed / 100.0;
        match self.context.configured.settings.motion.low_override {
            LowOverride::TimeBase => factor.max(1.0),
            LowOverride::Replan if factor == 0.0 => self.replanning.planned_for,
            LowOverride::Replan => factor,
        }
    }

    /// If the feed override has changed, plans the motion in the servo's queue again, from a point ahead of the motion
    /// on.
    pub(crate) fn follow_override(&mut self) {
        let factor = self.planned_override();
        let before = self.replanning.planned_for;
        if factor.total_cmp(&before).is_eq() || self.is_replanning() {
            return;
        }
        self.pipeline.planner.set_feed_override(factor);
        let slew_s = self.context.configured.settings.override_slew_ms / 1000.0 * (before - factor).max(0.0);
        let ahead_s = self.replanning.ahead_s * before + slew_s * f64::midpoint(before, factor);
        let place = self
            .state
            .run()
            .and(self.servo.point_ahead(ahead_s, &self.pipeline));
        let new = place.map(|place| (place, self.pipeline.planner.replan(place, false)));
        match new.filter(|(_, new)| new.can_begin()) {
            Some((place, mut new)) => {
                self.servo.splice(Some(place), &mut new.profiles);
                let new = Box::new(new);
                self.replanning
                    .splices
                    .push_back(Splicing::Override { new, factor });
            }
            // The rest of the old plan is too short to replace; the factor applies to motion planned from now on.
            None => self.replanning.planned_for = factor,
        }
    }

    /// Returns true while no motion may be prepared: the servo has not answered, the motion goes back, or the run is
    /// ending.
    pub(crate) fn is_replanning(&self) -> bool {
        !self.replanning.splices.is_empty() || self.state.retraces() || self.state.is_ending()
    }

    /// Passes profiles that are ready to the servo while preparation is suspended.
    pub(crate) fn hand_over(&mut self) {
        let turns = |splicing: &Splicing| matches!(splicing, Splicing::Turn);
        if !self.replanning.splices.iter().any(turns) {
            self.servo.hand_over_profiles(&mut self.pipeline.ready);
        }
    }

    /// Processes the servo's answer to a new plan: it has changed to the plan (`taken`), or refused it.
    pub(crate) fn on_spliced(&mut self, taken: bool) {
        self.servo.on_spliced(taken);
        match self.replanning.splices.pop_front() {
            Some(Splicing::Override { new, factor }) if taken => {
                self.replanning.ahead_s = AHEAD_S;
                self.replanning.planned_for = factor;
                if self.state.has_run() {
                    self.pipeline.adopt(*new);
                    self.pipeline.planner.set_feed_override(self.planned_override());
                }
            }
            Some(Splicing::Override { .. }) => {
                self.replanning.ahead_s = (2.0 * self.replanning.ahead_s).min(AHEAD_MAX_S);
            }
            Some(Splicing::Turn) | None => {}
        }
        if !self.is_replanning() && std::mem::take(&mut self.replanning.single_block) {
            self.stop_behind_what_is_planned();
        }
    }

    /// Notes that single block was switched on. Returns true if single block must wait for the servo's answer.
    pub(crate) fn single_block_waits(&mut self) -> bool {
        self.replanning.single_block = self.is_replanning();
        self.replanning.single_block
    }

    pub(crate) fn note_held_at(&mut self, at: PathPlace) {
        self.replanning.held_at = Some(at);
    }

    pub(crate) fn check_back_trace(&self, on: bool) -> Result<(), Refusal> {
        let refused = |text: &str| Err(Refusal::new(RefusalCode::NotAllowed, text));
        if !on {
            return if self.state.retraces() {
                Ok(())
            } else {
                refused("back trace is not on; resume continues the program")
            };
        }
        let has_way_back = self
            .replanning
            .held_at
            .is_some_and(|at| self.pipeline.planner.can_retrace(at));
        if !has_way_back {
            return refused(
                "back trace cannot go back from here: it follows only motion with G500, and does not pass \
                 an M code that \
                 the program waited for, a tool change, G31, a thread, or the oldest stored block",
            );
        }
        Ok(())
    }

    /// Starts a back trace: moves back along the path that the tool has travelled.
    pub(crate) fn go_back(&mut self) {
        let at = self.replanning.held_at;
        let back = at.map(|at| self.pipeline.planner.retrace(at)).unwrap_or_default();
        let Some(last) = back.back().map(|last| last.segment) else {
            let text = "a back trace was accepted, but no backward motion is possible";
            return self.context.report_inconsistency(text);
        };
        self.pipeline.ready = back;
        self.turn_round();
        self.drive(RunEvent::BackTrace { to: last });
        self.context.record(Event::BackTrace { on: true });
    }

    /// Ends a back trace: continues the program forward from the current position.
    pub(crate) fn go_forward(&mut self) {
        let Some(at) = self.replanning.held_at else {
            let text = "a back trace ends, but its position is unknown";
            return self.context.report_inconsistency(text);
        };
        self.pipeline.planner.set_feed_override(self.planned_override());
        self.replanning.planned_for = self.planned_override();
        let new = self.pipeline.planner.replan(at, true);
        self.servo.finished_segment = new.passed;
        self.pipeline.adopt(new);
        self.turn_round();
        self.context.record(Event::BackTrace { on: false });
    }

    fn turn_round(&mut self) {
        self.servo.splice(None, &mut self.pipeline.ready);
        self.replanning.splices.push_back(Splicing::Turn);
    }
}
