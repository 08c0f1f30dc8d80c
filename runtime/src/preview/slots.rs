//! The plans of a coordinate system, and the selection of the plan that a request or a run uses.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tandem_store::program_store::StoredProgram;

use super::plan::Plan;
use crate::coordinate_system::{Conditions, RunStart};

/// The plans of a coordinate system, one for each use.
#[derive(Debug, Default)]
pub(super) struct Slots {
    /// Plan of the run in progress.
    running: PlanSlot,
    /// Plan of the loaded program.
    loaded: PlanSlot,
    /// Plan of the last requested program that is not loaded.
    asked: PlanSlot,
}

/// Use of a plan in a coordinate system: by the run, for the loaded program, or for a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlanUse {
    Running,
    Loaded,
    Asked,
}

impl PlanUse {
    /// All uses in the order in which their plans are made.
    pub const ALL: [PlanUse; 3] = [PlanUse::Running, PlanUse::Loaded, PlanUse::Asked];
}

/// Order for a plan.
#[derive(Debug, Clone)]
pub(super) enum PlanOrder {
    /// Plan a program with the conditions at the time when planning begins.
    Program(Arc<StoredProgram>),
    /// Plan a run with the conditions at its start.
    Run(Arc<RunStart>),
}

impl PlanOrder {
    fn is(&self, other: &Self) -> bool {
        match (self, other) {
            (PlanOrder::Program(one), PlanOrder::Program(other)) => Arc::ptr_eq(one, other),
            (PlanOrder::Run(one), PlanOrder::Run(other)) => Arc::ptr_eq(one, other),
            _ => false,
        }
    }
}

#[derive(Debug, Default)]
struct PlanSlot {
    plan: Option<Arc<Plan>>,
    /// Order for a plan that has not begun. It remains until planning begins, so that a request meanwhile does
    /// not order the plan again.
    wanted: Option<PlanOrder>,
    /// Duration of the last planning, and the time when it ended.
    took: Option<(Duration, Instant)>,
}

impl PlanSlot {
    /// Orders a plan; returns true if this plan was not ordered yet.
    fn want(&mut self, wanted: PlanOrder) -> bool {
        if self.wanted.as_ref().is_some_and(|known| known.is(&wanted)) {
            return false;
        }
        self.clear();
        self.wanted = Some(wanted);
        true
    }

    fn clear(&mut self) {
        if let Some(plan) = self.plan.take() {
            plan.cancel();
        }
        self.wanted = None;
    }
}

impl Slots {
    fn slot_mut(&mut self, which: PlanUse) -> &mut PlanSlot {
        match which {
            PlanUse::Running => &mut self.running,
            PlanUse::Loaded => &mut self.loaded,
            PlanUse::Asked => &mut self.asked,
        }
    }

    /// Returns the plan of a run: made for this run, or made earlier with the same conditions. If no such
    /// plan exists, returns `None`, and `true` if the plan was not ordered before.
    pub fn plan_of_run(&mut self, run: &Arc<RunStart>) -> (Option<Arc<Plan>>, bool) {
        let plans = [self.running.plan.clone(), self.loaded.plan.clone()];
        let mut plans = plans.into_iter().flatten();
        if let Some(plan) = plans.find(|plan| plan.matches(&run.conditions)) {
            self.running.plan = Some(Arc::clone(&plan));
            self.running.wanted = None;
            return (Some(plan), false);
        }
        (None, self.running.want(PlanOrder::Run(Arc::clone(run))))
    }

    /// Returns the plan of a program for the conditions `now`. During manual motion, accepts a plan of an
    /// earlier position. If no such plan exists, returns `None`, and `true` if the plan was not ordered
    /// before.
    pub fn plan_of_program(
        &mut self,
        which: PlanUse,
        program: &Arc<StoredProgram>,
        now: &Conditions,
        is_moving: bool,
    ) -> (Option<Arc<Plan>>, bool) {
        let is_same = |plan: &&Arc<Plan>| plan.matches(now) || is_moving && plan.matches_but_position(now);
        let slot = self.slot_mut(which);
        if let Some(plan) = slot.plan.as_ref().filter(is_same) {
            return (Some(Arc::clone(plan)), false);
        }
        (None, slot.want(PlanOrder::Program(Arc::clone(program))))
    }

    /// Drops the plan of the ended run; if the loaded program uses the same plan, that use remains.
    pub fn end_run(&mut self) {
        self.running.wanted = None;
        let Some(plan) = self.running.plan.take() else {
            return;
        };
        if !self
            .loaded
            .plan
            .as_ref()
            .is_some_and(|kept| Arc::ptr_eq(kept, &plan))
        {
            plan.cancel();
        }
    }

    pub fn is_run_waiting(&self) -> bool {
        self.running.wanted.is_some()
    }

    /// Returns the order for a plan that has not begun.
    pub fn wanted(&mut self, which: PlanUse) -> Option<PlanOrder> {
        self.slot_mut(which).wanted.clone()
    }

    /// Records that planning for an order has begun.
    pub fn begin_plan(&mut self, which: PlanUse, order: &PlanOrder, plan: &Arc<Plan>) {
        let slot = self.slot_mut(which);
        slot.wanted.take_if(|wanted| wanted.is(order));
        slot.plan = Some(Arc::clone(plan));
    }

    /// Records that planning has ended; discards an incomplete plan.
    pub fn end_plan(&mut self, which: PlanUse, plan: &Arc<Plan>, took: Duration) {
        self.slot_mut(which).took = Some((took, Instant::now()));
        if plan.content().is_complete() {
            return;
        }
        for slot in [&mut self.running, &mut self.loaded, &mut self.asked] {
            slot.plan.take_if(|kept| Arc::ptr_eq(kept, plan));
        }
    }

    /// Returns true if the loaded program was planned so recently that planning for changed conditions must
    /// wait.
    pub fn pauses(&self, number: u16, factor: u32) -> bool {
        let plan = self.loaded.plan.as_ref();
        let is_of = plan.is_some_and(|plan| plan.conditions.main.number == number);
        let took = self.loaded.took.filter(|_| is_of);
        took.is_some_and(|(took, ended)| ended.elapsed() < took * factor)
    }

    /// Cancels all plans of the coordinate system.
    pub fn cancel(&self) {
        for slot in [&self.running, &self.loaded, &self.asked] {
            if let Some(plan) = &slot.plan {
                plan.cancel();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tandem_config::Config;

    use super::*;

    #[test]
    fn an_order_is_given_once_until_its_planning_begins() {
        let machine = Config::demo().resolve().unwrap();
        let program = Arc::new(StoredProgram::new(1, "M30\n", machine.text_rules()));
        let order = PlanOrder::Program(program);
        let mut slots = Slots::default();
        assert!(slots.slot_mut(PlanUse::Loaded).want(order.clone()));
        // the planning thread has seen the order, and collects the conditions
        let seen = slots.wanted(PlanUse::Loaded);
        assert!(seen.is_some_and(|seen| seen.is(&order)));
        assert!(!slots.slot_mut(PlanUse::Loaded).want(order));
    }
}
