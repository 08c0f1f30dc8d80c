//! The limits of the motors on one piece, and the rates that they allow.
//!
//! On a piece of plan time h the square x of the rate is linear from x0 to x1. Let `q'` and `q''` be the
//! derivatives of a motor's position by plan time. The motor's acceleration is `f = q'' x + q' (x1 - x0)/(2
//! h)`. Between the ends f deviates from its chord by at most `h^2/8 max |f''|`, with `f'' = q'''' x + 5/2
//! q''' x'`. Limits that hold at both ends, reduced by this bound, therefore hold on the whole piece. Each
//! limit is a half plane `left x0 + right x1 <= 1`. On a piece measured by distance the same holds with
//! distance instead of plan time.

use tandem_model::profile::SlewRoom;
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings};
use tandem_model::{AXES_MAX, Axis};

use super::blended_block::PieceMotion;
use super::course::Course;
use crate::limit::ACCELERATION_RESERVE;

/// Smallest square of the rate: a millionth of the rate without look-ahead. The rate is never lower, so that
/// every block ends.
pub(super) const SQUARE_MIN: f64 = 1e-12;

/// Margin for rounding of the constraints, relative to a limit.
const ROUNDING: f64 = 1e-12;

/// Tolerance of a border, far above rounding and far below the reserve of the acceleration. Two borders that
/// differ only by rounding must not reduce the rate to zero. A start on a border that hardly depends on the
/// end must not lower the end.
const SLACK: f64 = 1e-9;

/// Tolerance per unit of the larger factor, for a limit that is a small difference of large values; at most
/// [`SLACK_MAX`].
const SLACK_OF_FACTORS: f64 = 32.0 * f64::EPSILON;
const SLACK_MAX: f64 = 1e-6;

/// Largest velocity of a motor for the time in which it comes to rest, relative to its largest speed so far.
const FASTER_MAX: f64 = 25.0;

/// A constraint `left x0 + right x1 <= 1`.
#[derive(Debug, Clone, Copy)]
pub(super) struct HalfPlane {
    left: f64,
    right: f64,
}

impl HalfPlane {
    /// Returns the tolerance by which the sum may exceed 1 because of rounding.
    fn slack(self) -> f64 {
        (self.left.abs().max(self.right.abs()) * SLACK_OF_FACTORS).clamp(SLACK, SLACK_MAX)
    }
}

/// Acceleration of a motor at both ends of a piece as factors of x0 and x1, in shares of its maximum. Between
/// the ends the acceleration deviates by at most `level (x0 + x1) + change |x1 - x0|`.
struct Rows {
    ends: [[f64; 2]; 2],
    level: f64,
    change: f64,
}

impl Rows {
    fn new(course: &Course, axis: Axis, inverse: f64) -> Self {
        let (motion, h_s) = (&course.motion, course.length_s);
        let [q1, r1] = motion
            .velocity
            .map(|velocity| velocity[axis] * inverse / (2.0 * h_s));
        let [q2, r2] = motion
            .acceleration
            .map(|acceleration| acceleration[axis] * inverse);
        let level = motion.fourth[axis] * inverse * h_s * h_s / 16.0;
        Self {
            ends: [[q2 - q1, q1], [-r1, r2 + r1]],
            level,
            change: level + motion.third[axis] * inverse * h_s * (2.5 / 8.0),
        }
    }
}

/// The limits of the motors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motors {
    /// 1 divided by the maximum acceleration of each motor; 0 for a motor without a maximum.
    pub(super) inverse: [f64; AXES_MAX],
    /// 1 divided by the maximum jerk of each motor; 0 for a motor without a maximum.
    pub(super) inverse_jerks: [f64; AXES_MAX],
    /// True if any motor has a maximum jerk.
    pub(super) has_jerk: bool,
    /// Maximum velocity of each motor; 0 for a motor without a maximum.
    pub(super) velocities: [f64; AXES_MAX],
    /// Servo period, s.
    pub(super) period_s: f64,
}

impl Motors {
    /// Returns a time after which a stop no longer affects the fastest motion, s: three times the longest time in which a motor
    /// comes to rest from its maximum velocity. A maximum velocity far above the speeds of the motion does not count.
    pub(super) fn horizon_s(&self, speeds: &[f64; AXES_MAX]) -> f64 {
        let stop_s = |i: usize| {
            let brake_s = self.velocities[i].min(FASTER_MAX * speeds[i]) * self.inverse[i];
            let jerk_s = if self.inverse[i] > 0.0 {
                self.inverse_jerks[i] / self.inverse[i]
            } else {
                0.0
            };
            brake_s + jerk_s
        };
        3.0 * (0..AXES_MAX).map(stop_s).fold(0.0, f64::max)
    }

