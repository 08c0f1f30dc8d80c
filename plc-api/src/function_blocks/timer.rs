//! Timers: IEC 61131-3, table "Standard timer function blocks" and its timing diagrams.
//!
//! Each call is given the time of the scan. A time before that of an earlier call counts as the same time. A preset time that is
//! changed counts from the next call on, also for a time that runs.

use std::time::Duration;

/// A time that runs up to its preset time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Running {
    preset: Duration,
    /// When it began.
    since: Option<Duration>,
    elapsed: Duration,
}

impl Running {
    const fn new(preset: Duration) -> Self {
        Self {
            preset,
            since: None,
            elapsed: Duration::ZERO,
        }
    }

    /// Begins or goes on; true once the preset time is over.
    fn run(&mut self, now: Duration) -> bool {
        let since = *self.since.get_or_insert(now);
        self.elapsed = now.saturating_sub(since).min(self.preset);
        self.elapsed >= self.preset
    }

    fn clear(&mut self) {
        (self.since, self.elapsed) = (None, Duration::ZERO);
    }
}

/// `TON`: on once its input has been on for the preset time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OnDelay {
    /// Since the input came on.
    time: Running,
    q: bool,
}

impl OnDelay {
    /// With this `PT`.
    pub const fn new(preset: Duration) -> Self {
        Self {
            time: Running::new(preset),
            q: false,
        }
    }

    /// Takes `IN` and the time of the scan; gives `Q`.
    pub fn update(&mut self, input: bool, now: Duration) -> bool {
        self.q = if input {
            self.time.run(now)
        } else {
            self.time.clear();
            false
        };
        self.q
    }

    /// `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }

    /// `ET`: how long the input has been on, at most the preset time.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed
    }

    /// Sets `PT`.
    pub fn set_preset(&mut self, preset: Duration) {
        self.time.preset = preset;
    }
}

/// `TOF`: off once its input has been off for the preset time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OffDelay {
    /// Since the input went off.
    time: Running,
    q: bool,
}

impl OffDelay {
    /// With this `PT`; off until its input has been on.
    pub const fn new(preset: Duration) -> Self {
        Self {
            time: Running::new(preset),
            q: false,
        }
    }

    /// Takes `IN` and the time of the scan; gives `Q`.
    pub fn update(&mut self, input: bool, now: Duration) -> bool {
        if input {
            self.time.clear();
            self.q = true;
        } else if self.q {
            self.q = !self.time.run(now);
        }
        self.q
    }

    /// `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }

    /// `ET`: how long the input has been off, at most the preset time; it keeps its value until the input comes on.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed
    }

    /// Sets `PT`.
    pub fn set_preset(&mut self, preset: Duration) {
        self.time.preset = preset;
    }
}

/// `TP`: on for the preset time after its input comes on, whatever the input does meanwhile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// Since the pulse began; it may be over, with the input still on.
    time: Running,
    q: bool,
}

impl Pulse {
    /// With this `PT`.
    pub const fn new(preset: Duration) -> Self {
        Self {
            time: Running::new(preset),
            q: false,
        }
    }

    /// Takes `IN` and the time of the scan; gives `Q`.
    pub fn update(&mut self, input: bool, now: Duration) -> bool {
        if input || self.q {
            self.q = !self.time.run(now);
        }
        if !input && !self.q {
            self.time.clear();
        }
        self.q
    }

    /// `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }

