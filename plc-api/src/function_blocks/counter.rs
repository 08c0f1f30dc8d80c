//! Counters: IEC 61131-3, table "Standard counter function blocks".
//!
//! The counters count rising edges. Their value stays within the range of `i64`, as the standard requires for
//! `PVmin` and `PVmax`.

use super::edge::RisingEdge;

/// `CTU`: a counter that counts up. Its output is on while the value is at least the preset value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UpCounter {
    up: RisingEdge,
    preset: i64,
    value: i64,
}

impl UpCounter {
    /// Creates a counter with the value 0 and this preset value, `PV`.
    pub const fn new(preset: i64) -> Self {
        Self {
            up: RisingEdge::NEW,
            preset,
            value: 0,
        }
    }

    /// Updates the counter with the inputs `CU`, which counts rising edges, and `R`, which sets the value to
    /// 0; returns `Q`.
    pub fn update(&mut self, up: bool, reset: bool) -> bool {
        let up = self.up.update(up);
        if reset {
            self.value = 0;
        } else if up {
            self.value = self.value.saturating_add(1);
        }
        self.q()
    }

    /// Returns `Q`: true if the value is at least the preset value.
    pub fn q(&self) -> bool {
        self.value >= self.preset
    }

    /// Returns `CV`, the value of the counter.
    pub fn value(&self) -> i64 {
        self.value
    }

    /// Sets `PV`, the preset value.
    pub fn set_preset(&mut self, preset: i64) {
        self.preset = preset;
    }
}

/// `CTD`: a counter that counts down from its preset value. Its output is on while the value is 0 or less.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DownCounter {
    down: RisingEdge,
    preset: i64,
    value: i64,
}

impl DownCounter {
    /// Creates a counter with this preset value, `PV`. Until the first load the value is 0, and thus the
    /// output on.
    pub const fn new(preset: i64) -> Self {
        Self {
            down: RisingEdge::NEW,
            preset,
            value: 0,
        }
    }

    /// Updates the counter with the inputs `CD`, which counts rising edges, and `LD`, which sets the value to
    /// the preset value; returns `Q`.
    pub fn update(&mut self, down: bool, load: bool) -> bool {
        let down = self.down.update(down);
        if load {
            self.value = self.preset;
        } else if down {
            self.value = self.value.saturating_sub(1);
        }
        self.q()
    }

    /// Returns `Q`: true if the value is 0 or less.
    pub fn q(&self) -> bool {
        self.value <= 0
    }

    /// Returns `CV`, the value of the counter.
    pub fn value(&self) -> i64 {
        self.value
    }

    /// Sets `PV`, the preset value, which applies from the next load on.
    pub fn set_preset(&mut self, preset: i64) {
        self.preset = preset;
    }
}

/// `CTUD`: a counter that counts up and down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UpDownCounter {
    up: RisingEdge,
    down: RisingEdge,
    preset: i64,
    value: i64,
}

impl UpDownCounter {
    /// Creates a counter with the value 0 and this preset value, `PV`.
    pub const fn new(preset: i64) -> Self {
        Self {
            up: RisingEdge::NEW,
            down: RisingEdge::NEW,
            preset,
            value: 0,
        }
    }

    /// Updates the counter with the inputs `CU`, `CD`, `R` and `LD`. If `CU` and `CD` have an edge in the
    /// same call, the value does not change. `R` has priority over `LD`, and both have priority over the
    /// edges.
    #[expect(
        clippy::fn_params_excessive_bools,
        reason = "the inputs of the standard, in its order"
    )]
    pub fn update(&mut self, up: bool, down: bool, reset: bool, load: bool) {
        let (up, down) = (self.up.update(up), self.down.update(down));
        self.value = match (reset, load, up, down) {
            (true, ..) => 0,
            (_, true, ..) => self.preset,
            (_, _, true, false) => self.value.saturating_add(1),
            (_, _, false, true) => self.value.saturating_sub(1),
            _ => self.value,
        };
    }

    /// Returns `QU`: true if the value is at least the preset value.
    pub fn q_up(&self) -> bool {
        self.value >= self.preset
    }

    /// Returns `QD`: true if the value is 0 or less.
    pub fn q_down(&self) -> bool {
        self.value <= 0
    }

    /// Returns `CV`, the value of the counter.
    pub fn value(&self) -> i64 {
        self.value
    }

    /// Sets `PV`, the preset value.
    pub fn set_preset(&mut self, preset: i64) {
        self.preset = preset;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ctu_counts_rising_edges_and_is_on_from_the_preset_value_on() {
        let mut counter = UpCounter::new(2);
        let calls = [true, true, false, true, false, true];
        let seen = calls.map(|up| (counter.update(up, false), counter.value()));
        assert_eq!(
            seen,
            [
                (false, 1),
                (false, 1),
                (false, 1),
                (true, 2),
                (true, 2),
                (true, 3)
            ]
        );
    }

    #[test]
    fn ctu_is_reset_before_it_counts_and_an_edge_during_the_reset_is_lost() {
        let mut counter = UpCounter::new(1);
        assert!(counter.update(true, false));
        counter.update(false, false);
        assert!(!counter.update(true, true));
        assert!(
            !counter.update(true, false),
            "the input was on before the reset ended"
        );
        assert_eq!(counter.value(), 0);
    }

    #[test]
    fn ctd_counts_down_from_the_loaded_value_and_is_on_from_0_on() {
        let mut counter = DownCounter::new(2);
        assert!(counter.update(false, false), "it has not been loaded");
        assert!(!counter.update(true, true), "a load comes before the edge");
        assert_eq!(counter.value(), 2);
        let calls = [false, true, false, true, false, true];
        let seen = calls.map(|down| (counter.update(down, false), counter.value()));
        assert_eq!(
            seen,
            [
                (false, 2),
                (false, 1),
                (false, 1),
                (true, 0),
                (true, 0),
                (true, -1)
            ]
        );
    }

    #[test]
    fn ctud_counts_no_edge_of_both_inputs_at_once() {
        let mut counter = UpDownCounter::new(1);
        counter.update(true, false, false, false);
        assert_eq!(
            (counter.value(), counter.q_up(), counter.q_down()),
            (1, true, false)
        );
        counter.update(false, false, false, false);
        counter.update(true, true, false, false);
        assert_eq!(counter.value(), 1);
        counter.update(false, false, false, false);
        counter.update(false, true, false, false);
        assert_eq!(
            (counter.value(), counter.q_up(), counter.q_down()),
            (0, false, true)
        );
    }

    #[test]
    fn ctud_is_reset_before_it_is_loaded_and_loaded_before_it_counts() {
        let mut counter = UpDownCounter::new(5);
        counter.update(true, false, false, true);
        assert_eq!(counter.value(), 5);
        counter.update(false, false, true, true);
        assert_eq!(counter.value(), 0);
    }

    #[test]
    fn a_counter_at_the_limit_of_its_value_stays_there() {
        let mut up = UpCounter {
            value: i64::MAX,
            ..UpCounter::new(1)
        };
        up.update(true, false);
        let mut down = DownCounter {
            value: i64::MIN,
            ..DownCounter::new(1)
        };
        down.update(true, false);
        assert_eq!((up.value(), down.value()), (i64::MAX, i64::MIN));
    }
}
