//! Lines and arcs in the plane of the compensation, and their offset curves.

use std::f64::consts::PI;
use std::ops::{Add, Mul, Sub};

use tandem_model::AxisVector;
use tandem_model::flow::Path;
use tandem_model::plane::Plane;

use crate::length::LENGTH_MIN;

/// Radius of the centre's path if the tool is as large as the arc, mm. The direction along this path is still
/// exact to [`super::corner::TANGENT`] some hundred mm away from the origin; the wall is overcut by at most
/// this radius.
const POINT_RADIUS: f64 = 1e-7;

/// A point or a direction in the plane: its values on the first and the second axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Vec2(pub f64, pub f64);

impl Vec2 {
    pub fn project(vector: AxisVector, plane: Plane) -> Self {
        let [first, second] = plane.axes();
        Self(vector[first], vector[second])
    }

    /// Returns `vector` with the values of this point on the plane's axes.
    pub fn onto_plane(self, mut vector: AxisVector, plane: Plane) -> AxisVector {
        let [first, second] = plane.axes();
        vector[first] = self.0;
        vector[second] = self.1;
        vector
    }

    pub fn dot(self, other: Self) -> f64 {
        self.0 * other.0 + self.1 * other.1
    }

    /// Returns the cross product, which is positive if `other` points to the left.
    pub fn cross(self, other: Self) -> f64 {
        self.0 * other.1 - self.1 * other.0
    }

    /// Returns the vector turned by 90 degrees counter-clockwise.
    pub fn left_normal(self) -> Self {
        Self(-self.1, self.0)
    }

    /// Returns the length. The squares of positions are far too small to overflow.
    pub fn length(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// Returns the angle from this direction to `other`, -pi to pi radians; counter-clockwise positive.
    pub fn angle_to(self, other: Self) -> f64 {
        self.cross(other).atan2(self.dot(other))
    }
}

impl Add for Vec2 {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

impl Sub for Vec2 {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, self.1 - other.1)
    }
}

impl Mul<f64> for Vec2 {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor)
    }
}

/// A line or an arc in the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Curve {
    Line(Line),
    Arc(Arc),
}

/// A straight line. If the line is cut, even to length 0, its direction stays the direction of the block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    pub from: Vec2,
    pub to: Vec2,
    /// Direction of the line, a unit vector.
    pub along: Vec2,
}

/// An arc. The radii at its ends may differ because of rounding in the program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arc {
    pub centre: Vec2,
    pub from: Vec2,
    pub to: Vec2,
    /// Radii at the start and at the end, mm.
    pub radii: [f64; 2],
    /// Angle from the start to the end, radians; counter-clockwise positive.
    pub sweep: f64,
}

impl Curve {
    /// Returns the projection of a path to the plane; `None` if the path does not move in the plane.
    pub fn project(path: &Path, plane: Plane) -> Option<Self> {
        let (from, to) = (
            Vec2::project(path.start(), plane),
            Vec2::project(path.end(), plane),
        );
        match path {
            Path::Line { .. } => Self::line(from, to),
            Path::Arc(arc) => Some(Self::Arc(Arc {
                centre: Vec2(arc.centre()[0], arc.centre()[1]),
                from,
                to,
                radii: arc.radii(),
                sweep: arc.sweep(),
            })),
        }
    }

    /// Returns the straight line between two points; `None` if its length is below [`LENGTH_MIN`].
    pub fn line(from: Vec2, to: Vec2) -> Option<Self> {
        let way = to - from;
        let length = way.length();
        let along = way * (1.0 / length);
        (length >= LENGTH_MIN).then_some(Self::Line(Line { from, to, along }))
    }

    pub fn from(&self) -> Vec2 {
        match self {
            Self::Line(line) => line.from,
            Self::Arc(arc) => arc.from,
        }
    }

    pub fn to(&self) -> Vec2 {
        match self {
            Self::Line(line) => line.to,
            Self::Arc(arc) => arc.to,
        }
    }

    /// Returns the unit vector of the direction at the start.
    pub fn start_direction(&self) -> Vec2 {
        match self {
            Self::Line(line) => line.along,
            Self::Arc(arc) => arc.direction(arc.from, arc.radii[0]),
        }
    }

    /// Returns the unit vector of the direction at the end.
    pub fn end_direction(&self) -> Vec2 {
        match self {
            Self::Line(line) => line.along,
            Self::Arc(arc) => arc.direction(arc.to, arc.radii[1]),
        }
    }

    /// Returns the angle by which the direction turns along the curve, radians; counter-clockwise positive.
    pub fn turning(&self) -> f64 {
        match self {
            Self::Line(_) => 0.0,
            Self::Arc(arc) => arc.sweep,
        }
    }

