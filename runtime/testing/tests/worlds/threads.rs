//! The threads of a simulated process, as tasks.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::task::AbortHandle;

use tandem_store::environment::{StartedThread, SupervisedWork, ThreadStarter};

/// All threads of a simulated process, including those that have ended. A clone refers to the same process.
#[derive(Debug, Clone, Default)]
pub(super) struct SimulatedThreads(Arc<Mutex<Vec<SimulatedThread>>>);

/// A thread whose rounds a task executes.
#[derive(Debug, Clone)]
struct SimulatedThread {
    task: AbortHandle,
    work: Arc<Mutex<SupervisedWork>>,
}

impl SimulatedThreads {
    /// Stops all threads, because their process ends.
    pub fn stop(&self) {
        for thread in self.0.lock().drain(..) {
            thread.task.abort();
        }
    }
}

impl ThreadStarter for SimulatedThreads {
    fn start(&self, work: SupervisedWork) -> io::Result<Arc<dyn StartedThread>> {
        let work = Arc::new(Mutex::new(work));
        let of_task = Arc::clone(&work);
        let task = tokio::spawn(async move {
            loop {
                let pause = of_task.lock().delay();
                tokio::time::sleep(pause.max(Duration::from_millis(1))).await;
                if !of_task.lock().work_now() {
                    return;
                }
            }
        });
        let thread = SimulatedThread {
            task: task.abort_handle(),
            work,
        };
        self.0.lock().push(thread.clone());
        Ok(Arc::new(thread))
    }
}

impl StartedThread for SimulatedThread {
    fn join(&self) {
        // In this round the work finds that the thread must end.
        self.work.lock().work_for_caller();
    }

    fn work_for_caller(&self) -> bool {
        self.work.lock().work_for_caller();
        true
    }
}
