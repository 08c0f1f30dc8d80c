//! The unit ramp: from rest to speed 1 with limited acceleration and jerk.
//!
//! The ramp takes the time `ta + ts`: a jerk phase of `ts` at each end, and constant acceleration for `ta -
//! ts` between them.

/// The unit ramp S(t) with acceleration time `ta_s` and jerk time `ts_s`, both in seconds, `ta_s >= ts_s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitRamp {
    ta_s: f64,
    ts_s: f64,
}

impl UnitRamp {
    /// Creates the ramp with these times. An acceleration time below the jerk time is raised to the jerk
    /// time.
    pub fn new(ta_s: f64, ts_s: f64) -> Self {
        Self {
            ta_s: ta_s.max(ts_s),
            ts_s,
        }
    }

    /// Returns the ramp shortened to `duration_s`: first the jerk time is reduced, then the acceleration
    /// time.
    #[must_use]
    pub fn at_most(self, duration_s: f64) -> Self {
        if self.duration_s() <= duration_s {
            return self;
        }
        let ta_s = self.ta_s.min(duration_s);
        Self {
            ta_s,
            ts_s: duration_s - ta_s,
        }
    }

    /// Returns the shortest ramp whose times are at least those of `self`, whose slope `dS/dt` is at most
    /// `slope` per second, and whose change of slope is at most `change` per second squared.
    #[must_use]
    pub fn within(self, slope: f64, change: f64) -> Self {
        let ta_s = self.ta_s.max(1.0 / slope);
        let ts_s = self.ts_s.max(1.0 / (change * ta_s));
        if ts_s <= ta_s {
            return Self { ta_s, ts_s };
        }
        // The ramp would need `ts > ta`, so it has no phase of constant acceleration: `ta = ts`.
        let both_s = change.sqrt().recip();
        Self {
            ta_s: both_s,
            ts_s: both_s,
        }
    }

    /// Returns the largest slope of S, per second, and the largest change of the slope, per second squared.
    /// The change is infinite without a jerk time.
    #[inline]
    pub fn steepest(self) -> [f64; 2] {
        [1.0 / self.ta_s, 1.0 / (self.ta_s * self.ts_s)]
    }

    /// Returns the jerk time `ts`, s.
    #[inline]
    pub fn jerk_time_s(self) -> f64 {
        self.ts_s
    }

    /// Returns the duration `ta + ts`, s.
    #[inline]
    pub fn duration_s(self) -> f64 {
        self.ta_s + self.ts_s
    }

    /// Returns S(t): the share of the final speed at `t_s` seconds, 0 before the ramp and 1 after it.
    #[inline]
    pub fn speed(self, t_s: f64) -> f64 {
        let duration = self.duration_s();
        if t_s <= 0.0 {
            0.0
        } else if t_s >= duration {
            1.0
        } else if t_s <= self.ta_s {
            self.rising_speed(t_s)
        } else {
            1.0 - self.rising_speed(duration - t_s)
        }
    }

    /// Returns P(t), the integral of S from 0 to `t_s` seconds. At the end of the ramp P is half the
    /// duration; after it, P grows with t.
    #[inline]
    pub fn distance(self, t_s: f64) -> f64 {
        let duration = self.duration_s();
        if t_s <= 0.0 {
            0.0
        } else if t_s >= duration {
            t_s - duration / 2.0
        } else if t_s <= self.ta_s {
            self.rising_distance(t_s)
        } else {
            t_s - duration / 2.0 + self.rising_distance(duration - t_s)
        }
    }

    /// Returns begin and end of the three phases, s: first jerk phase, constant acceleration, second jerk
    /// phase.
    #[inline]
    pub fn phases(self) -> [[f64; 2]; 3] {
        let Self { ta_s: ta, ts_s: ts } = self;
        [[0.0, ts], [ts, ta], [ta, ta + ts]]
    }

    /// Returns the first and second derivative of S at `t_s`, by the formula of the phase that contains
    /// `within_s`. Returns 0 if `within_s` is outside the ramp.
    #[inline]
    pub fn slopes(self, t_s: f64, within_s: f64) -> [f64; 2] {
        let Self { ta_s: ta, ts_s: ts } = self;
        if within_s <= 0.0 || within_s >= self.duration_s() {
            [0.0, 0.0]
        } else if within_s < ts {
            [t_s / (ta * ts), 1.0 / (ta * ts)]
        } else if within_s <= ta {
            [1.0 / ta, 0.0]
        } else {
            [(self.duration_s() - t_s) / (ta * ts), -1.0 / (ta * ts)]
        }
    }

