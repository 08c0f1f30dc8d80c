//! Plans a program before it runs: its path and its rehearsal. A thread of low priority uses the stages of a
//! run for this. The servo and its tasks do not depend on this thread, and it reads only data that all
//! threads may read.
//!
//! The loaded program of each coordinate system is planned automatically, and again when an input of its plan
//! changes. A run uses the plan for the conditions at its start: an existing plan if its conditions are
//! equal, otherwise a new plan, which is made during the run. Other programs are planned on request.

mod bytes;
mod chunk;
mod in_progress;
mod path_simplifier;
mod plan;
mod planning;
mod planning_thread;
mod rehearsed;
mod slots;
mod spindle;
mod tracer;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use parking_lot::{Condvar, Mutex};
use plc_protocol::supervisor::Consequence;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::line_start::{LineStart, LineState};
use plc_protocol::types::message::Payload;
use plc_protocol::types::planned::{PathIdentity, PathQuery, PlannedPath, Rehearsal, RehearsedRun};
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::run::TimeLeft;
use plc_protocol::types::state::{Execution, Overrides, Reason, State};
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_config::ConfiguredSystem;
use tandem_model::Axis;
use tandem_store::program_store::StoredProgram;
use tokio::sync::watch;

use crate::coordinate_system::{Conditions, RunStart, View, line_search, state_of};
use crate::shared::SharedState;
use plan::{Plan, PlanContent, RunMoment};
use slots::{PlanUse, Slots};

/// Interval at which the time left of each run is published.
const TIME_LEFT_INTERVAL: Duration = Duration::from_secs(1);

/// Time that a request waits for a plan that has begun; the plan of a short program is then complete.
const PATIENCE: Duration = Duration::from_millis(500);

/// Time that a request waits for a plan that has not begun because the thread plans another program.
const TURN_MAX: Duration = Duration::from_secs(10);

/// Name of the planning thread.
const THREAD: &str = "preview";

/// Pause after a fault in the planning of a program. Reason: the thread plans the same program again.
const FAULT_PAUSE: Duration = Duration::from_secs(1);

/// If an M code takes longer than its usual time multiplied by this, plus `OVERDUE_S`, its end is unknown.
const OVERDUE_FACTOR: f64 = 2.0;
const OVERDUE_S: f64 = 1.0;

/// Plans of all coordinate systems.
#[derive(Debug)]
pub(crate) struct Previews {
    inner: Arc<Inner>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Inner {
    shared: Arc<SharedState>,
    systems: Vec<PlannedSystem>,
    slots: Mutex<BTreeMap<CoordinateSystemNumber, Slots>>,
    /// Wakes the planning thread.
    work: Condvar,
    closing: AtomicBool,
    /// Counts the changes of all plans.
    changes: watch::Sender<u64>,
}

/// Coordinate system whose programs are planned.
type PlannedSystem = (ConfiguredSystem, Arc<View>);

/// A plan, and the run in progress that uses it.
struct FoundPlan {
    plan: Arc<Plan>,
    run: Option<Arc<RunStart>>,
}

impl FoundPlan {
    fn identity(&self, content: &PlanContent) -> PathIdentity {
        PathIdentity {
            run_id: self.run.as_ref().map(|run| run.run_id.clone()),
            plan: self.plan.identity(content),
        }
    }
}

impl Previews {
    /// Creates the previews without a thread, for simulated time: the requesting thread makes each plan.
    pub fn on_demand(shared: &Arc<SharedState>, views: impl Iterator<Item = Arc<View>>) -> Self {
        let systems = shared.machine.coordinate_systems.iter().cloned().zip(views);
        let inner = Inner {
            shared: Arc::clone(shared),
            systems: systems.collect(),
            slots: Mutex::default(),
            work: Condvar::new(),
            closing: AtomicBool::new(false),
            changes: watch::Sender::new(0),
        };
        Self {
            inner: Arc::new(inner),
            thread: None,
        }
    }

    /// Starts a thread that makes the plans from now on. Without it, the requesting thread makes them.
    pub fn start_thread(&mut self) {
        let inner = Arc::clone(&self.inner);
        let work = move || {
            tandem_store::threads::lower_priority();
            while let Err(panicked) = catch_unwind(AssertUnwindSafe(|| inner.work())) {
                let supervisor = &inner.shared.supervisor;
                supervisor.report_panic(THREAD, Consequence::Restarted, panicked.as_ref());
                std::thread::sleep(FAULT_PAUSE);
            }
        };
        match std::thread::Builder::new().name(THREAD.into()).spawn(work) {
            Ok(thread) => self.thread = Some(thread),
            Err(error) => tracing::warn!(%error, "the thread that plans programs could not be started"),
        }
    }

