//! Delays between attempts to connect.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

/// First and longest wait; each wait doubles the last one.
const FIRST: Duration = Duration::from_millis(100);
const MAX: Duration = Duration::from_secs(5);

/// The next wait.
#[derive(Debug)]
pub struct Backoff {
    next: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { next: FIRST }
    }
}

impl Backoff {
    /// After a connection: starts again with the first wait.
    pub fn reset(&mut self) {
        self.next = FIRST;
    }

    /// The wait before the next attempt: 50 to 100 percent of 100 ms, doubled each time up to 5 s.
    pub fn next_wait(&mut self) -> Duration {
        let wait = jittered(self.next);
        self.next = (self.next * 2).min(MAX);
        wait
    }

    #[cfg(any(feature = "mqtt", feature = "rest"))]
    pub(super) async fn wait(&mut self) {
        tokio::time::sleep(self.next_wait()).await;
    }
}

/// 50 to 100 percent, so that not all clients reconnect at the same time.
fn jittered(wait: Duration) -> Duration {
    let random = RandomState::new().hash_one(0_u8) % 1000;
    wait.mul_f64(0.5 + random as f64 / 2000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_is_jittered_between_half_and_whole() {
        for _ in 0..100 {
            let wait = jittered(MAX);
            assert!(wait >= MAX / 2 && wait <= MAX, "{wait:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn waits_double_up_to_the_longest_and_begin_again_after_a_connection() {
        let mut backoff = Backoff::default();
        for _ in 0..10 {
            backoff.wait().await;
        }
        assert_eq!(backoff.next, MAX);
        backoff.reset();
        backoff.wait().await;
        assert_eq!(backoff.next, FIRST * 2);
    }
}
