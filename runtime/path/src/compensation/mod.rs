//! G41 and G42: converts programmed segments to segments of the tool centre (M1g).
//!
//! Between lead-in and lead-out, the compensator holds back the last [`LOOK_AHEAD_MAX`] blocks that move in
//! the plane. An overcut is thus found before the first motion of the first block that it concerns. All
//! geometry is in the plane of the compensation; the other axes move linearly with their block, and rest on
//! extra pieces in the plane.
//!
//! Decisions where the manual is silent:
//! - The radius is in mm of the machine: the offset is applied after all transforms (D20). A mirror of one
//!   axis of the plane, or a negative scale, puts the tool on the other side in machine coordinates.
//! - An added arc belongs to the block that follows the arc, with the line, feedrate and stop of that block.
//!   A straight extension belongs to the block that it extends. An exact stop between two blocks is made
//!   where their extensions meet, before an added arc.
//! - A block that moves no axis of the plane is held back until the next block that moves in the plane. It
//!   then moves at the joint of the blocks before and after it. This also applies after G40. Blocks before
//!   and after a move along another axis are not measured against each other: they cut at different heights.
//! - The straight lead-in and lead-out are not measured: in the manual's own examples, they come closer to
//!   the contour than the radius. Arcs added to them are measured.
//! - If the radii of an arc differ by at most the arc radius tolerance, each end of the arc is treated as
//!   part of a circle. A spiral is rejected, since it has no offset curve.
//! - Blocks that the prevention of overcuts leaves out lose their feedrate and stops; the next block makes
//!   the moves of their other axes.

mod builder;
mod corner;
mod curve;
mod distance;
mod interference;
mod piece;
mod prevention;
mod straight_corner;

use std::collections::VecDeque;

use tandem_model::alarm::{
    COMPENSATION_ARC_SMALL, COMPENSATION_CORNER, COMPENSATION_LEAD_SHORT, COMPENSATION_LOOK_AHEAD,
    COMPENSATION_REFUSED, COMPENSATION_SPIRAL, OVERCUT,
};
use tandem_model::flow::{Path, SegmentMotion};
use tandem_model::plane::Plane;
use tandem_model::settings::{CompensationRules, CompensationStart, CoordinateSystemSettings, Overcut};
use tandem_model::{Alarm, AxisVector};

use self::builder::Builder;
use self::corner::Joint;
use self::curve::{Curve, Vec2};
pub(crate) use self::piece::Leg;
use self::piece::{Piece, Role};
use crate::length::LENGTH_MIN;

/// Maximum number of blocks held back for the overcut check, and of blocks in a row without a move in the
/// plane. An overcut between blocks farther apart is not found; more blocks in a row without a move in the
/// plane are an alarm.
pub const LOOK_AHEAD_MAX: usize = 64;

/// Largest angle between the direction given at a rounded corner and the direction of the next motion,
/// radians: a hundredth of a degree.
const DIRECTION_TOLERANCE: f64 = 1.75e-4;

/// Direction in which the motion continues after a rounded corner.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Rounding {
    /// The motion may continue in any direction.
    Free,
    /// The motion must continue in this direction.
    Towards(AxisVector),
}

/// The active cutter compensation: its plane and the tool radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CompensationSide {
    pub plane: Plane,
    /// Tool radius, mm; negative if the tool is on the right of the path in machine coordinates.
    pub tool: f64,
}

/// Pieces in a row of which at least one must change or be left out.
#[derive(Debug, Clone)]
struct Conflict {
    /// Number of the first of the pieces, which must not be output before the conflict is solved.
    first: u64,
    /// Number of the last of the pieces, as far as they are known.
    last: u64,
    alarm: Alarm,
}

/// Converts segments of blocks with G41 and G42, up to the lead-out, to segments of the tool centre.
#[derive(Debug, Clone)]
pub(crate) struct Compensator {
    overcut: Overcut,
    rules: CompensationRules,
    start: CompensationStart,
    spiral_min_mm: f64,
    /// The active compensation, from the lead-in to the lead-out.
    pub side: Option<CompensationSide>,
    queue: VecDeque<Piece>,
    builder: Builder,
    /// Number of pieces since the lead-in.
    count: u64,
    /// True if the machine must stop before the next piece.
    stop_next: bool,
    /// Rounding of the next corner; `None` for a corner that is not rounded.
    round_next: Option<Rounding>,
    conflict: Option<Conflict>,
}

