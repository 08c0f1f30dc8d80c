//! G00: each motor alone, in its shortest time (motion-semantics 1e).

use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE};
use tandem_model::profile::{Law, MotorMove, TimeBase};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector};

use crate::planner::Planned;

/// The motion of a G00 block. It ends with the slowest motor.
pub(crate) fn plan(
    settings: &CoordinateSystemSettings,
    from: AxisVector,
    to: AxisVector,
) -> Result<Planned, Alarm> {
    let mut moves = [MotorMove::default(); AXES_MAX];
    let mut duration_s = 0.0_f64;
    for axis in Axis::ALL {
        let distance = to[axis] - from[axis];
        if !distance.is_finite() {
            let text = format!("Axis {} would move by {distance}", axis.letter());
            return Err(Alarm::new(&VALUE_NOT_FINITE, text));
        }
        if distance == 0.0 {
            continue;
        }
        let motor = settings.motors[axis.index()].as_ref();
        let limits = Limits {
            velocity: limit(
                axis,
                "rapid_velocity",
                motor.map_or(0.0, |motor| motor.rapid_velocity),
            )?,
            acceleration: limit(
                axis,
                "rapid_acceleration",
                motor.map_or(0.0, |motor| motor.rapid_acceleration),
            )?,
            jerk: match motor.and_then(|motor| motor.max_jerk) {
                Some(jerk) => Some(limit(axis, "max_jerk", jerk)?),
                None => None,
            },
        };
        let motor_move = shortest_move(distance, limits);
        duration_s = duration_s.max(motor_move.duration_s());
        moves[axis.index()] = motor_move;
    }
    Ok(Planned {
        law: Law::Motors { from, to, moves },
        duration_s,
        time_base: TimeBase::Rapid,
    })
}

fn limit(axis: Axis, name: &str, value: f64) -> Result<f64, Alarm> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        let text = format!("{name} of axis {} is {value}", axis.letter());
        Err(Alarm::new(&LIMIT_ZERO, text))
    }
}

/// Limits of one motor, all above zero.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
    /// `None`: not limited.
    pub(crate) jerk: Option<f64>,
}

/// The shortest move from rest to rest over a signed distance.
///
/// Without a jerk limit: trapezoid, or triangle when `D < v^2/a`. With one, the ramp to a speed w has jerk phases of
/// `ts` and an acceleration time `ta = w/a_peak`: `ts = a/j` where w is enough to reach a (`w >= a^2/j`), else
/// `ts = ta = sqrt(w/j)`. Both ramps take the distance `w (ta + ts)`; w is the limit, or the speed at which that is D.
pub(crate) fn shortest_move(distance: f64, limits: Limits) -> MotorMove {
    let way = distance.abs();
    let (peak, ramp_s, jerk_s) = match limits.jerk {
        None => without_jerk_limit(way, limits.velocity, limits.acceleration),
        Some(jerk) => with_jerk_limit(way, limits.velocity, limits.acceleration, jerk),
    };
    MotorMove {
        velocity: peak.copysign(distance),
        ramp_s,
        jerk_s,
        cruise_s: (way / peak - ramp_s).max(0.0),
    }
}

/// Peak speed, ramp time and jerk time.
fn without_jerk_limit(way: f64, velocity: f64, acceleration: f64) -> (f64, f64, f64) {
    if way >= velocity * velocity / acceleration {
        (velocity, velocity / acceleration, 0.0)
    } else {
        // D = w^2/a; the ramp time from D and w keeps w * ramp = D to the last bit or two.
        let peak = (way * acceleration).sqrt();
        (peak, way / peak, 0.0)
    }
}

/// Peak speed, ramp time and jerk time.
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
    // Below the speed limit: D = w (w/a + a/j) while that w reaches a, else D = 2 w sqrt(w/j).
    if way >= 2.0 * acceleration * full_jerk_s * full_jerk_s {
        let discriminant = full_jerk_s * full_jerk_s + 4.0 * way / acceleration;
        let peak = 2.0 * way / (full_jerk_s + discriminant.sqrt());
        (peak, way / peak, full_jerk_s)
    } else {
        let jerk_s = (way / (2.0 * jerk)).cbrt();
        (jerk * jerk_s * jerk_s, 2.0 * jerk_s, jerk_s)
    }
}
