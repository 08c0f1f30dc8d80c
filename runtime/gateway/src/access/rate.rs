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

    /// Counts one more. If there is no room, counts nothing and returns the time until there is room.
    pub(crate) fn try_charge(&self) -> Result<(), Duration> {
        let mut state = self.refilled();
        if state.left < 1.0 {
            return Err(Duration::from_secs_f64((1.0 - state.left) / self.per_second));
        }
        state.left -= 1.0;
        Ok(())
    }

    /// Refunds one count.
    pub(crate) fn refund(&self) {
        let mut state = self.refilled();
        state.left = (state.left + 1.0).min(self.burst);
    }

    /// Counts one more even without room. Returns how long the caller must wait to keep to the rate.
    pub(crate) fn charge(&self) -> Duration {
        self.charge_many(1.0)
    }

    /// Counts this many, even without room. Returns how long the caller must wait to keep to the rate.
    pub(crate) fn charge_many(&self, count: f64) -> Duration {
        let mut state = self.refilled();
        state.left -= count;
        Duration::from_secs_f64((-state.left).max(0.0) / self.per_second)
    }

    /// Returns true for a completely recovered rate.
    fn is_recovered(&self) -> bool {
        self.refilled().left >= self.burst
    }

    /// Returns the time until all debt is paid as an error. Counts nothing.
    pub(crate) fn check(&self) -> Result<(), Duration> {
        let left = self.refilled().left;
        if left < 0.0 {
            return Err(Duration::from_secs_f64(-left / self.per_second));
        }
        Ok(())
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

/// One [`Rate`] per key. At `KEYS_MAX` keys those that have recovered are removed, else the most recovered one; if all
/// are used up, further keys share one rate. So no number of keys resets a rate that is used up.
#[derive(Debug)]
pub(crate) struct Rates<K> {
    burst: u32,
    per_second: f64,
    by_key: Mutex<HashMap<K, Arc<Rate>>>,
    shared: Arc<Rate>,
}

/// Largest number of keys of one [`Rates`]. Reason: more than the tokens of a file and than the clients of the broker.
const KEYS_MAX: usize = 1024;

impl<K: Clone + Eq + Hash> Rates<K> {
    pub(crate) fn new(burst: u32, per_second: impl Into<f64>) -> Self {
        let per_second = per_second.into();
        Self {
            burst,
            per_second,
            by_key: Mutex::default(),
            shared: Arc::new(Rate::new(burst, per_second)),
        }
    }

    /// Returns the rate of a key.
    pub(crate) fn rate_for(&self, key: &K) -> Arc<Rate> {
        let mut by_key = self.by_key.lock();
        if by_key.len() >= KEYS_MAX && !by_key.contains_key(key) {
            by_key.retain(|_, rate| !rate.is_recovered());
            if by_key.len() >= KEYS_MAX {
                let left = by_key.iter().map(|(key, rate)| (rate.refilled().left, key));
                match left.max_by(|one, other| one.0.total_cmp(&other.0)) {
                    Some((left, most)) if left >= 1.0 => {
                        let most = most.clone();
                        by_key.remove(&most);
                    }
                    _ => return Arc::clone(&self.shared),
                }
            }
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
        assert_eq!([(); 3].map(|()| rate.try_charge()), [Ok(()); 3]);
        assert_eq!(rate.try_charge(), Err(Duration::from_millis(500)));
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!([(); 2].map(|()| rate.try_charge()), [Ok(()); 2]);
        assert!(rate.try_charge().is_err());
        tokio::time::advance(Duration::from_mins(1)).await;
        assert_eq!(
            [(); 4].map(|()| rate.try_charge().is_ok()),
            [true, true, true, false]
        );
    }

    #[tokio::test(start_paused = true)]
    async fn idle_keys_are_forgotten_first_and_a_used_up_rate_stays() {
        let rates = Rates::new(1, 1.0 / 60.0);
        assert!(rates.rate_for(&0).try_charge().is_ok());
        for key in 1..2 * KEYS_MAX {
            rates.rate_for(&key);
        }
        assert!(
            rates.rate_for(&0).try_charge().is_err(),
            "other keys do not refill it"
        );
        rates.rate_for(&0).refund();
        assert!(rates.rate_for(&0).try_charge().is_ok());
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_owed_is_waited_for() {
        let rate = Rate::new(1, 10);
        assert_eq!(rate.charge(), Duration::ZERO);
        assert_eq!(rate.charge(), Duration::from_millis(100));
        assert_eq!(rate.charge(), Duration::from_millis(200));
    }

    #[tokio::test(start_paused = true)]
    async fn a_large_amount_is_owed_until_the_rate_has_paid_it() {
        let rate = Rate::new(10, 5);
        assert_eq!(rate.check(), Ok(()));
        assert_eq!(rate.charge_many(10.0), Duration::ZERO);
        assert_eq!(rate.check(), Ok(()), "all is spent, nothing is owed");
        assert_eq!(rate.charge_many(15.0), Duration::from_secs(3));
        tokio::time::advance(Duration::from_secs(2)).await;
        assert_eq!(rate.check(), Err(Duration::from_secs(1)));
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!(rate.check(), Ok(()));
    }

    #[tokio::test(start_paused = true)]
    async fn each_key_has_a_rate_of_its_own_and_their_number_is_bounded() {
        let rates = Rates::new(2, 1);
        assert_eq!(
            [(); 3].map(|()| rates.rate_for(&0).try_charge().is_ok()),
            [true, true, false]
        );
        assert!(rates.rate_for(&1).try_charge().is_ok());
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!(
            [(); 2].map(|()| rates.rate_for(&0).try_charge().is_ok()),
            [true, false]
        );
        for key in 0..2 * KEYS_MAX {
            rates.rate_for(&key);
        }
        assert!(rates.by_key.lock().len() <= KEYS_MAX);
    }

    #[tokio::test(start_paused = true)]
    async fn keys_beyond_the_limit_reset_no_rate_and_share_one() {
        let rates = Rates::new(1, 1);
        for key in 0..KEYS_MAX {
            assert!(rates.rate_for(&key).try_charge().is_ok());
        }
        assert!(rates.rate_for(&KEYS_MAX).try_charge().is_ok());
        assert!(
            rates.rate_for(&(KEYS_MAX + 1)).try_charge().is_err(),
            "it shares the rate of the key before"
        );
        assert!(rates.rate_for(&0).try_charge().is_err(), "no rate was reset");
        tokio::time::advance(Duration::from_secs(1)).await;
        rates.rate_for(&KEYS_MAX);
        assert_eq!(rates.by_key.lock().len(), 1, "recovered rates are removed");
    }
}
