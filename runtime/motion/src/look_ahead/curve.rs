//! An arc between its ramps, if a motor has a maximum jerk. The rate changes as on a line, within the part of
//! acceleration and jerk that the curvature at the largest rate leaves.
//!
//! With the derivatives p' to p''' by distance and the speed v, at the rate w the acceleration is `p'' v^2
//! w^2 + p' v w'` and the jerk is `p''' v^3 w^3 + 3 p'' v^2 w w' + p' v w''`.

use tandem_model::{ArcPath, Axis};

use super::blended_block::{self, BlendedBlock};
use super::limits::{Bounds, SQUARE_MIN};
use super::straight::Straight;

/// Largest share of a limit that the curvature may use. The remaining share is available for changes of the
/// rate.
const SHARE: f64 = 0.75;

/// Largest ratio of a spiral's radii for which its curvature is treated as constant, equal to that at the
/// narrowest point.
const SPIRAL_MAX: f64 = 1.5;

/// Returns the limits of the rate on an arc, and the largest square of the rate. Returns `None` if no moving
/// motor has a maximum jerk, or if the arc is a spiral that opens wide.
pub(super) fn straightened(
    way: &BlendedBlock<'_>,
    arc: &ArcPath,
    bounds: Bounds<'_>,
) -> Option<(Straight, f64)> {
    let motors = bounds.motors;
    if !motors.has_jerk || opens_wide(arc) {
        return None;
    }
    let v = way.block.speed;
    let [second, third] = blended_block::bends(arc, [0.0, arc.length()]);
    let each = Axis::ALL.map(|axis| {
        let by_speed = [
            arc.steepest(axis) * v,
            second[axis] * v * v,
            third[axis] * v * v * v,
        ];
        let [inverse, inverse_jerk] = [&motors.inverse, &motors.inverse_jerks].map(|of| of[axis.index()]);
        (by_speed, inverse, inverse_jerk)
    });
    each.iter()
        .any(|([first, ..], _, inverse_jerk)| first * inverse_jerk > 0.0)
        .then_some(())?;
    let mut square = bounds.cap_at(|axis| each[axis.index()].0[0]);
    for ([_, second, third], inverse, inverse_jerk) in &each {
        square = square
            .min(SHARE / (second * inverse))
            .min((third * inverse_jerk / SHARE).powf(-2.0 / 3.0));
    }
    let square = square.max(SQUARE_MIN);
    let rate = square.sqrt();
    let [mut change, mut jerk] = [f64::INFINITY; 2];
    for ([first, second, third], inverse, inverse_jerk) in &each {
        let left = |taken: f64| (1.0 - taken).max(1.0 - SHARE);
        // Each of the two terms may use half of the remaining jerk.
        let left_of_jerk = left(third * square * rate * inverse_jerk) / 2.0;
        change = change
            .min(left(second * square * inverse) / (first * inverse))
            .min(left_of_jerk / (3.0 * second * rate * inverse_jerk));
        jerk = jerk.min(left_of_jerk / (first * inverse_jerk));
    }
    let change = 2.0 * change;
    Some((Straight { change, jerk }, square))
}

/// Returns true for a spiral whose largest radius exceeds [`SPIRAL_MAX`] times its smallest radius.
pub(super) fn opens_wide(arc: &ArcPath) -> bool {
    let [start, end] = arc.radii();
    start.max(end) > SPIRAL_MAX * start.min(end)
}
