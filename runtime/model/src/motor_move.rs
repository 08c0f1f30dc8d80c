//! The motion of a single motor from rest to rest (M1e).

use crate::pace::SlewRoom;
use crate::ramp::UnitRamp;

/// The fastest move of one motor over a distance, from rest to rest, with limited speed, acceleration and
/// jerk. If all fields are zero, the motor does not move.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotorMove {
    /// Signed peak velocity, units per second.
    pub velocity: f64,
    /// Time of each of the two ramps, including its jerk phases, s.
    pub ramp_s: f64,
    /// Time of each of the two jerk phases of a ramp, s, at most half of `ramp_s`; 0 if jerk is not limited.
    pub jerk_s: f64,
    /// Time at peak velocity, s.
    pub cruise_s: f64,
}

impl MotorMove {
    /// Returns the time from start to rest, s.
    pub fn duration_s(&self) -> f64 {
        2.0 * self.ramp_s + self.cruise_s
    }

    /// Returns the shortest move from rest to rest over a signed distance D. For a distance of 0, all fields
    /// are zero.
    ///
    /// Without a jerk limit, the speed forms a trapezoid, or a triangle if `D < v^2/a`. With a jerk limit j,
    /// the ramp to a speed w has jerk phases of `ts` and an acceleration time `ta = w/a_peak`. If w is large
    /// enough to reach a (`w >= a^2/j`), `ts = a/j`, else `ts = ta = sqrt(w/j)`. Both ramps together cover
    /// the distance `w (ta + ts)`; w is the speed limit, or the speed at which this distance is D.
    pub fn shortest(distance: f64, limits: MotorLimits) -> Self {
        let way = distance.abs();
        if way == 0.0 {
            return Self::default();
        }
        let (peak, ramp_s, jerk_s) = match limits.jerk {
            None => without_jerk_limit(way, limits.velocity, limits.acceleration),
            Some(jerk) => with_jerk_limit(way, limits.velocity, limits.acceleration, jerk),
        };
        Self {
            velocity: peak.copysign(distance),
            ramp_s,
            jerk_s,
            cruise_s: (way / peak - ramp_s).max(0.0),
        }
    }

    /// Returns the signed velocity `t_s` seconds after the start.
    pub fn velocity_at(&self, t_s: f64) -> f64 {
        let left = self.duration_s() - t_s;
        if self.ramp_s <= 0.0 || t_s <= 0.0 || left <= 0.0 {
            return 0.0;
        }
        let ramp = UnitRamp::new(self.ramp_s - self.jerk_s, self.jerk_s);
        self.velocity * ramp.speed(t_s).min(ramp.speed(left))
    }

    /// Returns the signed acceleration `t_s` seconds after the start.
    pub fn acceleration_at(&self, t_s: f64) -> f64 {
        let left = self.duration_s() - t_s;
        if self.ramp_s <= 0.0 || t_s <= 0.0 || left <= 0.0 {
            return 0.0;
        }
        let ramp = UnitRamp::new(self.ramp_s - self.jerk_s, self.jerk_s);
        let [driving, _] = ramp.slopes(t_s, t_s);
        let [braking, _] = ramp.slopes(left, left);
        self.velocity * (driving - braking)
    }

    /// Returns the room for overrides and feed hold between two times of the move (M1i), for a motor with
    /// this maximum acceleration. A move whose own acceleration exceeds the maximum leaves no room.
    pub fn room(&self, max_acceleration: f64, from_s: f64, to_s: f64) -> SlewRoom {
        let brakes_s = self.ramp_s + self.cruise_s;
        if self.velocity == 0.0 || to_s <= 0.0 || from_s >= self.duration_s() {
            return SlewRoom::default();
        }
        let own = self.velocity.abs() / (self.ramp_s - self.jerk_s);
        let most = max_acceleration.max(own);
        let fastest = if to_s > self.ramp_s && from_s < brakes_s {
            self.velocity.abs()
        } else {
            self.velocity_at(from_s).abs().max(self.velocity_at(to_s).abs())
        };
        SlewRoom {
            slope: most / fastest,
            braking: if to_s > brakes_s { own / most } else { 0.0 },
            driving: if from_s < self.ramp_s { own / most } else { 0.0 },
        }
    }

    /// Returns the signed distance from the start after `t_s` seconds.
    #[inline]
    pub fn distance(&self, t_s: f64) -> f64 {
        if self.ramp_s <= 0.0 || t_s <= 0.0 {
            return 0.0;
        }
        let ramp = UnitRamp::new(self.ramp_s - self.jerk_s, self.jerk_s);
        let brakes_s = self.ramp_s + self.cruise_s;
        if t_s <= brakes_s {
            self.velocity * ramp.distance(t_s)
        } else {
            let left = (self.duration_s() - t_s).max(0.0);
            self.velocity * (brakes_s - ramp.distance(left))
        }
    }
}

/// Limits of one motor, all above zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorLimits {
    /// Maximum velocity, units per second.
    pub velocity: f64,
    /// Maximum acceleration, units per second squared.
    pub acceleration: f64,
    /// Maximum jerk, units per second cubed. `None` disables the limit.
    pub jerk: Option<f64>,
}

/// Part of a maximum jerk that plans leave for feed hold and overrides (M1i.6).
pub const JERK_RESERVE: f64 = 0.05;

/// Part of the acceleration that G00 and G31 leave for feed hold and overrides, if the motor has a maximum jerk.
const ACCELERATION_RESERVE: f64 = 0.03;

impl MotorLimits {
    /// Returns the limits for a plan. With a maximum jerk, a part of the acceleration and of the jerk remains for feed hold
    /// and overrides, which can then begin at any time.
    #[must_use]
    pub fn with_reserve(self) -> Self {
        match self.jerk {
            Some(jerk) => Self {
                acceleration: self.acceleration * (1.0 - ACCELERATION_RESERVE),
                jerk: Some(jerk * (1.0 - JERK_RESERVE)),
                ..self
            },
            None => self,
        }
    }
}

