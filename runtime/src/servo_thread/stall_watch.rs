//! Detection of a servo cycle that does not end because a bus or a spindle does not return.
//!
//! If the whole process is late, this is a different fault (`SERVO_LATE`), which holds the motion. So a cycle is
//! stalled only if the relay thread itself is on time and the servo thread does not merely lack a processor. Under any
//! load, a cycle is stalled if it has not ended after [`STARVED_MAX`] in which the relay thread could run.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Interval at which the relay thread inspects the servo thread.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Time after which a running cycle is stalled. Reason: the alarm must be raised within 100 ms, and no working cycle
/// takes 60 ms.
pub(super) const STALL_MAX: Duration = Duration::from_millis(60);

/// Time after which a running cycle is stalled even if the servo thread or the relay thread lacks a processor. An
/// interval between two inspections contributes at most [`LOOK_LATE`], so that a suspension of the process does not count.
pub(super) const STARVED_MAX: Duration = Duration::from_secs(1);

/// Interval between two inspections above which the relay thread itself was late: the process was suspended, or the
/// computer is overloaded. Then the watch starts again.
const LOOK_LATE: Duration = Duration::from_millis(30);

/// Share of processor time below which a runnable thread lacks a processor.
const STARVED_SHARE: f64 = 0.5;

/// Watch over the cycles of one servo thread.
#[derive(Debug)]
pub(super) struct StallWatch {
    /// Directory of the servo thread in `/proc`, where the operating system describes the thread.
    place: Arc<OnceLock<String>>,
    looked: Option<Instant>,
    suspect: Option<Suspect>,
    /// Cycle that was running at the last inspection, and the counted time since it was first found.
    unfinished: Option<(u64, Duration)>,
}

/// Cycle that was already running at an earlier inspection.
#[derive(Debug)]
struct Suspect {
    cycle: u64,
    since: Instant,
    /// Processor time of the thread at that inspection.
    processor: Option<Duration>,
}

impl StallWatch {
    pub(super) fn new(place: Arc<OnceLock<String>>) -> Self {
        Self {
            place,
            looked: None,
            suspect: None,
            unfinished: None,
        }
    }

    /// Inspects the running cycle. Returns the time after which it is stalled; `None` if it is not stalled.
    pub(super) fn find_stall(&mut self, now: Instant, running: Option<u64>) -> Option<Duration> {
        let looked = self.looked.replace(now);
        let interval = looked.map_or(Duration::ZERO, |looked| now.duration_since(looked));
        let before = self.unfinished.filter(|(cycle, _)| Some(*cycle) == running);
        let unfinished = before.map_or(Duration::ZERO, |(_, time)| time + interval.min(LOOK_LATE));
        self.unfinished = running.map(|cycle| (cycle, unfinished));
        if unfinished >= STARVED_MAX {
            return Some(STARVED_MAX);
        }
        self.has_stalled(now, interval > LOOK_LATE, running)
            .then_some(STALL_MAX)
    }

    /// Returns true if the running cycle has stalled while both threads could run.
    fn has_stalled(&mut self, now: Instant, is_late: bool, running: Option<u64>) -> bool {
        let Some(cycle) = running.filter(|_| !is_late) else {
            self.suspect = None;
            return false;
        };
        match &self.suspect {
            Some(suspect) if suspect.cycle == cycle => {
                let since = now.duration_since(suspect.since);
                if since < STALL_MAX {
                    return false;
                }
                if self.is_starved(suspect, since) {
                    self.suspect = None;
                    return false;
                }
                true
            }
            _ => {
                self.suspect = Some(Suspect {
                    cycle,
                    since: now,
                    processor: self.thread().map(|(_, processor)| processor),
                });
                false
            }
        }
    }

    /// Returns true if the thread was runnable since `suspect`, but received too little processor time.
    fn is_starved(&self, suspect: &Suspect, since: Duration) -> bool {
        let (Some((is_runnable, processor)), Some(before)) = (self.thread(), suspect.processor) else {
            return false;
        };
        is_runnable && processor.saturating_sub(before).as_secs_f64() < STARVED_SHARE * since.as_secs_f64()
    }

