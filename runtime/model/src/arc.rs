//! Circular, spiral, helical and conical paths (M1f).

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::axis::{Axis, AxisVector};
use crate::bisect;
use crate::plane::{Plane, Turn};

mod slope;

/// Distance below which start and end are treated as equal directions from the centre, mm. The arc is then a
/// full turn. Reason: rounding of the preceding transforms is about 1e-12.
const SAME_DIRECTION: f64 = 1e-9;

/// Change of radius, as a share of the radius, below which the arc is a circle: a smaller change is rounding.
const CONSTANT_RADIUS: f64 = 1e-12;

/// Maximum number of Newton steps from an arc length to its share of the angle. 9 steps suffice for radii
/// whose ratio is 1e9.
const NEWTON_STEPS_MAX: u32 = 16;

/// Number of halvings: one for each bit of a share.
const HALVINGS: u32 = 60;

/// A path that turns about a centre in a plane. The radius and all axes outside the plane change linearly
/// with the angle.
#[derive(Debug, Clone, PartialEq)]
pub struct ArcPath {
    from: AxisVector,
    to: AxisVector,
    plane: Plane,
    centre: [f64; 2],
    start_radius: f64,
    /// End radius minus start radius.
    growth: f64,
    start_angle: f64,
    /// Angle from start to end, radians, counter-clockwise positive.
    sweep: f64,
    /// Distance along X, Y or Z normal to the plane, mm.
    height: f64,
    length: f64,
}

impl ArcPath {
    /// Creates the path between two points about a centre, given as the values of the plane's two axes.
    /// Neither end may lie on the centre. Equal directions of start and end from the centre give a full turn.
    pub fn new(from: AxisVector, to: AxisVector, plane: Plane, centre: [f64; 2], turn: Turn) -> Self {
        let [first, second] = plane.axes();
        let start = [from[first] - centre[0], from[second] - centre[1]];
        let end = [to[first] - centre[0], to[second] - centre[1]];
        let (start_radius, end_radius) = (start[0].hypot(start[1]), end[0].hypot(end[1]));
        let across = start[0] * end[1] - start[1] * end[0];
        let along = start[0] * end[0] + start[1] * end[1];
        let sense = match turn {
            Turn::CounterClockwise => 1.0,
            Turn::Clockwise => -1.0,
        };
        let angle = (sense * across).atan2(along);
        let sweep = if angle.abs() * start_radius.max(end_radius) < SAME_DIRECTION {
            TAU
        } else if angle < 0.0 {
            angle + TAU
        } else {
            angle
        };
        let mut path = Self {
            from,
            to,
            plane,
            centre,
            start_radius,
            growth: end_radius - start_radius,
            start_angle: start[1].atan2(start[0]),
            sweep: sense * sweep,
            height: (to[plane.normal()] - from[plane.normal()]).abs(),
            length: 0.0,
        };
        path.length = path.length_to(1.0);
        path
    }

    /// Returns the start point.
    pub fn start(&self) -> AxisVector {
        self.from
    }

    /// Returns the end point.
    pub fn end(&self) -> AxisVector {
        self.to
    }

    /// Returns the plane of the circle.
    pub fn plane(&self) -> Plane {
        self.plane
    }

    /// Returns the centre as the values of the plane's two axes.
    pub fn centre(&self) -> [f64; 2] {
        self.centre
    }

    /// Returns the radius at the start and at the end, mm.
    pub fn radii(&self) -> [f64; 2] {
        [self.start_radius, self.start_radius + self.growth]
    }

    /// Returns the angle from start to end, radians, counter-clockwise positive.
    pub fn sweep(&self) -> f64 {
        self.sweep
    }

    /// Returns the length over X, Y and Z, mm.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Returns the point at `distance` mm from the start; both ends are exact.
    pub fn point_at(&self, distance: f64) -> AxisVector {
        if distance <= 0.0 {
            self.from
        } else if distance >= self.length {
            self.to
        } else {
            self.point(self.share_at(distance))
        }
    }

    /// Returns the lowest and highest value of an axis on the arc, from its end and its turning points. The
    /// start is not included.
    pub fn reach(&self, axis: Axis) -> [f64; 2] {
        let mut reach = [self.to[axis]; 2];
        // The first axis turns where the direction of travel is perpendicular to it, the second where it is
        // parallel to the first.
        let offset = match self.plane.axes() {
            [first, _] if first == axis => FRAC_PI_2,
            [_, second] if second == axis => 0.0,
            _ => return reach,
        };
        let (a, b) = (self.travel_angle(0.0) - offset, self.travel_angle(1.0) - offset);
        let (low, high) = (a.min(b), a.max(b));
        let mut half_turns = (low / PI).ceil();
        while half_turns * PI <= high {
            let value = self.point(self.share_of_travel_angle(half_turns * PI + offset))[axis];
            reach = [reach[0].min(value), reach[1].max(value)];
            half_turns += 1.0;
        }
        reach
    }

