//! Threads for work that waits for a disk. They are a parameter of the runtime: by default they are threads of the
//! operating system; a simulated world executes their rounds in tasks that the simulated clock schedules.

use std::fmt::Debug;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::supervisor::{Consequence, Restarts, Supervisor};

/// Priority of threads whose results only a person or a client waits for, on the scale 0 to 99 of `thread_priority`. On
/// Linux this value is a niceness of 10. If ordinary threads occupy all processors, such a thread gets about a tenth of
/// the share of an ordinary thread. The lowest priority would give one seventieth, and no plan would be ready within
/// minutes.
#[cfg(unix)]
const LOW_PRIORITY: u8 = 22;

/// Gives the calling thread a low priority, so that ordinary threads run first.
pub fn lower_priority() {
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
pub trait Work: Send + 'static {
    /// Returns the time for which a round may wait for messages.
    fn patience(&self) -> Duration;

    /// Returns the maximum time for which received messages may wait. If rounds do not wait for messages, one follows
    /// at least this often.
    fn delay(&self) -> Duration {
        self.patience()
    }

    /// Waits for messages for at most `patience`, then does the work that is due. Returns false if the thread must end.
    fn round(&mut self, patience: Duration) -> bool;
}

/// Work of a thread, with its supervision. A panic in a round is reported, and the next round follows. After too many
/// panics the runtime shuts down.
pub struct SupervisedWork {
    name: &'static str,
    supervisor: Supervisor,
    restarts: Restarts,
    work: Box<dyn Work>,
}

impl Debug for SupervisedWork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("SupervisedWork").field(&self.name).finish()
    }
}

impl SupervisedWork {
    /// Returns the name of the thread.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Returns the maximum time between two rounds that do not wait.
    pub fn delay(&self) -> Duration {
        self.work.delay()
    }

    /// Executes a round, which waits for messages until work is due. Returns false if the thread must end.
    pub fn wait_and_work(&mut self) -> bool {
        self.supervise(|work| {
            let patience = work.patience();
            work.round(patience)
        })
    }

    /// Executes a round that does not wait. Returns false if the thread must end.
    pub fn work_now(&mut self) -> bool {
        self.supervise(|work| work.round(Duration::ZERO))
    }

    /// Executes a round that does not wait, for a caller that needs its result. A panic reaches the caller.
    pub fn work_for_caller(&mut self) {
        self.work.round(Duration::ZERO);
    }

    fn supervise(&mut self, round: impl FnOnce(&mut dyn Work) -> bool) -> bool {
        let work = &mut *self.work;
        let round = || {
            self.supervisor.fault_point(self.name);
            round(work)
        };
        catch_unwind(AssertUnwindSafe(round)).unwrap_or_else(|panicked| {
            let consequence = self.restarts.after_panic();
            self.supervisor
                .report_panic(self.name, consequence, panicked.as_ref());
            consequence == Consequence::Restarted
        })
    }
}

/// A started thread.
pub trait StartedThread: Debug + Send + Sync {
    /// Waits for the end of the thread.
    fn join(&self);

    /// Executes a round in the calling thread, if a task executes the rounds. Returns false for a thread that runs in
    /// parallel: the caller may then block until that thread has answered.
    fn work_for_caller(&self) -> bool;
}

/// Starts threads for supervised work.
pub trait ThreadStarter: Debug + Send + Sync {
    /// Starts a thread that executes the rounds of the work until a round returns false.
    ///
    /// # Errors
    /// Returns an error if the operating system provides no thread.
    fn start(&self, work: SupervisedWork) -> io::Result<Arc<dyn StartedThread>>;
}

/// The threads of a runtime. A clone starts the same kind of threads. The default is threads of the operating system.
#[derive(Debug, Clone)]
pub struct Threads(Arc<dyn ThreadStarter>);

impl Default for Threads {
    fn default() -> Self {
        Self::new(OsThreads)
    }
}

impl Threads {
    /// Creates threads from an implementation that starts them.
    pub fn new(starter: impl ThreadStarter + 'static) -> Self {
        Self(Arc::new(starter))
    }

    /// Starts a thread with this name.
    ///
    /// # Errors
    /// Returns an error if the operating system provides no thread.
    pub fn start(
        &self,
        name: &'static str,
        supervisor: &Supervisor,
        work: impl Work,
    ) -> io::Result<Arc<dyn StartedThread>> {
        self.0.start(SupervisedWork {
            name,
            supervisor: supervisor.clone(),
            restarts: Restarts::default(),
            work: Box::new(work),
        })
    }
}

/// Starts threads of the operating system.
#[derive(Debug)]
struct OsThreads;

/// A thread of the operating system; `None` after it was joined.
#[derive(Debug)]
struct OsThread(Mutex<Option<JoinHandle<()>>>);

impl ThreadStarter for OsThreads {
    fn start(&self, mut work: SupervisedWork) -> io::Result<Arc<dyn StartedThread>> {
        let builder = Builder::new().name(work.name().to_owned());
        let thread = builder.spawn(move || while work.wait_and_work() {})?;
        Ok(Arc::new(OsThread(Mutex::new(Some(thread)))))
    }
}

impl StartedThread for OsThread {
    fn join(&self) {
        let thread = self.0.lock().take();
        if let Some(thread) = thread {
            // joins also a thread that has ended by a panic
            let _ = thread.join();
        }
    }

    fn work_for_caller(&self) -> bool {
        false
    }
}
