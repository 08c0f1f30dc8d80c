//! Distances and intersections of lines and arcs in the plane.

use super::curve::{Arc, Curve, Line, Vec2};
use crate::length::LENGTH_MIN;

/// Returns the smallest distance between two curves; 0 if they cross.
pub(super) fn distance(a: &Curve, b: &Curve) -> f64 {
    if intersections(a, b).iter().any(Option::is_some) {
        return 0.0;
    }
    let ends = to_point(b, a.from())
        .min(to_point(b, a.to()))
        .min(to_point(a, b.from()))
        .min(to_point(a, b.to()));
    // Between their ends, two curves that do not cross are closest where they have a common normal.
    match (a, b) {
        (Curve::Line(_), Curve::Line(_)) => ends,
        (Curve::Line(line), Curve::Arc(arc)) | (Curve::Arc(arc), Curve::Line(line)) => ends.min(
            to_point_if_on_arc(arc, line.along.left_normal(), &Curve::Line(*line)),
        ),
        (Curve::Arc(first), Curve::Arc(second)) => {
            let way = second.centre - first.centre;
            ends.min(to_point_if_on_arc(first, way, b))
                .min(to_point_if_on_arc(second, way, a))
        }
    }
}

/// Returns the smaller distance to `curve` of two points of an arc: the point in this direction from the
/// arc's centre, and the opposite point. A point that is not on the arc is ignored.
fn to_point_if_on_arc(arc: &Arc, towards: Vec2, curve: &Curve) -> f64 {
    let length = towards.length();
    if length < LENGTH_MIN {
        return f64::INFINITY;
    }
    [1.0, -1.0]
        .into_iter()
        .filter_map(|sense| {
            let normal = towards * (sense / length);
            let share = arc.share(normal)?;
            Some(to_point(curve, arc.centre + normal * arc.radius_at(share)))
        })
        .fold(f64::INFINITY, f64::min)
}

/// Returns the distance of a point from a curve.
fn to_point(curve: &Curve, point: Vec2) -> f64 {
    match curve {
        Curve::Line(line) => {
            let along = (point - line.from).dot(line.along);
            let length = (line.to - line.from).dot(line.along);
            let foot = line.from + line.along * along.clamp(0.0, length.max(0.0));
            (point - foot).length()
        }
        Curve::Arc(arc) => {
            let from_centre = point - arc.centre;
            match arc.share(from_centre) {
                Some(share) => (from_centre.length() - arc.radius_at(share)).abs(),
                None => (point - arc.from).length().min((point - arc.to).length()),
            }
        }
    }
}

/// Intersections of two curves: at most two points.
type Points = [Option<Vec2>; 2];

/// Returns the point of `points` that the curve reaches first.
pub(super) fn first_on(curve: &Curve, points: Points) -> Option<Vec2> {
    let place = |point: &Vec2| match curve {
        Curve::Line(line) => (*point - line.from).dot(line.along),
        Curve::Arc(arc) => arc.share(*point - arc.centre).unwrap_or_default(),
    };
    points
        .into_iter()
        .flatten()
        .min_by(|a, b| place(a).total_cmp(&place(b)))
}

/// Returns the points at which two curves meet. Two overlapping lines meet where the overlap begins.
pub(super) fn intersections(a: &Curve, b: &Curve) -> Points {
    let mean = |arc: &Arc| f64::midpoint(arc.radii[0], arc.radii[1]);
    let candidates = match (a, b) {
        (Curve::Line(first), Curve::Line(second)) => [line_intersection(first, second), None],
        (Curve::Line(line), Curve::Arc(arc)) | (Curve::Arc(arc), Curve::Line(line)) => {
            Chord::on_line(line, arc.centre, mean(arc)).ends()
        }
        (Curve::Arc(first), Curve::Arc(second)) => {
            let radii = [mean(first), mean(second)];
            Chord::between_circles([first.centre, second.centre], radii).map_or([None; 2], Chord::ends)
        }
    };
    candidates.map(|point| point.filter(|point| is_on(a, *point) && is_on(b, *point)))
}

fn line_intersection(a: &Line, b: &Line) -> Option<Vec2> {
    let (sin, between) = (a.along.cross(b.along), b.from - a.from);
    if sin.abs() > LENGTH_MIN {
        return Some(a.from + a.along * (between.cross(b.along) / sin));
    }
    let same_line = a.along.cross(between).abs() < LENGTH_MIN && a.along.dot(b.along) > 0.0;
    let first = if a.along.dot(between) > 0.0 {
        b.from
    } else {
        a.from
    };
    same_line.then_some(first)
}

/// The chord of a circle that a line or another circle cuts off.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chord {
    middle: Vec2,
    /// Direction of the chord, a unit vector.
    along: Vec2,
    radius: f64,
    /// Distance of the chord's middle from the circle's centre. If the distance is above the radius, the
    /// circle does not meet the line or the other circle.
    distance: f64,
}

impl Chord {
    pub fn on_line(line: &Line, centre: Vec2, radius: f64) -> Self {
        let middle = line.from + line.along * (centre - line.from).dot(line.along);
        Self {
            middle,
            along: line.along,
            radius,
            distance: (middle - centre).length(),
        }
    }

    /// Returns the chord of two circles; `None` if both circles have the same centre.
    pub fn between_circles([a, b]: [Vec2; 2], [first, second]: [f64; 2]) -> Option<Self> {
        let way = b - a;
        let distance = way.length();
        if distance < LENGTH_MIN {
            return None;
        }
        let along = way * (1.0 / distance);
        let foot = f64::midpoint(distance, (first - second) * (first + second) / distance);
        Some(Self {
            middle: a + along * foot,
            along: along.left_normal(),
            radius: first,
            distance: foot.abs(),
        })
    }

    fn half_length(self) -> f64 {
        ((self.radius - self.distance) * (self.radius + self.distance))
            .max(0.0)
            .sqrt()
    }

    fn ends(self) -> Points {
        let half = self.half_length();
        [-half, half].map(|half| (self.distance <= self.radius).then(|| self.middle + self.along * half))
    }

    /// Returns the end of the chord in this direction from the circle's centre. A line that misses the circle
    /// only by rounding is treated as touching the circle.
    pub fn end_towards(self, direction: Vec2) -> Option<Vec2> {
        let side = direction.dot(self.along).signum();
        let meets = self.distance <= self.radius + LENGTH_MIN;
        meets.then(|| self.middle + self.along * (side * self.half_length()))
    }
}

/// Returns true if a point of the curve's line or circle is between the ends of the curve.
fn is_on(curve: &Curve, point: Vec2) -> bool {
    let at_an_end = |end: Vec2| (point - end).length() < LENGTH_MIN;
    if at_an_end(curve.from()) || at_an_end(curve.to()) {
        return true;
    }
    match curve {
        Curve::Line(line) => {
            let along = (point - line.from).dot(line.along);
            (0.0..=(line.to - line.from).dot(line.along)).contains(&along)
        }
        Curve::Arc(arc) => arc.share(point - arc.centre).is_some(),
    }
}
