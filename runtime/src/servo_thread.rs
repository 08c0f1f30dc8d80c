//! The servo thread. In real time it executes the servo cycles of all coordinate systems in lock-step, once per period.
//!
//! The thread never allocates, locks or waits for a task. A relay thread, which the servo thread unparks, passes events
//! to the tasks; reason: waking a task takes locks. The servo thread runs with real-time priority if the operating
//! system allows this. The relay thread also watches the servo thread: a panic, or a cycle that does not end, is a
//! failure of the servo. After a failure nothing moves.

mod stall_watch;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use plc_protocol::server::{Durations, ServoTiming};
use plc_protocol::supervisor::panic_text;
use tandem_servo::{Cutoff, Servo};

use stall_watch::{LOOK_EVERY, StallWatch, record_thread_folder};

/// Maximum time for which a stop waits for the threads. Reason: a call of the bus may block the servo thread.
const JOIN_MAX: Duration = Duration::from_secs(1);

/// Real-time priority of the servo thread, from 0 to 99. The value is above the processes of a desktop or server, and
/// below the kernel's own work.
const PRIORITY: u8 = 80;

/// Number of buckets of a histogram. Bucket `n` counts times from 2^n to 2^(n+1) microseconds; the first bucket
/// includes all shorter times, the last one all longer times.
pub const JITTER_BUCKETS: usize = 16;

/// Statistics of the punctuality of the servo thread. Any thread can read them at any time.
#[derive(Debug, Default)]
pub struct ServoStatistics {
    /// Servo cycles since the start.
    pub cycles: AtomicU64,
    /// Cycles that were not finished when the next cycle was due, including omitted cycles.
    pub overruns: AtomicU64,
    /// Cycles omitted because the servo was late by more than two periods.
    pub missed: AtomicU64,
    /// Exchanges with the drives that ended late.
    pub late_exchanges: AtomicU64,
    /// Frames to the drives that were lost.
    pub lost_frames: AtomicU64,
    /// Delay of the start of each cycle after its due time.
    pub lateness: DurationHistogram,
    /// Computing time of each cycle.
    pub computing: DurationHistogram,
    /// Cycles that have begun. One more than `cycles` while a cycle runs.
    pub begun: AtomicU64,
    /// Reason of the servo's failure, if it has failed. After a failure nothing moves.
    failure: OnceLock<String>,
}

/// Histogram of measured times.
#[derive(Debug, Default)]
pub struct DurationHistogram {
    /// Longest time so far in ns.
    pub max_ns: AtomicU64,
    /// Sum of all times in ns.
    pub sum_ns: AtomicU64,
    /// Number of times in each bucket.
    pub buckets: [AtomicU64; JITTER_BUCKETS],
}

impl DurationHistogram {
    fn count(&self, time: Duration) {
        let time_ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.max_ns.fetch_max(time_ns, Ordering::Relaxed);
        self.sum_ns.fetch_add(time_ns, Ordering::Relaxed);
        let bucket = ((time_ns / 1000).max(1).ilog2() as usize).min(JITTER_BUCKETS - 1);
        self.buckets[bucket].fetch_add(1, Ordering::Relaxed);
    }

    fn durations(&self) -> Durations {
        let bound_s = |n: usize| {
            if n + 1 < JITTER_BUCKETS {
                f64::from(2_u32 << n) / 1e6
            } else {
                f64::INFINITY
            }
        };
        let counts = self.buckets.iter().map(|bucket| bucket.load(Ordering::Relaxed));
        Durations {
            buckets: counts.enumerate().map(|(n, count)| (bound_s(n), count)).collect(),
            sum_s: self.sum_ns.load(Ordering::Relaxed) as f64 / 1e9,
            max_s: self.max_ns.load(Ordering::Relaxed) as f64 / 1e9,
        }
    }
}

impl ServoStatistics {
    /// Records a failure of the servo. Only the first reason is kept.
    pub(crate) fn fail(&self, why: &str) {
        self.failure.get_or_init(|| why.to_owned());
    }

    /// Returns the reason of the servo's failure; `None` if it has not failed.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }

    /// Returns the number of the running cycle; `None` between two cycles.
    pub(crate) fn running_cycle(&self) -> Option<u64> {
        let begun = self.begun.load(Ordering::Relaxed);
        (begun != self.cycles.load(Ordering::Relaxed)).then_some(begun)
    }

    fn count(&self, begin: Begin, computing: Duration, period: Duration) {
        self.cycles.fetch_add(1, Ordering::Relaxed);
        self.lateness.count(begin.late);
        self.computing.count(computing);
        let overruns = begin.missed + u64::from(begin.late + computing > period);
        if overruns > 0 {
            self.overruns.fetch_add(overruns, Ordering::Relaxed);
            self.missed.fetch_add(begin.missed, Ordering::Relaxed);
        }
    }

