//! Supervision of the tasks and threads of a machine: the consequences of a panic in a task or thread, and
//! the record of faults that `GET /health` returns.

use std::any::Any;
use std::collections::BTreeMap;
use std::future::Future;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use futures_util::FutureExt;
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::Instant;

/// Largest number of panics of one restarted task within [`RESTART_WINDOW`]; one more panic ends the process.
/// Reason: if a fault recurs at once, a restart of the task does not remove its cause.
pub const RESTARTS_MAX: usize = 2;

/// Length of the time window in which the panics of a restarted task are counted.
pub const RESTART_WINDOW: Duration = Duration::from_mins(1);

/// Pause before a task is restarted.
const RESTART_PAUSE: Duration = Duration::from_millis(100);

/// Largest number of tasks in the record of faults; the fault of a further task is only reported. Reason:
/// task names are constants of the program, and the program has fewer names than this.
const FAULTS_MAX: usize = 64;

/// Consequence of a fault in a task or a thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Consequence {
    /// Only the piece of work in which the fault occurred ends, such as one connection or one request.
    Contained,
    /// The task was restarted.
    Restarted,
    /// One coordinate system stops, until a reset.
    StopsCoordinateSystem,
    /// One coordinate system stops, until a later reset succeeds or the runtime is restarted.
    CoordinateSystemNeedsRestart,
    /// All coordinate systems stop and the drives are off, until the runtime is restarted.
    StopsAll,
    /// The runtime shuts down in an orderly way: motion stops on its path, then the process ends.
    Exits,
}

impl Consequence {
    /// Returns true if the machine cannot be used until the runtime is restarted.
    pub fn needs_restart(self) -> bool {
        self >= Consequence::CoordinateSystemNeedsRestart
    }

    fn text(self) -> &'static str {
        match self {
            Consequence::Contained => "only this connection or request has ended",
            Consequence::Restarted => "the task was restarted",
            Consequence::StopsCoordinateSystem => "the coordinate system has stopped; reset it",
            Consequence::CoordinateSystemNeedsRestart => {
                "the coordinate system stays stopped; restart the runtime"
            }
            Consequence::StopsAll => "all motion has stopped; restart the runtime",
            Consequence::Exits => "the runtime shuts down",
        }
    }
}

/// Faults of a task or a thread since the start of the runtime.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TaskFault {
    /// Name of the task or thread.
    pub task: String,
    /// Number of faults so far.
    pub count: u64,
    /// Consequence of the last fault.
    pub consequence: Consequence,
}

/// Report of a supervisor about one fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaultReport {
    /// Name of the task or thread.
    pub task: String,
    /// Consequence of the fault.
    pub consequence: Consequence,
    /// The message of the panic.
    pub text: String,
}

impl FaultReport {
    /// Returns the fault and its consequence as a text for an operator.
    pub fn message(&self) -> String {
        format!("{}: {}; {}", self.task, self.text, self.consequence.text())
    }
}

type Listener = Box<dyn Fn(&FaultReport) + Send + Sync>;

/// A supervisor of tasks and threads. Clones are handles to the same supervisor.
#[derive(Clone)]
pub struct Supervisor(Arc<SupervisorState>);

struct SupervisorState {
    faults: Mutex<BTreeMap<String, TaskFault>>,
    listener: OnceLock<Listener>,
    /// Reason why the process must end; `None` until a fault requires the end of the process.
    exit: watch::Sender<Option<String>>,
    /// Name of the task that panics when it next runs; empty if no fault is injected.
    injected: watch::Sender<String>,
}

impl std::fmt::Debug for Supervisor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Supervisor").finish_non_exhaustive()
    }
}

impl Default for Supervisor {
    fn default() -> Self {
        Self(Arc::new(SupervisorState {
            faults: Mutex::default(),
            listener: OnceLock::new(),
            exit: watch::Sender::new(None),
            injected: watch::Sender::default(),
        }))
    }
}

