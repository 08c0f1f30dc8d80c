//! The clock: the only file of the runtime that reads the time. The clock gives real time, the time of a simulation, or
//! the time of another source.

use std::collections::BTreeMap;
use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant, SystemTime};

use parking_lot::Mutex;
use plc_protocol::handshake::Now;

/// Wall time at the start of a simulation: 2000-01-01T00:00:00Z. A constant, so that equal runs give equal bytes.
const SIMULATION_EPOCH_S: u64 = 946_684_800;

/// Time since the start of the runtime. A clone refers to the same clock.
#[derive(Debug, Clone)]
pub struct Clock(ClockKind);

#[derive(Debug, Clone)]
enum ClockKind {
    /// Time of a source. The timers of the executor keep the same time.
    Source {
        source: Arc<dyn TimeSource>,
        /// Time of day at the start of the clock.
        wall: SystemTime,
    },
    Simulated(Arc<SimulatedTime>),
}

/// Source of the time for a clock. The timers of the tokio executor must keep the same time.
pub trait TimeSource: fmt::Debug + Send + Sync {
    /// Returns the time since the source was created. The time never jumps, and never goes back.
    fn elapsed(&self) -> Duration;

    /// Returns the time of day, which may jump and go back.
    fn time_of_day(&self) -> SystemTime;

    /// Returns true if the time also passes while tasks work. If false, the time passes only while all tasks wait: the
    /// runtime then does all work in its tasks, and starts no thread that waits for a time.
    fn is_real(&self) -> bool;
}

/// The time of the operating system.
#[derive(Debug)]
struct OsTime {
    start: Instant,
}

impl TimeSource for OsTime {
    fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    fn time_of_day(&self) -> SystemTime {
        SystemTime::now()
    }

    fn is_real(&self) -> bool {
        true
    }
}

/// State of simulated time. Values that each servo cycle reads are atomics outside the lock.
#[derive(Debug)]
struct SimulatedTime {
    started: Instant,
    now_ns: AtomicU64,
    /// Due time of the first timer in ns; [`NEVER_NS`] if no timer is set.
    next_due_ns: AtomicU64,
    timers: Mutex<Timers>,
}

#[derive(Debug, Default)]
struct Timers {
    by_time: BTreeMap<(u64, u64), Waker>,
    next_id: u64,
}

impl Timers {
    fn pop_due(&mut self, now_ns: u64) -> Option<Waker> {
        let first = self.by_time.first_entry()?;
        (first.key().0 <= now_ns).then(|| first.remove())
    }
}

/// Time in ns that is later than the due time of any sleeper.
const NEVER_NS: u64 = u64::MAX;

impl SimulatedTime {
    fn now_ns(&self) -> u64 {
        self.now_ns.load(Ordering::SeqCst)
    }

    fn next_due_ns(&self) -> u64 {
        self.next_due_ns.load(Ordering::SeqCst)
    }

    /// Changes the timers, and updates the due time of the first timer.
    fn change<T>(&self, change: impl FnOnce(&mut Timers) -> T) -> T {
        // The lock is also usable after another thread has panicked; the timers in it are complete.
        let mut timers = self.timers.lock();
        let changed = change(&mut timers);
        let first = timers.by_time.keys().next();
        let next_due_ns = first.map_or(NEVER_NS, |(at_ns, _)| *at_ns);
        self.next_due_ns.store(next_due_ns, Ordering::SeqCst);
        changed
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::real()
    }
}

impl Clock {
    /// Creates a clock of real time that starts now.
    pub fn real() -> Self {
        Self::from_source(OsTime {
            start: Instant::now(),
        })
    }

    /// Creates a clock from a source that was created at the start of the clock.
    pub fn from_source(source: impl TimeSource + 'static) -> Self {
        Self(ClockKind::Source {
            wall: source.time_of_day(),
            source: Arc::new(source),
        })
    }

    /// Creates a clock of simulated time that starts at 0.
    pub fn simulated() -> Self {
        Self(ClockKind::Simulated(Arc::new(SimulatedTime {
            started: Instant::now(),
            now_ns: AtomicU64::new(0),
            next_due_ns: AtomicU64::new(NEVER_NS),
            timers: Mutex::default(),
        })))
    }

    /// Returns true if the time passes only while all tasks wait.
    pub fn is_simulated(&self) -> bool {
        match &self.0 {
            ClockKind::Source { source, .. } => !source.is_real(),
            ClockKind::Simulated(_) => true,
        }
    }

    /// Returns the time of day of the system. A person may change it at any moment, so events are ordered by numbers.
    pub fn time_of_day(&self) -> SystemTime {
        match &self.0 {
            ClockKind::Source { source, .. } => source.time_of_day(),
            ClockKind::Simulated(_) => self.wall(),
        }
    }

    /// Returns the seconds since the start of the clock.
    pub fn now_s(&self) -> f64 {
        self.now().monotonic_s
    }

    /// Returns the wall time (time of day) of the clock.
    pub fn wall(&self) -> SystemTime {
        self.now().time
    }

    /// Returns the time since the start of the clock, and the wall time of the same moment.
    pub fn now(&self) -> Now {
        match &self.0 {
            ClockKind::Source { source, wall } => {
                let since_start = source.elapsed();
                Now {
                    monotonic_s: since_start.as_secs_f64(),
                    time: *wall + since_start,
                }
            }
            ClockKind::Simulated(time) => {
                let now_ns = time.now_ns();
                let epoch = SystemTime::UNIX_EPOCH + Duration::from_secs(SIMULATION_EPOCH_S);
                Now {
                    monotonic_s: now_ns as f64 / 1e9,
                    time: epoch + Duration::from_nanos(now_ns),
                }
            }
        }
    }

