//! The largest speed at which the motion can stop on its path within the known profiles (M1d). If the next
//! blocks of a chain are late, or do not fit into a short ring, the chain slows down. It never runs out of
//! profiles.

use tandem_model::profile::{Law, Profile, SlewRoom};

use crate::profile_queue::ProfileConsumer;

/// Number of profiles of a G500 chain that are examined in one cycle. This limits the time of the cycle. If
/// more profiles would be needed, the motion is slower than necessary.
const PACED_MAX: usize = 128;

/// Number of servo periods that are kept in reserve at the end of the known profiles.
const LATE_PERIODS: f64 = 3.0;

/// Share of a servo period that is kept in reserve at any factor. It exceeds the rounding with which a
/// profile ends.
const REST_PERIODS: f64 = 1e-5;

/// Search for a factor if the motion may become faster: ratio of each tried factor to the previous one, and
/// number of tries. The last factor is below 1e-7. The ratio is coarse because each try examines profiles.
const PACED_TRIES: (f64, u32) = (0.5, 24);

/// Ratio and number of tries for a chain whose factor falls at a constant slope.
const EVEN_TRIES: (f64, u32) = (0.9, 160);

/// The path on which the motion stops, from a time within the running profile on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathToRest<'a> {
    running: &'a Profile,
    now_s: f64,
    /// Largest fall of the factor per second where the motors set no limit.
    pub(crate) slope: f64,
    period_s: f64,
}

impl<'a> PathToRest<'a> {
    /// Creates the path to rest. `hold_slope` is the slope of feed hold.
    pub(crate) fn new(running: &'a Profile, now_s: f64, hold_slope: f64, period_s: f64) -> Self {
        Self {
            running,
            now_s,
            slope: match &running.law {
                Law::Paced { .. } => f64::INFINITY,
                _ => hold_slope,
            },
            period_s,
        }
    }

    /// Returns the factor for the coming cycle, at most `wanted`. Returns `None` if the motion needs all
    /// known profiles to come to rest.
    pub(crate) fn target(&self, waiting: &mut ProfileConsumer, rate: f64, wanted: f64) -> Option<f64> {
        if self.allows(waiting, rate.max(wanted)) {
            return Some(wanted);
        }
        if rate > 0.0 && (rate >= wanted || !self.allows(waiting, rate)) {
            return None;
        }
        let (share, tries) = match &self.running.law {
            Law::Paced { .. } => PACED_TRIES,
            _ => EVEN_TRIES,
        };
        let mut factor = wanted;
        for _ in 0..tries {
            factor *= share;
            if factor <= rate || self.allows(waiting, factor) {
                return Some(factor.max(rate));
            }
        }
        Some(rate)
    }

    /// Returns true if the motion can stop within the running profile and the queued profiles, after a cycle
    /// with this factor.
    fn allows(&self, waiting: &mut ProfileConsumer, factor: f64) -> bool {
        factor == 0.0 || with_waiting(waiting, |known| self.is_path_to_rest(known, factor))
    }

    fn is_path_to_rest(&self, known: [&[Box<Profile>]; 2], factor: f64) -> bool {
        let is_paced = matches!(self.running.law, Law::Paced { .. });
        self.is_free(known, factor) || is_paced && self.allows_paced(known, factor)
    }

    /// Returns true if the motion can continue with this factor, now and at any earlier time.
    fn is_free(&self, known: [&[Box<Profile>]; 2], factor: f64) -> bool {
        self.running.exact_stop
            || match (&self.running.law, newest(known).map(|newest| &newest.law)) {
                (Law::Paced { pace, .. }, None) | (Law::Paced { .. }, Some(Law::Paced { pace, .. })) => {
                    pace.frees(self.running.segment)
                }
                // A profile outside the G500 chain starts after the end of the chain.
                (Law::Paced { .. }, Some(_)) => true,
                _ => self.allows_even(known, factor),
            }
    }

    /// Returns true if all cycles with this factor, up to this time, keep the reserve to the end of the known
    /// profiles.
    pub(crate) fn is_steady(&self, waiting: &mut ProfileConsumer, factor: f64) -> bool {
        with_waiting(waiting, |known| self.is_free(known, factor))
    }

    /// Returns the profile time at the end of the coming cycle, s.
    fn next_s(&self, factor: f64) -> f64 {
        self.now_s + factor * self.period_s
    }

    /// Returns the time that is kept in reserve at the end of the known profiles, s.
    fn reserve_s(&self, factor: f64) -> f64 {
        (LATE_PERIODS * factor + REST_PERIODS) * self.period_s
    }

    /// Returns true if the motion can stop with a factor that falls at a constant slope.
    fn allows_even(&self, known: [&[Box<Profile>]; 2], factor: f64) -> bool {
        let needed_s = factor * factor / (2.0 * self.slope) + self.reserve_s(factor);
        let running_s = self.running.duration_s - self.next_s(factor);
        running_s + self.waiting_s(known) >= needed_s
    }