impl Supervisor {
    /// Registers a function that is called with each fault from now on. Only the first call of `listen` has
    /// an effect.
    pub fn listen(&self, listener: impl Fn(&FaultReport) + Send + Sync + 'static) {
        // a second listener would report each fault twice
        let _ = self.0.listener.set(Box::new(listener));
    }

    /// Records a fault and reports it to the listener. Does not panic.
    pub fn report(&self, report: &FaultReport) {
        {
            let mut faults = self.0.faults.lock().unwrap_or_else(PoisonError::into_inner);
            if faults.len() < FAULTS_MAX || faults.contains_key(&report.task) {
                let fault = faults.entry(report.task.clone()).or_insert(TaskFault {
                    task: report.task.clone(),
                    count: 0,
                    consequence: report.consequence,
                });
                fault.count += 1;
                fault.consequence = report.consequence;
            }
        }
        if let Some(listener) = self.0.listener.get() {
            // an error of the listener is ignored, because the fault is already recorded
            let _ = catch_unwind(AssertUnwindSafe(|| listener(report)));
        }
        if report.consequence == Consequence::Exits {
            self.0.exit.send_if_modified(|exit| {
                let is_first = exit.is_none();
                exit.get_or_insert_with(|| report.message());
                is_first
            });
        }
    }

    /// Records that a reset has recovered a coordinate system after its task had failed, so that it needs no
    /// restart of the runtime.
    pub fn note_reset(&self, task: &str) {
        let mut faults = self.0.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(fault) = faults.get_mut(task)
            && fault.consequence == Consequence::CoordinateSystemNeedsRestart
        {
            fault.consequence = Consequence::StopsCoordinateSystem;
        }
    }

    /// Records and reports a panic as a fault.
    pub fn report_panic(&self, task: &str, consequence: Consequence, panicked: &(dyn Any + Send)) {
        self.report(&FaultReport {
            task: task.to_owned(),
            consequence,
            text: panic_text(panicked).to_owned(),
        });
    }

    /// Returns the faults so far, by the name of their task.
    pub fn faults(&self) -> Vec<TaskFault> {
        let faults = self.0.faults.lock().unwrap_or_else(PoisonError::into_inner);
        faults.values().cloned().collect()
    }

    /// Waits until a fault requires the end of the process, and returns the reason.
    pub async fn exit(&self) -> String {
        let mut exit = self.0.exit.subscribe();
        // the wait cannot fail, because the sender lives as long as `self`
        let why = exit.wait_for(Option::is_some).await;
        why.ok().and_then(|why| why.clone()).unwrap_or_default()
    }

    /// Injects a fault: the task or thread of this name panics once, when it next runs. A later call replaces
    /// a fault that has not occurred yet. For tests of the consequences of a fault; no request from outside
    /// the process can inject a fault.
    pub fn inject(&self, task: &str) {
        self.0.injected.send_replace(task.to_owned());
    }

    /// Returns true while an injected fault has not occurred.
    pub fn is_injected(&self) -> bool {
        !self.0.injected.borrow().is_empty()
    }

    /// Panics if a fault is injected for this task. A thread calls this function at the start of each of its
    /// rounds.
    ///
    /// # Panics
    /// Panics if the fault is injected.
    pub fn fault_point(&self, task: &str) {
        let is_due = self.is_injected()
            && self.0.injected.send_if_modified(|injected| {
                let is_due = injected == task;
                if is_due {
                    injected.clear();
                }
                is_due
            });
        if is_due {
            // unwinds like a panic, but without the report of the panic hook
            resume_unwind(Box::new("an injected fault"));
        }
    }

    /// Runs the work of a task. If a fault is injected for this task, it also occurs while the work waits.
    async fn with_fault_point<F: Future>(&self, task: &str, work: F) -> F::Output {
        let mut injected = self.0.injected.subscribe();
        let fault = async {
            while injected.wait_for(|injected| injected == task).await.is_ok() {
                self.fault_point(task);
            }
            // not reached, because the sender lives as long as `self`
            std::future::pending().await
        };
        tokio::select! {
            biased;
            output = fault => output,
            output = work => output,
        }
    }

