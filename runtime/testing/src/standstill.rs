//! Detects code in a test that blocks in real time, such as a sleep of the standard library. Simulated time
//! does not advance while such code blocks.

use std::fs::read_to_string;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::time::{Duration, Instant};

/// Time for which a step must block before it is reported; time in which the thread works or waits for the
/// processor does not count. Reason: a step sometimes reads a file, which may take long on a busy disk.
const STANDS_MIN: Duration = Duration::from_millis(400);

/// Maximum age of the start of a measurement.
const AGE_MAX: Duration = Duration::from_millis(20);

/// Real time and processor time of this thread at one moment.
struct ThreadMoment {
    at: Instant,
    /// Time for which the thread had worked or waited for the processor; `None` if the operating system does
    /// not report this time.
    busy: Option<Duration>,
}

impl ThreadMoment {
    fn now() -> Self {
        let told = read_to_string("/proc/thread-self/schedstat").ok();
        let worked_and_waited = told.as_deref().and_then(|told| {
            let mut times = told.split(' ').map(|ns| ns.parse::<u64>().ok());
            Some(times.next()?? + times.next()??)
        });
        Self {
            at: Instant::now(),
            busy: worked_and_waited.map(Duration::from_nanos),
        }
    }

    /// Returns the time for which the thread has been blocked since this moment.
    fn stood(&self) -> Option<Duration> {
        let now = Self::now();
        let busy = now.busy?.saturating_sub(self.busy?);
        Some((now.at - self.at).saturating_sub(busy))
    }
}

/// Runs work, and calls `stands` for each step that has blocked, with the duration.
pub(super) async fn watched<T>(work: impl Future<Output = T>, mut stands: impl FnMut(Duration)) -> T {
    let mut work = pin!(work);
    let mut begin = ThreadMoment::now();
    poll_fn(move |context| {
        let at = Instant::now();
        if at - begin.at > AGE_MAX {
            begin = ThreadMoment::now();
        }
        let done = work.as_mut().poll(context);
        if at.elapsed() >= STANDS_MIN
            && let Some(stood) = begin.stood().filter(|stood| *stood >= STANDS_MIN)
        {
            stands(stood);
        }
        done
    })
    .await
}