    /// Returns the parallel curve at the distance `left`; `None` for an arc into which the tool does not fit.
    /// With `as_large`, a tool with the radius of the arc fits: its centre stays at the centre of the arc
    /// except for [`POINT_RADIUS`].
    pub fn offset(&self, left: f64, as_large: bool) -> Option<Self> {
        match *self {
            Self::Line(line) => {
                let shift = line.along.left_normal() * left;
                Some(Self::Line(Line {
                    from: line.from + shift,
                    to: line.to + shift,
                    along: line.along,
                }))
            }
            Self::Arc(arc) => {
                let outward = -arc.sweep.signum() * left;
                let radii = arc.radii.map(|radius| {
                    let moved = radius + outward;
                    let is_point = as_large && moved.abs() < POINT_RADIUS;
                    if is_point { POINT_RADIUS } else { moved }
                });
                let moved =
                    |point: Vec2, i: usize| arc.centre + (point - arc.centre) * (radii[i] / arc.radii[i]);
                radii.iter().all(|radius| *radius > LENGTH_MIN).then(|| {
                    Self::Arc(Arc {
                        from: moved(arc.from, 0),
                        to: moved(arc.to, 1),
                        radii,
                        ..arc
                    })
                })
            }
        }
    }

    /// Returns the part of the curve between two points; a line is extended beyond its ends. Returns `None`
    /// if `to` is before `from` in the direction of the curve.
    pub fn between(&self, from: Vec2, to: Vec2) -> Option<Self> {
        match *self {
            Self::Line(line) => {
                let forward = (to - from).dot(line.along) >= -LENGTH_MIN;
                forward.then_some(Self::Line(Line { from, to, ..line }))
            }
            Self::Arc(arc) => {
                let sense = arc.sweep.signum();
                let cut = |a: Vec2, b: Vec2| sense * (a - arc.centre).angle_to(b - arc.centre);
                let (mut left, mut radii) = (arc.sweep.abs(), arc.radii);
                if from != arc.from {
                    left -= cut(arc.from, from);
                    radii[0] = (from - arc.centre).length();
                }
                if to != arc.to {
                    left -= cut(to, arc.to);
                    radii[1] = (to - arc.centre).length();
                }
                let radius = arc.radii[0].min(arc.radii[1]);
                (left * radius >= -LENGTH_MIN).then_some(Self::Arc(Arc {
                    from,
                    to,
                    radii,
                    sweep: sense * left.max(0.0),
                    ..arc
                }))
            }
        }
    }

    /// Returns the length of the curve in the plane, mm.
    pub fn length(&self) -> f64 {
        match self {
            Self::Line(line) => (line.to - line.from).length(),
            Self::Arc(arc) => arc.sweep.abs() * f64::midpoint(arc.radii[0], arc.radii[1]),
        }
    }
}

impl Arc {
    /// Returns the direction of travel, a unit vector, at a point of the arc with this radius.
    fn direction(&self, point: Vec2, radius: f64) -> Vec2 {
        (point - self.centre).left_normal() * (self.sweep.signum() / radius)
    }

    /// Returns the share of the sweep at which the arc passes this direction from its centre; `None` if the
    /// arc does not pass it.
    pub fn share(&self, towards: Vec2) -> Option<f64> {
        let angle = self.sweep.signum() * (self.from - self.centre).angle_to(towards);
        let angle = if angle < 0.0 { angle + 2.0 * PI } else { angle };
        (angle <= self.sweep.abs()).then(|| angle / self.sweep.abs())
    }

    pub fn radius_at(&self, share: f64) -> f64 {
        self.radii[0] + (self.radii[1] - self.radii[0]) * share
    }
}

/// An axis-parallel rectangle that contains a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    low: Vec2,
    high: Vec2,
}

impl Bounds {
    pub fn from_curve(curve: &Curve) -> Self {
        let (from, to) = (curve.from(), curve.to());
        let ends = Self {
            low: Vec2(from.0.min(to.0), from.1.min(to.1)),
            high: Vec2(from.0.max(to.0), from.1.max(to.1)),
        };
        let Curve::Arc(arc) = curve else { return ends };
        let sweep = arc.sweep.abs();
        if sweep <= PI {
            // The rise above the chord c is c/2 tan(sweep/4), and the tangent is below its chord up to pi/4.
            ends.wider((to - from).length() * sweep / (2.0 * PI))
        } else {
            let radius = arc.radii[0].max(arc.radii[1]);
            let point = Self {
                low: arc.centre,
                high: arc.centre,
            };
            point.wider(radius).with(&ends)
        }
    }

    pub fn with(self, other: &Self) -> Self {
        Self {
            low: Vec2(self.low.0.min(other.low.0), self.low.1.min(other.low.1)),
            high: Vec2(self.high.0.max(other.high.0), self.high.1.max(other.high.1)),
        }
    }

    fn wider(self, by: f64) -> Self {
        let by = Vec2(by, by);
        Self {
            low: self.low - by,
            high: self.high + by,
        }
    }

    /// Returns true if the gap between the rectangles is smaller than `distance` on both axes.
    pub fn is_near(&self, other: &Self, distance: f64) -> bool {
        self.low.0 - other.high.0 < distance
            && other.low.0 - self.high.0 < distance
            && self.low.1 - other.high.1 < distance
            && other.low.1 - self.high.1 < distance
    }
}