    /// Supervises one piece of work, such as one connection: a panic ends only this work.
    pub fn contained<F: Future<Output = ()>>(
        &self,
        task: &'static str,
        work: F,
    ) -> impl Future<Output = ()> + use<F> {
        let work = self.catch_panic(task, work);
        async move {
            // `catch_panic` has already reported a panic
            let _ = work.await;
        }
    }

    /// Supervises one piece of work with a result, such as one request: a panic ends only this work, and the
    /// result is `None`.
    pub fn catch_panic<F: Future>(
        &self,
        task: &'static str,
        work: F,
    ) -> impl Future<Output = Option<F::Output>> + use<F> {
        let supervisor = self.clone();
        async move {
            let work = supervisor.with_fault_point(task, work);
            match AssertUnwindSafe(work).catch_unwind().await {
                Ok(result) => Some(result),
                Err(panicked) => {
                    supervisor.report_panic(task, Consequence::Contained, panicked.as_ref());
                    None
                }
            }
        }
    }

    /// Does work that may block its thread, in a thread for such work. A panic ends only this work, and the
    /// result is `None`; also if the tokio runtime ends.
    pub async fn catch_blocking<T: Send + 'static>(
        &self,
        task: &'static str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<T> {
        let supervisor = self.clone();
        let work = move || {
            supervisor.fault_point(task);
            work()
        };
        match tokio::task::spawn_blocking(work).await {
            Ok(result) => Some(result),
            Err(error) => {
                if let Ok(panicked) = error.try_into_panic() {
                    self.report_panic(task, Consequence::Contained, panicked.as_ref());
                }
                None
            }
        }
    }

    /// Supervises a task without which the machine can be neither operated nor observed: after a panic the
    /// runtime shuts down.
    pub fn essential<F: Future<Output = ()>>(
        &self,
        task: &'static str,
        work: F,
    ) -> impl Future<Output = ()> + use<F> {
        let supervisor = self.clone();
        async move {
            let work = supervisor.with_fault_point(task, work);
            if let Err(panicked) = AssertUnwindSafe(work).catch_unwind().await {
                supervisor.report_panic(task, Consequence::Exits, panicked.as_ref());
            }
        }
    }

    /// Supervises a task that is started by `make`, and restarted after a panic. After [`RESTARTS_MAX`]
    /// panics within [`RESTART_WINDOW`], the runtime shuts down at the next panic.
    pub fn restarted<F: Future<Output = ()>, M: FnMut() -> F>(
        &self,
        task: &'static str,
        mut make: M,
    ) -> impl Future<Output = ()> + use<F, M> {
        let supervisor = self.clone();
        async move {
            let mut restarts = Restarts::default();
            loop {
                let work = supervisor.with_fault_point(task, async { make().await });
                let Err(panicked) = AssertUnwindSafe(work).catch_unwind().await else {
                    return;
                };
                let consequence = restarts.after_panic();
                supervisor.report_panic(task, consequence, panicked.as_ref());
                if consequence == Consequence::Exits {
                    return;
                }
                tokio::time::sleep(RESTART_PAUSE).await;
            }
        }
    }
}

/// Times of the panics of a restarted task.
#[derive(Debug, Default)]
pub struct Restarts(Vec<Instant>);

impl Restarts {
    /// Counts a panic that occurs now, and returns its consequence: a restart, or the end of the process.
    pub fn after_panic(&mut self) -> Consequence {
        let now = Instant::now();
        self.0.retain(|at| now.duration_since(*at) < RESTART_WINDOW);
        self.0.push(now);
        if self.0.len() > RESTARTS_MAX {
            Consequence::Exits
        } else {
            Consequence::Restarted
        }
    }
}