    /// Creates the limits. The maximum accelerations are reduced by the reserve for feed hold.
    pub(super) fn new(settings: &CoordinateSystemSettings) -> Self {
        let of_each = |value: fn(&MotorSettings) -> f64| {
            settings
                .motors
                .each_ref()
                .map(|motor| motor.as_ref().map_or(0.0, value))
        };
        let inverse = |most: f64| if most > 0.0 { 1.0 / most } else { 0.0 };
        let inverse_jerks = of_each(|motor| motor.max_jerk.unwrap_or(0.0)).map(inverse);
        Self {
            inverse: of_each(|motor| motor.max_acceleration * (1.0 - ACCELERATION_RESERVE)).map(inverse),
            inverse_jerks,
            has_jerk: inverse_jerks.iter().any(|inverse| *inverse > 0.0),
            velocities: of_each(|motor| motor.max_velocity),
            period_s: settings.servo_period_s,
        }
    }
}

/// The limits of one block.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds<'a> {
    pub(super) motors: &'a Motors,
    /// Largest square of the rate in the block.
    pub(super) cap: f64,
    /// True if no motor exceeds its maximum velocity at the rate 1. On a smoothed path one may, where the
    /// next block begins to turn the motion into the direction of a slower motor.
    pub(super) is_within_velocity: bool,
    /// Largest change of the square of the rate per second of plan time, for the ramps from rest and to rest
    /// of a smoothed path; otherwise infinite.
    pub(super) change: f64,
}

impl Bounds<'_> {
    /// Returns the largest square of the rate at which no motor exceeds its maximum velocity. `fastest`
    /// returns the speed of an axis at the rate 1.
    pub(super) fn cap_at(self, fastest: impl Fn(Axis) -> f64) -> f64 {
        if self.is_within_velocity && self.cap <= 1.0 {
            return self.cap;
        }
        let least = if self.is_within_velocity { 1.0 } else { SQUARE_MIN };
        Axis::ALL.into_iter().fold(self.cap, |cap, axis| {
            let fastest = fastest(axis);
            if fastest > 0.0 {
                let square = (self.motors.velocities[axis.index()] / fastest).powi(2);
                cap.min(square.max(least))
            } else {
                cap
            }
        })
    }
}

/// Sets `planes` to the limits that can be exceeded while the squares of the rate are between 0 and the cap.
pub(super) fn half_planes(course: &Course, bounds: Bounds<'_>, planes: &mut Vec<HalfPlane>) {
    let Bounds {
        motors, cap, change, ..
    } = bounds;
    planes.clear();
    let mut add = |left: f64, right: f64| {
        let right = right * course.scale;
        if (left.max(0.0) + right.max(0.0)) * cap > 1.0 {
            planes.push(HalfPlane { left, right });
        }
    };
    if change.is_finite() {
        let factor = 1.0 / (change * course.length_s);
        add(-factor, factor);
        add(factor, -factor);
    }
    for axis in Axis::ALL {
        let inverse = motors.inverse[axis.index()];
        if inverse == 0.0 {
            continue;
        }
        let Rows { ends, level, change } = Rows::new(course, axis, inverse);
        for end in ends {
            for [left, right] in [end, end.map(|factor| -factor)] {
                add(left + level - change, right + level + change);
                if change > 0.0 {
                    add(left + level + change, right + level - change);
                }
            }
        }
    }
}

/// Differences between the ends of a piece, in shares of the maximum accelerations; each value is the largest
/// of all motors.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Spread {
    /// Change of the velocity, divided by the maximum acceleration, s.
    pub(super) change_s: f64,
    /// The smaller of the velocities at both ends, divided by the maximum acceleration, s.
    pub(super) slower_s: f64,
    /// Acceleration at the rate 1.
    pub(super) used: f64,
    /// Change of the acceleration between the ends.
    pub(super) swing: f64,
    /// Bound of the fourth derivative, per second squared.
    pub(super) bend: f64,
}