    /// Returns true if the thread is running or runnable, with its processor time. Returns `None` if the operating
    /// system does not provide them.
    fn thread(&self) -> Option<(bool, Duration)> {
        let place = self.place.get()?;
        let state = std::fs::read_to_string(format!("/proc/{place}/stat")).ok()?;
        let times = std::fs::read_to_string(format!("/proc/{place}/schedstat")).ok()?;
        parse_thread(&state, &times)
    }
}

/// Parses the files `stat` and `schedstat` of a thread in `/proc`.
fn parse_thread(state: &str, times: &str) -> Option<(bool, Duration)> {
    let (_, state) = state.rsplit_once(") ")?;
    let processor_ns = times.split_ascii_whitespace().next()?.parse().ok()?;
    Some((state.starts_with('R'), Duration::from_nanos(processor_ns)))
}

/// Records the directory of the calling thread in `/proc`.
pub(super) fn record_thread_folder(place: &OnceLock<String>) {
    let link = std::fs::read_link("/proc/thread-self").ok();
    if let Some(link) = link.and_then(|link| link.into_os_string().into_string().ok()) {
        // fails only if it is already recorded; each thread records it once, at its start
        let _ = place.set(link);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch() -> StallWatch {
        StallWatch::new(Arc::default())
    }

    /// Inspects at each time in `looks`, with the cycle running then. Returns the time in ms at which a stall is found.
    fn stalls_at(looks: impl IntoIterator<Item = (u64, Option<u64>)>) -> Option<u64> {
        let (start, mut watch) = (Instant::now(), watch());
        let mut looks = looks.into_iter();
        let found = looks.find(|(at_ms, running)| {
            watch
                .find_stall(start + Duration::from_millis(*at_ms), *running)
                .is_some()
        });
        found.map(|(at_ms, _)| at_ms)
    }

    #[test]
    fn a_cycle_that_does_not_end_is_found_within_80_ms() {
        assert_eq!(stalls_at((0..).map(|n| (n * 10, Some(7)))), Some(60));
        let late = (0..).map(|n| (n * 30, Some(7)));
        assert_eq!(stalls_at(late), Some(60), "looks may be 30 ms apart");
    }

    #[test]
    fn cycles_that_end_and_a_suspended_process_are_no_stall() {
        assert_eq!(
            stalls_at((0..1000).map(|n| (n * 10, Some(n)))),
            None,
            "each look finds a new one"
        );
        assert_eq!(
            stalls_at((0..1000).map(|n| (n * 10, None))),
            None,
            "between two cycles"
        );
        let suspended = (0..30).map(|n| (n * 8000, Some(7)));
        assert_eq!(stalls_at(suspended), None, "the relay itself is late each time");
        let stopped = [(0, Some(7)), (10, Some(7)), (8000, Some(7)), (8010, Some(8))];
        assert_eq!(stalls_at(stopped), None);
    }

    #[test]
    fn cycle_that_never_ends_under_load_is_found_after_1_s() {
        let late = (0..).map(|n| (n * 31, Some(7)));
        let counted_ms = 34 * 31;
        assert_eq!(stalls_at(late), Some(counted_ms), "34 intervals of at most 30 ms");
        // without processor time the watch starts again each 60 ms
        let mut watch = watch();
        let start = Instant::now();
        let mut found = (0..).map(|n| n * 10).filter_map(|at_ms| {
            watch.suspect = None;
            let stall = watch.find_stall(start + Duration::from_millis(at_ms), Some(7));
            stall.map(|after| (at_ms, after))
        });
        assert_eq!(found.next(), Some((1000, STARVED_MAX)));
    }

    #[test]
    fn the_files_of_a_thread_tell_whether_it_could_run() {
        let running = parse_thread("42 (a) b) R 1 2", "5000000 77 3\n");
        assert_eq!(running, Some((true, Duration::from_millis(5))));
        let waiting = parse_thread("42 (servo) S 1 2", "1 2 3");
        assert_eq!(waiting.map(|(is_runnable, _)| is_runnable), Some(false));
        assert_eq!(parse_thread("", ""), None);
    }
}
