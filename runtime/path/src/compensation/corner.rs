//! Joints of two compensated blocks (M1g).
//!
//! The deflection between two blocks determines the type of their joint. On the inside, both blocks are cut
//! at the intersection of their offset curves. On the outside, up to a deflection of 90 degrees, both are
//! extended by straight lines to the intersection of these lines. Beyond 90 degrees, an arc about the
//! programmed corner is added. A reversal within [`REVERSAL`] is treated as an outside corner on either side;
//! on the inside, the overcut check finds the reversal if its blocks are apart.
//!
//! Decision: a straight piece along the tangent extends an arc.

use std::f64::consts::PI;

use super::curve::{Arc, Curve, Vec2};
use super::distance::Chord;
use crate::length::LENGTH_MIN;

/// Deflections below this angle are treated as rounding, radians: for a tool of 100 mm, the corner is then
/// off the curves by less than 1e-10 mm.
pub(super) const TANGENT: f64 = 1e-6;

/// Largest angle from the opposite direction at which two blocks are a reversal, radians: 1 degree.
pub(super) const REVERSAL: f64 = PI / 180.0;

/// Cosine of the largest deflection at which two blocks are extended: 90 degrees and rounding.
pub(super) const RIGHT_ANGLE: f64 = -1e-9;

/// Path of the tool's centre from one block to the next. The centre moves along the first curve to `end`,
/// then straight to `meet`, the place of a programmed exact stop. From there it moves along `arc`, or
/// straight through `via`, to `start` of the next curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Joint {
    pub end: Vec2,
    pub meet: Vec2,
    pub arc: Option<Curve>,
    pub via: Option<Vec2>,
    pub start: Vec2,
    /// Deflection, radians; counter-clockwise positive.
    pub turn: f64,
}

impl Joint {
    /// Creates a joint at the point in which both curves meet.
    pub fn at(point: Vec2, turn: f64) -> Self {
        Self {
            end: point,
            meet: point,
            arc: None,
            via: None,
            start: point,
            turn,
        }
    }

    /// Creates a joint with an arc about the corner.
    pub fn round(corner: Vec2, from: Vec2, to: Vec2, tool: f64, turn: f64) -> Self {
        let away = -tool.signum();
        let sweep = if turn * away > 0.0 {
            turn
        } else {
            turn + away * 2.0 * PI
        };
        let radius = tool.abs();
        Self {
            end: from,
            meet: from,
            arc: Some(Curve::Arc(Arc {
                centre: corner,
                from,
                to,
                radii: [radius; 2],
                sweep,
            })),
            via: None,
            start: to,
            turn,
        }
    }
}

/// Returns the joint of two offset curves whose programmed blocks meet at `corner`. `tool` is the tool
/// radius, negative if the tool is on the right. If the curves do not meet, returns their ends at the corner,
/// and `false`.
pub(super) fn between(before: &Curve, after: &Curve, corner: Vec2, tool: f64) -> (Joint, bool) {
    let (incoming, outgoing) = (before.end_direction(), after.start_direction());
    let (turn, cos) = (incoming.angle_to(outgoing), incoming.dot(outgoing));
    if tool.abs() < LENGTH_MIN {
        return (Joint::at(corner, turn), true);
    }
    if needs_arc(turn, cos, tool) {
        return (Joint::round(corner, before.to(), after.from(), tool, turn), true);
    }
    let straight = matches!((before, after), (Curve::Line(_), Curve::Line(_)));
    let outside = turn * tool < 0.0;
    if straight || outside || turn.abs() < TANGENT {
        // Both normals make the same angle with the direction from the corner to `meet`.
        let meet = corner + (incoming.left_normal() + outgoing.left_normal()) * (tool / (1.0 + cos));
        let mut joint = Joint::at(meet, turn);
        if outside && turn.abs() >= TANGENT {
            if let Curve::Arc(arc) = before {
                joint.end = arc.to;
            }
            if let Curve::Arc(arc) = after {
                joint.start = arc.from;
            }
        }
        return (joint, true);
    }
    // Takes the intersection on the same side of the chord's middle as the programmed corner: if the tool's
    // radius grew from zero, the intersection would move from the corner to this point.
    let on_line_and_circle =
        |line, arc: &Arc, radius| Chord::on_line(line, arc.centre, radius).end_towards(corner - arc.centre);
    let meet = match (before, after) {
        (Curve::Line(line), Curve::Arc(arc)) => on_line_and_circle(line, arc, arc.radii[0]),
        (Curve::Arc(arc), Curve::Line(line)) => on_line_and_circle(line, arc, arc.radii[1]),
        (Curve::Arc(a), Curve::Arc(b)) => {
            let chord = Chord::between_circles([a.centre, b.centre], [a.radii[1], b.radii[0]]);
            chord.and_then(|chord| chord.end_towards(corner - a.centre))
        }
        (Curve::Line(_), Curve::Line(_)) => None,
    };
    let feet = Joint {
        end: before.to(),
        start: after.from(),
        ..Joint::at(before.to(), turn)
    };
    meet.map_or((feet, false), |meet| (Joint::at(meet, turn), true))
}

/// Returns the joint of a straight lead-in in this direction and the first compensated curve.
pub(super) fn leading_in(direction: Vec2, after: &Curve, corner: Vec2, tool: f64) -> Joint {
    let outgoing = after.start_direction();
    let (turn, cos) = (direction.angle_to(outgoing), direction.dot(outgoing));
    if needs_arc(turn, cos, tool) {
        let foot = corner + direction.left_normal() * tool;
        Joint::round(corner, foot, after.from(), tool, turn)
    } else {
        Joint::at(after.from(), turn)
    }
}

/// Returns the joint of the last compensated curve and a straight lead-out in this direction.
pub(super) fn leading_out(before: &Curve, direction: Vec2, corner: Vec2, tool: f64) -> Joint {
    let incoming = before.end_direction();
    let (turn, cos) = (incoming.angle_to(direction), incoming.dot(direction));
    if needs_arc(turn, cos, tool) {
        let foot = corner + direction.left_normal() * tool;
        Joint::round(corner, before.to(), foot, tool, turn)
    } else {
        Joint::at(before.to(), turn)
    }
}

fn needs_arc(turn: f64, cos: f64, tool: f64) -> bool {
    let reversal = PI - turn.abs() <= REVERSAL;
    tool.abs() >= LENGTH_MIN && (reversal || (turn * tool < 0.0 && cos < RIGHT_ANGLE))
}
