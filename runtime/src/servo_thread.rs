//! The servo thread: in real time it keeps the servo period for all coordinate systems in lock-step.
//!
//! The thread itself never allocates, locks or waits for a task. What happened reaches the tasks by way of a relay
//! thread, which it unparks: waking a task takes locks that a servo cycle must not take.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tandem_servo::Servo;
use tokio::sync::Notify;

/// Buckets of the wake-up histogram: bucket `n` counts wake-ups that came 2^n to 2^(n+1) microseconds late.
pub const JITTER_BUCKETS: usize = 16;

/// How punctual the servo thread is. Read at any time.
#[derive(Debug, Default)]
pub struct ServoStatistics {
    /// Servo cycles since the start.
    pub cycles: AtomicU64,
    /// Cycles that began more than one period late.
    pub overruns: AtomicU64,
    /// Latest wake-up so far, ns after its time.
    pub jitter_max_ns: AtomicU64,
    /// Wake-ups by lateness.
    pub jitter: [AtomicU64; JITTER_BUCKETS],
}

impl ServoStatistics {
    fn count(&self, late: Duration, period: Duration) {
        let late_ns = u64::try_from(late.as_nanos()).unwrap_or(u64::MAX);
        self.cycles.fetch_add(1, Ordering::Relaxed);
        self.jitter_max_ns.fetch_max(late_ns, Ordering::Relaxed);
        if late > period {
            self.overruns.fetch_add(1, Ordering::Relaxed);
        }
        let bucket = ((late_ns / 1000).max(1).ilog2() as usize).min(JITTER_BUCKETS - 1);
        self.jitter[bucket].fetch_add(1, Ordering::Relaxed);
    }
}

/// The running servo thread; dropping it stops it.
#[derive(Debug)]
pub struct ServoThread {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    /// How punctual it is.
    pub statistics: Arc<ServoStatistics>,
}

impl ServoThread {
    /// Starts the thread. `wake` are the tasks' signals, one for each coordinate system.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub fn start(mut servo: Servo, period: Duration, wake: Vec<Arc<Notify>>) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let statistics = Arc::new(ServoStatistics::default());
        let relay_stop = Arc::clone(&stop);
        let relay = std::thread::Builder::new()
            .name("servo-relay".into())
            .spawn(move || {
                while !relay_stop.load(Ordering::Acquire) {
                    std::thread::park();
                    for notify in &wake {
                        notify.notify_one();
                    }
                }
            })?;
        let relay_thread = relay.thread().clone();
        let (servo_stop, servo_statistics) = (Arc::clone(&stop), Arc::clone(&statistics));
        let cycles = std::thread::Builder::new().name("servo".into()).spawn(move || {
            let mut next = Instant::now() + period;
            while !servo_stop.load(Ordering::Acquire) {
                let now = Instant::now();
                if now < next {
                    std::thread::sleep(next - now);
                }
                let late = next.elapsed();
                servo_statistics.count(late, period);
                if servo.cycle() {
                    relay_thread.unpark();
                }
                next += period;
                // After a long stall the missed cycles are left out: setpoints must not come in a burst.
                if late > period * 2 {
                    next = Instant::now() + period;
                }
            }
        })?;
        Ok(Self {
            stop,
            threads: vec![cycles, relay],
            statistics,
        })
    }
}

impl Drop for ServoThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            // A panic of the servo thread has been reported by its own message; nothing is left to do here.
            let _ = thread.join();
        }
    }
}
