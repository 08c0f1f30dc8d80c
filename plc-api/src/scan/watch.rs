//! Supervision of the duration of scans.

use std::time::Duration;

/// Shortest time between two lines of the log about late scans. Reason: a fast scan could otherwise fill the
/// log.
const REPORT_EVERY_S: f64 = 10.0;

/// Durations of scans.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct CycleTimes {
    pub(super) last_s: f64,
    pub(super) longest_s: f64,
    /// Number of scans that took longer than the limit.
    pub(super) late: u64,
}

/// Supervisor of the duration of scans, from the image to the last write.
#[derive(Debug)]
pub(super) struct CycleWatch {
    limit: Duration,
    pub(super) times: CycleTimes,
    /// Time of the last report, and the number of late scans up to that time.
    reported: Option<(f64, u64)>,
}

impl CycleWatch {
    pub(super) fn new(limit: Duration) -> Self {
        Self {
            limit,
            times: CycleTimes::default(),
            reported: None,
        }
    }

    /// Records the duration of a scan. Returns the text of a report if one is due: the first late scan is
    /// reported at once, further late scans together.
    pub(super) fn ended(&mut self, took_s: f64, now_s: f64) -> Option<String> {
        let CycleTimes {
            last_s,
            longest_s,
            late,
        } = &mut self.times;
        *last_s = took_s;
        *longest_s = longest_s.max(took_s);
        // tolerance for clocks that return nanoseconds as a float
        let is_late = took_s - self.limit.as_secs_f64() > 1e-9;
        if is_late {
            *late += 1;
        }
        let (at_s, reported) = self.reported.unwrap_or((f64::NEG_INFINITY, 0));
        if *late == reported || now_s - at_s < REPORT_EVERY_S {
            return None;
        }
        let (news, limit_ms) = (*late - reported, 1e3 * self.limit.as_secs_f64());
        let (last_ms, longest_ms) = (1e3 * took_s, 1e3 * *longest_s);
        self.reported = Some((now_s, *late));
        Some(format!(
            "{news} scans took longer than {limit_ms} ms: the last took {last_ms:.3} ms, the longest {longest_ms:.3} ms; \
             {late} late scans since the start"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_that_takes_longer_than_the_limit_is_told_at_once_with_its_time() {
        let mut watch = CycleWatch::new(Duration::from_millis(10));
        assert_eq!(watch.ended(0.010, 0.010), None, "exactly the limit is not late");
        let told = watch.ended(0.0125, 0.5).unwrap();
        assert!(
            told.contains("longer than 10 ms") && told.contains("12.500 ms"),
            "{told}"
        );
        assert_eq!(
            watch.times,
            CycleTimes {
                last_s: 0.0125,
                longest_s: 0.0125,
                late: 1
            }
        );
    }

    #[test]
    fn further_ones_are_counted_and_told_together_every_10_s() {
        let mut watch = CycleWatch::new(Duration::from_millis(10));
        watch.ended(0.02, 0.0).unwrap();
        assert_eq!(watch.ended(0.03, 5.0), None);
        assert_eq!(watch.ended(0.02, 9.9), None);
        let told = watch.ended(0.001, 10.0).unwrap();
        assert!(
            told.starts_with("2 scans") && told.contains("30.000 ms"),
            "{told}"
        );
        assert_eq!(watch.ended(0.001, 30.0), None, "nothing new");
        assert_eq!(watch.times.late, 3);
    }
}
