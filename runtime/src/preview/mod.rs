//! What a program will do, before it runs: its path and its rehearsal. A thread of low priority plans it with the stages of a run; the
//! servo and its tasks do not depend on it, and it reads only what anybody may read.
//!
//! The loaded program of each coordinate system is planned automatically, and again when something that its plan depends on changes, but
//! never while it runs. Other programs are planned on request.

mod bytes;
mod chunk;
mod plan;
mod planning;
mod rehearsed;
mod sleeve;
mod tracer;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::line_start::{LineStart, LineState};
use plc_api::types::message::Payload;
use plc_api::types::planned::{PathQuery, PlannedPath, Rehearsal, RehearsedRun};
use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::run::TimeLeft;
use plc_api::types::state::{Execution, Overrides, State};
use plc_api::types::topic::{CsTopic, Topic};
use tandem_model::Axis;
use tokio::sync::watch;

use crate::config::CoordinateSystem as Configured;
use crate::coordinate_system::{Conditions, View, line_search, state_of};
use crate::program_store::StoredProgram;
use crate::shared::Shared;
use plan::{Moment, Plan};

/// How often the thread looks whether something has changed.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// How often the time left is published.
const TIME_LEFT_INTERVAL: Duration = Duration::from_secs(1);

/// How long a request waits for a plan that is not complete: that of a short program is there then.
const PATIENCE: Duration = Duration::from_millis(500);

/// How long it waits for a plan that is not begun, since another program is being planned.
const TURN_MAX: Duration = Duration::from_secs(10);

/// A plan of changed conditions waits so many times as long as the last one took.
const PAUSE_FACTOR: u32 = 2;

/// Plans of all coordinate systems.
#[derive(Debug)]
pub(crate) struct Previews {
    inner: Arc<Inner>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Inner {
    shared: Arc<Shared>,
    systems: Vec<(Configured, Arc<View>)>,
    slots: Mutex<BTreeMap<CoordinateSystemNumber, Slots>>,
    /// Wakes the thread.
    work: Condvar,
    closing: AtomicBool,
    /// Counts changes of plans.
    changes: watch::Sender<u64>,
}

/// The plans of a coordinate system.
#[derive(Debug, Default)]
struct Slots {
    /// Of the loaded program.
    loaded: Slot,
    /// Of another one that was asked for last.
    asked: Slot,
}

#[derive(Debug, Default)]
struct Slot {
    plan: Option<Arc<Plan>>,
    /// It is to be made.
    wanted: Option<Arc<StoredProgram>>,
    /// How long the last one took, and when it ended.
    took: Option<(Duration, Instant)>,
}

impl Slot {
    fn is_of(&self, program: &StoredProgram) -> bool {
        self.plan
            .as_ref()
            .is_some_and(|plan| plan.conditions.main.number == program.number)
    }

