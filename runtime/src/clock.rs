//! The clock: the only file of the runtime that reads the time. The clock gives real time, or the time of a simulation.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant, SystemTime};

use parking_lot::Mutex;
use plc_api::handshake::Now;

/// Wall time at the start of a simulation: 2000-01-01T00:00:00Z. A constant, so that equal runs give equal bytes.
const SIMULATION_EPOCH_S: u64 = 946_684_800;

/// Time since the start of the runtime. A clone refers to the same clock.
#[derive(Debug, Clone)]
pub struct Clock(ClockKind);

#[derive(Debug, Clone)]
enum ClockKind {
    Real {
        start: Instant,
        wall: SystemTime,
    },
    Simulated(Arc<SimulatedTime>),
    /// The clock of a tokio executor whose time is paused.
    #[cfg(test)]
    Paused(Arc<PausedTime>),
}

/// Time that advances when all tasks are idle. Each reading also adds a little, so that two readings differ. The sum of
/// these additions is less than 1 ms, the resolution of the executor.
#[cfg(test)]
#[derive(Debug)]
struct PausedTime {
    start: tokio::time::Instant,
    wall: SystemTime,
    last: Mutex<(Duration, Duration)>,
}

#[cfg(test)]
impl PausedTime {
    const READING: Duration = Duration::from_micros(20);

    fn elapsed(&self) -> Duration {
        let elapsed = self.start.elapsed();
        let mut last = self.last.lock();
        let read = if last.0 == elapsed { last.1 } else { Duration::ZERO };
        *last = (elapsed, (read + Self::READING).min(Duration::from_micros(999)));
        elapsed + read
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

/// Returns the time of day. A person may change the system time at any moment, so events are ordered by numbers.
pub(crate) fn time_of_day() -> SystemTime {
    #[cfg(test)]
    if let Some(simulated) = crate::disk::simulated::memory::time_of_day() {
        return simulated;
    }
    SystemTime::now()
}

impl Clock {
    /// Creates a clock of real time that starts now.
    pub fn real() -> Self {
        Self(ClockKind::Real {
            start: Instant::now(),
            wall: SystemTime::now(),
        })
    }

    /// Creates the clock of an executor with paused time. The clock starts now, at the time of day `wall`.
    #[cfg(test)]
    pub fn paused(wall: SystemTime) -> Self {
        Self(ClockKind::Paused(Arc::new(PausedTime {
            start: tokio::time::Instant::now(),
            wall,
            last: Mutex::default(),
        })))
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

    /// Returns true unless the clock gives real time.
    pub fn is_simulated(&self) -> bool {
        !matches!(self.0, ClockKind::Real { .. })
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
        let real = |since_start: Duration, wall: SystemTime| Now {
            monotonic_s: since_start.as_secs_f64(),
            time: wall + since_start,
        };
        match &self.0 {
            ClockKind::Real { start, wall } => real(start.elapsed(), *wall),
            #[cfg(test)]
            ClockKind::Paused(time) => real(time.elapsed(), time.wall),
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
            ClockKind::Real { start, .. } => start.elapsed(),
            #[cfg(test)]
            ClockKind::Paused(time) => time.elapsed(),
            ClockKind::Simulated(time) => time.started.elapsed(),
        }
    }

    /// Sleeps for a duration that is measured by this clock.
    pub async fn sleep(&self, duration: Duration) {
        match &self.0 {
            ClockKind::Real { .. } => tokio::time::sleep(duration).await,
            #[cfg(test)]
            ClockKind::Paused(_) => tokio::time::sleep(duration).await,
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
    pub(crate) fn set_ns(&self, now_ns: u64) {
        if let ClockKind::Simulated(time) = &self.0 {
            time.now_ns.store(now_ns, Ordering::SeqCst);
        }
    }

    /// Wakes every sleeper that is due, and returns true if a sleeper was due. Has an effect in simulated time only.
    pub(crate) fn wake_due(&self) -> bool {
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
    pub(crate) fn next_due_ns(&self) -> Option<u64> {
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