    /// Returns the first and second derivative of the point with respect to distance, at this distance from
    /// the start.
    pub fn derivatives_at(&self, distance: f64) -> [AxisVector; 2] {
        let share = self.share_at(distance.clamp(0.0, self.length));
        let (sin, cos) = (self.start_angle + self.sweep * share).sin_cos();
        let way = self.to.minus(self.from);
        let [first, second] = self.plane.axes();
        if self.is_circle() {
            let rate = 1.0 / self.length;
            let once = self.sweep * self.start_radius * rate;
            let twice = -self.sweep * rate * once;
            let mut derivatives = [way.scaled(rate), AxisVector::ZERO];
            for (axis, along, across) in [(first, cos, -sin), (second, sin, cos)] {
                derivatives[0][axis] = once * across;
                derivatives[1][axis] = twice * along;
            }
            return derivatives;
        }
        let radius = self.start_radius + self.growth * share;
        let rate = self.length_rate(radius);
        let bend = -self.sweep * self.sweep * radius * self.growth / (rate * rate * rate * rate);
        let mut derivatives = [way.scaled(1.0 / rate), way.scaled(bend)];
        let (g, turn) = (self.growth, self.sweep * radius);
        for (axis, along, across) in [(first, cos, -sin), (second, sin, cos)] {
            let once = g * along + turn * across;
            let twice = self.sweep * (2.0 * g * across - turn * along);
            derivatives[0][axis] = once / rate;
            derivatives[1][axis] = twice / (rate * rate) + once * bend;
        }
        derivatives
    }

    /// Returns bounds of the first to fourth derivative with respect to distance, between two distances from
    /// the start: for an axis in the plane, and for any other axis per unit of its distance from start to
    /// end.
    ///
    /// Let u be the share of the angle, `l = ds/du`, A the sweep, g the growth and r the radius. Then `|l'|
    /// <= e = |A g|`, so `|u''| <= e/l^3`, `|u'''| <= 4 e^2/l^5`, `|u''''| <= 28 e^3/l^7`. In the plane the
    /// n-th derivative by u is at most `|A|^(n-1) hypot(n g, A r)`.
    pub fn derivative_bounds(&self, from: f64, to: f64) -> [[f64; 4]; 2] {
        if self.is_circle() {
            let rate = 1.0 / self.length;
            let turn = self.sweep.abs() * rate;
            let first = self.start_radius * turn;
            let second = first * turn;
            let third = second * turn;
            return [[first, second, third, third * turn], [rate, 0.0, 0.0, 0.0]];
        }
        let radius_at =
            |distance: f64| self.start_radius + self.growth * self.share_at(distance.clamp(0.0, self.length));
        let radii = [radius_at(from), radius_at(to)];
        let (small, large) = (radii[0].min(radii[1]), radii[0].max(radii[1]));
        let (sweep, growth) = (self.sweep.abs(), self.growth.abs());
        let u1 = 1.0 / self.length_rate(small);
        let e = sweep * growth;
        let (u2, u3, u4) = (
            e * u1.powi(3),
            4.0 * e * e * u1.powi(5),
            28.0 * e * e * e * u1.powi(7),
        );
        let bounds = |d: [f64; 4]| {
            [
                d[0] * u1,
                d[1] * u1 * u1 + d[0] * u2,
                d[2] * u1 * u1 * u1 + 3.0 * d[1] * u1 * u2 + d[0] * u3,
                d[3] * u1.powi(4)
                    + 6.0 * d[2] * u1 * u1 * u2
                    + d[1] * (4.0 * u1 * u3 + 3.0 * u2 * u2)
                    + d[0] * u4,
            ]
        };
        let turn = sweep * large;
        let in_plane = bounds(std::array::from_fn(|k| {
            let n = k as f64 + 1.0;
            (n * growth).hypot(turn) * [1.0, sweep, sweep * sweep, sweep * sweep * sweep][k]
        }));
        [in_plane, [u1, u2, u3, u4]]
    }