    fn want(&mut self, program: Arc<StoredProgram>) {
        if let Some(plan) = self.plan.take() {
            plan.cancel();
        }
        self.wanted = Some(program);
    }
}

impl Previews {
    /// Plans are made when they are asked for, in the thread that asks: for simulated time.
    pub fn on_demand(shared: &Arc<Shared>, views: impl Iterator<Item = Arc<View>>) -> Self {
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

    /// From now on a thread makes them. Without one they are made when they are asked for.
    pub fn start_thread(&mut self) {
        let inner = Arc::clone(&self.inner);
        let work = move || {
            lower_priority();
            inner.work();
        };
        match std::thread::Builder::new().name("preview".into()).spawn(work) {
            Ok(thread) => self.thread = Some(thread),
            Err(error) => tracing::warn!(%error, "there is no thread that plans programs ahead"),
        }
    }

    /// The planned path of a program, as far as it is known.
    ///
    /// # Errors
    /// There is no such coordinate system, or it does not run the program.
    pub async fn path(&self, program: Arc<StoredProgram>, query: &PathQuery) -> Result<PlannedPath, Refusal> {
        let (cs, plan) = self.plan(program, query.cs).await?;
        let content = plan.content();
        Ok(PlannedPath {
            tag: plan.tag(&content),
            bytes: bytes::encode(&plan, &content, cs, query),
        })
    }

    /// What a run of a program does, as far as it is known.
    ///
    /// # Errors
    /// As for a path.
    pub async fn rehearsal(
        &self,
        program: Arc<StoredProgram>,
        cs: Option<CoordinateSystemNumber>,
    ) -> Result<Rehearsal, Refusal> {
        let (cs, plan) = self.plan(program, cs).await?;
        let content = plan.content();
        let mut rehearsal = rehearsed::rehearsal(&plan, &content);
        let inner = &self.inner;
        rehearsal.run = inner.run_now(cs, &plan);
        Ok(rehearsal)
    }

    /// Says once a second how long the programs that run take to their ends.
    pub fn tell_time_left(&self) -> impl Future<Output = ()> + use<> {
        let inner = Arc::clone(&self.inner);
        async move {
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
    }

    /// What is in force at a line of the loaded program: a function, which takes its time, for a thread that may wait.
    ///
    /// # Errors
    /// No program is loaded, or as [`line_entry`].
    pub fn line_state(
        &self,
        cs: CoordinateSystemNumber,
        from: LineStart,
    ) -> impl FnOnce() -> Result<LineState, Refusal> + Send + use<> {
        let inner = Arc::clone(&self.inner);
        move || {
            let state = state_of(&inner.shared, cs).unwrap_or_default();
            let program = state.program.and_then(|number| inner.shared.store.get(number));
            let none = "no program is loaded; load one first";
            let program = program.ok_or_else(|| Refusal::new(RefusalCode::NotFound, none))?;
            inner.judge(cs, &program)?;
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
    ) -> Result<(CoordinateSystemNumber, Arc<Plan>), Refusal> {
        let inner = &self.inner;
        let cs = cs.or_else(|| inner.where_loaded(program.number));
        let first = || {
            inner
                .systems
                .first()
                .map(|(configured, _)| configured.settings.number)
        };
        let cs = cs.or_else(first).unwrap_or_default();
        inner.judge(cs, &program)?;
        if self.thread.is_none() {
            inner.make_if_needed(cs, &program);
        }
        let mut changes = inner.changes.subscribe();
        let begun = tokio::time::Instant::now();
        loop {
            let plan = inner.look(cs, &program);
            if let Some(plan) = &plan
                && plan.content().is_complete()
            {
                return Ok((cs, Arc::clone(plan)));
            }
            let patience = if plan.is_some() { PATIENCE } else { TURN_MAX };
            let left = (begun + patience).saturating_duration_since(tokio::time::Instant::now());
            let clock = &inner.shared.clock;
            let is_late = clock.within_real(left, changes.changed()).await.is_none();
            if is_late {
                return match plan.or_else(|| inner.look(cs, &program)) {
                    Some(plan) => Ok((cs, plan)),
                    None => Err(Refusal::new(
                        RefusalCode::Unavailable,
                        "other programs are being planned; ask again",
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
            for plan in slots.loaded.plan.iter().chain(&slots.asked.plan) {
                plan.cancel();
            }
        }
        self.inner.work.notify_all();
        if let Some(thread) = self.thread.take() {
            // a panic of it has been reported by its own message
            let _ = thread.join();
        }
    }
}

impl Inner {
    fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed) || self.shared.closing.is_cancelled()
    }

    fn system(&self, cs: CoordinateSystemNumber) -> Option<&(Configured, Arc<View>)> {
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

    fn judge(&self, cs: CoordinateSystemNumber, program: &StoredProgram) -> Result<(), Refusal> {
        let Some((configured, _)) = self.system(cs) else {
            let text = format!("there is no coordinate system {cs}");
            return Err(Refusal::new(RefusalCode::NotFound, text));
        };
        let (number, own, here) = (program.number, program.dialect.name, configured.dialect.name);
        if own != here {
            let text = format!(
                "program {number} is of dialect {own}, and coordinate system {cs} speaks {here}; name another one by cs="
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

    /// How far the run of a planned program is; `None`: it does not run, it has begun at a line, or its plan is not complete.
    fn run_now(&self, cs: CoordinateSystemNumber, plan: &Plan) -> Option<RehearsedRun> {
        let state = state_of(&self.shared, cs)?;
        let runs = is_running(&state) && state.program == Some(plan.conditions.main.number);
        let (_, view) = self.system(cs)?;
        let content = plan.content();
        if !runs || !content.is_complete() || view.began_at_line() {
            return None;
        }
        let (segment, executing, since_s) = view.segment();
        let at = view.commanded().0;
        let moment = Moment {
            segment,
            executing,
            elapsed_s: self.shared.clock.now_s() - since_s,
            is_waiting: state.waiting_on.is_some(),
            at: Axis::ORTHOGONAL.map(|axis| chunk::single(at[axis])),
        };
        let overrides = overrides_of(&self.shared, cs);
        Some(rehearsed::run(&content, &moment, &overrides))
    }

    /// How long the program that runs takes to its end, to a tenth of a second, and which share of it is done, to a thousandth.
    fn time_left(&self, cs: CoordinateSystemNumber) -> TimeLeft {
        let state = state_of(&self.shared, cs).filter(is_running);
        let program = state.and_then(|state| self.shared.store.get(state.program?));
        // one that began at once after its load is planned while it runs
        let plan = program.and_then(|program| self.look(cs, &program));
        let run = plan.and_then(|plan| self.run_now(cs, &plan));
        TimeLeft {
            left_s: run.map(|run| (run.left_s * 10.0).round() / 10.0),
            progress: run.map(|run| (run.progress * 1000.0).round() / 1000.0),
        }
    }

    /// The plan of a program as it would run now; when there is none, it is wanted.
    fn look(&self, cs: CoordinateSystemNumber, program: &Arc<StoredProgram>) -> Option<Arc<Plan>> {
        let state = state_of(&self.shared, cs).unwrap_or_default();
        let now = self.conditions(cs, program)?;
        let mut all = self.slots.lock();
        let slots = all.entry(cs).or_default();
        let is_loaded = state.program == Some(program.number);
        let slot = if is_loaded {
            &mut slots.loaded
        } else {
            &mut slots.asked
        };
        let is_frozen = is_loaded && is_running(&state);
        if slot.is_of(program)
            && let Some(plan) = &slot.plan
            && (is_frozen || plan.conditions.revision == now.revision)
        {
            return Some(Arc::clone(plan));
        }
        if slot
            .wanted
            .as_ref()
            .is_none_or(|wanted| !Arc::ptr_eq(wanted, program))
        {
            slot.want(Arc::clone(program));
            self.work.notify_all();
        }
        None
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

    /// In the thread that asks.
    fn make_if_needed(&self, cs: CoordinateSystemNumber, program: &Arc<StoredProgram>) {
        if self.look(cs, program).is_none() {
            while let Some((cs, is_loaded, program)) = self.next() {
                self.make(cs, is_loaded, &program);
            }
        }
    }

    fn work(&self) {
        while !self.is_closing() {
            self.want_loaded();
            if let Some((cs, is_loaded, program)) = self.next() {
                self.make(cs, is_loaded, &program);
                continue;
            }
            let mut slots = self.slots.lock();
            if !self.is_closing() {
                self.work.wait_for(&mut slots, LOOK_INTERVAL);
            }
        }
    }

    /// Loaded programs are wanted when there is no plan of them, or one of other conditions.
    fn want_loaded(&self) {
        for (configured, _) in &self.systems {
            let cs = configured.settings.number;
            let Some(state) = state_of(&self.shared, cs) else {
                continue;
            };
            let program = state.program.and_then(|number| self.shared.store.get(number));
            let Some(program) = program.filter(|_| !is_running(&state)) else {
                continue;
            };
            if self.judge(cs, &program).is_err() {
                continue;
            }
            let pauses = self.slots.lock().get(&cs).is_some_and(|slots| {
                let took = slots.loaded.took.filter(|_| slots.loaded.is_of(&program));
                took.is_some_and(|(took, ended)| ended.elapsed() < took * PAUSE_FACTOR)
            });
            if !pauses {
                self.look(cs, &program);
            }
        }
    }

    /// The plan to be made next: loaded programs first.
    fn next(&self) -> Option<(CoordinateSystemNumber, bool, Arc<StoredProgram>)> {
        let mut all = self.slots.lock();
        for is_loaded in [true, false] {
            for (cs, slots) in all.iter_mut() {
                let slot = if is_loaded {
                    &mut slots.loaded
                } else {
                    &mut slots.asked
                };
                if let Some(program) = slot.wanted.take() {
                    return Some((*cs, is_loaded, program));
                }
            }
        }
        None
    }

    fn make(&self, cs: CoordinateSystemNumber, is_loaded: bool, program: &Arc<StoredProgram>) {
        let Some(conditions) = self.conditions(cs, program) else {
            return;
        };
        let plan = Arc::new(Plan::new(conditions));
        let slot = |change: &dyn Fn(&mut Slot)| {
            let mut all = self.slots.lock();
            let slots = all.entry(cs).or_default();
            change(if is_loaded {
                &mut slots.loaded
            } else {
                &mut slots.asked
            });
        };
        slot(&|slot| slot.plan = Some(Arc::clone(&plan)));
        let began = Instant::now();
        let is_wanted = || {
            let loaded = state_of(&self.shared, cs).and_then(|state| state.program);
            !self.is_closing() && (loaded == Some(program.number)) == is_loaded
        };
        let on_change = || self.changes.send_modify(|count| *count += 1);
        planning::plan(&self.shared, &plan, &is_wanted, &on_change);
        slot(&|slot| {
            slot.took = Some((began.elapsed(), Instant::now()));
            if !plan.content().is_complete()
                && slot.plan.as_ref().is_some_and(|kept| Arc::ptr_eq(kept, &plan))
            {
                slot.plan = None;
            }
        });
        on_change();
    }
}

/// True from a start to the end of the run.
fn is_running(state: &State) -> bool {
    !matches!(
        state.execution,
        Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
    )
}

fn overrides_of(shared: &Shared, cs: CoordinateSystemNumber) -> Overrides {
    match shared
        .hub
        .read(&Topic::cs(cs, CsTopic::Override))
        .map(|last| last.payload.clone())
    {
        Some(Payload::Override(overrides)) => overrides,
        _ => Overrides::default(),
    }
}

/// Others first.
fn lower_priority() {
    #[cfg(unix)]
    {
        use thread_priority::ThreadPriority;
        use thread_priority::unix::{
            NormalThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
            thread_native_id,
        };
        let policy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
        // without it the thread is one as any other
        let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, policy);
    }
}