    /// `ET`: how long the pulse has been on, at most the preset time; it keeps its value until the input goes off.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed
    }

    /// Sets `PT`.
    pub fn set_preset(&mut self, preset: Duration) {
        self.time.preset = preset;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRESET: Duration = Duration::from_millis(50);

    /// `Q` and `ET`, ms, of calls every 10 ms; `_` and `#` are the input, as in a timing diagram.
    fn diagram(
        input: &str,
        mut update: impl FnMut(bool, Duration) -> (bool, Duration),
    ) -> (String, Vec<u128>) {
        let calls = input.chars().zip(0..).map(|(level, call)| {
            let (q, elapsed) = update(level == '#', Duration::from_millis(10 * call));
            (if q { '#' } else { '_' }, elapsed.as_millis())
        });
        calls.unzip()
    }

    fn on_delay(input: &str) -> (String, Vec<u128>) {
        let mut timer = OnDelay::new(PRESET);
        diagram(input, |input, now| (timer.update(input, now), timer.elapsed()))
    }

    fn off_delay(input: &str) -> (String, Vec<u128>) {
        let mut timer = OffDelay::new(PRESET);
        diagram(input, |input, now| (timer.update(input, now), timer.elapsed()))
    }

    fn pulse(input: &str) -> (String, Vec<u128>) {
        let mut timer = Pulse::new(PRESET);
        diagram(input, |input, now| (timer.update(input, now), timer.elapsed()))
    }

    #[test]
    fn ton_comes_on_the_preset_time_behind_its_input_and_goes_off_with_it() {
        let (q, elapsed) = on_delay("_#######__");
        assert_eq!(q, /*      */ "______##__");
        assert_eq!(elapsed, [0, 0, 10, 20, 30, 40, 50, 50, 0, 0]);
    }

    #[test]
    fn ton_does_not_come_on_for_an_input_that_is_shorter_and_begins_anew() {
        let (q, elapsed) = on_delay("#####_######");
        assert_eq!(q, /*      */ "___________#");
        assert_eq!(elapsed, [0, 10, 20, 30, 40, 0, 0, 10, 20, 30, 40, 50]);
    }

    #[test]
    fn tof_comes_on_with_its_input_and_goes_off_the_preset_time_behind_it() {
        let (q, elapsed) = off_delay("_##______#");
        assert_eq!(q, /*       */ "_#######_#");
        assert_eq!(elapsed, [0, 0, 0, 0, 10, 20, 30, 40, 50, 0]);
    }

    #[test]
    fn tof_whose_input_comes_back_stays_on_and_begins_anew() {
        let (q, elapsed) = off_delay("#____#______");
        assert_eq!(q, /*       */ "###########_");
        assert_eq!(elapsed, [0, 0, 10, 20, 30, 0, 0, 10, 20, 30, 40, 50]);
    }

    #[test]
    fn tof_is_off_until_its_input_has_been_on() {
        assert_eq!(off_delay("________").0, "________");
    }

    #[test]
    fn tp_is_on_for_the_preset_time_behind_a_short_and_a_long_input() {
        let (q, elapsed) = pulse("#_______");
        assert_eq!(q, /*   */ "#####___");
        assert_eq!(elapsed, [0, 10, 20, 30, 40, 0, 0, 0]);
        let (q, elapsed) = pulse("########_");
        assert_eq!(q, /*   */ "#####____");
        assert_eq!(elapsed, [0, 10, 20, 30, 40, 50, 50, 50, 0]);
    }

    #[test]
    fn tp_does_not_begin_anew_while_it_is_on() {
        let (q, elapsed) = pulse("#_#_#_#####");
        assert_eq!(q, /*   */ "#####_#####");
        assert_eq!(elapsed, [0, 10, 20, 30, 40, 0, 0, 10, 20, 30, 40]);
        let (q, _) = pulse("#_#_###__#_");
        assert_eq!(
            q, "#####____##",
            "an input that came on before the end makes no second pulse"
        );
    }

    #[test]
    fn with_a_preset_time_of_0_ton_and_tof_follow_their_input_and_tp_is_never_on() {
        let now = Duration::from_secs(1);
        let (mut on, mut off, mut pulse) = (
            OnDelay::new(Duration::ZERO),
            OffDelay::new(Duration::ZERO),
            Pulse::new(Duration::ZERO),
        );
        for input in [true, false, true] {
            assert_eq!(on.update(input, now), input);
            assert_eq!(off.update(input, now), input);
            assert!(!pulse.update(input, now));
        }
    }

    #[test]
    fn a_time_that_goes_back_ends_nothing() {
        let mut timer = OnDelay::new(PRESET);
        timer.update(true, Duration::from_secs(10));
        assert!(!timer.update(true, Duration::ZERO));
        assert!(timer.update(true, Duration::from_millis(10_050)));
    }

    #[test]
    fn a_preset_time_that_is_changed_counts_at_once() {
        let mut timer = OnDelay::new(PRESET);
        timer.update(true, Duration::ZERO);
        timer.set_preset(Duration::from_millis(20));
        assert!(timer.update(true, Duration::from_millis(20)));
    }
}
