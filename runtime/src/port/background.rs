//! Work that every client with read access may request, such as the check of a text. It runs at low priority, and its
//! number is limited, in total and for each user, so that readers take a limited share of the processor and no reader
//! delays another one by more than one piece of work.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::Builder;

use parking_lot::Mutex;
use plc_protocol::supervisor::{Consequence, Supervisor};
use plc_protocol::types::request::{Refusal, RefusalCode};
use tandem_store::threads::lower_priority;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::RuntimePort;

/// Maximum number of texts that this process checks at the same time without storing them; further texts wait. Reason:
/// a check takes about ten times the memory of its text and a whole core.
const CHECKS_MAX: usize = 1;

/// Maximum number of searches at the same time: of filtered journal lines, of the state at a line, and intermediate
/// codes; further ones wait. Reason: each takes a whole core.
const SEARCHES_MAX: usize = 2;

pub(super) static CHECKS: BackgroundWork = BackgroundWork::new("check", "check of a text", CHECKS_MAX);
static SEARCHES: BackgroundWork = BackgroundWork::new("search", "search of a reader", SEARCHES_MAX);

/// Threads of low priority for one kind of work.
pub(super) struct BackgroundWork {
    name: &'static str,
    /// Name of the task in reports of faults.
    task: &'static str,
    permits: Semaphore,
    /// The turn of each user who works or waits: a user does one piece of work at a time.
    turns: Mutex<BTreeMap<String, Arc<Semaphore>>>,
}

impl BackgroundWork {
    const fn new(name: &'static str, task: &'static str, most: usize) -> Self {
        Self {
            name,
            task,
            permits: Semaphore::const_new(most),
            turns: Mutex::new(BTreeMap::new()),
        }
    }

    /// Waits for the turn of a user.
    async fn take_turn(&self, user: &str) -> Option<OwnedSemaphorePermit> {
        let turn = {
            let mut turns = self.turns.lock();
            // whoever works or waits shares the turn
            turns.retain(|_, turn| Arc::strong_count(turn) > 1);
            let new = || Arc::new(Semaphore::new(1));
            Arc::clone(turns.entry(user.to_owned()).or_insert_with(new))
        };
        turn.acquire_owned().await.ok()
    }

    /// Does work for a user on a thread of low priority. Only the client that requested this work waits for it.
    ///
    /// # Errors
    /// Returns an error if the operating system provides no thread, or if the work panics.
    pub async fn execute<T: Send + 'static>(
        &'static self,
        supervisor: &Supervisor,
        user: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Refusal> {
        let unavailable = || {
            let text = format!("the {} could not be executed; send the request again", self.name);
            Refusal::new(RefusalCode::Unavailable, text)
        };
        let turn = self.take_turn(user).await;
        let permit = self.permits.acquire().await.map_err(|_| unavailable())?;
        let (sender, done) = oneshot::channel();
        let supervisor = supervisor.clone();
        let thread = Builder::new().name(self.name.into()).spawn(move || {
            lower_priority();
            let done = catch_unwind(AssertUnwindSafe(work));
            drop((permit, turn));
            match done {
                // fails only if the client no longer waits
                Ok(done) => _ = sender.send(done),
                // the client receives the refusal
                Err(panicked) => {
                    supervisor.report_panic(self.task, Consequence::Contained, panicked.as_ref());
                }
            }
        });
        thread.map_err(|_| unavailable())?;
        done.await.map_err(|_| unavailable())
    }
}

impl RuntimePort {
    /// Does work for a user that only reads, in the background; in simulated time, which has only one thread, does it at once.
    ///
    /// # Errors
    /// Returns an error if the operating system provides no thread, or if the work panics.
    pub(super) async fn search<T: Send + 'static>(
        &self,
        user: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Refusal> {
        if self.shared.clock.is_simulated() {
            Ok(work())
        } else {
            SEARCHES.execute(&self.shared.supervisor, user, work).await
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use futures_util::future::join_all;

    use super::*;

    #[tokio::test]
    async fn searches_of_readers_are_limited_and_each_is_done() {
        static RUNNING: AtomicUsize = AtomicUsize::new(0);
        static MOST: AtomicUsize = AtomicUsize::new(0);
        let supervisor = Supervisor::default();
        let readers = ["a", "b", "c", "d", "e", "f", "g", "h"];
        let searches = (0..readers.len()).map(|n| {
            SEARCHES.execute(&supervisor, readers[n], move || {
                let running = RUNNING.fetch_add(1, Ordering::SeqCst) + 1;
                MOST.fetch_max(running, Ordering::SeqCst);
                std::thread::sleep(Duration::from_millis(20));
                RUNNING.fetch_sub(1, Ordering::SeqCst);
                n
            })
        });
        let done: Result<Vec<_>, _> = join_all(searches).await.into_iter().collect();
        assert_eq!(done.unwrap(), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert!(MOST.load(Ordering::SeqCst) <= SEARCHES_MAX);
    }

    #[tokio::test]
    async fn a_reader_with_many_searches_delays_another_by_one_at_most() {
        static WORK: BackgroundWork = BackgroundWork::new("search", "search of a reader", 2);
        let supervisor = Supervisor::default();
        let (release, held) = std::sync::mpsc::channel::<()>();
        let mut held = Some(held);
        // the first search of a reader runs until it is released; the others wait for it
        let mut greedy: Vec<_> = (0..8)
            .map(|_| {
                let held = held.take();
                Box::pin(WORK.execute(&supervisor, "greedy", move || {
                    if let Some(held) = held {
                        _ = held.recv();
                    }
                }))
            })
            .collect();
        for search in &mut greedy {
            assert!(futures_util::poll!(search.as_mut()).is_pending());
        }
        let other = WORK.execute(&supervisor, "other", || 7).await;
        assert_eq!(other.unwrap(), 7, "it waits for none of them");
        drop(release);
        assert!(join_all(greedy).await.iter().all(Result::is_ok));
        WORK.execute(&supervisor, "last", || ()).await.unwrap();
        assert_eq!(WORK.turns.lock().len(), 1, "no turn of an absent reader stays");
    }
}
