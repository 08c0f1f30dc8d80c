//! A ramp in a chain with a maximum jerk: it is passed at a constant rate, at which no motor exceeds its
//! limits.
//!
//! Let dv be the change of a motor's velocity over a ramp of `ta` and `ts`. At the rate w its acceleration is
//! at most `|dv|/ta w^2` and its jerk `|dv|/(ta ts) w^3` (M1b). A changing rate would add steps of
//! acceleration. A ramp without a jerk time has steps of acceleration at any rate, so the jerk does not limit
//! its rate.
//!
//! On an arc with the derivatives p' to p''' by distance, the velocity `v p'` turns by at most `p'' v^2 (ta +
//! ts)/2` within the ramp; this is added to dv. With the share S of the speed, `p'' v^2 S^2` is added to the
//! acceleration and `3 p'' v^2 S S' + p''' v^3 S^3` to the jerk. The shares S of two arcs add up to 1, so the
//! larger of their two terms bounds the sum.

use tandem_model::flow::Path;
use tandem_model::ramp::UnitRamp;
use tandem_model::{Axis, AxisVector};

use super::blended_block::{self, BlendedBlock};
use super::curve;
use super::limits::{Motors, SQUARE_MIN};

/// Margin for rounding of an acceleration, relative to its limit.
const ROUNDING: f64 = 1e-9;

/// The motion along a block next to a joint, at the rate 1; zero at rest.
#[derive(Debug, Clone, Copy, Default)]
struct Side {
    /// Velocity at the joint.
    velocity: AxisVector,
    /// Bounds of the second and third derivative that the curvature causes.
    bends: [AxisVector; 2],
}

impl Side {
    /// Creates the side of a block between two distances along it; the first distance is at the joint.
    fn new(path: &Path, slopes: AxisVector, speed: f64, [at, to]: [f64; 2]) -> Self {
        match path {
            Path::Line { .. } => Self {
                velocity: slopes.scaled(speed),
                ..Self::default()
            },
            Path::Arc(arc) => {
                // The same bounds as between the ramps (`curve`), so that the rate need not fall after the
                // ramp.
                let within = if curve::opens_wide(arc) {
                    [at.min(to), at.max(to)]
                } else {
                    [0.0, arc.length()]
                };
                let [second, third] = blended_block::bends(arc, within);
                Self {
                    velocity: arc.derivatives_at(at)[0].scaled(speed),
                    bends: [second.scaled(speed * speed), third.scaled(speed * speed * speed)],
                }
            }
        }
    }
}

/// Returns the largest square of the rate on the ramp from rest at the start of a block. Returns infinity
/// without a limit.
pub(super) fn from_rest(way: &BlendedBlock<'_>, motors: &Motors) -> f64 {
    if !motors.has_jerk || !way.begins_at_rest() {
        return f64::INFINITY;
    }
    let gone = way.block.speed * way.block.start.duration_s() / 2.0;
    let own = Side::new(&way.block.path, way.slopes[0], way.block.speed, [0.0, gone]);
    largest_square(way.block.start, [Side::default(), own], motors)
}

/// Returns the largest square of the rate on the ramp at the end of a block. Returns infinity without a
/// limit.
pub(super) fn at_end(way: &BlendedBlock<'_>, motors: &Motors) -> f64 {
    if !motors.has_jerk {
        return f64::INFINITY;
    }
    let half_s = way.block.stop.duration_s() / 2.0;
    let length = way.block.path.length();
    let own = [length, length - way.block.speed * half_s];
    let own = Side::new(&way.block.path, way.slopes[0], way.block.speed, own);
    let next = way.block.next.as_ref().map_or(Side::default(), |next| {
        Side::new(&next.path, way.slopes[1], next.speed, [0.0, next.speed * half_s])
    });
    largest_square(way.block.stop, [own, next], motors)
}

fn largest_square(ramp: UnitRamp, [own, next]: [Side; 2], motors: &Motors) -> f64 {
    if ramp.jerk_time_s() < motors.period_s {
        return f64::INFINITY;
    }
    let [slope, change] = ramp.steepest();
    let half_s = ramp.duration_s() / 2.0;
    let mut has_jerk = false;
    let mut square = f64::INFINITY;
    for axis in Axis::ALL {
        let [inverse, inverse_jerk] = [&motors.inverse, &motors.inverse_jerks].map(|of| of[axis.index()]);
        let [bend, sway] = [0, 1].map(|n| own.bends[n][axis].max(next.bends[n][axis]));
        let [before, after] = [own.velocity[axis], next.velocity[axis]];
        has_jerk |= inverse_jerk > 0.0 && (before != 0.0 || after != 0.0 || bend != 0.0);
        let turn = (after - before).abs() + (own.bends[0][axis] + next.bends[0][axis]) * half_s;
        if turn > 0.0 {
            let acceleration = turn * slope + bend;
            let jerk = turn * change + 3.0 * bend * slope + sway;
            square = square
                .min(1.0 / (acceleration * inverse))
                .min((jerk * inverse_jerk).powf(-2.0 / 3.0));
        }
    }
    if has_jerk {
        (square * (1.0 - ROUNDING)).max(SQUARE_MIN)
    } else {
        f64::INFINITY
    }
}
