//! The time base of a channel (M1i): the time of the running profile advances at a rate whose change per
//! second is limited.

/// Tolerance as a share of a period: a slew that ends at most this much after a period is treated as ending
/// within the period, because of rounding.
const STEP_TOLERANCE: f64 = 1e-9;

/// Profile time. At a constant rate the time is calculated from a number of cycles, not summed. So at 100
/// percent sample k is at exactly k periods, even after hours.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathTime {
    period_s: f64,
    /// Profile time per time; 1.0 is the programmed speed.
    rate: f64,
    /// Profile time when the rate last changed, s.
    anchor_s: f64,
    /// Number of cycles at this rate since the last change.
    cycles: u64,
}

impl PathTime {
    pub(crate) fn new(period_s: f64) -> Self {
        Self {
            period_s,
            rate: 0.0,
            anchor_s: 0.0,
            cycles: 0,
        }
    }

    pub(crate) fn rate(&self) -> f64 {
        self.rate
    }

    /// Returns the profile time of the last cycle, s.
    pub(crate) fn now_s(&self) -> f64 {
        self.anchor_s + self.cycles as f64 * (self.rate * self.period_s)
    }

    /// Begins a profile at this rate and this profile time.
    pub(crate) fn start_profile(&mut self, rate: f64, at_s: f64) {
        self.rate = rate;
        self.carry_over(at_s);
    }

    /// Sets the rate to 0 at the current profile time.
    pub(crate) fn stop(&mut self) {
        self.start_profile(0.0, self.now_s());
    }

    /// Begins a profile that follows another profile without a stop, at this profile time. The rate stays.
    pub(crate) fn carry_over(&mut self, at_s: f64) {
        self.anchor_s = at_s;
        self.cycles = 0;
    }

    /// Advances by this number of cycles at the current rate.
    pub(crate) fn pass(&mut self, cycles: u64) {
        self.cycles += cycles;
    }

    /// Advances by one cycle at a new rate. Returns the profile time.
    pub(crate) fn step(&mut self, rate: f64) -> f64 {
        if rate.total_cmp(&self.rate).is_eq() {
            self.cycles += 1;
            return self.now_s();
        }
        let at_s = self.now_s() + rate * self.period_s;
        self.start_profile(rate, at_s);
        at_s
    }

    /// Advances by one cycle towards a target rate, with a change of at most `slope` per second. Returns the
    /// profile time.
    pub(crate) fn advance(&mut self, target: f64, slope: f64) -> f64 {
        let change = target - self.rate;
        if change == 0.0 {
            self.cycles += 1;
            return self.now_s();
        }
        let now_s = self.now_s();
        let slew_s = change.abs() / slope;
        let (rate, step_s) = if slew_s <= self.period_s * (1.0 + STEP_TOLERANCE) {
            let slewed_s = f64::midpoint(self.rate, target) * slew_s;
            (target, slewed_s + target * (self.period_s - slew_s).max(0.0))
        } else {
            let rate = self.rate + slope.copysign(change) * self.period_s;
            (rate, f64::midpoint(self.rate, rate) * self.period_s)
        };
        self.rate = rate;
        self.carry_over(now_s + step_s);
        self.anchor_s
    }
}

/// Returns the slope of a slew of 100 percent in this time, per second. Returns infinity if the time is not
/// above 0.
pub(crate) fn slope(slew_ms: f64) -> f64 {
    if slew_ms > 0.0 {
        1000.0 / slew_ms
    } else {
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-12, "{a} is not {b}");
    }

    #[test]
    fn s1i_at_full_rate_sample_k_is_at_k_periods_after_ten_hours() {
        let mut time = PathTime::new(0.001);
        time.start_profile(1.0, 0.0);
        time.cycles = 36_000_000 - 1;
        assert_eq!(
            time.advance(1.0, 5.0).to_bits(),
            (36_000_000.0_f64 * 0.001).to_bits()
        );
    }

    #[test]
    fn s1i_a_hold_of_slew_time_h_goes_on_for_half_of_h() {
        for slew_ms in [200.0, 37.3, 0.4] {
            let mut time = PathTime::new(0.001);
            time.start_profile(1.0, 0.0);
            let mut cycles = 0;
            while time.rate() > 0.0 {
                time.advance(0.0, slope(slew_ms));
                cycles += 1;
            }
            close(time.anchor_s, slew_ms / 2000.0);
            assert!((f64::from(cycles) - slew_ms).abs() < 1.0);
        }
    }

    #[test]
    fn s1i_a_slew_time_of_zero_changes_the_rate_at_once() {
        let mut time = PathTime::new(0.001);
        time.start_profile(1.0, 0.0);
        close(time.advance(0.5, slope(0.0)), 0.0005);
        close(time.advance(0.5, slope(0.0)), 0.001);
    }

    #[test]
    fn s1i_the_rate_passes_within_a_period_to_its_target() {
        // 1.0 to 0.9 at 200 per second takes 0.5 ms of a 1 ms period: 0.95 * 0.5 + 0.9 * 0.5
        let mut time = PathTime::new(0.001);
        time.start_profile(1.0, 0.0);
        close(time.advance(0.9, 200.0), 0.000_475 + 0.000_45);
    }
}
