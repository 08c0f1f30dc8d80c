//! Threads for work that waits for a disk. In tests with a simulated world, each of them is a task that the simulated
//! clock schedules.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use plc_api::supervisor::{Consequence, Restarts, Supervisor};

/// Priority of threads whose results only a person or a client waits for, on the scale 0 to 99 of `thread_priority`. On
/// Linux this value is a niceness of 10. If ordinary threads occupy all processors, such a thread gets about a tenth of
/// the share of an ordinary thread. The lowest priority would give one seventieth, and no plan would be ready within
/// minutes.
#[cfg(unix)]
const LOW_PRIORITY: u8 = 22;

/// Gives the calling thread a low priority, so that ordinary threads run first.
pub(crate) fn lower_priority() {
    #[cfg(unix)]
    {
        use thread_priority::ThreadPriority;
        use thread_priority::unix::{
            NormalThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
            thread_native_id,
        };
        let Ok(priority) = LOW_PRIORITY.try_into().map(ThreadPriority::Crossplatform) else {
            return;
        };
        let policy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
        // if this fails, the thread keeps its ordinary priority
        let _ = set_thread_priority_and_policy(thread_native_id(), priority, policy);
    }
}

/// Work of a supervised thread, in rounds.
pub(crate) trait Work: Send + 'static {
    /// Returns the time for which a round may wait for messages.
    fn patience(&self) -> Duration;

    /// Returns the maximum time for which received messages may wait. A simulated thread has a round at least this
    /// often.
    #[cfg(test)]
    fn delay(&self) -> Duration {
        self.patience()
    }

    /// Waits for messages for at most `patience`, then does the work that is due. Returns false if the thread must end.
    fn round(&mut self, patience: Duration) -> bool;
}

/// Executes the rounds of a thread. A panic in a round is reported, and the next round follows. After too many panics
/// the runtime shuts down.
pub(crate) struct SupervisedRounds {
    name: &'static str,
    supervisor: Supervisor,
    restarts: Restarts,
}

impl SupervisedRounds {
    fn new(name: &'static str, supervisor: &Supervisor) -> Self {
        Self {
            name,
            supervisor: supervisor.clone(),
            restarts: Restarts::default(),
        }
    }

    /// Executes one round. Returns false if the thread must end.
    fn round(&mut self, round: impl FnOnce() -> bool) -> bool {
        let round = || {
            self.supervisor.fault_point(self.name);
            round()
        };
        catch_unwind(AssertUnwindSafe(round)).unwrap_or_else(|panicked| {
            let consequence = self.restarts.after_panic();
            self.supervisor
                .report_panic(self.name, consequence, panicked.as_ref());
            consequence == Consequence::Restarted
        })
    }
}

#[cfg(not(test))]
pub(crate) use real::OsThread as Thread;
#[cfg(test)]
pub(crate) use simulated::{Rounds, Thread, simulate, stop_simulating};

#[cfg_attr(test, allow(dead_code, reason = "tests take the names of the simulated ones"))]
mod real {
    use std::thread::{Builder, JoinHandle};

    use super::{SupervisedRounds, Supervisor, Work, io};

    /// A thread of the operating system.
    #[derive(Debug)]
    pub(crate) struct OsThread(JoinHandle<()>);

    impl OsThread {
        /// # Errors
        /// Returns an error if the operating system provides no thread.
        pub fn start(name: &'static str, supervisor: &Supervisor, mut work: impl Work) -> io::Result<Self> {
            let mut rounds = SupervisedRounds::new(name, supervisor);
            let rounds = move || while rounds.round(|| work.round(work.patience())) {};
            Builder::new().name(name.to_owned()).spawn(rounds).map(Self)
        }

        /// Waits for the end of the thread.
        pub fn join(self) {
            // joins also a thread that has ended by a panic
            let _ = self.0.join();
        }
    }
}

#[cfg(test)]
mod simulated {
    use std::cell::RefCell;
    use std::sync::Arc;

    use parking_lot::Mutex;
    use tokio::task::AbortHandle;

    use super::{Duration, SupervisedRounds, Supervisor, Work, io, real};

    /// All simulated threads of a simulated process, including those that have ended.
    type All = Vec<(AbortHandle, Arc<Mutex<dyn Work>>)>;

    thread_local! {
        static ALL: RefCell<Option<All>> = const { RefCell::new(None) };
    }

    /// From now on, threads that the calling thread starts are simulated as tasks.
    pub(crate) fn simulate() {
        ALL.set(Some(Vec::new()));
    }

    /// Stops all simulated threads, because their process ends.
    pub(crate) fn stop_simulating() {
        for (task, _) in ALL.take().into_iter().flatten() {
            task.abort();
        }
    }

    #[derive(Debug)]
    pub(crate) enum Thread {
        Real(real::OsThread),
        Simulated(Rounds),
    }

    /// Handle with which a test executes rounds of a simulated thread.
    #[derive(Clone)]
    pub(crate) struct Rounds(Arc<Mutex<dyn Work>>);

    impl std::fmt::Debug for Rounds {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("Rounds")
        }
    }

    impl Thread {
        pub fn start(name: &'static str, supervisor: &Supervisor, work: impl Work) -> io::Result<Self> {
            if !ALL.with_borrow(Option::is_some) {
                return real::OsThread::start(name, supervisor, work).map(Self::Real);
            }
            let work: Arc<Mutex<dyn Work>> = Arc::new(Mutex::new(work));
            let of_task = Arc::clone(&work);
            let mut rounds = SupervisedRounds::new(name, supervisor);
            let task = tokio::spawn(async move {
                loop {
                    let pause = of_task.lock().delay();
                    tokio::time::sleep(pause.max(Duration::from_millis(1))).await;
                    if !rounds.round(|| of_task.lock().round(Duration::ZERO)) {
                        return;
                    }
                }
            });
            let of_process = (task.abort_handle(), Arc::clone(&work));
            ALL.with_borrow_mut(|all| all.as_mut().unwrap().push(of_process));
            Ok(Self::Simulated(Rounds(work)))
        }

        pub fn join(self) {
            match self {
                Self::Real(thread) => thread.join(),
                // this round finds that the thread must end
                Self::Simulated(rounds) => drop(rounds.0.lock().round(Duration::ZERO)),
            }
        }

        /// Returns the handle of a simulated thread; `None` for a real thread.
        pub fn rounds(&self) -> Option<Rounds> {
            match self {
                Self::Real(_) => None,
                Self::Simulated(rounds) => Some(rounds.clone()),
            }
        }
    }

    impl Rounds {
        pub fn take_one(&self) {
            self.0.lock().round(Duration::ZERO);
        }
    }
}
