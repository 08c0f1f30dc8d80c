//! A chain of blended blocks with the formula of its path.

use super::rig::{Point, close};
use crate::support::formula::Ramp;

/// Stairs of four blocks of 20 mm at 50 mm/s, with ramps of 60 ms: `x + y` always grows.
pub const STAIRS: &str = "ta50 td50 ts10 G01 F3000\nX20\nY20\nX40\nY40\nM30\n";
const CORNERS: [[f64; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
const LENGTH: f64 = 20.0;
const SPEED: f64 = 50.0;

/// M1b: nominal times at the boundaries, one ramp centred on each, the blocks' motions superposed.
fn stairs(t: f64) -> Point {
    let ramp = Ramp::new(0.05, 0.01);
    let half = ramp.total() / 2.0;
    let mut at = [0.0; 3];
    for (n, direction) in CORNERS.iter().enumerate() {
        let begin = half + n as f64 * LENGTH / SPEED;
        let end = begin + LENGTH / SPEED;
        let way = SPEED * (ramp.integral(t - begin + half) - ramp.integral(t - end + half));
        at[0] += direction[0] * way;
        at[1] += direction[1] * way;
    }
    at
}

pub fn stairs_end_s() -> f64 {
    4.0 * LENGTH / SPEED + Ramp::new(0.05, 0.01).total()
}

/// Checks that the point is on the path of the formula, within 1e-9 mm.
#[track_caller]
pub fn assert_on_stairs(point: Point) {
    let (mut low, mut high) = (0.0, stairs_end_s());
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        let [x, y, _] = stairs(middle);
        if x + y > point[0] + point[1] {
            high = middle;
        } else {
            low = middle;
        }
    }
    close(point, stairs(low));
}
