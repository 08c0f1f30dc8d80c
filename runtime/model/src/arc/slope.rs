//! The steepest slope of an axis along an arc. It limits the path speed if a motor has a maximum velocity.

use std::f64::consts::{FRAC_PI_2, PI};

use super::ArcPath;
use crate::axis::Axis;
use crate::bisect;

/// Number of halvings of the share of the angle. Near its maximum the slope falls with the square of the
/// distance, so that an error of 2^-40 of the arc causes only rounding errors.
const HALVINGS: u32 = 40;

impl ArcPath {
    /// Returns the largest change of an axis per mm of the path, except for rounding.
    pub fn steepest(&self, axis: Axis) -> f64 {
        // The first axis is steepest where the direction of travel is parallel to it, the second where the
        // direction is perpendicular to the first.
        let offset = match self.plane.axes() {
            [first, _] if first == axis => 0.0,
            [_, second] if second == axis => FRAC_PI_2,
            _ => {
                let way = (self.to[axis] - self.from[axis]).abs();
                let [start, end] = self.radii();
                return if way == 0.0 {
                    0.0
                } else {
                    way / self.length_rate(start.min(end))
                };
            }
        };
        let ends = self.slope(0.0, offset).max(self.slope(1.0, offset));
        self.steepest_between(offset)
            .map_or(ends, |share| ends.max(self.slope(share, offset)))
    }

    /// Returns the absolute change per mm of an axis in the plane, at a share of the angle.
    fn slope(&self, share: f64, offset: f64) -> f64 {
        let in_plane = self
            .growth
            .hypot(self.sweep * (self.start_radius + self.growth * share));
        (self.travel_angle(share) - offset).cos().abs() * in_plane / in_plane.hypot(self.height)
    }

    /// Returns the share of the angle at which the slope of an axis in the plane is largest. Returns `None`
    /// if this is at an end of the arc.
    ///
    /// Let f be the direction of travel from the axis, g the growth of the radius r, h the height, A the
    /// sweep, `y = A r` and `p^2 = g^2 + y^2`. The slope is `|cos f| p/sqrt(p^2 + h^2)`. Its logarithm has
    /// the derivative by the share `-f' tan f + A y g h^2/(p^2 (p^2 + h^2))`, and `f' = A (p^2 + g^2)/p^2`.
    /// So the derivative is zero where `tan f = m`, with `m = y g h^2/((p^2 + h^2) (p^2 + g^2))`.
    ///
    /// Where m grows with f, `|dm/du| <= |A|/2`, and always `|f'| >= |A|`. So `f - atan m` is monotonic, and
    /// each half turn of f contains one such maximum. Towards the larger radius each maximum is at least as
    /// high as the previous one, because between them lies `cos f = 1` with a larger p. The largest slope is
    /// therefore at the maximum nearest to the larger radius.
    fn steepest_between(&self, offset: f64) -> Option<f64> {
        let (growth_2, height_2) = (self.growth * self.growth, self.height * self.height);
        let lean = |share: f64| {
            let y = self.sweep * (self.start_radius + self.growth * share);
            let p_2 = growth_2 + y * y;
            (y * self.growth * height_2 / ((p_2 + height_2) * (p_2 + growth_2))).atan()
        };
        let sense = self.sweep.signum();
        let angle = |share: f64| sense * (self.travel_angle(share) - offset - lean(share));
        let (first, last) = (angle(0.0), angle(1.0));
        let half_turns = if self.growth < 0.0 {
            (first / PI).ceil()
        } else {
            (last / PI).floor()
        };
        let wanted = half_turns * PI;
        if !(first..=last).contains(&wanted) {
            return None;
        }
        let [low, high] = bisect([0.0, 1.0], HALVINGS, |share| angle(share) <= wanted);
        Some(f64::midpoint(low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axis::AxisVector;
    use crate::plane::{Plane, Turn};

    /// Creates an arc from (2 + r0, 1) about (2, 1), and a function: the changes of X, Y and Z per mm at a
    /// share of the angle.
    fn arc(r0: f64, r1: f64, sweep: f64, height: f64) -> (ArcPath, impl Fn(f64) -> [f64; 3]) {
        let xyz = |x: f64, y: f64, z: f64| AxisVector([x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let to = xyz(2.0 + r1 * sweep.cos(), 1.0 + r1 * sweep.sin(), height);
        let turn = if sweep > 0.0 {
            Turn::CounterClockwise
        } else {
            Turn::Clockwise
        };
        let path = ArcPath::new(xyz(2.0 + r0, 1.0, 0.0), to, Plane::Xy, [2.0, 1.0], turn);
        let slopes = move |share: f64| {
            let (sin, cos) = (sweep * share).sin_cos();
            let (g, y) = (r1 - r0, sweep * (r0 + (r1 - r0) * share));
            let way = [g * cos - y * sin, g * sin + y * cos, height];
            let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
            way.map(|v| v.abs() / length)
        };
        (path, slopes)
    }

    /// Returns the largest of 1000 values, refined by thirds around each value that is at least as high as
    /// its neighbours.
    fn largest(of: impl Fn(f64) -> f64) -> f64 {
        let n = 1000;
        let place = |i: i32| f64::from(i.clamp(0, n)) / f64::from(n);
        let values: Vec<f64> = (-1..=n + 1).map(|i| of(place(i))).collect();
        let refined = |i: i32| {
            let (mut low, mut high) = (place(i - 1), place(i + 1));
            for _ in 0..100 {
                let third = (high - low) / 3.0;
                if of(low + third) < of(high - third) {
                    low += third;
                } else {
                    high -= third;
                }
            }
            of(place(i)).max(of(low)).max(of(high))
        };
        let peaks = (0..=n)
            .zip(values.windows(3))
            .filter(|(_, near)| near[1] >= near[0].max(near[2]));
        peaks.map(|(i, _)| refined(i)).fold(0.0, f64::max)
    }

    #[test]
    fn s1a_the_steepest_slope_of_each_axis_is_that_of_the_formula() {
        for (r0, r1, height) in [
            (10.0, 10.0, 0.0),
            (10.0, 10.0, 4.0),
            (10.0, 10.0 + 1e-7, 4.0),
            (10.0, 25.0, 0.0),
            (10.0, 3.0, 40.0),
            (3.0, 10.0, 40.0),
            (10.0, 72.0_f64.sqrt(), 20.0),
            (0.01, 30.0, 5.0),
            (30.0, 0.01, 5.0),
            (10.0, 12.0, 1e4),
            (50.0, 51.0, 0.1),
        ] {
            for k in 1..=24 {
                let sweep = (f64::from(k) * 0.26).min(6.2);
                for sweep in [sweep, -sweep] {
                    let (path, slopes) = arc(r0, r1, sweep, height);
                    for (n, axis) in [Axis::X, Axis::Y, Axis::Z].into_iter().enumerate() {
                        let (found, expected) = (path.steepest(axis), largest(|u| slopes(u)[n]));
                        assert!(
                            (found - expected).abs() <= 1e-12 * expected.max(1e-3),
                            "{r0} {r1} {height} {sweep} {axis:?}: {found} is not {expected}"
                        );
                    }
                }
            }
        }
    }
}