    /// Returns the real time since the start of the clock, even if the clock is simulated. Real time never stops and
    /// never jumps.
    pub fn real_time(&self) -> Duration {
        match &self.0 {
            ClockKind::Source { source, .. } => source.elapsed(),
            ClockKind::Simulated(time) => time.started.elapsed(),
        }
    }

    /// Sleeps for a duration that is measured by this clock.
    pub async fn sleep(&self, duration: Duration) {
        match &self.0 {
            ClockKind::Source { .. } => tokio::time::sleep(duration).await,
            ClockKind::Simulated(time) => {
                let duration_ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
                let deadline_ns = time.now_ns().saturating_add(duration_ns).min(NEVER_NS - 1);
                Sleep {
                    time: Arc::clone(time),
                    deadline_ns,
                    id: None,
                }
                .await;
            }
        }
    }

    /// Waits for the result of `work` for at most `limit`. Returns `None` if the result has not arrived by then. The
    /// limit is in real time even in a simulation, because the result may never arrive.
    pub async fn within_real<T>(&self, limit: Duration, work: impl Future<Output = T>) -> Option<T> {
        if !matches!(self.0, ClockKind::Simulated(_)) {
            return tokio::time::timeout(limit, work).await.ok();
        }
        // the executor of a simulation has no timer of its own
        let (done, is_done) = std::sync::mpsc::channel::<()>();
        let (late, is_late) = tokio::sync::oneshot::channel();
        let limited = std::thread::spawn(move || {
            let _done = is_done.recv_timeout(limit);
            let _nobody_waits = late.send(());
        });
        let ended = tokio::select! {
            biased;
            ended = work => Some(ended),
            _ = is_late => None,
        };
        drop((done, limited));
        ended
    }

    /// Sleeps until `at_s` seconds after the start of the clock.
    pub async fn sleep_until_s(&self, at_s: f64) {
        let left_s = (at_s - self.now_s()).clamp(0.0, 1e9);
        self.sleep(Duration::from_secs_f64(left_s)).await;
    }

    /// Sets the time. Has an effect in simulated time only.
    pub fn set_ns(&self, now_ns: u64) {
        if let ClockKind::Simulated(time) = &self.0 {
            time.now_ns.store(now_ns, Ordering::SeqCst);
        }
    }

    /// Wakes every sleeper that is due, and returns true if a sleeper was due. Has an effect in simulated time only.
    pub fn wake_due(&self) -> bool {
        let ClockKind::Simulated(time) = &self.0 else {
            return false;
        };
        let now_ns = time.now_ns();
        let mut woken = false;
        while time.next_due_ns() <= now_ns
            && let Some(waker) = time.change(|timers| timers.pop_due(now_ns))
        {
            waker.wake();
            woken = true;
        }
        woken
    }

    /// Returns the due time of the next sleeper in ns; `None` without a sleeper or in real time.
    pub fn next_due_ns(&self) -> Option<u64> {
        let ClockKind::Simulated(time) = &self.0 else {
            return None;
        };
        Some(time.next_due_ns()).filter(|at_ns| *at_ns != NEVER_NS)
    }
}

struct Sleep {
    time: Arc<SimulatedTime>,
    deadline_ns: u64,
    id: Option<u64>,
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let Sleep {
            time,
            deadline_ns,
            id,
        } = &mut *self;
        if time.now_ns() >= *deadline_ns {
            return Poll::Ready(());
        }
        time.change(|timers| {
            let id = *id.get_or_insert_with(|| {
                timers.next_id += 1;
                timers.next_id
            });
            timers.by_time.insert((*deadline_ns, id), context.waker().clone());
        });
        // The deadline may have passed before the timer was registered.
        if time.now_ns() >= *deadline_ns {
            return Poll::Ready(());
        }
        Poll::Pending
    }
}

impl Drop for Sleep {
    fn drop(&mut self) {
        if let Some(id) = self.id {
            let timer = (self.deadline_ns, id);
            self.time.change(|timers| timers.by_time.remove(&timer));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn sleepers_wake_in_the_order_of_their_times() {
        let clock = Clock::simulated();
        let (first, second) = (clock.clone(), clock.clone());
        let late = tokio::spawn(async move {
            second.sleep(Duration::from_millis(20)).await;
            second.now_s()
        });
        let early = tokio::spawn(async move {
            first.sleep(Duration::from_millis(10)).await;
            first.now_s()
        });
        tokio::task::yield_now().await;
        while let Some(at_ns) = clock.next_due_ns() {
            clock.set_ns(at_ns);
            assert!(clock.wake_due());
            tokio::task::yield_now().await;
        }
        assert_eq!((early.await.ok(), late.await.ok()), (Some(0.01), Some(0.02)));
    }

    #[tokio::test]
    async fn a_dropped_sleeper_leaves_no_timer() {
        let clock = Clock::simulated();
        let sleep = clock.sleep(Duration::from_secs(1));
        assert!(futures_util::future::FutureExt::now_or_never(sleep).is_none());
        assert_eq!(clock.next_due_ns(), None);
    }
}
