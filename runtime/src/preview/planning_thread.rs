//! Work of the thread that plans: orders missing plans, makes them one after the other, and stops those that are no
//! longer useful.

use std::sync::Arc;
use std::time::Duration;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::planned::RehearsalOutcome;
use plc_protocol::types::start::{StartObstacle, StartObstacleKind};
use tandem_store::program_store::StoredProgram;

use super::in_progress::PlanInProgress;
use super::plan::Plan;
use super::slots::{PlanOrder, PlanUse, Slots};
use super::{Inner, PlannedSystem, THREAD, is_running, planning};
use crate::coordinate_system::{Conditions, Prediction, state_of};

/// Interval at which the thread checks for changes.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// Pause before a plan for changed conditions, as a multiple of the duration of the last planning.
const PAUSE_FACTOR: u32 = 2;

impl Inner {
    /// Makes the plan in the requesting thread if it does not exist.
    pub(super) fn make_if_needed(&self, cs: CoordinateSystemNumber, program: &Arc<StoredProgram>) {
        if self.look(cs, program).is_none() {
            while let Some((system, which, order)) = self.next() {
                self.make(system, which, &order);
            }
        }
    }

    pub(super) fn work(&self) {
        while !self.is_closing() {
            self.shared.supervisor.fault_point(THREAD);
            self.want_loaded();
            if let Some((system, which, order)) = self.next() {
                self.make(system, which, &order);
                continue;
            }
            let mut slots = self.slots.lock();
            if !self.is_closing() {
                self.work.wait_for(&mut slots, LOOK_INTERVAL);
            }
        }
    }

    /// Orders missing plans for runs and loaded programs, and plans for changed conditions.
    fn want_loaded(&self) {
        for (configured, view) in &self.systems {
            let cs = configured.settings.number;
            if let Some(run) = view.run() {
                self.look_at_run(cs, run);
                continue;
            }
            if let Some(slots) = self.slots.lock().get_mut(&cs) {
                slots.end_run();
            }
            let Some(state) = state_of(&self.shared, cs) else {
                continue;
            };
            let program = state.program.and_then(|number| self.shared.store.get(number));
            let Some(program) = program.filter(|_| !is_running(&state)) else {
                continue;
            };
            if self.validate_program(cs, &program).is_err() {
                continue;
            }
            let slots = self.slots.lock();
            let pauses = slots
                .get(&cs)
                .is_some_and(|slots| slots.pauses(program.number, PAUSE_FACTOR));
            drop(slots);
            if !pauses {
                let found = self.look(cs, &program);
                self.predict(cs, found.map(|found| found.plan).as_deref());
            }
        }
    }

    /// Returns the next order for a plan.
    fn next(&self) -> Option<(&PlannedSystem, PlanUse, PlanOrder)> {
        let mut all = self.slots.lock();
        PlanUse::ALL.into_iter().find_map(|which| {
            self.systems.iter().find_map(|system| {
                let slots = all.get_mut(&system.0.settings.number)?;
                Some((system, which, slots.wanted(which)?))
            })
        })
    }

    fn make(&self, (configured, view): &PlannedSystem, which: PlanUse, order: &PlanOrder) {
        let conditions = match order {
            PlanOrder::Program(program) => {
                let program = Arc::clone(program);
                Arc::new(Conditions::now(&self.shared, view, configured, program))
            }
            PlanOrder::Run(run) => Arc::clone(&run.conditions),
        };
        let (cs, number) = (configured.settings.number, conditions.main.number);
        let plan = Arc::new(Plan::new(conditions));
        let in_progress = PlanInProgress::new(self, cs, (which, order), &plan);
        let is_wanted = || {
            self.shared.supervisor.fault_point(THREAD);
            !self.is_closing() && self.is_wanted(cs, which, number, &plan)
        };
        let on_change = || self.changes.send_modify(|count| *count += 1);
        planning::plan(&self.shared, &plan, &is_wanted, &on_change);
        drop(in_progress);
        if which == PlanUse::Loaded {
            self.predict(cs, Some(&plan));
        }
        on_change();
    }

    /// Records the alarm with which the plan of the loaded program ends, if it ends with an alarm.
    fn predict(&self, cs: CoordinateSystemNumber, plan: Option<&Plan>) {
        let prediction = plan.and_then(|plan| {
            let content = plan.content();
            (content.outcome == RehearsalOutcome::Alarm).then(|| Prediction {
                hash: plan.conditions.main.checksum().to_owned(),
                obstacle: StartObstacle {
                    refuses: false,
                    at: content.at,
                    detail: content.text.clone(),
                    ..StartObstacle::refusing(
                        StartObstacleKind::Prediction,
                        format!("the rehearsal ends in an alarm: {}", content.text),
                    )
                },
            })
        });
        let is_new = self.system(cs).is_some_and(|(_, view)| view.predict(prediction));
        if is_new {
            self.shared.wake_all();
        }
    }

    /// Returns false if a plan in progress is no longer useful, or if a run waits for the planning thread.
    fn is_wanted(&self, cs: CoordinateSystemNumber, which: PlanUse, number: u16, plan: &Plan) -> bool {
        let run = self.system(cs).and_then(|(_, view)| view.run());
        if let Some(run) = run.filter(|run| run.conditions.main.number == number) {
            return plan.matches(&run.conditions);
        }
        let loaded = state_of(&self.shared, cs).and_then(|state| state.program);
        let waits = |slots: &Slots| slots.is_run_waiting();
        match which {
            PlanUse::Running => false,
            PlanUse::Loaded => loaded == Some(number),
            PlanUse::Asked => loaded != Some(number) && !self.slots.lock().values().any(waits),
        }
    }
}