/// Returns the message of a panic.
pub fn panic_text(panicked: &(dyn Any + Send)) -> &str {
    crate::text::panic_text(panicked)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(supervisor: &Supervisor) -> Vec<(String, u64, Consequence)> {
        let faults = supervisor.faults().into_iter();
        faults
            .map(|fault| (fault.task, fault.count, fault.consequence))
            .collect()
    }

    #[tokio::test]
    async fn a_contained_panic_ends_its_work_alone() {
        let supervisor = Supervisor::default();
        for _ in 0..5 {
            supervisor.contained("connection", async { panic!("boom") }).await;
        }
        assert_eq!(
            faults(&supervisor),
            [("connection".to_owned(), 5, Consequence::Contained)]
        );
        assert!(supervisor.exit().now_or_never().is_none());
    }

    #[tokio::test]
    async fn panic_of_blocking_work_is_reported_and_ends_this_work_alone() {
        let supervisor = Supervisor::default();
        assert_eq!(supervisor.catch_blocking("disk", || 7).await, Some(7));
        let failed: Option<()> = supervisor.catch_blocking("disk", || panic!("boom")).await;
        assert_eq!(failed, None);
        assert_eq!(
            faults(&supervisor),
            [("disk".to_owned(), 1, Consequence::Contained)]
        );
        assert!(supervisor.exit().now_or_never().is_none());
    }

    #[tokio::test]
    async fn an_essential_task_that_panics_ends_the_process_with_the_reason() {
        let supervisor = Supervisor::default();
        supervisor.essential("server", async { panic!("boom") }).await;
        assert_eq!(
            faults(&supervisor),
            [("server".to_owned(), 1, Consequence::Exits)]
        );
        let why = supervisor.exit().now_or_never().unwrap();
        assert_eq!(why, "server: boom; the runtime shuts down");
    }

    #[tokio::test(start_paused = true)]
    async fn the_third_panic_within_60_s_ends_the_process() {
        let supervisor = Supervisor::default();
        let mut starts = 0;
        supervisor
            .restarted("publisher", || {
                starts += 1;
                async { panic!("boom") }
            })
            .await;
        assert_eq!(starts, RESTARTS_MAX + 1);
        assert!(supervisor.exit().now_or_never().is_some());
    }

    #[tokio::test(start_paused = true)]
    async fn panics_that_are_60_s_apart_never_end_the_process() {
        let supervisor = Supervisor::default();
        let mut starts = 0;
        supervisor
            .restarted("publisher", || {
                starts += 1;
                let is_last = starts == 20;
                async move {
                    tokio::time::sleep(RESTART_WINDOW / 2 + Duration::from_millis(1)).await;
                    assert!(is_last, "boom");
                }
            })
            .await;
        assert_eq!(
            faults(&supervisor),
            [("publisher".to_owned(), 19, Consequence::Restarted)]
        );
        assert!(supervisor.exit().now_or_never().is_none());
    }

    #[tokio::test]
    async fn an_injected_fault_occurs_once_in_its_task_and_in_no_other() {
        let supervisor = Supervisor::default();
        let waits = |task| tokio::spawn(supervisor.contained(task, std::future::pending()));
        let (one, other) = (waits("one"), waits("other"));
        supervisor.inject("one");
        one.await.unwrap();
        assert!(!supervisor.is_injected());
        let second = waits("one");
        tokio::task::yield_now().await;
        assert!(!second.is_finished() && !other.is_finished());
        assert_eq!(
            faults(&supervisor),
            [("one".to_owned(), 1, Consequence::Contained)]
        );
    }

    #[tokio::test]
    async fn a_listener_that_panics_hides_no_fault() {
        let supervisor = Supervisor::default();
        supervisor.listen(|_| panic!("the listener"));
        supervisor.essential("server", async { panic!("boom") }).await;
        assert_eq!(supervisor.faults().len(), 1);
        assert!(supervisor.exit().now_or_never().is_some());
    }
}
