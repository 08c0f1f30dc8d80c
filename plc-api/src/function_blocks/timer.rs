//! Timers: IEC 61131-3, table "Standard timer function blocks" and its timing diagrams.
//!
//! Each call receives the time of the scan. If that time is before the start of a running timer, the elapsed
//! time of the timer is 0. A changed preset time applies from the next call on, also to a running timer.

use std::time::Duration;

/// Measured time of a timer, which increases up to the preset time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PresetTimer {
    preset: Duration,
    /// Time of the scan in which the measurement started; `None` while no time is measured.
    since: Option<Duration>,
    elapsed: Duration,
}

impl PresetTimer {
    const fn new(preset: Duration) -> Self {
        Self {
            preset,
            since: None,
            elapsed: Duration::ZERO,
        }
    }

    /// Starts or continues the measurement; returns true once the preset time has passed.
    fn run(&mut self, now: Duration) -> bool {
        let since = *self.since.get_or_insert(now);
        self.elapsed = now.saturating_sub(since).min(self.preset);
        self.elapsed >= self.preset
    }

    fn clear(&mut self) {
        (self.since, self.elapsed) = (None, Duration::ZERO);
    }
}

/// `TON`: the output turns on when the input has been on for the preset time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OnDelay {
    /// Time since the input turned on.
    time: PresetTimer,
    q: bool,
}

impl OnDelay {
    /// Creates a timer with this preset time, `PT`.
    pub const fn new(preset: Duration) -> Self {
        Self {
            time: PresetTimer::new(preset),
            q: false,
        }
    }

    /// Updates the timer with the input `IN` and the time of the scan; returns `Q`.
    pub fn update(&mut self, input: bool, now: Duration) -> bool {
        self.q = if input {
            self.time.run(now)
        } else {
            self.time.clear();
            false
        };
        self.q
    }

    /// Returns `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }

    /// Returns `ET`: the time since the input turned on, at most the preset time.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed
    }

    /// Sets `PT`, the preset time.
    pub fn set_preset(&mut self, preset: Duration) {
        self.time.preset = preset;
    }
}

/// `TOF`: the output turns off when the input has been off for the preset time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OffDelay {
    /// Time since the input turned off.
    time: PresetTimer,
    q: bool,
}

impl OffDelay {
    /// Creates a timer with this preset time, `PT`. The output is off until the input has been on.
    pub const fn new(preset: Duration) -> Self {
        Self {
            time: PresetTimer::new(preset),
            q: false,
        }
    }

    /// Updates the timer with the input `IN` and the time of the scan; returns `Q`.
    pub fn update(&mut self, input: bool, now: Duration) -> bool {
        if input {
            self.time.clear();
            self.q = true;
        } else if self.q {
            self.q = !self.time.run(now);
        }
        self.q
    }

    /// Returns `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }

    /// Returns `ET`: the time since the input turned off, at most the preset time. The value is kept until
    /// the input turns on.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed
    }

    /// Sets `PT`, the preset time.
    pub fn set_preset(&mut self, preset: Duration) {
        self.time.preset = preset;
    }
}

/// `TP`: the output is on for the preset time after the input turns on, independent of the later input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// Time since the start of the pulse. The pulse may have ended while the input is still on.
    time: PresetTimer,
    q: bool,
}

impl Pulse {
    /// Creates a timer with this preset time, `PT`.
    pub const fn new(preset: Duration) -> Self {
        Self {
            time: PresetTimer::new(preset),
            q: false,
        }
    }

    /// Updates the timer with the input `IN` and the time of the scan; returns `Q`.
    pub fn update(&mut self, input: bool, now: Duration) -> bool {
        if input || self.q {
            self.q = !self.time.run(now);
        }
        if !input && !self.q {
            self.time.clear();
        }
        self.q
    }

    /// Returns `Q` of the last call.
    pub fn q(&self) -> bool {
        self.q
    }

    /// Returns `ET`: the time since the start of the pulse, at most the preset time. The value is kept until
    /// the input turns off.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed
    }

    /// Sets `PT`, the preset time.
    pub fn set_preset(&mut self, preset: Duration) {
        self.time.preset = preset;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRESET: Duration = Duration::from_millis(50);

    /// Calls a timer every 10 ms; returns `Q` and `ET` (in ms) after each call. In `input`, `_` means off and
    /// `#` means on, as in a timing diagram.
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
            "an input that turned on before the end starts no second pulse"
        );
    }

    #[test]
    fn with_preset_time_0_ton_and_tof_follow_the_input_and_tp_stays_off() {
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