/// Returns the peak speed, ramp time and jerk time of a move without a jerk limit.
fn without_jerk_limit(way: f64, velocity: f64, acceleration: f64) -> (f64, f64, f64) {
    if way >= velocity * velocity / acceleration {
        (velocity, velocity / acceleration, 0.0)
    } else {
        // D = w^2/a; the ramp time is D/w, so that w * ramp equals D except for the last one or two bits.
        let peak = (way * acceleration).sqrt();
        (peak, way / peak, 0.0)
    }
}

/// Returns the peak speed, ramp time and jerk time of a move with a jerk limit.
fn with_jerk_limit(way: f64, velocity: f64, acceleration: f64, jerk: f64) -> (f64, f64, f64) {
    let full_jerk_s = acceleration / jerk;
    let full = if velocity >= acceleration * full_jerk_s {
        (velocity, velocity / acceleration + full_jerk_s, full_jerk_s)
    } else {
        let jerk_s = (velocity / jerk).sqrt();
        (velocity, 2.0 * jerk_s, jerk_s)
    };
    if way >= full.0 * full.1 {
        return full;
    }
    // Below the speed limit: D = w (w/a + a/j) if this w reaches a, else D = 2 w sqrt(w/j).
    if way >= 2.0 * acceleration * full_jerk_s * full_jerk_s {
        let discriminant = full_jerk_s * full_jerk_s + 4.0 * way / acceleration;
        let peak = 2.0 * way / (full_jerk_s + discriminant.sqrt());
        (peak, way / peak, full_jerk_s)
    } else {
        let jerk_s = (way / (2.0 * jerk)).cbrt();
        (jerk * jerk_s * jerk_s, 2.0 * jerk_s, jerk_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-12, "{a} is not {b}");
    }

    #[test]
    fn s1e_a_motor_move_without_jerk_limit_is_a_trapezoid() {
        // v = 10, a = 100: ramps of 0.1 s, 0.5 each; cruise 0.2 s, 2.0
        let trapezoid = MotorMove {
            velocity: 10.0,
            ramp_s: 0.1,
            jerk_s: 0.0,
            cruise_s: 0.2,
        };
        close(trapezoid.duration_s(), 0.4);
        close(trapezoid.distance(0.05), 100.0 * 0.05 * 0.05 / 2.0);
        close(trapezoid.distance(0.1), 0.5);
        close(trapezoid.distance(0.2), 1.5);
        close(trapezoid.distance(0.35), 3.0 - 100.0 * 0.05 * 0.05 / 2.0);
        close(trapezoid.distance(0.4), 3.0);
        close(trapezoid.distance(9.0), 3.0);
    }

    #[test]
    fn s1e_a_motor_move_with_jerk_limit_has_seven_phases() {
        // v = -8, ramp 0.2 s of jerk 0.05, constant 0.1, jerk 0.05: ta = 0.15, a = 8/0.15, j = a/0.05
        let shaped = MotorMove {
            velocity: -8.0,
            ramp_s: 0.2,
            jerk_s: 0.05,
            cruise_s: 0.1,
        };
        let jerk = 8.0 / 0.15 / 0.05;
        close(shaped.distance(0.04), -jerk * 0.04_f64.powi(3) / 6.0);
        close(shaped.distance(0.2), -8.0 * 0.1);
        close(shaped.distance(0.3), -8.0 * 0.2);
        close(shaped.distance(0.46), -8.0 * 0.3 + jerk * 0.04_f64.powi(3) / 6.0);
        close(shaped.distance(0.5), -8.0 * 0.3);
    }

    #[test]
    fn m1i_move_leaves_the_acceleration_its_ramps_do_not_need() {
        // v = 10, a = 50: ramps of 0.2 s, cruise 0.2 s; the motor may do 200, so each ramp takes a quarter of it.
        let moved = MotorMove {
            velocity: -10.0,
            ramp_s: 0.2,
            jerk_s: 0.0,
            cruise_s: 0.2,
        };
        let room = |from_s, to_s| {
            let SlewRoom {
                slope,
                braking,
                driving,
            } = moved.room(200.0, from_s, to_s);
            [slope, braking, driving]
        };
        let expected = [
            // speeds up to 5; cruises; into braking from full speed; brakes from 5
            ((0.05, 0.1), [40.0, 0.0, 0.25]),
            ((0.25, 0.3), [20.0, 0.0, 0.0]),
            ((0.35, 0.45), [20.0, 0.25, 0.0]),
            ((0.5, 0.55), [40.0, 0.25, 0.0]),
        ];
        for ((from_s, to_s), values) in expected {
            let found = room(from_s, to_s);
            for (a, b) in found.into_iter().zip(values) {
                close(a, b);
            }
        }
        // A move is symmetric: its room backward equals its room forward at the mirrored time.
        for (from_s, to_s) in [(0.05, 0.1), (0.15, 0.3), (0.25, 0.3), (0.35, 0.45), (0.1, 0.55)] {
            let mirrored = moved.room(200.0, 0.6 - to_s, 0.6 - from_s);
            let back = moved.room(200.0, from_s, to_s).reversed();
            close(back.slope, mirrored.slope);
            close(back.braking, mirrored.braking);
            close(back.driving, mirrored.driving);
        }
        assert_eq!(moved.room(200.0, 0.65, 0.7), SlewRoom::default());
        // A move whose acceleration exceeds the maximum uses the whole maximum.
        close(moved.room(25.0, 0.05, 0.1).driving, 1.0);
    }
}
