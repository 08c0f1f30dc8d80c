//! Detects a servo cycle that does not end: a bus or a spindle that does not return.
//!
//! Lateness of the whole process is a different fault and holds the motion (`SERVO_LATE`): a cycle is stalled only if
//! the relay thread itself runs on time, and if the servo thread does not merely lack a processor.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Time between two looks at the servo thread.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Duration after which a running cycle is stalled. Reason: the alarm is raised within 100 ms, and no sound cycle takes
/// that long.
pub(super) const STALL_MAX: Duration = Duration::from_millis(60);

/// Interval between two looks above which the relay thread was late itself: the process was suspended, or the computer
/// is overloaded. The watch then starts again.
const LOOK_LATE: Duration = Duration::from_millis(30);

/// A runnable thread that gets less than this share of processor time lacks a processor.
const STARVED_SHARE: f64 = 0.5;

/// Watches one thread.
#[derive(Debug)]
pub(super) struct StallWatch {
    /// Directory in which the operating system describes the servo thread.
    place: Arc<OnceLock<String>>,
    looked: Option<Instant>,
    suspect: Option<Suspect>,
}

/// Cycle that was already running at an earlier look.
#[derive(Debug)]
struct Suspect {
    cycle: u64,
    since: Instant,
    /// Processor time of the thread at that look.
    processor: Option<Duration>,
}

impl StallWatch {
    pub(super) fn new(place: Arc<OnceLock<String>>) -> Self {
        Self {
            place,
            looked: None,
            suspect: None,
        }
    }

    /// Inspects the running cycle; returns true if it has stalled.
    pub(super) fn has_stalled(&mut self, now: Instant, running: Option<u64>) -> bool {
        let looked = self.looked.replace(now);
        let is_late = looked.is_some_and(|looked| now.duration_since(looked) > LOOK_LATE);
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

    /// Returns true if the thread was runnable but received no processor.
    fn is_starved(&self, suspect: &Suspect, since: Duration) -> bool {
        let (Some((is_runnable, processor)), Some(before)) = (self.thread(), suspect.processor) else {
            return false;
        };
        is_runnable && processor.saturating_sub(before).as_secs_f64() < STARVED_SHARE * since.as_secs_f64()
    }

    /// Returns whether the thread runs or is runnable, and its processor time; `None` if the operating system does not
    /// provide them.
    fn thread(&self) -> Option<(bool, Duration)> {
        let place = self.place.get()?;
        let state = std::fs::read_to_string(format!("/proc/{place}/stat")).ok()?;
        let times = std::fs::read_to_string(format!("/proc/{place}/schedstat")).ok()?;
        parse_thread(&state, &times)
    }
}

/// Parses the files `stat` and `schedstat` of a thread.
fn parse_thread(state: &str, times: &str) -> Option<(bool, Duration)> {
    let (_, state) = state.rsplit_once(") ")?;
    let processor_ns = times.split_ascii_whitespace().next()?.parse().ok()?;
    Some((state.starts_with('R'), Duration::from_nanos(processor_ns)))
}

/// Notes the directory in which the operating system describes the calling thread.
pub(super) fn record_thread_folder(place: &OnceLock<String>) {
    let link = std::fs::read_link("/proc/thread-self").ok();
    if let Some(link) = link.and_then(|link| link.into_os_string().into_string().ok()) {
        // noted once, at the start of the thread
        let _ = place.set(link);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch() -> StallWatch {
        StallWatch::new(Arc::default())
    }

    /// Looks at these times, with these cycles running; returns the time at which a stall is found.
    fn stalls_at(looks: impl IntoIterator<Item = (u64, Option<u64>)>) -> Option<u64> {
        let (start, mut watch) = (Instant::now(), watch());
        let mut looks = looks.into_iter();
        let found =
            looks.find(|(at_ms, running)| watch.has_stalled(start + Duration::from_millis(*at_ms), *running));
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
        let suspended = (0..1000).map(|n| (n * 31, Some(7)));
        assert_eq!(stalls_at(suspended), None, "the relay itself is late each time");
        let stopped = [(0, Some(7)), (10, Some(7)), (8000, Some(7)), (8010, Some(8))];
        assert_eq!(stalls_at(stopped), None);
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
