//! A limit on how often something may happen.

use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use tokio::time::Instant;

/// So many at once, and so many a second after that.
#[derive(Debug)]
pub(crate) struct Rate {
    burst: f64,
    per_second: f64,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    left: f64,
    since: Instant,
}

impl Rate {
    pub(crate) fn new(burst: u32, per_second: u32) -> Self {
        let burst = f64::from(burst);
        let state = State {
            left: burst,
            since: Instant::now(),
        };
        Self {
            burst,
            per_second: f64::from(per_second),
            state: Mutex::new(state),
        }
    }

    /// Counts one more. An error is the time after which there is room again; then nothing is counted.
    pub(crate) fn take(&self) -> Result<(), Duration> {
        let mut state = self.refilled();
        if state.left < 1.0 {
            return Err(Duration::from_secs_f64((1.0 - state.left) / self.per_second));
        }
        state.left -= 1.0;
        Ok(())
    }

    /// Counts one more, whether there is room or not: the time after which the debt is paid.
    pub(crate) fn owe(&self) -> Duration {
        let mut state = self.refilled();
        state.left -= 1.0;
        Duration::from_secs_f64((-state.left).max(0.0) / self.per_second)
    }

    fn refilled(&self) -> MutexGuard<'_, State> {
        let mut state = self.state.lock();
        let now = Instant::now();
        let gained = now.duration_since(state.since).as_secs_f64() * self.per_second;
        state.left = (state.left + gained).min(self.burst);
        state.since = now;
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn so_many_at_once_and_so_many_a_second_after_that() {
        let rate = Rate::new(3, 2);
        assert_eq!([(); 3].map(|()| rate.take()), [Ok(()); 3]);
        assert_eq!(rate.take(), Err(Duration::from_millis(500)));
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!([(); 2].map(|()| rate.take()), [Ok(()); 2]);
        assert!(rate.take().is_err());
        tokio::time::advance(Duration::from_mins(1)).await;
        assert_eq!([(); 4].map(|()| rate.take().is_ok()), [true, true, true, false]);
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_owed_is_waited_for() {
        let rate = Rate::new(1, 10);
        assert_eq!(rate.owe(), Duration::ZERO);
        assert_eq!(rate.owe(), Duration::from_millis(100));
        assert_eq!(rate.owe(), Duration::from_millis(200));
    }
}
