//! Detects code in a test that blocks in real time, such as in a sleep of the standard library: simulated
//! time does not advance meanwhile.

use std::fs::read_to_string;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::time::{Duration, Instant};

/// Time in one step after which a thread that neither works nor waits for the processor is reported. Reason:
/// a step sometimes reads a file, which may take long on a busy disk.
const STANDS_MIN: Duration = Duration::from_millis(400);

/// Maximum age of the beginning of a measurement.
const AGE_MAX: Duration = Duration::from_millis(20);

/// A moment of this thread.
struct ThreadMoment {
    at: Instant,
    /// Time for which the thread had worked or waited for the processor; `None` if the operating system does
    /// not report it.
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

    /// Returns the time for which the thread has been blocked since then.
    fn stood(&self) -> Option<Duration> {
        let now = Self::now();
        let busy = now.busy?.saturating_sub(self.busy?);
        Some((now.at - self.at).saturating_sub(busy))
    }
}

/// Runs work, and reports each step that has been blocked, with the duration.
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
