//! The clock of a simulated world.

use std::time::{Duration, SystemTime};

use parking_lot::Mutex;
use tokio::time::Instant;

use tandem_store::environment::TimeSource;
use tandem_testing::simulated_disk::SimulatedDisk;

/// Time of an executor whose time is paused: it advances when all tasks are idle. Each reading also adds a little, so
/// that two readings differ. The sum of these additions is less than 1 ms, the resolution of the executor.
#[derive(Debug)]
pub(super) struct PausedTime {
    start: Instant,
    /// Disk whose model contains the time of day.
    disk: SimulatedDisk,
    /// Time of the last reading without additions, and its additions.
    last: Mutex<(Duration, Duration)>,
}

impl PausedTime {
    const READING: Duration = Duration::from_micros(20);

    /// Creates a source that starts now.
    pub fn new(disk: SimulatedDisk) -> Self {
        Self {
            start: Instant::now(),
            disk,
            last: Mutex::default(),
        }
    }
}

impl TimeSource for PausedTime {
    fn elapsed(&self) -> Duration {
        let elapsed = self.start.elapsed();
        let mut last = self.last.lock();
        let read = if last.0 == elapsed { last.1 } else { Duration::ZERO };
        *last = (elapsed, (read + Self::READING).min(Duration::from_micros(999)));
        elapsed + read
    }

    fn time_of_day(&self) -> SystemTime {
        self.disk.lock().now
    }

    fn is_real(&self) -> bool {
        false
    }
}