    /// Returns the program with this number as a run in progress uses it; `None` without such a run.
    pub fn running(&self, number: u16, cs: Option<CoordinateSystemNumber>) -> Option<Arc<StoredProgram>> {
        let systems = self.inner.systems.iter();
        let mut asked = systems.filter(|(of, _)| cs.is_none_or(|cs| of.settings.number == cs));
        asked.find_map(|(_, view)| {
            let run = view.run()?;
            let main = &run.conditions.main;
            (main.number == number).then(|| Arc::clone(main))
        })
    }

    /// Returns the planned path of a program, up to the point that the planning has reached.
    ///
    /// # Errors
    /// Returns an error if the coordinate system does not exist, or cannot run the program.
    pub async fn path(&self, program: Arc<StoredProgram>, query: &PathQuery) -> Result<PlannedPath, Refusal> {
        let (cs, found) = self.plan(program, query.cs).await?;
        let content = found.plan.content();
        let identity = found.identity(&content);
        Ok(PlannedPath {
            tag: Plan::tag(&content, &identity),
            bytes: bytes::encode(&found.plan, &content, &identity, cs, query),
            run_id: identity.run_id,
            plan: identity.plan,
        })
    }

    /// Returns the rehearsal of a program, up to the point that the planning has reached.
    ///
    /// # Errors
    /// Returns an error in the same cases as [`Previews::path`].
    pub async fn rehearsal(
        &self,
        program: Arc<StoredProgram>,
        cs: Option<CoordinateSystemNumber>,
    ) -> Result<Rehearsal, Refusal> {
        let (cs, found) = self.plan(program, cs).await?;
        let content = found.plan.content();
        let mut rehearsal = rehearsed::rehearsal(&found.plan, &content, found.identity(&content));
        rehearsal.run = self.inner.run_now(cs, &found);
        Ok(rehearsal)
    }

    /// Publishes the time left of the active run of each coordinate system, once a second.
    pub fn run_time_left_publisher(&self) -> impl Future<Output = ()> + use<> {
        let supervisor = self.inner.shared.supervisor.clone();
        let inner = Arc::clone(&self.inner);
        supervisor.restarted("publisher of the time left", move || {
            Self::publish_time_left(Arc::clone(&inner))
        })
    }

    async fn publish_time_left(inner: Arc<Inner>) {
        let mut interval = tokio::time::interval(TIME_LEFT_INTERVAL);
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                () = inner.shared.closing.cancelled() => return,
                _ = interval.tick() => {}
            }
            for (configured, _) in &inner.systems {
                let cs = configured.settings.number;
                let time_left = Payload::TimeLeft(inner.time_left(cs));
                inner.shared.publish(Topic::cs(cs, CsTopic::TimeLeft), time_left);
            }
        }
    }

    /// Returns a function that computes the state in force at a line of the loaded program. This takes long,
    /// so the caller must run the function on a thread that may block.
    ///
    /// # Errors
    /// Returns an error if no program is loaded, or in the cases of [`line_entry`].
    pub fn line_state(
        &self,
        cs: CoordinateSystemNumber,
        from: LineStart,
    ) -> impl FnOnce() -> Result<LineState, Refusal> + Send + use<> {
        let inner = Arc::clone(&self.inner);
        move || {
            let state = state_of(&inner.shared, cs).unwrap_or_default();
            let program = state.program.and_then(|number| inner.shared.store.get(number));
            let none = "no program is loaded; load a program first";
            let program = program.ok_or_else(|| Refusal::new(RefusalCode::NotFound, none))?;
            inner.validate_program(cs, &program)?;
            let conditions = inner.conditions(cs, &program);
            let conditions = conditions.ok_or_else(|| Refusal::new(RefusalCode::NotFound, none))?;
            let entry = line_search::search(&inner.shared, &conditions, &from)?;
            Ok(line_search::line_state(&entry, &conditions))
        }
    }

    async fn plan(
        &self,
        program: Arc<StoredProgram>,
        cs: Option<CoordinateSystemNumber>,
    ) -> Result<(CoordinateSystemNumber, FoundPlan), Refusal> {
        let inner = &self.inner;
        let cs = cs.or_else(|| inner.where_loaded(program.number));
        let cs = cs.unwrap_or_else(|| inner.configured_for(program.number));
        inner.validate_program(cs, &program)?;
        if self.thread.is_none() {
            inner.make_if_needed(cs, &program);
        }
        let mut changes = inner.changes.subscribe();
        let begun = tokio::time::Instant::now();
        loop {
            let found = inner.look(cs, &program);
            let patience = match found {
                Some(found) if found.plan.content().is_complete() => return Ok((cs, found)),
                Some(_) => PATIENCE,
                None => TURN_MAX,
            };
            let left = (begun + patience).saturating_duration_since(tokio::time::Instant::now());
            let clock = &inner.shared.clock;
            let is_late = clock.within_real(left, changes.changed()).await.is_none();
            if is_late {
                // A run may have begun or ended while the request waited.
                return match inner.look(cs, &program) {
                    Some(found) => Ok((cs, found)),
                    None => Err(Refusal::new(
                        RefusalCode::Unavailable,
                        "other programs are being planned; repeat the request",
                    )),
                };
            }
        }
    }
}

