//! G00 and G31: each motor moves alone, in its shortest time (M1e).

use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE};
use tandem_model::profile::{Law, MotorLimits, MotorMove, Stretch, TimeBase};
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings};
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector};

use crate::planned::Planned;

/// The motion of a G00 block. It ends with the slowest motor.
pub(crate) fn plan(
    settings: &CoordinateSystemSettings,
    from: AxisVector,
    to: AxisVector,
) -> Result<Planned, Alarm> {
    let velocity = |motor: &MotorSettings| motor.rapid_velocity;
    let (moves, duration_s) = moves(settings, from, to, ("rapid_velocity", velocity))?;
    Ok(Planned {
        law: Law::Motors {
            from,
            to,
            moves,
            stretch: Stretch::whole(duration_s),
        },
        duration_s,
        time_base: TimeBase::Rapid,
    })
}

/// The motion of a G31 block while no skip input comes: as G00, at the skip velocities.
pub(crate) fn plan_skip(
    settings: &CoordinateSystemSettings,
    from: AxisVector,
    to: AxisVector,
) -> Result<Planned, Alarm> {
    let velocity = |motor: &MotorSettings| motor.skip_velocity;
    let (moves, duration_s) = moves(settings, from, to, ("skip_velocity", velocity))?;
    Ok(Planned {
        law: Law::Skip { from, to, moves },
        duration_s,
        time_base: TimeBase::Rapid,
    })
}

/// A velocity of a motor, with its name.
type Velocity = (&'static str, fn(&MotorSettings) -> f64);

/// The shortest move of each motor, and the time of the slowest.
fn moves(
    settings: &CoordinateSystemSettings,
    from: AxisVector,
    to: AxisVector,
    (name, velocity): Velocity,
) -> Result<([MotorMove; AXES_MAX], f64), Alarm> {
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
        let limits = MotorLimits {
            velocity: limit(axis, name, motor.map_or(0.0, velocity))?,
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
        let motor_move = MotorMove::shortest(distance, limits);
        duration_s = duration_s.max(motor_move.duration_s());
        moves[axis.index()] = motor_move;
    }
    Ok((moves, duration_s))
}

fn limit(axis: Axis, name: &str, value: f64) -> Result<f64, Alarm> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        let text = format!("{name} of axis {} is {value}", axis.letter());
        Err(Alarm::new(&LIMIT_ZERO, text))
    }
}
