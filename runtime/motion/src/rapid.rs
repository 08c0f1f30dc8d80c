//! G00 and G31: each motor moves alone, in its shortest time (M1e).

use tandem_model::alarm::VALUE_NOT_FINITE;
use tandem_model::profile::{Law, MotorLimits, MotorMove, Stretch};
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings, RapidPath};
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector};

use crate::limit;

/// Returns the motion of a G00 block, and its duration: the time of the slowest motor.
pub(crate) fn plan(
    settings: &CoordinateSystemSettings,
    from: AxisVector,
    to: AxisVector,
) -> Result<(Law, f64), Alarm> {
    let (moves, duration_s) = moves(settings, [from, to], "rapid_velocity", |motor| {
        motor.rapid_velocity
    })?;
    let law = Law::Motors {
        from,
        to,
        moves,
        stretch: Stretch::whole(duration_s),
    };
    Ok((law, duration_s))
}

/// Returns the motion of a G31 block whose skip inputs stay off: as G00, but at the skip velocities.
pub(crate) fn plan_skip(
    settings: &CoordinateSystemSettings,
    from: AxisVector,
    to: AxisVector,
) -> Result<(Law, f64), Alarm> {
    let (moves, duration_s) = moves(settings, [from, to], "skip_velocity", |motor| motor.skip_velocity)?;
    Ok((Law::Skip { from, to, moves }, duration_s))
}

/// Returns the shortest move of each motor, and the time of the slowest motor. `velocity` returns the
/// velocity limit of a motor, `name` is the name of this limit.
fn moves(
    settings: &CoordinateSystemSettings,
    [from, to]: [AxisVector; 2],
    name: &str,
    velocity: fn(&MotorSettings) -> f64,
) -> Result<([MotorMove; AXES_MAX], f64), Alarm> {
    let mut moving = [None; AXES_MAX];
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
        let acceleration = motor.map_or(0.0, |motor| motor.rapid_acceleration);
        let jerk = motor.and_then(|motor| motor.max_jerk);
        let limits = MotorLimits {
            velocity: limit::check_axis_limit(axis, name, motor.map_or(0.0, velocity))?,
            acceleration: limit::check_axis_limit(axis, "rapid_acceleration", acceleration)?,
            jerk: jerk
                .map(|jerk| limit::check_axis_limit(axis, "max_jerk", jerk))
                .transpose()?,
        };
        let limits = limits.with_reserve();
        moving[axis.index()] = Some((distance, limits));
    }
    if settings.path.rapid == RapidPath::Straight {
        keep_together(&mut moving);
    }
    let mut moves = [MotorMove::default(); AXES_MAX];
    let mut duration_s = 0.0_f64;
    for (of_motor, moving) in moves.iter_mut().zip(moving) {
        if let Some((distance, limits)) = moving {
            *of_motor = MotorMove::shortest(distance, limits);
            duration_s = duration_s.max(of_motor.duration_s());
        }
    }
    Ok((moves, duration_s))
}

/// Sets the limits of each motor in proportion to its distance, as high as all motors allow. Then all motors
/// cover the same share of their distances at any time, so that the path is straight.
fn keep_together(moving: &mut [Option<(f64, MotorLimits)>; AXES_MAX]) {
    let of_way = |of: fn(&MotorLimits) -> f64| {
        let ratios = moving
            .iter()
            .flatten()
            .map(|(distance, limits)| of(limits) / distance.abs());
        ratios.fold(f64::INFINITY, f64::min)
    };
    let velocity = of_way(|limits| limits.velocity);
    let acceleration = of_way(|limits| limits.acceleration);
    let jerk = of_way(|limits| limits.jerk.unwrap_or(f64::INFINITY));
    for (distance, limits) in moving.iter_mut().flatten() {
        let way = distance.abs();
        *limits = MotorLimits {
            velocity: velocity * way,
            acceleration: acceleration * way,
            jerk: jerk.is_finite().then_some(jerk * way),
        };
    }
}