impl Drop for Previews {
    fn drop(&mut self) {
        self.inner.closing.store(true, Ordering::Relaxed);
        for slots in self.inner.slots.lock().values() {
            slots.cancel();
        }
        self.inner.work.notify_all();
        if let Some(thread) = self.thread.take() {
            // If the thread has panicked, the panic has already been reported.
            let _ = thread.join();
        }
    }
}

impl Inner {
    fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed) || self.shared.closing.is_cancelled()
    }

    fn system(&self, cs: CoordinateSystemNumber) -> Option<&PlannedSystem> {
        let mut systems = self.systems.iter();
        systems.find(|(configured, _)| configured.settings.number == cs)
    }

    fn where_loaded(&self, program: u16) -> Option<CoordinateSystemNumber> {
        let mut numbers = self
            .systems
            .iter()
            .map(|(configured, _)| configured.settings.number);
        numbers.find(|cs| state_of(&self.shared, *cs).is_some_and(|state| state.program == Some(program)))
    }

    /// Returns the coordinate system whose `programs` (configuration) name the program, otherwise the first.
    fn configured_for(&self, program: u16) -> CoordinateSystemNumber {
        let mut systems = self.systems.iter().map(|(configured, _)| configured);
        let named = systems.find(|configured| configured.programs.contains_key(&program));
        let system = named.or_else(|| self.systems.first().map(|(configured, _)| configured));
        system.map_or(0, |configured| configured.settings.number)
    }

    fn validate_program(&self, cs: CoordinateSystemNumber, program: &StoredProgram) -> Result<(), Refusal> {
        let Some((configured, _)) = self.system(cs) else {
            let text = format!("there is no coordinate system {cs}");
            return Err(Refusal::new(RefusalCode::NotFound, text));
        };
        let (number, own, here) = (program.number, program.dialect.name, configured.dialect.name);
        if own != here {
            let text = format!(
                "program {number} has dialect {own}, but coordinate system {cs} has {here}; name another \
                 one with cs="
            );
            return Err(Refusal::new(RefusalCode::WrongDialect, text));
        }
        if program.has_errors() {
            let text = format!("program {number} has errors; correct them first");
            return Err(Refusal {
                diagnostics: program.check.diagnostics.clone(),
                ..Refusal::new(RefusalCode::ProgramHasErrors, text)
            });
        }
        Ok(())
    }

    /// Returns the progress of the run that uses a plan; `None` without such a run or a complete plan.
    fn run_now(&self, cs: CoordinateSystemNumber, found: &FoundPlan) -> Option<RehearsedRun> {
        found.run.as_ref()?;
        let state = state_of(&self.shared, cs)?;
        let (_, view) = self.system(cs)?;
        let content = found.plan.content();
        if !content.is_complete() {
            return None;
        }
        let (segment, executing, since_s) = view.segment();
        let at = view.commanded().0;
        let elapsed_s = self.shared.clock.now_s() - since_s;
        let moment = RunMoment {
            segment,
            executing,
            elapsed_s,
            is_waiting: state.waiting_on.is_some(),
            waits_without_end: self.waits_without_end(cs, &state, elapsed_s),
            at: Axis::ORTHOGONAL.map(|axis| chunk::single(at[axis])),
        };
        let overrides = overrides_of(&self.shared, cs);
        let low_override = found.plan.conditions.configured.settings.motion.low_override;
        Some(rehearsed::run(&content, &moment, &overrides, low_override))
    }

    /// Returns true if the end of the wait is unknown: at M00 and M01, or if an M code waits for a person, a
    /// lost handler, or a spindle that an override of 0 percent stops. Also if the M code was never measured, or takes much longer than measured.
    fn waits_without_end(&self, cs: CoordinateSystemNumber, state: &State, elapsed_s: f64) -> bool {
        if matches!(
            state.execution,
            Execution::ProgramStopped | Execution::OptionalStop
        ) {
            return true;
        }
        let (Some(waiting), Some((configured, _))) = (&state.waiting_on, self.system(cs)) else {
            return false;
        };
        let known_s = planning::wait_of(&self.shared, configured, waiting.m);
        matches!(state.reason, Some(Reason::HandlerLost | Reason::OverrideZero))
            || waiting.question.is_some()
            || known_s.is_none_or(|known_s| elapsed_s > known_s * OVERDUE_FACTOR + OVERDUE_S)
    }

    /// Returns the time left of the active run, rounded to 0.1 s, and its progress, rounded to 0.001.
    fn time_left(&self, cs: CoordinateSystemNumber) -> TimeLeft {
        let run = self.system(cs).and_then(|(_, view)| view.run());
        let Some(run) = run else {
            return TimeLeft::default();
        };
        let found = self.look_at_run(cs, run.clone());
        let now = found.as_ref().and_then(|found| self.run_now(cs, found));
        TimeLeft {
            run_id: Some(run.run_id.clone()),
            plan: now
                .and(found)
                .map(|found| found.plan.identity(&found.plan.content())),
            left_s: now.and_then(|now| Some((now.left_s? * 10.0).round() / 10.0)),
            progress: now.map(|now| (now.progress * 1000.0).round() / 1000.0),
        }
    }

    /// Returns the plan that the active run of the program uses; without such a run, the plan of the program
    /// for the current conditions. If no plan exists, orders it.
    fn look(&self, cs: CoordinateSystemNumber, program: &Arc<StoredProgram>) -> Option<FoundPlan> {
        let state = state_of(&self.shared, cs).unwrap_or_default();
        if let Some(run) = self.run_of(cs, program) {
            return self.look_at_run(cs, run);
        }
        let now = self.conditions(cs, program)?;
        // A run may have begun meanwhile. Then `now` may contain a position on its path, which would replace the
        // plan with which the run began.
        match self.run_of(cs, program) {
            Some(run) => self.look_at_run(cs, run),
            None => self.look_at_program(cs, program, &state, &now),
        }
    }

    /// Returns the active run of the program.
    fn run_of(&self, cs: CoordinateSystemNumber, program: &StoredProgram) -> Option<Arc<RunStart>> {
        let (_, view) = self.system(cs)?;
        view.run()
            .filter(|run| run.conditions.main.number == program.number)
    }

    fn look_at_run(&self, cs: CoordinateSystemNumber, run: Arc<RunStart>) -> Option<FoundPlan> {
        let mut all = self.slots.lock();
        let (plan, is_new) = all.entry(cs).or_default().plan_of_run(&run);
        if is_new {
            self.work.notify_all();
        }
        Some(FoundPlan {
            plan: plan?,
            run: Some(run),
        })
    }

    fn look_at_program(
        &self,
        cs: CoordinateSystemNumber,
        program: &Arc<StoredProgram>,
        state: &State,
        now: &Conditions,
    ) -> Option<FoundPlan> {
        let is_loaded = state.program == Some(program.number);
        let which = if is_loaded {
            PlanUse::Loaded
        } else {
            PlanUse::Asked
        };
        let is_moving = is_loaded && is_running(state);
        let mut all = self.slots.lock();
        let slots = all.entry(cs).or_default();
        let (plan, is_new) = slots.plan_of_program(which, program, now, is_moving);
        if is_new {
            self.work.notify_all();
        }
        Some(FoundPlan {
            plan: plan?,
            run: None,
        })
    }

    fn conditions(&self, cs: CoordinateSystemNumber, program: &Arc<StoredProgram>) -> Option<Conditions> {
        let (configured, view) = self.system(cs)?;
        Some(Conditions::now(
            &self.shared,
            view,
            configured,
            Arc::clone(program),
        ))
    }
}

/// Returns true from the start of a run to its end.
fn is_running(state: &State) -> bool {
    !matches!(
        state.execution,
        Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
    )
}

fn overrides_of(shared: &SharedState, cs: CoordinateSystemNumber) -> Overrides {
    match shared
        .hub
        .read(&Topic::cs(cs, CsTopic::Override))
        .map(|last| last.payload.clone())
    {
        Some(Payload::Override(overrides)) => overrides,
        _ => Overrides::default(),
    }
}
