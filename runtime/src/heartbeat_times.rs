//! Real times of the servo cycles that heartbeats named. The runtime derives the age of a request from these times.

use std::collections::VecDeque;
use std::time::Duration;

use plc_protocol::types::not_after::{NOT_AFTER_MAX_MS, NotAfter};

/// Time for which the time of a heartbeat is stored. Reason: `not_after` of a request allows at most this age.
const KEPT: Duration = Duration::from_millis(NOT_AFTER_MAX_MS);

/// A heartbeat that follows the previous one within this time is stored with the time of the previous one. Reason: so
/// at most 6,000 times are stored if simulated time runs fast. A request then appears at most 10 ms older than it is.
const SPACING: Duration = Duration::from_millis(10);

/// Servo cycles that heartbeats named, with their times, the oldest first.
#[derive(Debug, Default)]
pub(crate) struct HeartbeatTimes {
    times: VecDeque<(u64, Duration)>,
    newest: Option<u64>,
}

impl HeartbeatTimes {
    /// Stores the time of a heartbeat. Called before the heartbeat is sent; `now` is the real time since the start.
    pub fn record_heartbeat(&mut self, cycle: u64, now: Duration) {
        if self.newest.is_some_and(|newest| cycle <= newest) {
            return;
        }
        self.newest = Some(cycle);
        while self
            .times
            .front()
            .is_some_and(|(_, at)| now.saturating_sub(*at) > KEPT)
        {
            self.times.pop_front();
        }
        if self
            .times
            .back()
            .is_none_or(|(_, at)| now.saturating_sub(*at) >= SPACING)
        {
            self.times.push_back((cycle, now));
        }
    }

    /// Returns the time since the heartbeat with this cycle; `None` if it was never sent, or was sent before [`KEPT`].
    pub fn age(&self, cycle: u64, now: Duration) -> Option<Duration> {
        if self.newest.is_none_or(|newest| cycle > newest) {
            return None;
        }
        let later = self.times.partition_point(|(noted, _)| *noted <= cycle);
        let (_, at) = self.times.get(later.checked_sub(1)?)?;
        Some(now.saturating_sub(*at))
    }

    /// Checks that a request is not older than its `not_after` allows.
    ///
    /// # Errors
    /// Returns an error, as text for the client, if the request is too old.
    pub fn check(&self, not_after: &NotAfter, now: Duration) -> Result<(), String> {
        let NotAfter {
            heartbeat, within_ms, ..
        } = not_after;
        let again = "nothing was done; inspect the machine, then send a new request";
        match self.age(*heartbeat, now) {
            Some(age) if age <= Duration::from_millis(*within_ms) => Ok(()),
            Some(age) => Err(format!(
                "the request is {} ms old, and its not_after allows {within_ms} ms: {again}",
                age.as_millis()
            )),
            None => Err(format!(
                "not_after names heartbeat {heartbeat}, which is older than {} s or was never sent: {again}",
                KEPT.as_secs()
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_request_is_as_old_as_the_newest_heartbeat_at_or_before_its_cycle() {
        let mut times = HeartbeatTimes::default();
        for beat in 0..=10 {
            times.record_heartbeat(beat * 100, ms(beat * 100));
        }
        for (cycle, now_ms, age_ms) in [
            (1000, 1000, Some(0)),
            (1000, 1700, Some(700)),
            (950, 1000, Some(100)),
            (0, 1000, Some(1000)),
            (1001, 1000, None),
        ] {
            assert_eq!(
                times.age(cycle, ms(now_ms)),
                age_ms.map(ms),
                "{cycle} at {now_ms}"
            );
        }
    }

    #[test]
    fn a_cycle_that_stands_still_keeps_its_first_time() {
        let mut times = HeartbeatTimes::default();
        times.record_heartbeat(5, ms(100));
        times.record_heartbeat(5, ms(9000));
        assert_eq!(times.age(5, ms(9000)), Some(ms(8900)));
    }

    #[test]
    fn a_heartbeat_older_than_times_are_kept_is_unknown() {
        let mut times = HeartbeatTimes::default();
        times.record_heartbeat(1, ms(0));
        times.record_heartbeat(2, KEPT + ms(1));
        assert_eq!(times.age(1, KEPT + ms(1)), None);
    }

    #[test]
    fn a_clock_that_runs_a_thousand_times_as_fast_fills_no_more_memory() {
        let mut times = HeartbeatTimes::default();
        for beat in 0..1_000_000_u64 {
            times.record_heartbeat(beat * 100, Duration::from_micros(beat * 100));
        }
        let most = usize::try_from(KEPT.as_millis() / SPACING.as_millis()).unwrap() + 1;
        assert!(times.times.len() <= most, "{}", times.times.len());
        let age = times.age(99_999_900, ms(100_000)).unwrap();
        assert!(age <= SPACING + ms(1), "{age:?}");
    }

    #[test]
    fn a_request_is_expired_one_ms_after_its_limit() {
        let mut times = HeartbeatTimes::default();
        times.record_heartbeat(7, ms(0));
        let not_after = NotAfter {
            boot_id: plc_protocol::types::BootId("b".into()),
            heartbeat: 7,
            within_ms: 1000,
        };
        assert_eq!(times.check(&not_after, ms(1000)), Ok(()));
        assert!(
            times
                .check(&not_after, ms(1001))
                .unwrap_err()
                .contains("1001 ms old")
        );
    }
}
