//! Distances and intersections of lines and arcs in the plane.

use super::curve::{Arc, Curve, Line, Vec2};
use crate::length::LENGTH_MIN;

/// The smallest distance between two curves; 0 when they cross.
pub(super) fn distance(a: &Curve, b: &Curve) -> f64 {
    if !intersections(a, b).is_empty() {
        return 0.0;
    }
    let ends = to_point(b, a.from())
        .min(to_point(b, a.to()))
        .min(to_point(a, b.from()))
        .min(to_point(a, b.to()));
    // Between the ends two curves that do not cross are closest where a normal of one is a normal of the other.
    match (a, b) {
        (Curve::Line(_), Curve::Line(_)) => ends,
        (Curve::Line(line), Curve::Arc(arc)) | (Curve::Arc(arc), Curve::Line(line)) => {
            ends.min(to_point_if_on_arc(arc, line.along.left(), &Curve::Line(*line)))
        }
        (Curve::Arc(first), Curve::Arc(second)) => {
            let way = second.centre - first.centre;
            ends.min(to_point_if_on_arc(first, way, b))
                .min(to_point_if_on_arc(second, way, a))
        }
    }
}

/// The distance from the points of an arc in this direction from its centre, and opposite, to a curve.
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

/// The distance of a point from a curve.
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

/// A few points.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Points {
    points: [Option<Vec2>; 2],
}

impl Points {
    pub fn is_empty(&self) -> bool {
        self.points.iter().all(Option::is_none)
    }

    fn one(point: Vec2) -> Self {
        Self {
            points: [Some(point), None],
        }
    }

    /// The one that the curve comes to first.
    pub fn first_on(&self, curve: &Curve) -> Option<Vec2> {
        let place = |point: &Vec2| match curve {
            Curve::Line(line) => (*point - line.from).dot(line.along),
            Curve::Arc(arc) => arc.share(*point - arc.centre).unwrap_or_default(),
        };
        self.points
            .into_iter()
            .flatten()
            .min_by(|a, b| place(a).total_cmp(&place(b)))
    }
}

/// Where two curves meet. Of two lines upon each other: where both begin to be.
pub(super) fn intersections(a: &Curve, b: &Curve) -> Points {
    let candidates = match (a, b) {
        (Curve::Line(first), Curve::Line(second)) => of_lines(first, second),
        (Curve::Line(line), Curve::Arc(arc)) | (Curve::Arc(arc), Curve::Line(line)) => {
            let foot = line.from + line.along * (arc.centre - line.from).dot(line.along);
            let radius = f64::midpoint(arc.radii[0], arc.radii[1]);
            either_side(foot, line.along, radius, (foot - arc.centre).length())
        }
        (Curve::Arc(first), Curve::Arc(second)) => of_circles(first, second),
    };
    Points {
        points: candidates
            .points
            .map(|point| point.filter(|point| is_on(a, *point) && is_on(b, *point))),
    }
}

fn of_lines(a: &Line, b: &Line) -> Points {
    let (sin, between) = (a.along.cross(b.along), b.from - a.from);
    if sin.abs() > LENGTH_MIN {
        return Points::one(a.from + a.along * (between.cross(b.along) / sin));
    }
    let same_line = a.along.cross(between).abs() < LENGTH_MIN && a.along.dot(b.along) > 0.0;
    if !same_line {
        return Points::default();
    }
    Points::one(if a.along.dot(between) > 0.0 {
        b.from
    } else {
        a.from
    })
}

fn of_circles(a: &Arc, b: &Arc) -> Points {
    let way = b.centre - a.centre;
    let distance = way.length();
    if distance < LENGTH_MIN {
        return Points::default();
    }
    let along = way * (1.0 / distance);
    let radius = |arc: &Arc| f64::midpoint(arc.radii[0], arc.radii[1]);
    let (first, second) = (radius(a), radius(b));
    let foot = f64::midpoint(distance, (first - second) * (first + second) / distance);
    either_side(a.centre + along * foot, along.left(), first, foot.abs())
}

/// Both ends of the chord of a circle, from the middle of the chord.
fn either_side(middle: Vec2, along: Vec2, radius: f64, distance: f64) -> Points {
    if distance > radius {
        return Points::default();
    }
    let half_chord = ((radius - distance) * (radius + distance)).sqrt();
    Points {
        points: [
            Some(middle - along * half_chord),
            Some(middle + along * half_chord),
        ],
    }
}

/// True for a point of the curve's line or circle that lies within its ends.
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