    /// Returns the point at a share of the angle, 0 to 1.
    fn point(&self, share: f64) -> AxisVector {
        let mut point = self.from.plus(self.to.minus(self.from).scaled(share));
        let (sin, cos) = (self.start_angle + self.sweep * share).sin_cos();
        let radius = self.start_radius + self.growth * share;
        let [first, second] = self.plane.axes();
        point[first] = self.centre[0] + radius * cos;
        point[second] = self.centre[1] + radius * sin;
        point
    }

    fn is_circle(&self) -> bool {
        self.growth.abs() <= CONSTANT_RADIUS * self.start_radius
    }

    /// Returns the derivative of the arc length with respect to the share of the angle.
    fn length_rate(&self, radius: f64) -> f64 {
        root_of_squares(self.sweep * radius, root_of_squares(self.growth, self.height))
    }

    /// Returns the arc length up to a share u of the angle: the integral of `sqrt(A^2 r^2 + k^2)`, with `r =
    /// r0 + g u`, A the sweep and `k^2 = g^2 + height^2`. The integral is `[r q + k^2/A asinh(A r/k)]/(2 g)`,
    /// with `q` the root. The code avoids the cancellation in the differences, so that a small g loses no
    /// digits.
    fn length_to(&self, share: f64) -> f64 {
        let start = self.start_radius;
        if self.is_circle() {
            return share * self.length_rate(start);
        }
        let sweep = self.sweep.abs();
        let rest = root_of_squares(self.growth, self.height);
        let radius = start + self.growth * share;
        let (q, q_start) = (self.length_rate(radius), self.length_rate(start));
        let (a, b) = (sweep * radius / rest, sweep * start / rest);
        let slope = (a + b) / (a * root_of_squares(b, 1.0) + b * root_of_squares(a, 1.0));
        // asinh(a) - asinh(b) = asinh(x)
        let x = (a - b) * slope;
        let asinh_over_x = if x.abs() < 1e-5 {
            1.0 - x * x / 6.0
        } else {
            x.asinh() / x
        };
        let product = q + start * sweep * sweep * (radius + start) / (q + q_start);
        share * 0.5 * (product + rest * slope * asinh_over_x)
    }

    /// Returns the share of the angle at an arc length, by Newton's method. The length is convex or concave
    /// in the share, so that from the second step on the shares converge from one side. After a step h the
    /// error is at most `h^2 A/4`, because `l''/l' = A^2 g r/(A^2 r^2 + k^2)` with `k >= g` is at most A/2.
    fn share_at(&self, distance: f64) -> f64 {
        let mut share = distance / self.length;
        if self.is_circle() {
            return share;
        }
        for _ in 0..NEWTON_STEPS_MAX {
            let rate = self.length_rate(self.start_radius + self.growth * share);
            let step = (self.length_to(share) - distance) / rate;
            share = (share - step).clamp(0.0, 1.0);
            if step * step * self.sweep.abs() <= f64::EPSILON {
                break;
            }
        }
        share
    }

    /// Returns the direction of travel in the plane at a share of the angle, as an angle counter-clockwise
    /// from the first axis. Along the path it only grows or only falls.
    fn travel_angle(&self, share: f64) -> f64 {
        let radius = self.start_radius + self.growth * share;
        let off_radius = (self.sweep * radius).atan2(self.growth);
        self.start_angle + self.sweep * share + off_radius
    }

    /// Returns the share of the angle at which the direction of travel is `angle`, by bisection.
    fn share_of_travel_angle(&self, angle: f64) -> f64 {
        if self.is_circle() {
            return ((angle - self.travel_angle(0.0)) / self.sweep).clamp(0.0, 1.0);
        }
        let before = |share: f64| (self.travel_angle(share) - angle) * self.sweep <= 0.0;
        let [low, high] = bisect([0.0, 1.0], HALVINGS, before);
        f64::midpoint(low, high)
    }
}

