//! Work in the background of a test, and the failures of that work that end the test.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::FutureExt;
use parking_lot::Mutex;
use tokio::sync::Notify;

use super::TestError;
use super::standstill::watched;

/// Text that a panic of tokio contains if code in a test uses a socket of tokio.
const FOREIGN: &str = "IO is disabled";

/// Advice in error texts: the replacement for real hardware.
const MODEL: &str = "replace it by a model (Bench::plant)";

/// Returns true if the text of a panic or an alarm shows that code has used a socket.
pub(super) fn is_foreign(text: &str) -> bool {
    text.contains(FOREIGN)
}

/// Returns the error of a test in which `what` used a socket.
pub(super) fn socket_error(what: &str) -> TestError {
    TestError::new(format!(
        "{what} used a socket, and simulated time does not wait for a network: {MODEL}"
    ))
}

/// Returns the error of a test in which `what` blocked in real time.
fn standstill_error(what: &str, stood: Duration) -> TestError {
    TestError::new(format!(
        "{what} was blocked for {:.1} s of real time, by std::thread::sleep, a lock or a blocking call, and \
         simulated time did not \
         advance meanwhile: wait by plc.sleep(..).await, or {MODEL}",
        stood.as_secs_f64()
    ))
}

enum BackgroundFailure {
    Error(TestError),
    Panic(Box<dyn Any + Send>),
}

/// The first failure in the background of a test.
#[derive(Clone, Default)]
pub(super) struct Failures {
    first: Arc<Mutex<Option<BackgroundFailure>>>,
    noted: Arc<Notify>,
    other_thread: Arc<AtomicBool>,
}

impl std::fmt::Debug for Failures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Failures").finish_non_exhaustive()
    }
}

impl Failures {
    /// Records that background work has ended with an error.
    pub(super) fn error(&self, error: TestError) {
        self.record_failure(BackgroundFailure::Error(error));
    }

    /// Records that background work has panicked.
    pub(super) fn panicked(&self, what: &str, panic: Box<dyn Any + Send>) {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        match text {
            Some(text) if is_foreign(text) => self.error(socket_error(what)),
            _ => self.record_failure(BackgroundFailure::Panic(panic)),
        }
    }

    fn record_failure(&self, failure: BackgroundFailure) {
        self.first.lock().get_or_insert(failure);
        self.noted.notify_one();
    }

    /// Records that work runs on a thread with its own clock.
    pub(super) fn on_other_thread(&self) {
        self.other_thread.store(true, Ordering::SeqCst);
    }

    /// Waits until background work has failed.
    pub(super) async fn noted(&self) {
        self.noted.notified().await;
    }

    /// Runs work concurrently with the test; if the work fails, the test fails.
    pub(super) async fn watch(self, what: &str, work: impl Future<Output = plc_api::Result<()>>) {
        let work = watched(work, |stood| self.error(standstill_error(what, stood)));
        match AssertUnwindSafe(work).catch_unwind().await {
            Ok(Ok(())) => {}
            Ok(Err(error)) if is_foreign(&error.to_string()) => self.error(socket_error(what)),
            Ok(Err(error)) => self.error(TestError::new(format!("{what} ended: {error}"))),
            Err(panic) => self.panicked(what, panic),
        }
    }

    /// Reports the first failure of background work.
    ///
    /// # Errors
    /// Returns an error if background work has failed.
    ///
    /// # Panics
    /// Panics if background work has panicked.
    pub(super) fn raise_failure(&self) -> Result<(), TestError> {
        match self.first.lock().take() {
            Some(BackgroundFailure::Error(error)) => return Err(error),
            Some(BackgroundFailure::Panic(panic)) => std::panic::resume_unwind(panic),
            None => {}
        }
        if self.other_thread.load(Ordering::SeqCst) {
            return Err(TestError::new(format!(
                "some work runs on another thread, by spawn_blocking, tokio::fs or a name lookup, and \
                 simulated time does not \
                 wait for it: call it directly if it is short, or {MODEL}"
            )));
        }
        Ok(())
    }
}
