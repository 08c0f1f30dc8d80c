//! The stop of a single motor from any velocity and acceleration (M1e.3).

use crate::motor_move::MotorLimits;
use crate::pace::SlewRoom;

/// The fastest stop of one motor with limited acceleration and jerk: its acceleration changes to a deceleration, stays
/// there, and changes to 0. Without a jerk limit, the deceleration begins and ends at once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorStop {
    /// Direction of the motion, 1 or -1.
    direction: f64,
    /// Velocity and acceleration at the start in this direction, units per second and per second squared.
    start: [f64; 2],
    /// Largest deceleration, units per second squared.
    deceleration: f64,
    jerk: f64,
    /// Times of the three phases, s.
    phases_s: [f64; 3],
}

impl MotorStop {
    /// Returns the stop from a velocity and an acceleration, units per second and per second squared.
    ///
    /// With the velocity v, the acceleration a (negative if the motor brakes already), the jerk j and the largest
    /// deceleration p, the phases take `(a + p)/j`, `(v + a^2/(2 j) - p^2/j)/p` and `p/j`. Here p is the limit, or
    /// `sqrt(j v + a^2/2)`, at which the second phase takes no time.
    pub fn fastest(velocity: f64, acceleration: f64, limits: MotorLimits) -> Self {
        let direction = if velocity == 0.0 { acceleration } else { velocity }.signum();
        let (v, a) = (velocity * direction, acceleration * direction);
        let Some(jerk) = limits.jerk else {
            return Self {
                direction,
                start: [v, -limits.acceleration],
                deceleration: limits.acceleration,
                jerk: 0.0,
                phases_s: [0.0, v / limits.acceleration, 0.0],
            };
        };
        let whole = v + a * a / (2.0 * jerk);
        let deceleration = limits.acceleration.min((jerk * whole).sqrt()).max(-a);
        let even_s = if deceleration > 0.0 {
            ((whole - deceleration * deceleration / jerk) / deceleration).max(0.0)
        } else {
            0.0
        };
        Self {
            direction,
            start: [v, a],
            deceleration,
            jerk,
            phases_s: [(a + deceleration) / jerk, even_s, deceleration / jerk],
        }
    }

    /// Returns the time to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.phases_s.iter().sum()
    }

    /// Returns the signed distance covered after `t_s` seconds.
    pub fn distance(&self, t_s: f64) -> f64 {
        let [mut v, mut a] = self.start;
        let (mut gone, mut left_s) = (0.0, t_s.max(0.0));
        for (phase_s, jerk) in self.phases_s.into_iter().zip([-self.jerk, 0.0, self.jerk]) {
            let t = phase_s.min(left_s);
            gone += t * (v + t * (a / 2.0 + t * jerk / 6.0));
            v += t * (a + t * jerk / 2.0);
            a += t * jerk;
            left_s -= t;
        }
        gone * self.direction
    }

    /// Returns the room for overrides and feed hold during the stop, for a motor with this maximum acceleration.
    pub fn room(&self, max_acceleration: f64) -> SlewRoom {
        let [v, a] = self.start;
        let most = max_acceleration.max(self.deceleration).max(a);
        // While an acceleration falls to 0, the velocity rises.
        let fastest = if self.jerk > 0.0 {
            v + a.max(0.0).powi(2) / (2.0 * self.jerk)
        } else {
            v
        };
        SlewRoom {
            slope: most / fastest,
            braking: self.deceleration / most,
            driving: a.max(0.0) / most,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(jerk: Option<f64>) -> MotorLimits {
        MotorLimits {
            velocity: 100.0,
            acceleration: 1000.0,
            jerk,
        }
    }

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9, "{a} is not {b}");
    }

    #[test]
    fn m1e3_without_a_jerk_limit_the_deceleration_is_constant() {
        // v = 50, a = 1000: 0.05 s, v^2/(2 a) = 1.25
        let stop = MotorStop::fastest(-50.0, 300.0, limits(None));
        close(stop.duration_s(), 0.05);
        close(stop.distance(0.05), -1.25);
        close(stop.distance(1.0), -1.25);
    }

    #[test]
    fn m1e3_with_a_jerk_limit_the_stop_has_three_phases() {
        // v = 100, j = 20000: phases of a/j = 0.05 s and v/a - a/j = 0.05 s; the mean speed is half of v.
        let stop = MotorStop::fastest(100.0, 0.0, limits(Some(20_000.0)));
        close(stop.duration_s(), 0.15);
        close(stop.distance(0.15), 100.0 * 0.15 / 2.0);
        // v = 20 does not reach the limit: two phases of sqrt(v/j)
        let short = MotorStop::fastest(-20.0, 0.0, limits(Some(20_000.0)));
        close(short.duration_s(), 2.0 * (20.0_f64 / 20_000.0).sqrt());
        close(short.distance(1.0), -20.0 * short.duration_s() / 2.0);
    }

    #[test]
    fn m1e3_a_stop_from_any_state_ends_at_rest_within_the_limits() {
        for velocity in [-80.0, -3.0, 5.0, 100.0_f64] {
            // A motor that brakes has a velocity from which it can come to rest within the jerk.
            let jerk = 20_000.0;
            let most = (2.0 * jerk * velocity.abs()).sqrt().min(1000.0);
            for share in [-1.0, -0.4, 0.0, 0.7] {
                let acceleration = share * most * velocity.signum();
                let stop = MotorStop::fastest(velocity, acceleration, limits(Some(jerk)));
                let h = 1e-5;
                let at = |k: i32| stop.distance(stop.duration_s() * f64::from(k) / 1000.0);
                let step_s = stop.duration_s() / 1000.0;
                for k in 0..=997 {
                    let [p0, p1, p2, p3] = [0, 1, 2, 3].map(|n| at(k + n));
                    let second = (p2 - 2.0 * p1 + p0) / (step_s * step_s);
                    let third = (p3 - 3.0 * p2 + 3.0 * p1 - p0) / (step_s * step_s * step_s);
                    assert!(second.abs() <= 1000.0 + 1e-3, "{velocity} {share}: {second}");
                    assert!(third.abs() <= jerk * 1.001, "{velocity} {share}: {third}");
                }
                let end = stop.distance(stop.duration_s()) - stop.distance(stop.duration_s() - h);
                assert!(
                    end.abs() < 1e-4 * h * velocity.abs().max(1.0),
                    "{velocity} {share}: {end}"
                );
                let begin = stop.distance(h) / h;
                assert!((begin - velocity).abs() < 0.02, "{velocity} {share}: {begin}");
            }
        }
    }
}