    /// Returns the time of the waiting part of the running profile's chain, s. Returns infinity if the end of
    /// the chain is known.
    fn waiting_s(&self, known: [&[Box<Profile>]; 2]) -> f64 {
        let Some(newest) = newest(known) else { return 0.0 };
        match (&self.running.law, &newest.law) {
            (Law::Ramped { place: running, .. }, Law::Ramped { place: waiting, .. })
                if waiting.first_segment == running.first_segment && !newest.exact_stop =>
            {
                waiting.ends_s - running.ends_s
            }
            // A profile outside this chain starts after the end of the chain.
            _ => f64::INFINITY,
        }
    }

    /// Returns true if the motion can stop within the limit of each piece. The calculation goes backward from
    /// the end of the known profiles.
    fn allows_paced(&self, [first, second]: [&[Box<Profile>]; 2], factor: f64) -> bool {
        let from_s = self.next_s(factor);
        let first = first.get(..PACED_MAX).unwrap_or(first);
        let second = second.get(..PACED_MAX - first.len()).unwrap_or(second);
        let waiting_s: f64 = first.iter().chain(second).map(|next| next.duration_s).sum();
        let mut end_s = self.running.duration_s + waiting_s;
        let mut fall = FactorFall::new(self.slope, self.period_s, self.reserve_s(factor));
        let known = second
            .iter()
            .rev()
            .chain(first.iter().rev())
            .map(AsRef::as_ref)
            .chain([self.running]);
        for profile in known {
            let begin_s = end_s - profile.duration_s;
            let Law::Paced { pace, .. } = &profile.law else {
                return true;
            };
            for piece in pace.pieces().iter().rev() {
                let piece_s = (begin_s + piece.begins_s).max(from_s);
                if end_s > piece_s {
                    fall.add(end_s - piece_s, piece.room);
                    end_s = piece_s;
                }
            }
            if begin_s <= from_s {
                break;
            }
            end_s = begin_s;
        }
        fall.square() >= factor * factor
    }
}

/// Returns the profile that was queued last.
fn newest([first, second]: [&[Box<Profile>]; 2]) -> Option<&Profile> {
    second.last().or(first.last()).map(AsRef::as_ref)
}

fn with_waiting(waiting: &mut ProfileConsumer, look: impl FnOnce([&[Box<Profile>]; 2]) -> bool) -> bool {
    waiting.waiting().is_some_and(|chunk| {
        let (first, second) = chunk.as_slices();
        look([first, second])
    })
}

/// Returns true if a chain that begins at this override factor can stop within the queued profiles.
pub(crate) fn is_known(waiting: &mut ProfileConsumer, factor: f64, hold_slope: f64, period_s: f64) -> bool {
    with_waiting(waiting, |[first, second]| {
        first.split_first().is_some_and(|(running, first)| {
            PathToRest::new(running, 0.0, hold_slope, period_s).is_free([first, second], factor)
        })
    })
}

/// Returns true if the motion can stop within the queued profiles after it has switched to them. The switch
/// is at `at_s` within the first profile.
pub(crate) fn may_switch_over(waiting: &mut ProfileConsumer, factor: f64, at_s: f64, period_s: f64) -> bool {
    with_waiting(waiting, |[first, second]| {
        first.split_first().is_some_and(|(running, first)| {
            PathToRest::new(running, at_s, f64::INFINITY, period_s).is_path_to_rest([first, second], factor)
        })
    })
}

/// The square of the factor, from the end of the known profiles backward, in parts of at least a servo
/// period. Within a part of duration d the square falls by `2 s d`. Here s is the smallest fall that this
/// part and its neighbours allow, since a servo cycle may touch two parts.
struct FactorFall {
    slope: f64,
    period_s: f64,
    left_s: f64,
    square: f64,
    /// Room after the complete part.
    behind: SlewRoom,
    complete: Option<(f64, SlewRoom)>,
    open: (f64, SlewRoom),
}

impl FactorFall {
    fn new(slope: f64, period_s: f64, left_s: f64) -> Self {
        Self {
            slope,
            period_s,
            left_s,
            square: 0.0,
            behind: SlewRoom::default(),
            complete: None,
            open: (0.0, SlewRoom::default()),
        }
    }

    fn add(&mut self, duration_s: f64, room: SlewRoom) {
        self.open = (self.open.0 + duration_s, self.open.1.worst(room));
        if self.open.0 >= self.period_s {
            self.close();
        }
    }

    /// Completes the open part of the time. Then both neighbours of the part completed before are known, and the
    /// square of the factor passes that part.
    fn close(&mut self) {
        let (_, before) = self.open;
        if let Some((duration_s, room)) = self.complete.take() {
            self.pass(duration_s, room.worst(self.behind).worst(before));
            self.behind = room;
        }
        self.complete = Some(self.open);
        self.open = (0.0, SlewRoom::default());
    }

    fn pass(&mut self, duration_s: f64, room: SlewRoom) {
        let left_s = self.left_s.min(duration_s);
        self.left_s -= left_s;
        let time_s = duration_s - left_s;
        if time_s > 0.0 {
            self.square = room.square_before(self.square, self.slope, time_s);
        }
    }

    fn square(mut self) -> f64 {
        self.close();
        self.close();
        self.square
    }
}