    /// Returns S(t) for t up to ta: first jerk phase and constant acceleration.
    #[inline]
    fn rising_speed(self, t_s: f64) -> f64 {
        let Self { ta_s: ta, ts_s: ts } = self;
        if t_s < ts {
            t_s * t_s / (2.0 * ta * ts)
        } else {
            (t_s - ts / 2.0) / ta
        }
    }

    /// Returns P(t) for t up to ta: first jerk phase and constant acceleration.
    #[inline]
    fn rising_distance(self, t_s: f64) -> f64 {
        let Self { ta_s: ta, ts_s: ts } = self;
        if t_s < ts {
            t_s * t_s * t_s / (6.0 * ta * ts)
        } else {
            let past = t_s - ts;
            ts * ts / (6.0 * ta) + ts * past / (2.0 * ta) + past * past / (2.0 * ta)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-12, "{a} is not {b}");
    }

    #[test]
    fn a_ramp_covers_half_of_what_full_speed_would() {
        let ramp = UnitRamp::new(0.1, 0.05);
        close(ramp.duration_s(), 0.15);
        close(ramp.distance(0.15), 0.075);
    }

    #[test]
    fn speed_and_distance_follow_the_three_phases() {
        let ramp = UnitRamp::new(0.1, 0.05);
        // jerk phase: S = t^2/(2 ta ts), P = t^3/(6 ta ts)
        close(ramp.speed(0.02), 0.0004 / 0.01);
        close(ramp.distance(0.02), 0.000_008 / 0.03);
        // constant acceleration: S = (t - ts/2)/ta
        close(ramp.speed(0.075), 0.5);
        // the end mirrors the start
        close(ramp.speed(0.13), 1.0 - 0.0004 / 0.01);
    }

    #[test]
    fn without_jerk_time_the_ramp_is_a_straight_line() {
        let ramp = UnitRamp::new(0.2, 0.0);
        close(ramp.speed(0.05), 0.25);
        close(ramp.distance(0.1), 0.1 * 0.1 / 0.4);
    }

    #[test]
    fn acceleration_time_is_never_below_jerk_time() {
        close(UnitRamp::new(0.01, 0.05).duration_s(), 0.1);
    }

    #[test]
    fn s1b_in_a_shorter_ramp_the_jerk_time_gives_way_first() {
        let ramp = UnitRamp::new(0.1, 0.05);
        assert_eq!(ramp.at_most(0.2), ramp);
        let shorter = ramp.at_most(0.12);
        close(shorter.ta_s, 0.1);
        close(shorter.ts_s, 0.02);
        assert_eq!(ramp.at_most(0.04), UnitRamp::new(0.04, 0.0));
    }

    #[test]
    fn the_shortest_ramp_within_limits_of_slope_and_jerk() {
        let ramp = UnitRamp::new(0.1, 0.02);
        // Limits above the ramp's own values change nothing: slope 1/ta = 10, change 1/(ta ts) = 500.
        assert_eq!(ramp.within(10.5, 505.0), ramp);
        // ta = 1/slope; ts stays while its change of 1/(0.2 0.02) = 250 is within the limit.
        let longer = ramp.within(5.0, 260.0);
        close(longer.ta_s, 0.2);
        close(longer.ts_s, 0.02);
        // ts = slope/change.
        let softer = ramp.within(5.0, 50.0);
        close(softer.ta_s, 0.2);
        close(softer.ts_s, 0.1);
        // The slope is not reached: ta = ts, change 1/ts^2.
        let soft = ramp.within(1000.0, 25.0);
        close(soft.ta_s, 0.2);
        close(soft.ts_s, 0.2);
    }

    #[test]
    fn what_is_not_a_number_stays_so() {
        let ramp = UnitRamp::new(0.1, 0.05);
        assert!(ramp.speed(f64::NAN).is_nan());
        assert!(ramp.distance(f64::NAN).is_nan());
        assert!(UnitRamp::new(f64::NAN, f64::NAN).distance(0.1).is_nan());
    }

    #[test]
    fn jerk_time_and_acceleration_time_may_differ_by_the_last_bit() {
        let ramp = UnitRamp::new(f64::from_bits(0.05_f64.to_bits() + 1), 0.05);
        for k in 0..=1000 {
            let t_s = 0.1 * f64::from(k) / 1000.0;
            assert!((ramp.distance(t_s) - UnitRamp::new(0.05, 0.05).distance(t_s)).abs() < 1e-15);
        }
    }
}