impl Spread {
    pub(super) fn new(motion: &PieceMotion, inverse: &[f64; AXES_MAX]) -> Self {
        let mut spread = Self::default();
        let mut speeds = [0.0_f64; 2];
        for axis in Axis::ALL {
            let inverse = inverse[axis.index()];
            if inverse == 0.0 {
                continue;
            }
            let ends = [motion.velocity[0][axis], motion.velocity[1][axis]].map(|v| v * inverse);
            spread.change_s = spread.change_s.max((ends[1] - ends[0]).abs());
            for (speed, end) in speeds.iter_mut().zip(ends) {
                *speed = speed.max(end.abs());
            }
            let [begin, end] = [motion.acceleration[0][axis], motion.acceleration[1][axis]];
            spread.used = spread.used.max(begin.abs().max(end.abs()) * inverse);
            spread.swing = spread.swing.max((end - begin).abs() * inverse);
            spread.bend = spread.bend.max(motion.fourth[axis] * inverse);
        }
        spread.slower_s = speeds[0].min(speeds[1]);
        spread
    }

    /// Returns the acceleration that remains where the velocity would be constant, at the rate 1. A linear
    /// square x of the rate multiplies this acceleration by about x. Reason: a constant velocity would need
    /// different rates at both ends.
    pub(super) fn sway(&self) -> f64 {
        if self.slower_s > 0.0 {
            self.swing + self.change_s / self.slower_s * self.used
        } else {
            self.swing
        }
    }
}

/// Returns the largest x0 up to `cap` for which some x1 up to `end` is within the limits, and this x1. It is
/// a linear program in two variables, solved one half plane after another. (0, 0) is always within the
/// limits.
pub(super) fn fastest_start(planes: &[HalfPlane], cap: f64, end: f64) -> [f64; 2] {
    let (mut x, mut y) = (cap, end);
    for (i, plane) in planes.iter().enumerate() {
        if plane.left * x + plane.right * y <= 1.0 + ROUNDING {
            continue;
        }
        let found = on_border(*plane, planes.get(..i).unwrap_or(&[]), cap, end);
        let Some(found) = found else {
            return [at_one_rate(planes, cap.min(end)); 2];
        };
        (x, y) = found;
    }
    [x, y]
}

/// Returns the point with the largest x, then the largest y, on the border of a half plane within these
/// limits. Returns `None` if no such point exists except by rounding.
fn on_border(border: HalfPlane, within: &[HalfPlane], cap: f64, end: f64) -> Option<(f64, f64)> {
    let HalfPlane { left, right } = border;
    // The coordinate u runs along the border; the other coordinate is w = base + slope u.
    let by_x = right.abs() >= left.abs();
    let (base, slope, u_max, w_max) = if by_x {
        (1.0 / right, -left / right, cap, end)
    } else {
        (1.0 / left, -right / left, end, cap)
    };
    let (mut low, mut high) = (0.0_f64, u_max);
    let mut limit = |of_u: f64, of_w: f64, most: f64| {
        let (factor, rest) = (of_u + of_w * slope, most - of_w * base);
        if factor > 0.0 {
            high = high.min(rest / factor);
        } else if factor < 0.0 {
            low = low.max(rest / factor);
        }
    };
    limit(0.0, 1.0, w_max);
    limit(0.0, -1.0, 0.0);
    for plane in within {
        let most = 1.0 + plane.slack() / 2.0;
        if by_x {
            limit(plane.left, plane.right, most);
        } else {
            limit(plane.right, plane.left, most);
        }
    }
    if low > high * (1.0 + ROUNDING) {
        return None;
    }
    let high = high.max(low);
    if by_x {
        Some((high, base + slope * high))
    } else {
        let u = if slope < 0.0 { low } else { high };
        Some((base + slope * u, u))
    }
}

/// Returns the largest x that is within the limits if both ends have this x.
fn at_one_rate(planes: &[HalfPlane], most: f64) -> f64 {
    planes.iter().fold(most, |most, plane| {
        let sum = plane.left + plane.right;
        if sum > 0.0 { most.min(1.0 / sum) } else { most }
    })
}

/// Returns the largest x1 up to `end` within the limits, for a start that [`fastest_start`] allows.
pub(super) fn fastest_end(planes: &[HalfPlane], start: f64, end: f64) -> f64 {
    let most = planes.iter().fold(end, |most, plane| {
        if plane.right > 0.0 {
            most.min((1.0 + plane.slack() - plane.left * start) / plane.right)
        } else {
            most
        }
    });
    most.max(0.0)
}

