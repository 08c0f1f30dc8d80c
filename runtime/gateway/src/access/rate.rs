//! Rate limits.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use tokio::time::Instant;

/// A token bucket: a burst, refilled at a rate per second.
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
    pub(crate) fn new(burst: u32, per_second: impl Into<f64>) -> Self {
        let burst = f64::from(burst);
        let state = State {
            left: burst,
            since: Instant::now(),
        };
        Self {
            burst,
            per_second: per_second.into(),
            state: Mutex::new(state),
        }
    }

    /// Counts one more. The error is the time until there is room again; then nothing is counted.
    pub(crate) fn take(&self) -> Result<(), Duration> {
        let mut state = self.refilled();
        if state.left < 1.0 {
            return Err(Duration::from_secs_f64((1.0 - state.left) / self.per_second));
        }
        state.left -= 1.0;
        Ok(())
    }

    /// Counts one more even without room. Returns how long the caller must wait to keep to the rate.
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

/// One [`Rate`] per key. With more than `KEYS_MAX` keys all of them start afresh, so that memory stays bounded.
#[derive(Debug)]
pub(crate) struct Rates<K> {
    burst: u32,
    per_second: f64,
    by_key: Mutex<HashMap<K, Arc<Rate>>>,
}

/// Keys of one [`Rates`]. Reason: more than the tokens of a file and than the clients of the broker.
const KEYS_MAX: usize = 1024;

impl<K: Clone + Eq + Hash> Rates<K> {
    pub(crate) fn new(burst: u32, per_second: impl Into<f64>) -> Self {
        Self {
            burst,
            per_second: per_second.into(),
            by_key: Mutex::default(),
        }
    }

    /// The rate of a key.
    pub(crate) fn of(&self, key: &K) -> Arc<Rate> {
        let mut by_key = self.by_key.lock();
        if by_key.len() >= KEYS_MAX && !by_key.contains_key(key) {
            by_key.clear();
        }
        let new = || Arc::new(Rate::new(self.burst, self.per_second));
        Arc::clone(by_key.entry(key.clone()).or_insert_with(new))
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

    #[tokio::test(start_paused = true)]
    async fn each_key_has_a_rate_of_its_own_and_their_number_is_bounded() {
        let rates = Rates::new(2, 1);
        assert_eq!([(); 3].map(|()| rates.of(&0).take().is_ok()), [true, true, false]);
        assert!(rates.of(&1).take().is_ok());
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!([(); 2].map(|()| rates.of(&0).take().is_ok()), [true, false]);
        for key in 0..2 * KEYS_MAX {
            rates.of(&key);
        }
        assert!(rates.by_key.lock().len() <= KEYS_MAX);
    }
}
