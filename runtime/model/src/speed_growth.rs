//! Programmed speed and covered distance as functions of plan time, on a ramp between two feedrates.
//!
//! At a joint of different feedrates the speed along both blocks changes with plan time: `U = v_1 (1 - S) +
//! v_2 S`. If two blocks have one direction, the path of the ramp is a straight line in the distance, the
//! integral of U, for any ramp times.

/// Largest number of Newton steps.
const STEPS_MAX: u32 = 16;

/// Upper bound of the first Newton value, as a multiple of the solution for the third power alone. No piece
/// with a falling speed is longer.
const THIRD_POWERS: f64 = 4.0;

/// Share of the plan time below which a Newton step is only rounding.
const ROUNDING: f64 = 1e-16;

/// The speed within a piece, relative to the speed at the start of the piece.
///
/// It is a polynomial of second degree in the plan time since the start, and is above zero on the whole
/// piece. Without growth, the polynomial is 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpeedGrowth {
    /// First derivative at the start of the piece, per second.
    pub first: f64,
    /// Second derivative, per second squared.
    pub second: f64,
}

impl SpeedGrowth {
    /// Returns true if the speed is constant.
    pub fn is_none(self) -> bool {
        self.first == 0.0 && self.second == 0.0
    }

    /// Returns the same growth for backward motion, in which plan time falls.
    #[must_use]
    pub fn reversed(self) -> Self {
        Self {
            first: -self.first,
            ..self
        }
    }

    /// Returns the speed `plan_s` seconds of plan time after the start, relative to the speed at the start.
    pub fn speed(self, plan_s: f64) -> f64 {
        1.0 + plan_s * (self.first + plan_s * self.second / 2.0)
    }

    /// Returns the distance covered `plan_s` seconds of plan time after the start, divided by the initial
    /// speed, s.
    pub fn distance_s(self, plan_s: f64) -> f64 {
        plan_s * (1.0 + plan_s * (self.first + plan_s * self.second / 3.0) / 2.0)
    }

    /// Returns the plan time from the start to the point at which this distance is covered, s. It is the
    /// inverse of [`SpeedGrowth::distance_s`].
    pub fn plan_s(self, distance_s: f64) -> f64 {
        if self.is_none() {
            return distance_s;
        }
        // The solution for a constant slope has a closed form, with which Newton's method begins.
        let square = 1.0 + 2.0 * self.first * distance_s;
        let mut plan_s = 2.0 * distance_s / (1.0 + square.max(0.0).sqrt());
        if self.second == 0.0 {
            return plan_s;
        }
        if self.second > 0.0 {
            // With a slope near zero the third power dominates, and Newton would converge slowly from far above.
            let by_third_power = (6.0 * distance_s.abs() / self.second).cbrt();
            plan_s = plan_s.abs().min(THIRD_POWERS * by_third_power).copysign(plan_s);
        }
        for _ in 0..STEPS_MAX {
            let step_s = (self.distance_s(plan_s) - distance_s) / self.speed(plan_s);
            if step_s.is_nan() {
                break;
            }
            plan_s -= step_s;
            if step_s.abs() <= ROUNDING * plan_s.abs() {
                break;
            }
        }
        plan_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A third of the ramp from 5 to 1 with jerk phases, and further growths.
    const GROWTHS: [SpeedGrowth; 6] = [
        SpeedGrowth {
            first: 0.0,
            second: 0.0,
        },
        SpeedGrowth {
            first: 900.0,
            second: 0.0,
        },
        SpeedGrowth {
            first: -0.9,
            second: 0.0,
        },
        SpeedGrowth {
            first: -0.9,
            second: 0.9,
        },
        SpeedGrowth {
            first: 0.9,
            second: -0.9,
        },
        SpeedGrowth {
            first: 0.0,
            second: 2.0,
        },
    ];

    #[test]
    fn the_distance_is_the_integral_of_the_speed() {
        for growth in GROWTHS {
            // Simpson's rule is exact for a polynomial of second degree.
            let h = 0.7;
            let integral = h / 6.0 * (1.0 + 4.0 * growth.speed(h / 2.0) + growth.speed(h));
            assert!(
                (growth.distance_s(h) - integral).abs() < 1e-12 * integral,
                "{growth:?}"
            );
        }
    }

    #[test]
    fn plan_time_is_found_where_speed_grows_a_millionfold_from_zero_slope() {
        for second in [2e1, 2e3, 2e6] {
            let growth = SpeedGrowth { first: 0.0, second };
            for k in 0..=100 {
                let plan_s = f64::from(k) / 100.0;
                let off = growth.plan_s(growth.distance_s(plan_s)) - plan_s;
                assert!(off.abs() < 1e-14, "{second} {plan_s}: {off}");
            }
            // Down again: the slope is zero at its end.
            let share = second / growth.speed(1.0);
            let down = SpeedGrowth {
                first: -share,
                second: share,
            };
            for k in 0..=100 {
                let distance_s = down.distance_s(f64::from(k) / 100.0);
                let again = down.distance_s(down.plan_s(distance_s));
                assert!(
                    (again - distance_s).abs() < 1e-12,
                    "{second} {distance_s}: {again}"
                );
            }
        }
    }

    #[test]
    fn plan_time_is_found_from_the_distance_either_way() {
        for growth in GROWTHS {
            for k in 0..=100 {
                let plan_s = f64::from(k) / 100.0;
                let off = growth.plan_s(growth.distance_s(plan_s)) - plan_s;
                assert!(off.abs() < 1e-14, "{growth:?} {plan_s}: {off}");
                let back = growth.reversed();
                let off = back.plan_s(back.distance_s(-plan_s)) + plan_s;
                assert!(off.abs() < 1e-14, "{growth:?} -{plan_s}: {off}");
                assert!((back.speed(-plan_s) - growth.speed(plan_s)).abs() < 1e-12);
            }
        }
    }
}
