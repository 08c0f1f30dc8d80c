//! Delays between attempts to connect.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

/// First and longest wait; it doubles in between.
const FIRST: Duration = Duration::from_millis(100);
const MAX: Duration = Duration::from_secs(5);

/// How long the next wait is.
#[derive(Debug)]
pub(super) struct Backoff {
    next: Duration,
}

impl Backoff {
    pub(super) fn new() -> Self {
        Self { next: FIRST }
    }

    /// The connection was there: the next wait is the first one again.
    pub(super) fn reset(&mut self) {
        self.next = FIRST;
    }

    /// Waits before the next try.
    pub(super) async fn wait(&mut self) {
        tokio::time::sleep(jittered(self.next)).await;
        self.next = (self.next * 2).min(MAX);
    }
}

/// From half to one and a half of it, so that the clients of a machine that comes back do not all come at once.
fn jittered(wait: Duration) -> Duration {
    let random = RandomState::new().hash_one(0_u8) % 1000;
    wait / 2 + wait.mul_f64(random as f64 / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_is_jittered_between_half_and_one_and_a_half() {
        for _ in 0..100 {
            let wait = jittered(MAX);
            assert!(wait >= MAX / 2 && wait <= MAX * 3 / 2, "{wait:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn waits_double_up_to_the_longest_and_begin_again_after_a_connection() {
        let mut backoff = Backoff::new();
        for _ in 0..10 {
            backoff.wait().await;
        }
        assert_eq!(backoff.next, MAX);
        backoff.reset();
        backoff.wait().await;
        assert_eq!(backoff.next, FIRST * 2);
    }
}
