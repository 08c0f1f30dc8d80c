//! A block in the look-ahead of the compensation.

use tandem_model::flow::{Segment, SegmentMotion};

use super::corner::Joint;
use super::curve::{Bounds, Curve};

/// A segment, and whether the machine must stop before it.
#[derive(Debug, Clone)]
pub(crate) struct Leg {
    pub segment: Segment,
    pub stop_before: bool,
    /// True for a block in G61: the machine also stops at an arc added to the block, so that arc and block do
    /// not blend.
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
pub(super) struct CentrePath {
    /// In order: one or two parts from the joint with the block before to the block's offset curve, this
    /// curve, and a part to the joint with the next block.
    pub parts: [Option<Curve>; 4],
    pub bounds: Bounds,
}

impl CentrePath {
    /// Creates a path from its parts; returns `None` if it has no part.
    pub fn from_parts(parts: &[Option<Curve>; 4]) -> Option<Self> {
        let all = parts.iter().flatten().map(Bounds::from_curve);
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

/// A block that moves in the plane of the compensation.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub leg: Leg,
    pub role: Role,
    /// Number of the piece since the lead-in.
    pub id: u64,
    /// The programmed curve in the plane.
    pub wall: Curve,
    pub wall_bounds: Bounds,
    /// The programmed curve, shifted by the tool's radius.
    pub offset: Curve,
    /// Joint with the piece before.
    pub joint: Joint,
    /// Direction at the end of the piece, continuous from the direction of the lead-in, radians.
    pub heading: f64,
    /// Lowest and highest direction of the piece, including an arc added before it, radians.
    pub directions: [f64; 2],
    /// Path of the tool centre. `None` until the next block determines the end of the path, and if no part of
    /// it is left.
    pub way: Option<CentrePath>,
    /// True if overcuts are not checked: the centre may then move backward on a line that is too short for
    /// the tool.
    pub may_go_back: bool,
    /// True if the piece is left out to prevent an overcut.
    pub dropped: bool,
    /// The blocks that move no axis of the plane between this piece and the next one.
    pub stills: Vec<Leg>,
}

impl Piece {
    /// Returns the path of the tool centre up to the joint with the next piece; `None` if no part of the path
    /// is left.
    pub fn up_to(&self, next: &Joint) -> Option<CentrePath> {
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
        CentrePath::from_parts(&[head, second, Some(curve), Curve::line(next.end, next.meet)])
    }

    /// Returns the path backward on a line that is too short for the tool; `None` for an arc, or if overcuts
    /// are checked.
    fn back(&self, next: &Joint) -> Option<Curve> {
        let is_line = matches!(self.offset, Curve::Line(_));
        (self.may_go_back && is_line).then(|| Curve::line(self.joint.start, next.end))?
    }

    /// Returns true if the tool moves along another axis between this piece and the next piece.
    pub fn lifts(&self) -> bool {
        self.stills
            .iter()
            .any(|leg| !matches!(leg.segment.motion, SegmentMotion::Dwell { .. }))
    }
}