impl Compensator {
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        Self {
            overcut: settings.motion.overcut,
            rules: settings.path.compensation,
            start: settings.nc.compensation_start,
            spiral_min_mm: settings.motion.arc_radius_tolerance_mm,
            side: None,
            queue: VecDeque::new(),
            builder: Builder::new(settings.motion.compensation_feed, settings.max_feedrate_mm_min),
            count: 0,
            stop_next: false,
            round_next: None,
            conflict: None,
        }
    }

    /// Rounds the next corner, if it is an outside corner. The motion after it must have the direction in
    /// `rounding`.
    pub fn round_next(&mut self, rounding: Rounding) {
        self.round_next = Some(rounding);
    }

    /// Returns true from the lead-in to the lead-out, while segments are compensated.
    pub fn is_on(&self) -> bool {
        self.side.is_some()
    }

    /// Returns the number of segments of the blocks held back; blocks left out to prevent an overcut reduce
    /// it later.
    pub fn pending(&self) -> usize {
        let last = self.queue.len().saturating_sub(1);
        let of = |(i, piece): (usize, &Piece)| {
            let own = match &piece.way {
                Some(way) => way.parts().count(),
                None if i == last => 1 + usize::from(piece.joint.meet != piece.joint.start),
                None => 0,
            };
            own + piece.stills.len()
        };
        self.queue.iter().enumerate().map(of).sum()
    }

    /// Requests a stop before the next segment that the compensator receives.
    pub fn stop(&mut self) {
        self.stop_next = true;
    }

    /// Drops all blocks held back, and ends the compensation.
    pub fn clear(&mut self) {
        self.side = None;
        self.queue.clear();
        self.conflict = None;
        self.stop_next = false;
        self.round_next = None;
    }

    /// Outputs the pieces that do not depend on later blocks, drops all other pieces, and ends the
    /// compensation.
    pub fn abandon(&mut self, out: &mut Vec<Leg>) {
        let end = self.conflict.as_ref().map_or(u64::MAX, |conflict| conflict.first);
        while let Some(piece) = self.queue.pop_front() {
            let certain = piece.id < end && (piece.way.is_some() || piece.dropped);
            if !certain || self.builder.build(&piece, out).is_err() {
                break;
            }
        }
        self.clear();
    }

    /// Processes a segment of a block; `side` is the active or requested compensation. If `wanted` is `None`,
    /// the segment leads out.
    ///
    /// # Errors
    /// Returns the alarms of `PathStage::push`. The pieces before the block that the alarm names have been output.
    pub fn compensate(
        &mut self,
        leg: Leg,
        side: CompensationSide,
        wanted: Option<CompensationSide>,
        out: &mut Vec<Leg>,
    ) -> Result<(), Alarm> {
        let taken = self.compensate_leg(leg, side, wanted, out);
        if taken.is_err() {
            self.abandon(out);
        }
        taken
    }

    fn compensate_leg(
        &mut self,
        mut leg: Leg,
        side: CompensationSide,
        wanted: Option<CompensationSide>,
        out: &mut Vec<Leg>,
    ) -> Result<(), Alarm> {
        if wanted.is_some_and(|wanted| wanted != side) {
            return refused("The side in effect, the plane or the radius of the tool changes");
        }
        let is_rapid = matches!(leg.segment.motion, SegmentMotion::Rapid { .. });
        if self.rules == CompensationRules::Checked && wanted.is_some() && is_rapid {
            return refused("A rapid moves during cutter compensation");
        }
        leg.stop_before |= std::mem::take(&mut self.stop_next);
        let way = curve_in_plane(&leg.segment.motion, side.plane)?;
        match (way, self.is_on(), wanted) {
            (None, false, _) => out.push(leg),
            (None, true, _) => self.keep_still(leg)?,
            (Some(way), false, _) => self.lead_in(leg, way, side)?,
            (Some(way), true, Some(_)) => self.contour(leg, way, side)?,
            (Some(way), true, None) => return self.lead_out(leg, way, side, out),
        }
        while self.queue.len() > LOOK_AHEAD_MAX {
            if let Some(conflict) = &self.conflict {
                return Err(conflict.alarm.clone());
            }
            if let Some(piece) = self.queue.front() {
                self.builder.build(piece, out)?;
            }
            self.queue.drain(..1);
        }
        Ok(())
    }

    fn keep_still(&mut self, leg: Leg) -> Result<(), Alarm> {
        let Some(last) = self.queue.back_mut() else {
            return Ok(());
        };
        if last.stills.len() >= LOOK_AHEAD_MAX {
            let text =
                format!("{LOOK_AHEAD_MAX} blocks in a row have not moved in the plane of the compensation");
            return Err(Alarm::new(&COMPENSATION_LOOK_AHEAD, text));
        }
        last.stills.push(leg);
        Ok(())
    }

    fn lead_in(&mut self, leg: Leg, way: Curve, side: CompensationSide) -> Result<(), Alarm> {
        let lead = straight_lead(way, side, "lead-in", self.rules)?;
        match &leg.segment.motion {
            SegmentMotion::Feed { path, .. } => self.builder.start_contour(side.plane, path.start()),
            SegmentMotion::Rapid { from, .. } => self.builder.start_contour(side.plane, *from),
            SegmentMotion::Skip { .. } | SegmentMotion::Tap { .. } | SegmentMotion::Dwell { .. } => {}
        }
        (self.side, self.count) = (Some(side), 0);
        let joint = Joint::at(lead.from(), 0.0);
        self.append(leg, lead, lead, joint, Role::LeadIn);
        Ok(())
    }

    fn contour(&mut self, leg: Leg, wall: Curve, side: CompensationSide) -> Result<(), Alarm> {
        let offset = self.offset(&wall, side.tool)?;
        let Some(last) = self.queue.back() else {
            return Ok(());
        };
        let corner = last.wall.to();
        let (joint, solved) = match last.role {
            Role::LeadIn | Role::LeadOut => {
                let direction = last.wall.end_direction();
                let joint = match self.rules {
                    CompensationRules::Checked => corner::leading_in(direction, &offset, corner, side.tool),
                    CompensationRules::Unchecked => {
                        straight_corner::leading_in(direction, &offset, corner, side.tool, self.start)
                    }
                };
                (joint, true)
            }
            Role::Contour => match self.rules {
                CompensationRules::Checked => corner::between(&last.offset, &offset, corner, side.tool),
                CompensationRules::Unchecked => {
                    straight_corner::between(&last.offset, &offset, corner, side.tool)
                }
            },
        };
        let (joint, solved) = match self.rounded(&offset, corner, side)? {
            Some(joint) => (joint, true),
            None => (joint, solved),
        };
        let origin = leg.segment.origin;
        self.append(leg, wall, offset, joint, Role::Contour);
        let unsolved = (!solved).then(|| {
            let text = format!(
                "With a tool radius of {:.6} mm, the compensated path of this block does not meet that of the block before",
                side.tool.abs()
            );
            Alarm::new(&COMPENSATION_CORNER, text).at(origin)
        });
        self.check_solved_piece(unsolved, side.tool.abs())
    }

    /// Returns the joint with an arc about a corner that must be rounded. Returns `None` if the corner need
    /// not be rounded, or is an inside corner.
    fn rounded(
        &mut self,
        next: &Curve,
        corner: Vec2,
        side: CompensationSide,
    ) -> Result<Option<Joint>, Alarm> {
        let Some(wanted) = self.round_next.take() else {
            return Ok(None);
        };
        let Some(last) = self.queue.back().filter(|last| last.role == Role::Contour) else {
            return Ok(None);
        };
        let along = next.start_direction();
        let wanted = match wanted {
            Rounding::Free => None,
            Rounding::Towards(way) => Curve::line(Vec2(0.0, 0.0), Vec2::project(way, side.plane)),
        };
        let off = wanted.map_or(0.0, |way| way.start_direction().angle_to(along).abs());
        if off > DIRECTION_TOLERANCE {
            return refused("The motion after a rounded corner does not have the direction that G39 gives");
        }
        Ok(straight_corner::round(&last.offset, next, corner, side.tool))
    }

    fn lead_out(
        &mut self,
        leg: Leg,
        way: Curve,
        side: CompensationSide,
        out: &mut Vec<Leg>,
    ) -> Result<(), Alarm> {
        let lead = straight_lead(way, side, "lead-out", self.rules)?;
        let Some(last) = self.queue.back().filter(|last| last.role == Role::Contour) else {
            return refused("No block between the lead-in and the lead-out moves in the plane");
        };
        let (direction, corner) = (lead.start_direction(), lead.from());
        let joint = match self.rules {
            CompensationRules::Checked => corner::leading_out(&last.offset, direction, corner, side.tool),
            CompensationRules::Unchecked => {
                straight_corner::leading_out(&last.offset, direction, corner, side.tool, self.start)
            }
        };
        let radius = side.tool.abs();
        let overcut = joint
            .arc
            .filter(|_| self.rules == CompensationRules::Checked)
            .and_then(|arc| interference::with_last_arc(&self.queue, arc, radius));
        self.append(leg, lead, lead, joint, Role::LeadOut);
        self.check_solved_piece(None, radius)?;
        if let Some(overcut) = overcut {
            self.cut_by_last_arc(overcut, radius);
        }
        if let Some(conflict) = &self.conflict {
            return Err(conflict.alarm.clone());
        }
        let end = Joint::at(lead.to(), 0.0);
        if let Some(last) = self.queue.back_mut() {
            last.way = last.up_to(&end);
        }
        for piece in &self.queue {
            self.builder.build(piece, out)?;
        }
        self.clear();
        Ok(())
    }

    /// Records the overcut of the arc before the lead-out, unless another conflict is already recorded.
    fn cut_by_last_arc(&mut self, overcut: interference::Overcut, radius: f64) {
        let (Some(earlier), Some(lead)) = (self.queue.get(overcut.earlier), self.queue.back()) else {
            return;
        };
        if self.conflict.is_none() {
            self.conflict = Some(Conflict {
                first: earlier.id,
                last: lead.id,
                alarm: too_close(earlier, lead, overcut.distance, radius),
            });
        }
    }

    /// Returns the offset curve of a block: the path of the tool's centre.
    fn offset(&self, wall: &Curve, tool: f64) -> Result<Curve, Alarm> {
        if let Curve::Arc(arc) = wall {
            let [start, end] = arc.radii;
            if (end - start).abs() > self.spiral_min_mm {
                let text = format!("The radius is {start:.6} mm at the start, {end:.6} mm at the end");
                return Err(Alarm::new(&COMPENSATION_SPIRAL, text));
            }
        }
        // the manual's error is "an offset value that is larger than the radius" (manual dgshape, G40 to G42,
        // restriction 6): a tool as large as the arc is allowed
        let as_large = self.rules == CompensationRules::Unchecked;
        wall.offset(tool, as_large).ok_or_else(|| {
            let radius = match wall {
                Curve::Arc(arc) => arc.radii[0].min(arc.radii[1]),
                Curve::Line(_) => 0.0,
            };
            let text = format!(
                "The arc's radius is {radius:.6} mm on the inside, and the tool's radius is {:.6} mm",
                tool.abs()
            );
            Alarm::new(&COMPENSATION_ARC_SMALL, text)
        })
    }

    /// Appends a piece. Its joint determines the end of the piece before it.
    fn append(&mut self, leg: Leg, wall: Curve, offset: Curve, joint: Joint, role: Role) {
        let mut before = 0.0;
        if let Some(last) = self.queue.back_mut() {
            last.way = last.up_to(&joint);
            before = last.heading;
        }
        let start = before + joint.turn;
        let heading = start + wall.turning();
        let on_arc = if joint.arc.is_some() { before } else { start };
        self.queue.push_back(Piece {
            leg,
            role,
            id: self.count,
            wall,
            wall_bounds: curve::Bounds::from_curve(&wall),
            offset,
            joint,
            heading,
            directions: [start.min(heading).min(on_arc), start.max(heading).max(on_arc)],
            way: None,
            may_go_back: self.rules == CompensationRules::Unchecked,
            dropped: false,
            stills: Vec::new(),
        });
        self.count += 1;
    }

    /// Checks the piece before the last piece, whose end is now known, and tries to solve a conflict.
    fn check_solved_piece(&mut self, unsolved: Option<Alarm>, radius: f64) -> Result<(), Alarm> {
        let Some(place) = self.queue.len().checked_sub(2) else {
            return Ok(());
        };
        let Some(piece) = self.queue.get(place).filter(|piece| piece.role == Role::Contour) else {
            return Ok(());
        };
        let id = piece.id;
        let found = if let Some(alarm) = unsolved {
            Some((id, id + 1, alarm))
        } else if piece.way.is_none() {
            Some((id.saturating_sub(1), id + 1, nothing_left(piece, radius)))
        } else if self.conflict.is_none() && self.rules == CompensationRules::Checked {
            interference::with_earlier(&self.queue, place, radius).and_then(|overcut| {
                let earlier = self.queue.get(overcut.earlier)?;
                Some((
                    earlier.id,
                    id,
                    too_close(earlier, piece, overcut.distance, radius),
                ))
            })
        } else {
            None
        };
        if let Some((first, last, alarm)) = found {
            self.conflict = Some(match self.conflict.take() {
                Some(known) => Conflict {
                    first: known.first.min(first),
                    last: known.last.max(last),
                    ..known
                },
                None => Conflict { first, last, alarm },
            });
        }
        let Some(conflict) = &self.conflict else {
            return Ok(());
        };
        match self.overcut {
            Overcut::Detect => Err(conflict.alarm.clone()),
            Overcut::Prevent => {
                let (first, last) = (conflict.first, conflict.last);
                if id >= last && prevention::prevent(&mut self.queue, place, first, radius) {
                    self.conflict = None;
                }
                Ok(())
            }
        }
    }
}