    /// Returns the statistics in the form that server ends use.
    pub(crate) fn timing(&self, period: Duration) -> ServoTiming {
        ServoTiming {
            period_s: period.as_secs_f64(),
            overruns: self.overruns.load(Ordering::Relaxed),
            missed: self.missed.load(Ordering::Relaxed),
            late_exchanges: self.late_exchanges.load(Ordering::Relaxed),
            lost_frames: self.lost_frames.load(Ordering::Relaxed),
            lateness: self.lateness.durations(),
            computing: self.computing.durations(),
        }
    }
}

/// Due times of servo cycles. Pure: the caller passes the time.
#[derive(Debug)]
struct Timetable {
    period: Duration,
    /// Due time of the next cycle.
    next: Instant,
}

/// Timing of the start of a cycle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Begin {
    /// Delay after its due time.
    late: Duration,
    /// Number of earlier cycles that are omitted because they are overdue.
    missed: u64,
}

impl Timetable {
    /// Begins the cycle that is due. After a delay of up to two periods the next cycles follow sooner. After a longer
    /// delay the overdue cycles are omitted, because setpoints must not come in a burst.
    fn begin_cycle(&mut self, now: Instant) -> Begin {
        let late = now.saturating_duration_since(self.next);
        let mut missed = 0;
        self.next += self.period;
        if late > self.period * 2 {
            let periods = late.as_nanos() / self.period.as_nanos();
            missed = u64::try_from(periods).unwrap_or(u64::MAX);
            self.next += Duration::from_nanos_u128(periods * self.period.as_nanos());
        }
        Begin { late, missed }
    }
}

/// Executes a servo cycle after `missed` omitted cycles. If these are more than `missed_max`, motion is held. A panic
/// of the servo, the bus or a spindle is a failure of the servo, after which each cycle commands no power. Returns the
/// result of [`Servo::cycle`].
pub(crate) fn cycle_after(
    servo: &mut Servo,
    missed: u64,
    missed_max: u64,
    statistics: &ServoStatistics,
) -> bool {
    if statistics.failure().is_some() {
        servo.power_off();
        return false;
    }
    let cycled = catch_unwind(AssertUnwindSafe(|| {
        if missed > missed_max {
            servo.cycle_after_missed(missed)
        } else {
            servo.cycle()
        }
    }));
    cycled.unwrap_or_else(|panicked| {
        let text = panic_text(panicked.as_ref());
        statistics.fail(&format!(
            "a servo cycle, the bus to the drives or a spindle panicked: {text}"
        ));
        servo.power_off();
        true
    })
}

/// Executes several cycles at once by [`Servo::pass`]. A panic is a failure of the servo.
pub(crate) fn pass(servo: &mut Servo, cycles: u64, statistics: &ServoStatistics) {
    if let Err(panicked) = catch_unwind(AssertUnwindSafe(|| servo.pass(cycles))) {
        statistics.fail(&format!(
            "the bus to the drives or a spindle panicked: {}",
            panic_text(panicked.as_ref())
        ));
    }
}

/// Functions that the relay thread calls to report events of the servo thread.
pub(crate) struct RelayCallbacks<W, F> {
    /// Called after a cycle has emitted an event.
    pub wake: W,
    /// Called once when the servo has failed, with the reason as text.
    pub failed: F,
}

