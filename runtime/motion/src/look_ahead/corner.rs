//! A corner between two lines where a motor has a maximum jerk: it is passed at one rate, at which no motor exceeds its
//! limits anywhere in it.
//!
//! With the change dv of a motor's velocity over a ramp of `ta` and `ts` its acceleration at the rate w is at most
//! `|dv|/ta w^2`, its jerk `|dv|/(ta ts) w^3` (motion-semantics 1b); a rate that changes would add steps of acceleration. A
//! ramp without jerk time steps at any rate: it is not slowed for the jerk.

use tandem_model::Axis;
use tandem_model::flow::Path;

use super::limits::Motors;
use super::rate::SQUARE_MIN;
use super::way::Way;

/// Rounding of an acceleration, relative to its limit.
const ROUNDING: f64 = 1e-9;

/// The largest square of the rate on the ramp between a line and the next one; infinite: without a limit.
pub(super) fn largest_square(way: &Way<'_>, motors: &Motors) -> f64 {
    if !motors.has_jerk || way.stop.jerk_time_s() < motors.period_s {
        return f64::INFINITY;
    }
    let (Path::Line { .. }, Some((Path::Line { .. }, next_speed))) = (way.path, way.lead) else {
        return f64::INFINITY;
    };
    let [slope, change] = way.stop.steepest();
    let mut has_jerk = false;
    let mut square = f64::INFINITY;
    for axis in Axis::ALL {
        let [own, next] = [way.slopes[0][axis] * way.speed, way.slopes[1][axis] * next_speed];
        let [inverse, inverse_jerk] = [&motors.inverse, &motors.inverse_jerks].map(|of| of[axis.index()]);
        has_jerk |= inverse_jerk > 0.0 && (own != 0.0 || next != 0.0);
        let turn = (next - own).abs();
        if turn > 0.0 {
            square = square
                .min(1.0 / (turn * slope * inverse))
                .min((turn * change * inverse_jerk).powf(-2.0 / 3.0));
        }
    }
    if has_jerk {
        (square * (1.0 - ROUNDING)).max(SQUARE_MIN)
    } else {
        f64::INFINITY
    }
}