/// Returns the curve of a segment in the plane; `None` if the segment does not move in the plane.
fn curve_in_plane(motion: &SegmentMotion, plane: Plane) -> Result<Option<Curve>, Alarm> {
    match motion {
        SegmentMotion::Feed { path, .. } => {
            if let Path::Arc(arc) = path
                && arc.plane() != plane
            {
                return Err(Alarm::new(
                    &COMPENSATION_REFUSED,
                    format!("The arc is in {}, the compensation in {plane}", arc.plane()),
                ));
            }
            Ok(Curve::project(path, plane))
        }
        SegmentMotion::Rapid { from, to }
        | SegmentMotion::Skip { from, to }
        | SegmentMotion::Tap { from, to, .. } => Ok(Curve::line(
            Vec2::project(*from, plane),
            Vec2::project(*to, plane),
        )),
        SegmentMotion::Dwell { .. } => Ok(None),
    }
}

/// Returns a lead-in or lead-out: straight and, if overcuts are checked, not shorter than the tool's radius.
fn straight_lead(
    way: Curve,
    side: CompensationSide,
    what: &str,
    rules: CompensationRules,
) -> Result<Curve, Alarm> {
    let (length, radius) = (way.length(), side.tool.abs());
    match way {
        Curve::Arc(_) => refused(&format!("The {what} is an arc")),
        Curve::Line(_) if rules == CompensationRules::Checked && length < radius - LENGTH_MIN => {
            Err(Alarm::new(
                &COMPENSATION_LEAD_SHORT,
                format!(
                    "The {what} is {length:.6} mm long in the plane, the tool's radius is {radius:.6} mm"
                ),
            ))
        }
        Curve::Line(_) => Ok(way),
    }
}

fn refused<T>(text: &str) -> Result<T, Alarm> {
    Err(Alarm::new(&COMPENSATION_REFUSED, text))
}

fn nothing_left(piece: &Piece, radius: f64) -> Alarm {
    let text = format!(
        "With a tool radius of {radius:.6} mm, no part of the block's {:.6} mm is left between its neighbours",
        piece.wall.length()
    );
    Alarm::new(&OVERCUT, text).at(piece.leg.segment.origin)
}

fn too_close(earlier: &Piece, later: &Piece, distance: f64, radius: f64) -> Alarm {
    let other = later.leg.segment.origin;
    let text = format!(
        "This block and the one in program {} line {}: the tool's centre comes as close as {distance:.6} mm, \
         and the tool's radius is {radius:.6} mm",
        other.program, other.line
    );
    Alarm::new(&OVERCUT, text).at(earlier.leg.segment.origin)
}
