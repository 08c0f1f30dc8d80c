//! A block within the look-ahead of the compensation.

use tandem_model::flow::{Segment, SegmentMotion};

use super::corner::Joint;
use super::curve::{Bounds, Curve};

/// A segment, and whether the machine is to rest before it.
#[derive(Debug, Clone)]
pub(crate) struct Leg {
    pub segment: Segment,
    pub stop_before: bool,
    /// True for a block in G61: the machine rests also where an added arc meets it, so that none of them is blended.
    pub is_exact: bool,
}

/// The purpose of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    LeadIn,
    Contour,
    LeadOut,
}

/// The path of the tool centre on a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Way {
    /// From where it meets the block before to the block's own offset curve, by one or two parts, that curve, and from there
    /// to where it meets the next block.
    pub parts: [Option<Curve>; 4],
    pub bounds: Bounds,
}

impl Way {
    /// `None` without any part.
    pub fn of(parts: &[Option<Curve>; 4]) -> Option<Self> {
        let all = parts.iter().flatten().map(Bounds::of);
        let bounds = all.reduce(|all, part| all.with(&part))?;
        Some(Self {
            parts: *parts,
            bounds,
        })
    }

    pub fn parts(&self) -> impl Iterator<Item = &Curve> {
        self.parts.iter().flatten()
    }
}

/// A block that moves in the plane.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub leg: Leg,
    pub role: Role,
    /// Counts pieces since the lead-in.
    pub id: u64,
    /// The programmed curve in the plane.
    pub wall: Curve,
    pub wall_bounds: Bounds,
    /// The same curve moved by the tool's radius.
    pub offset: Curve,
    /// Joint with the piece before.
    pub joint: Joint,
    /// Direction at the end, continuous from that of the lead-in, radians.
    pub heading: f64,
    /// Lowest and highest direction, including an arc added before it.
    pub directions: [f64; 2],
    /// `None` until the next block decides where it ends, and where nothing is left of it.
    pub way: Option<Way>,
    /// Overcuts are not looked for.
    pub may_go_back: bool,
    /// Left out to prevent an overcut.
    pub dropped: bool,
    /// The blocks that move no axis of the plane between this piece and the next one.
    pub stills: Vec<Leg>,
}

impl Piece {
    /// Returns the path when the joint with the next piece is known; `None` when nothing is left.
    pub fn up_to(&self, next: &Joint) -> Option<Way> {
        let joint = &self.joint;
        let curve = match self.role {
            Role::LeadIn | Role::LeadOut => Curve::line(joint.start, next.end),
            Role::Contour => self
                .offset
                .between(joint.start, next.end)
                .or_else(|| self.back(next)),
        }?;
        let second = joint.via.and_then(|via| Curve::line(via, joint.start));
        let head = joint
            .arc
            .or_else(|| Curve::line(joint.meet, joint.via.unwrap_or(joint.start)));
        Way::of(&[head, second, Some(curve), Curve::line(next.end, next.meet)])
    }

    /// Returns the path against the direction of a line that is too short for the tool, if overcuts are not checked.
    fn back(&self, next: &Joint) -> Option<Curve> {
        let is_line = matches!(self.offset, Curve::Line(_));
        (self.may_go_back && is_line).then(|| Curve::line(self.joint.start, next.end))?
    }

    /// True when the tool moves along another axis before the next piece.
    pub fn lifts(&self) -> bool {
        self.stills
            .iter()
            .any(|leg| !matches!(leg.segment.motion, SegmentMotion::Dwell { .. }))
    }
}
