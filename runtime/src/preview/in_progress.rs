//! Guard for a plan while it is being made.

use std::sync::Arc;
use std::time::Instant;

use plc_protocol::types::CoordinateSystemNumber;

use super::Inner;
use super::plan::Plan;
use super::slots::{PlanOrder, PlanUse};

/// A plan that is being made. Dropping this value, also after a panic, ends the planning. An incomplete plan
/// is then discarded, so the program is planned again.
pub(super) struct PlanInProgress<'a> {
    inner: &'a Inner,
    cs: CoordinateSystemNumber,
    which: PlanUse,
    plan: &'a Arc<Plan>,
    began: Instant,
}

impl<'a> PlanInProgress<'a> {
    pub fn new(
        inner: &'a Inner,
        cs: CoordinateSystemNumber,
        (which, order): (PlanUse, &PlanOrder),
        plan: &'a Arc<Plan>,
    ) -> Self {
        let mut all = inner.slots.lock();
        all.entry(cs).or_default().begin_plan(which, order, plan);
        drop(all);
        Self {
            inner,
            cs,
            which,
            plan,
            began: Instant::now(),
        }
    }
}

impl Drop for PlanInProgress<'_> {
    fn drop(&mut self) {
        let mut all = self.inner.slots.lock();
        let slots = all.entry(self.cs).or_default();
        slots.end_plan(self.which, self.plan, self.began.elapsed());
    }
}
