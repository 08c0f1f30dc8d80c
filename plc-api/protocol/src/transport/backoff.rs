//! Delays between attempts to connect.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

/// First wait and longest wait between two attempts to connect; each wait is twice the previous wait.
const FIRST: Duration = Duration::from_millis(100);
const MAX: Duration = Duration::from_secs(5);

/// Generator of the waits between attempts to connect.
#[derive(Debug)]
pub struct Backoff {
    next: Duration,
    /// State of the random generator for the jitter.
    random: u64,
}

impl Default for Backoff {
    fn default() -> Self {
        Self::seeded(RandomState::new().hash_one(0_u8))
    }
}

impl Backoff {
    /// Creates a generator that returns the same waits for the same seed.
    pub fn seeded(seed: u64) -> Self {
        Self {
            next: FIRST,
            random: seed,
        }
    }

    /// Sets the next wait to the first wait, after a successful connection.
    pub fn reset(&mut self) {
        self.next = FIRST;
    }

    /// Returns the wait before the next attempt: 50 to 100 percent of a value that doubles from 100 ms up to
    /// 5 s.
    pub fn next_wait(&mut self) -> Duration {
        let wait = self.jittered(self.next);
        self.next = (self.next * 2).min(MAX);
        wait
    }

    /// Returns 50 to 100 percent of a wait, so that not all clients reconnect at the same time.
    fn jittered(&mut self, wait: Duration) -> Duration {
        // Knuth's linear congruential generator; only its high bits are sufficiently random
        self.random = (self.random)
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        wait.mul_f64(0.5 + (self.random >> 33) as f64 / (1_u64 << 32) as f64)
    }

    #[cfg(any(feature = "mqtt", feature = "rest"))]
    pub(super) async fn wait(&mut self) {
        tokio::time::sleep(self.next_wait()).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_is_jittered_between_half_and_whole() {
        let mut backoff = Backoff::default();
        for _ in 0..100 {
            let wait = backoff.jittered(MAX);
            assert!(wait >= MAX / 2 && wait <= MAX, "{wait:?}");
        }
    }

    #[test]
    fn equal_seeds_give_equal_waits() {
        let waits = |seed| {
            let mut backoff = Backoff::seeded(seed);
            std::array::from_fn::<_, 5, _>(|_| backoff.next_wait())
        };
        assert_eq!(waits(1), waits(1));
        assert_ne!(waits(1), waits(2));
    }

    #[test]
    fn waits_double_up_to_the_longest_and_begin_again_after_a_connection() {
        let mut backoff = Backoff::default();
        for _ in 0..10 {
            backoff.next_wait();
        }
        assert_eq!(backoff.next, MAX);
        backoff.reset();
        backoff.next_wait();
        assert_eq!(backoff.next, FIRST * 2);
    }
}