/// Returns `hypot` without its protection against squares outside the range of a float, which takes ten times
/// as long. Lengths are far below that range.
fn root_of_squares(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn xyz(x: f64, y: f64, z: f64) -> AxisVector {
        AxisVector([x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9, "{a} is not {b}");
    }

    /// Returns the length as the sum of chords between twenty thousand points of `r = r0 + g u`.
    fn length_by_chords(r0: f64, r1: f64, sweep: f64, height: f64, share: f64) -> f64 {
        let n = 20_000;
        let at = |i: i32| {
            let u = share * f64::from(i) / f64::from(n);
            let (r, a) = (r0 + (r1 - r0) * u, sweep * u);
            [r * a.cos(), r * a.sin(), height * u]
        };
        (0..n)
            .map(|i| {
                let (p, q) = (at(i), at(i + 1));
                (0..3).map(|k| (q[k] - p[k]).powi(2)).sum::<f64>().sqrt()
            })
            .sum()
    }

    #[test]
    fn s1f_equal_directions_are_a_full_turn_and_the_sweep_follows_the_sense() {
        for (turn, end, turns) in [
            (Turn::CounterClockwise, xyz(0.0, 10.0, 0.0), 0.25),
            (Turn::Clockwise, xyz(0.0, 10.0, 0.0), 0.75),
            (Turn::CounterClockwise, xyz(10.0, 0.0, 0.0), 1.0),
            (Turn::Clockwise, xyz(10.0, 1e-12, 0.0), 1.0),
            (Turn::Clockwise, xyz(-10.0, 0.0, 0.0), 0.5),
        ] {
            let path = ArcPath::new(xyz(10.0, 0.0, 0.0), end, Plane::Xy, [0.0, 0.0], turn);
            close(path.length(), turns * TAU * 10.0);
            let sense = if turn == Turn::CounterClockwise { 1.0 } else { -1.0 };
            let angle = sense * turns * TAU / 3.0;
            let third = path.point_at(path.length() / 3.0);
            close(third[Axis::X], 10.0 * angle.cos());
            close(third[Axis::Y], 10.0 * angle.sin());
        }
    }

    #[test]
    fn s1f_each_plane_turns_its_first_axis_towards_its_second() {
        for plane in [Plane::Xy, Plane::Zx, Plane::Yz] {
            let [first, second] = plane.axes();
            let (mut from, mut to) = (AxisVector::ZERO, AxisVector::ZERO);
            from[first] = 4.0;
            to[second] = 4.0;
            let path = ArcPath::new(from, to, plane, [0.0, 0.0], Turn::CounterClockwise);
            let middle = path.point_at(path.length() / 2.0);
            close(middle[first], 8.0_f64.sqrt());
            close(middle[second], 8.0_f64.sqrt());
        }
    }

    #[test]
    fn s1f_a_helix_is_linear_in_the_angle_and_its_length_is_that_of_x_y_z() {
        let mut to = xyz(10.0, 0.0, 7.0);
        to[Axis::A] = 90.0;
        let path = ArcPath::new(
            xyz(10.0, 0.0, 0.0),
            to,
            Plane::Xy,
            [0.0, 0.0],
            Turn::CounterClockwise,
        );
        close(path.length(), (TAU * 10.0).hypot(7.0));
        let quarter = path.point_at(path.length() / 4.0);
        close(quarter[Axis::Y], 10.0);
        close(quarter[Axis::Z], 1.75);
        close(quarter[Axis::A], 22.5);
    }

    #[test]
    fn s1f_spirals_and_cones_have_their_radius_linear_in_the_angle() {
        for (r0, r1, height) in [
            (50.0, 40.0, 0.0),
            (50.0, 10.0, 0.0),
            (1.0, 30.0, 25.0),
            (10.0, 10.001, 3.0),
            (10.0, 10.0 + 1e-7, 0.0),
            (20.0, 0.001, 0.0),
        ] {
            let path = ArcPath::new(
                xyz(r0, 0.0, 0.0),
                xyz(0.0, -r1, height),
                Plane::Xy,
                [0.0, 0.0],
                Turn::CounterClockwise,
            );
            let sweep = 1.5 * PI;
            for share in [0.1, 0.5, 0.9, 1.0] {
                let distance = length_by_chords(r0, r1, sweep, height, share);
                let (r, a) = (r0 + (r1 - r0) * share, sweep * share);
                let point = path.point_at(distance);
                // Chords are shorter by about length/24 (angle step)^2.
                let error = (point[Axis::X] - r * a.cos()).hypot(point[Axis::Y] - r * a.sin());
                assert!(error < 1e-6, "{r0} to {r1} at {share}: {error}");
                assert!((point[Axis::Z] - height * share).abs() < 1e-6);
            }
            assert_eq!(path.point_at(path.length()), path.end());
            assert_eq!(path.point_at(0.0), path.start());
        }
    }

    #[test]
    fn s1f_arc_length_share_is_exact_to_4_eps_for_radius_ratios_up_to_1e9() {
        for r0 in [1e-6, 0.03, 1.0, 999.0] {
            for r1 in [1e-6, 0.03, 1.0, 999.0, r0 * 1.000_000_1, r0 * 1.5] {
                for height in [0.0, 1e-3, 50.0] {
                    let to = xyz(0.0, -r1, height);
                    let path = ArcPath::new(xyz(r0, 0.0, 0.0), to, Plane::Xy, [0.0, 0.0], Turn::Clockwise);
                    for n in 0..=200 {
                        let distance = path.length() * (f64::from(n) / 200.0).powi(4);
                        let error = path.length_to(path.share_at(distance)) - distance;
                        assert!(
                            error.abs() <= 4.0 * f64::EPSILON * path.length(),
                            "{r0} to {r1}, {height}, {n}: {error}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_points_and_within_their_bounds() {
        for (r0, r1, height) in [
            (50.0, 50.0, 0.0),
            (10.0, 10.0, 4.0),
            (50.0, 20.0, 0.0),
            (1.0, 5.0, 3.0),
        ] {
            let mut to = xyz(0.0, -r1, height);
            to[Axis::A] = 30.0;
            let path = ArcPath::new(
                xyz(r0, 0.0, 0.0),
                to,
                Plane::Xy,
                [0.0, 0.0],
                Turn::CounterClockwise,
            );
            let step = path.length() / 4000.0;
            for k in 1..20 {
                let s = path.length() * f64::from(k) / 20.0;
                let [first, second] = path.derivatives_at(s);
                let [in_plane, beside] = path.derivative_bounds(s - 2.0 * step, s + 2.0 * step);
                let points: Vec<AxisVector> =
                    (-2..=2).map(|n| path.point_at(s + f64::from(n) * step)).collect();
                for axis in [Axis::X, Axis::Y, Axis::Z, Axis::A] {
                    let bounds = match axis {
                        Axis::X | Axis::Y => in_plane,
                        _ => beside.map(|bound| bound * (path.end()[axis] - path.start()[axis]).abs()),
                    };
                    let p: Vec<f64> = points.iter().map(|point| point[axis]).collect();
                    let differences = [
                        (p[3] - p[1]) / (2.0 * step),
                        (p[3] - 2.0 * p[2] + p[1]) / (step * step),
                        (p[4] - 2.0 * p[3] + 2.0 * p[1] - p[0]) / (2.0 * step.powi(3)),
                        (p[4] - 4.0 * p[3] + 6.0 * p[2] - 4.0 * p[1] + p[0]) / step.powi(4),
                    ];
                    assert!((differences[0] - first[axis]).abs() < 1e-5);
                    assert!((differences[1] - second[axis]).abs() < 1e-4);
                    for (n, difference) in differences.into_iter().enumerate() {
                        // Rounding of the points, 1e-14, divided by the step.
                        let rounding = 1e-13 * step.powi(-(i32::try_from(n).unwrap() + 1));
                        assert!(
                            difference.abs() <= bounds[n] * (1.0 + 1e-5) + 16.0 * rounding,
                            "{axis:?} {n}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn reach_holds_for_every_point_and_is_met_by_one() {
        for (n, (r1, height, turn)) in [
            (10.0, 0.0, Turn::CounterClockwise),
            (10.0, 4.0, Turn::Clockwise),
            (25.0, 0.0, Turn::Clockwise),
            (3.0, 40.0, Turn::CounterClockwise),
        ]
        .into_iter()
        .enumerate()
        {
            for k in 0..12 {
                let end = f64::from(k) * TAU / 12.0 + 0.05;
                let to = xyz(2.0 + r1 * end.cos(), 1.0 + r1 * end.sin(), height);
                let path = ArcPath::new(xyz(12.0, 1.0, 0.0), to, Plane::Xy, [2.0, 1.0], turn);
                for axis in [Axis::X, Axis::Y, Axis::Z] {
                    let at = |i: i32| path.point_at(path.length() * f64::from(i) / 1000.0)[axis];
                    let [low, high] = path.reach(axis);
                    let lowest = (0..=1000).map(at).fold(f64::MAX, f64::min);
                    let highest = (0..=1000).map(at).fold(f64::MIN, f64::max);
                    // A turning point between two samples exceeds them by at most r (half a step)^2/2.
                    assert!(
                        (lowest - low.min(at(0))).abs() < 2e-4,
                        "{n} {k} {axis:?}: {lowest} {low}"
                    );
                    assert!(
                        (highest - high.max(at(0))).abs() < 2e-4,
                        "{n} {k} {axis:?}: {highest} {high}"
                    );
                }
            }
        }
    }
}
