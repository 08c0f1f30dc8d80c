//! Whether what runs in a test stands still in real time, such as in a sleep of the standard library: simulated time does not pass
//! meanwhile.

use std::fs::read_to_string;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::time::{Duration, Instant};

/// A thread that neither works nor waits for the processor for so long, within one step, is told. Reason: a step reads a file now and
/// then, which takes its time on a busy disk.
const STANDS_MIN: Duration = Duration::from_millis(400);

/// How old the beginning of a measurement may be.
const AGE_MAX: Duration = Duration::from_millis(20);

/// A moment of this thread.
struct Moment {
    at: Instant,
    /// How long it had worked or waited for the processor; `None`: this computer does not tell.
    busy: Option<Duration>,
}

impl Moment {
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

    /// How long the thread has stood still since.
    fn stood(&self) -> Option<Duration> {
        let now = Self::now();
        let busy = now.busy?.saturating_sub(self.busy?);
        Some((now.at - self.at).saturating_sub(busy))
    }
}

/// Does some work, and tells when a step of it has stood still, and for how long.
pub(super) async fn watched<T>(work: impl Future<Output = T>, mut stands: impl FnMut(Duration)) -> T {
    let mut work = pin!(work);
    let mut begin = Moment::now();
    poll_fn(move |context| {
        let at = Instant::now();
        if at - begin.at > AGE_MAX {
            begin = Moment::now();
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
