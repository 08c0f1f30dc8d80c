//! Changes of the override factor within the maximum jerks and accelerations of the motors (M1i.6).
//!
//! The factor is constant within a cycle. The third and the second difference of the setpoints of each motor limit the
//! factor of the coming cycle, by the setpoints of the last three cycles. So the limits also hold where the plan itself
//! accelerates, and where one plan replaces another.

use tandem_model::profile::{JERK_RESERVE, Law, Profile};
use tandem_model::{AXES_MAX, AxisVector};

use crate::channel::Channel;

/// Part of the jerk that the motion counts on for the end of a change.
const LANDING: f64 = 0.5;

/// Part of a rise of the factor for which the jerk of the plan is expected.
const AHEAD: f64 = 0.25;

/// Part of the jerk that a motor uses when it brakes to rest.
const BRAKING: f64 = 0.97;

/// Margin for rounding of the differences.
const ROUNDING: f64 = 5e-4;

/// Difference of two factors at which positions are compared.
const APART: f64 = 1e-3;

/// Change of the factor that is only rounding.
const FACTOR_ROUNDING: f64 = 1e-9;

/// Range of the factor.
#[derive(Debug, Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    /// Limits the range so that a value that is linear in the factor, given at two factors, is within a limit.
    fn limit(&mut self, factors: [f64; 2], values: [f64; 2], limit: f64) {
        let slope = (values[1] - values[0]) / (factors[1] - factors[0]);
        if slope == 0.0 || !slope.is_finite() {
            return;
        }
        let ends = [-limit, limit].map(|end| factors[0] + (end - values[0]) / slope);
        self.low = self.low.max(ends[0].min(ends[1]));
        self.high = self.high.min(ends[0].max(ends[1]));
    }

    /// Returns the nearest factor; if no factor is within all limits, the one between them.
    fn nearest(self, factor: f64) -> f64 {
        if self.low <= self.high {
            factor.clamp(self.low, self.high)
        } else {
            f64::midpoint(self.low, self.high)
        }
    }
}

impl Channel {
    /// Returns true if the jerks of the motors limit the factor of the coming cycle.
    pub(crate) fn limits_slew(&mut self, target: f64) -> bool {
        if !self.motors.has_jerk() {
            return false;
        }
        if target.total_cmp(&self.time.rate()).is_ne() {
            self.history.check();
        }
        self.history.is_checked()
    }

    /// Returns the factor of the coming cycle: as near to the target as the motors allow, with a change of at most `slope`
    /// per second.
    pub(crate) fn factor_within_jerk(&mut self, target: f64, slope: f64) -> f64 {
        self.history.pass_check();
        let rate = self.time.rate();
        let wanted = self.wanted_factor(target, slope);
        let mut other = wanted;
        let mut factor = wanted;
        // The positions are not exactly linear in the factor, so the second estimate begins at the first.
        for _ in 0..2 {
            if (other - rate).abs() < APART {
                other = rate + if rate > 0.5 { -APART } else { APART };
            }
            factor = self.range(other, target).nearest(wanted).max(0.0);
            other = factor;
        }
        factor
    }

    /// Returns the range of the factor within the limits of the motors, by the positions with the present and another
    /// factor.
    fn range(&mut self, other: f64, target: f64) -> Range {
        let (now, step_s, rate) = (self.setpoint, self.period_s, self.time.rate());
        let at = [rate, other].map(|factor| self.position_ahead(self.time.now_s() + factor * step_s));
        let [one, two] = self.history.before();
        let mut range = Range {
            low: 0.0,
            high: 1.0_f64.max(rate).max(target),
        };
        for i in 0..AXES_MAX {
            let limits = self.motors.limits_of(i).map(|limit| limit * (1.0 - ROUNDING));
            let third = at.map(|at| at.0[i] - 3.0 * now.0[i] + 3.0 * one.0[i] - two.0[i]);
            let second = at.map(|at| at.0[i] - 2.0 * now.0[i] + one.0[i]);
            for (values, limit) in [
                (third, limits[0] * step_s.powi(3)),
                (second, limits[1] * step_s * step_s),
            ] {
                if limit.is_finite() {
                    range.limit([rate, other], values, limit);
                }
            }
        }
        range
    }

    /// Returns the factor from which the change can end at the target, without regard to the last cycles.
    fn wanted_factor(&mut self, target: f64, slope: f64) -> f64 {
        let t = self.period_s;
        let now_s = self.time.now_s();
        let rate = self.time.rate();
        let distance = (target - rate).abs();
        let [one, two, three] = [0.0, t, 2.0 * t].map(|after_s| self.position_ahead(now_s + after_s));
        // Parts of the jerk that the plan leaves at the target, and on the way to it
        let left_at = |factor: f64| 1.0 - (1.0 - JERK_RESERVE) * factor.powi(3).min(1.0);
        let [left, left_here] = [target, rate.max(AHEAD.mul_add(target - rate, rate))].map(left_at);
        let mut bend = f64::INFINITY;
        let mut slope = slope;
        for i in 0..AXES_MAX {
            let [jerk, _] = self.motors.limits_of(i);
            if jerk.is_finite() {
                let speed = (two.0[i] - one.0[i]) / t;
                let acceleration = (three.0[i] - 2.0 * two.0[i] + one.0[i]) / (t * t);
                bend = bend.min(LANDING * left * jerk / speed.abs());
                slope = slope
                    .min(LANDING * left_here * jerk / (3.0 * acceleration.abs() * rate.max(AHEAD * target)));
                if target < rate && acceleration * speed < 0.0 {
                    // The motor already brakes. Within the jerk it comes to rest from the speed v with at most sqrt(2 j v).
                    let most = (2.0 * BRAKING * jerk * speed.abs() * rate).sqrt();
                    slope = slope.min((most - acceleration.abs() * rate * rate).max(0.0) / speed.abs());
                }
            }
        }
        let change = if bend.is_finite() {
            bend * ((t * t + 2.0 * distance / bend).sqrt() - t)
        } else {
            f64::INFINITY
        };
        let step = (change.min(slope) * t).min(distance);
        if distance - step <= FACTOR_ROUNDING {
            target
        } else {
            rate + step.copysign(target - rate)
        }
    }

    /// Returns the position at a time of the running profile; beyond its end, on the profiles that follow it.
    fn position_ahead(&mut self, t_s: f64) -> AxisVector {
        let Some(profile) = &self.current else {
            return self.setpoint;
        };
        let mut left_s = t_s - self.skip.duration_s(profile);
        if left_s <= 0.0 {
            return self.skip.position(profile, t_s);
        }
        let mut end = self.skip.end_position(profile);
        if profile.exact_stop {
            return end;
        }
        let Some(chunk) = self.profiles.waiting() else {
            return end;
        };
        let (first, second) = chunk.as_slices();
        for next in first.iter().chain(second) {
            if left_s < next.duration_s {
                return next.position(left_s);
            }
            left_s -= next.duration_s;
            end = next.end_position();
            if next.exact_stop {
                break;
            }
        }
        end
    }
}

/// Returns true for a motion whose plan keeps the maximum jerks.
pub(crate) fn has_jerk_limit(profile: &Profile) -> bool {
    match &profile.law {
        Law::Paced { .. } | Law::Motors { .. } | Law::Skip { .. } => true,
        Law::Ramped { .. } | Law::Tap { .. } | Law::Rest { .. } => false,
    }
}