/// Returns the room that the motors leave to overrides and feed hold while the motion passes the piece from
/// x0 to x1.
pub(super) fn room(course: &Course, inverse: &[f64; AXES_MAX], [start, end]: [f64; 2]) -> SlewRoom {
    let (motion, h_s) = (&course.motion, course.length_s);
    let end = end * course.scale;
    let mut room = SlewRoom::default();
    let fastest = start.max(end).sqrt();
    for axis in Axis::ALL {
        let inverse = inverse[axis.index()];
        if inverse == 0.0 {
            continue;
        }
        let velocity = [motion.velocity[0][axis], motion.velocity[1][axis]];
        // Between the ends the velocity deviates from its chord by at most h^2/8 times the third derivative
        // of the position.
        let off_chord = motion.third[axis] * h_s * h_s / 8.0;
        let largest = velocity[0].abs().max(velocity[1].abs()) + off_chord;
        if largest == 0.0 {
            continue;
        }
        room.slope = room.slope.min(1.0 / (largest * fastest * inverse));
        let Rows { ends, level, change } = Rows::new(course, axis, inverse);
        let [a, b] = ends.map(|[left, right]| left * start + right * end);
        let between = level * (start + end) + change * (end - start).abs();
        let (low, high) = (a.min(b) - between, a.max(b) + between);
        let (braking, driving) = if velocity[0].min(velocity[1]) - off_chord >= 0.0 {
            (-low, high)
        } else if velocity[0].max(velocity[1]) + off_chord <= 0.0 {
            (high, -low)
        } else {
            (high.max(-low), high.max(-low))
        };
        room.braking = room.braking.max(braking);
        room.driving = room.driving.max(driving);
    }
    room
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the range of x1 that is within the limits for this x0.
    fn ends(planes: &[HalfPlane], x: f64, end: f64) -> [f64; 2] {
        planes.iter().fold([0.0, end], |[low, high], plane| {
            let border = (1.0 - plane.left * x) / plane.right;
            if plane.right > 0.0 {
                [low, high.min(border)]
            } else {
                [low.max(border), high]
            }
        })
    }

    #[test]
    fn borders_that_are_one_but_for_rounding_leave_the_fastest_start() {
        // -1 <= 2 M y - M x <= 1 at both ends of a piece; the factors of the ends differ in the last bits.
        let mut bits = 1_u64;
        let mut rounded = |value: f64| {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            value * (1.0 + f64::from(bits.to_be_bytes()[0] % 5) * f64::EPSILON - 2.0 * f64::EPSILON)
        };
        for case in 0..10_000 {
            let factor = 10_f64.powf(3.0 + 4.0 * f64::from(case) / 10_000.0);
            let planes: Vec<HalfPlane> = [1.0, -1.0, 1.0, -1.0]
                .map(|sign| HalfPlane {
                    left: rounded(-sign * factor),
                    right: rounded(2.0 * sign * factor),
                })
                .into();
            // 0.3 at the end leads to 0.6 + 1/M at the start.
            let [start, end] = fastest_start(&planes, 1.0, 0.3);
            assert!((start - 0.6 - 1.0 / factor).abs() < 1e-9, "{factor}: {start}");
            assert!((end - 0.3).abs() < 1e-9, "{factor}: {end}");
            let after = fastest_end(&planes, start, 1.0);
            assert!((after - 0.3 - 1.0 / factor).abs() < 1e-9, "{factor}: {after}");
        }
    }

    #[test]
    fn the_fastest_start_is_that_of_bisection_and_leaves_an_end() {
        let mut bits = 7_u64;
        let mut random = || {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (bits >> 11) as f64 / (1_u64 << 53) as f64
        };
        for case in 0..100_000 {
            let scale = 10_f64.powf(4.0 * random());
            let planes: Vec<HalfPlane> = (0..(case % 13))
                .map(|_| HalfPlane {
                    left: scale * (random() - 0.5),
                    right: scale * (random() - 0.5),
                })
                .collect();
            let (cap, end) = (random(), random());
            let [found, _] = fastest_start(&planes, cap, end);
            let (mut low, mut high) = (0.0, cap);
            for _ in 0..100 {
                let middle = f64::midpoint(low, high);
                let [least, most] = ends(&planes, middle, end);
                if least <= most {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            assert!((found - low).abs() < 1e-9, "case {case}: {found} is not {low}");
            let y = fastest_end(&planes, found, end);
            for plane in &planes {
                assert!(plane.left * found + plane.right * y <= 1.0 + 1e-8, "case {case}");
            }
        }
    }
}
