//! Joints of dialect dgshape (G40 to G42 of its manual). The manual's figures were not available, so the
//! joints are like those of most controls.
//!
//! Outside corners stay straight. Up to a deflection of 90 degrees, the offset blocks meet at the
//! intersection of their tangents. Beyond 90 degrees, both blocks are extended by the tool's radius, and a
//! line joins them. The lead-in and the lead-out end next to the corner (type A), or have the same joints as
//! two blocks (type B); within 1 degree of a reversal they are of type A. On the inside, the blocks meet at
//! the intersection of their offset curves; within 1 degree of a reversal, a line joins their ends.

use std::f64::consts::PI;

use tandem_model::settings::CompensationStart;

use super::corner::{self, Joint, REVERSAL, RIGHT_ANGLE, TANGENT};
use super::curve::{Curve, Vec2};
use crate::length::LENGTH_MIN;

/// End of an offset curve at a corner: its last or first point, and the direction there.
#[derive(Clone, Copy)]
struct End {
    foot: Vec2,
    along: Vec2,
    is_line: bool,
}

impl End {
    fn from_last(curve: &Curve) -> Self {
        Self {
            foot: curve.to(),
            along: curve.end_direction(),
            is_line: matches!(curve, Curve::Line(_)),
        }
    }

    fn from_next(curve: &Curve) -> Self {
        Self {
            foot: curve.from(),
            along: curve.start_direction(),
            is_line: matches!(curve, Curve::Line(_)),
        }
    }

    fn from_lead(direction: Vec2, corner: Vec2, tool: f64) -> Self {
        Self {
            foot: corner + direction.left_normal() * tool,
            along: direction,
            is_line: true,
        }
    }
}

/// Returns the joint of two offset curves; see [`corner::between`].
pub(super) fn between(before: &Curve, after: &Curve, corner: Vec2, tool: f64) -> (Joint, bool) {
    let (last, next) = (End::from_last(before), End::from_next(after));
    let turn = last.along.angle_to(next.along);
    if tool.abs() < LENGTH_MIN || turn.abs() < TANGENT {
        return corner::between(before, after, corner, tool);
    }
    if turn * tool < 0.0 {
        return (outside(last, next, corner, tool), true);
    }
    if is_reversal(turn) {
        let joint = Joint {
            start: next.foot,
            ..Joint::at(last.foot, turn)
        };
        return (joint, true);
    }
    corner::between(before, after, corner, tool)
}

/// Returns the joint of a straight lead-in in this direction and the first compensated curve.
pub(super) fn leading_in(
    direction: Vec2,
    after: &Curve,
    corner: Vec2,
    tool: f64,
    start: CompensationStart,
) -> Joint {
    let (lead, next) = (End::from_lead(direction, corner, tool), End::from_next(after));
    let turn = lead.along.angle_to(next.along);
    if is_straight(turn, tool, start) {
        return Joint::at(next.foot, turn);
    }
    outside(lead, next, corner, tool)
}

/// Returns the joint of the last compensated curve and a straight lead-out in this direction.
pub(super) fn leading_out(
    before: &Curve,
    direction: Vec2,
    corner: Vec2,
    tool: f64,
    start: CompensationStart,
) -> Joint {
    let (last, lead) = (End::from_last(before), End::from_lead(direction, corner, tool));
    let turn = last.along.angle_to(lead.along);
    if is_straight(turn, tool, start) {
        return Joint::at(last.foot, turn);
    }
    outside(last, lead, corner, tool)
}

/// Returns the joint with an arc about an outside corner (G39); `None` for an inside corner.
pub(super) fn round(last: &Curve, next: &Curve, corner: Vec2, tool: f64) -> Option<Joint> {
    let turn = last.end_direction().angle_to(next.start_direction());
    let is_outside = turn * tool < 0.0 && turn.abs() >= TANGENT && tool.abs() >= LENGTH_MIN;
    is_outside.then(|| Joint::round(corner, last.to(), next.from(), tool, turn))
}

fn is_straight(turn: f64, tool: f64, start: CompensationStart) -> bool {
    let inside = turn * tool >= 0.0 || turn.abs() < TANGENT || tool.abs() < LENGTH_MIN;
    inside || start == CompensationStart::A || is_reversal(turn)
}

fn is_reversal(turn: f64) -> bool {
    PI - turn.abs() <= REVERSAL
}

fn outside(last: End, next: End, corner: Vec2, tool: f64) -> Joint {
    let (turn, cos) = (last.along.angle_to(next.along), last.along.dot(next.along));
    let (meet, next_point) = if cos < RIGHT_ANGLE {
        let radius = tool.abs();
        (last.foot + last.along * radius, next.foot - next.along * radius)
    } else {
        let meet = corner + (last.along.left_normal() + next.along.left_normal()) * (tool / (1.0 + cos));
        (meet, meet)
    };
    let start = if next.is_line { next_point } else { next.foot };
    Joint {
        end: if last.is_line { meet } else { last.foot },
        meet,
        arc: None,
        via: (!next.is_line && next_point != meet).then_some(next_point),
        start,
        turn,
    }
}