/// The running servo thread and its relay thread. Dropping this value stops both.
#[derive(Debug)]
pub struct ServoThread {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl ServoThread {
    /// Starts the threads; the servo thread counts its cycles in `statistics`. If more than `missed_max` cycles in a
    /// row are omitted, motion is held.
    ///
    /// # Errors
    /// Returns an error if the operating system provides no thread.
    pub(crate) fn start<W, F>(
        mut servo: Servo,
        period: Duration,
        missed_max: u64,
        told: RelayCallbacks<W, F>,
        statistics: Arc<ServoStatistics>,
    ) -> std::io::Result<Self>
    where
        W: Fn() + Send + 'static,
        F: Fn(&str) + Send + 'static,
    {
        let stop = Arc::new(AtomicBool::new(false));
        let has_events = Arc::new(AtomicBool::new(false));
        let place = Arc::new(OnceLock::new());
        let relay = Relay {
            stop: Arc::clone(&stop),
            has_events: Arc::clone(&has_events),
            statistics: Arc::clone(&statistics),
            watch: StallWatch::new(Arc::clone(&place)),
            cutoff: servo.cutoff(),
            told,
        };
        let relay = std::thread::Builder::new()
            .name("servo-relay".into())
            .spawn(move || relay.run())?;
        let relay_thread = relay.thread().clone();
        let servo_stop = Arc::clone(&stop);
        let cycles = std::thread::Builder::new().name("servo".into()).spawn(move || {
            ask_for_real_time();
            record_thread_folder(&place);
            let mut timetable = Timetable {
                period,
                next: Instant::now() + period,
            };
            while !servo_stop.load(Ordering::Acquire) {
                let now = Instant::now();
                if now < timetable.next {
                    std::thread::sleep(timetable.next - now);
                }
                let begun = Instant::now();
                let begin = timetable.begin_cycle(begun);
                statistics.begun.fetch_add(1, Ordering::Relaxed);
                let told = cycle_after(&mut servo, begin.missed, missed_max, &statistics);
                let counts = servo.bus_counts();
                statistics.late_exchanges.store(counts.late, Ordering::Relaxed);
                statistics.lost_frames.store(counts.lost, Ordering::Relaxed);
                statistics.count(begin, begun.elapsed(), period);
                if told {
                    has_events.store(true, Ordering::Release);
                    relay_thread.unpark();
                }
            }
        })?;
        Ok(Self {
            stop,
            threads: vec![cycles, relay],
        })
    }
}

/// The relay thread: wakes the tasks on behalf of the servo thread, and watches the servo thread.
struct Relay<W, F> {
    stop: Arc<AtomicBool>,
    has_events: Arc<AtomicBool>,
    statistics: Arc<ServoStatistics>,
    watch: StallWatch,
    cutoff: Option<Cutoff>,
    told: RelayCallbacks<W, F>,
}

impl<W: Fn(), F: Fn(&str)> Relay<W, F> {
    fn run(mut self) {
        while !self.stop.load(Ordering::Acquire) {
            std::thread::park_timeout(LOOK_EVERY);
            // without the relay, motion would continue without its tasks, so its panic is a failure of the servo
            if let Err(panicked) = catch_unwind(AssertUnwindSafe(|| self.look())) {
                let text = panic_text(panicked.as_ref());
                self.statistics
                    .fail(&format!("the relay of the servo panicked: {text}"));
            }
            if let Some(why) = self.statistics.failure() {
                return self.report(why);
            }
        }
    }

    fn look(&mut self) {
        let running = self.statistics.running_cycle();
        if let Some(after) = self.watch.find_stall(Instant::now(), running) {
            self.statistics.fail(&format!(
                "a servo cycle has not ended for {} ms: the bus to the drives or a spindle does not return",
                after.as_millis()
            ));
        }
        if self.has_events.swap(false, Ordering::AcqRel) {
            (self.told.wake)();
        }
    }

    fn report(&self, why: &str) {
        // separate calls, so that a panic of one callback does not prevent the other
        if let Some(cutoff) = &self.cutoff {
            let _ = catch_unwind(AssertUnwindSafe(cutoff));
        }
        let _ = catch_unwind(AssertUnwindSafe(|| (self.told.failed)(why)));
    }
}

/// Requests real-time scheduling of the calling thread (first in, first out, before all ordinary threads). Without the
/// permission, the thread continues as an ordinary thread.
#[cfg(unix)]
fn ask_for_real_time() {
    use thread_priority::unix::{
        RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
    };
    use thread_priority::{ThreadPriority, ThreadPriorityValue};

    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let asked = ThreadPriorityValue::try_from(PRIORITY).and_then(|priority| {
        let priority = ThreadPriority::Crossplatform(priority);
        set_thread_priority_and_policy(thread_native_id(), priority, policy)
            .map_err(|error| error.to_string())
    });
    match asked {
        Ok(()) => tracing::debug!("the servo thread has real-time priority"),
        Err(error) => tracing::info!(
            error,
            "the servo thread has no real-time priority and may be late under load; allow it with \
             `setcap cap_sys_nice+ep` on the program, or an rtprio limit"
        ),
    }
}

/// Does nothing: other operating systems do not always grant such a priority.
#[cfg(not(unix))]
fn ask_for_real_time() {}

impl Drop for ServoThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let until = Instant::now() + JOIN_MAX;
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            while !thread.is_finished() && Instant::now() < until {
                std::thread::sleep(Duration::from_millis(1));
            }
            // a thread that a call of the bus blocks is not joined; it ends with the process
            if thread.is_finished() {
                let _ = thread.join();
            }
        }
    }
}

#[cfg(test)]
mod tests;
