//! Converts pieces to segments of the tool centre: joins the motion in the plane with the motion of the other
//! axes, and adds the feedrate.

use tandem_model::flow::{Path, Segment, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::settings::CompensationFeed;
use tandem_model::{Alarm, ArcPath, AxisVector};

use super::curve::{Curve, Vec2};
use super::piece::{CentrePath, Leg, Piece};
use crate::length::line_between;

/// Length below which an arc is output as a line, mm: an arc path between equal directions would be a full
/// turn.
const ARC_MIN: f64 = 1e-8;

/// Builder of successive segments: each segment begins exactly, to the last bit, at the end of the segment
/// before.
#[derive(Debug, Clone)]
pub(super) struct Builder {
    basis: CompensationFeed,
    max_feedrate_mm_min: f64,
    plane: Plane,
    /// Machine position at the end of the last segment.
    at: AxisVector,
    /// Feedrate of the last block with a feedrate that was built.
    feed: SegmentFeed,
    /// True if the next segment needs a stop before it, which a block without motion has requested.
    stop: bool,
    /// True if the last block that was built is in G61.
    is_exact: bool,
}

impl Builder {
    pub fn new(basis: CompensationFeed, max_feedrate_mm_min: f64) -> Self {
        Self {
            basis,
            max_feedrate_mm_min,
            plane: Plane::Xy,
            at: AxisVector::ZERO,
            feed: SegmentFeed::default(),
            stop: false,
            is_exact: false,
        }
    }

    pub fn start_contour(&mut self, plane: Plane, at: AxisVector) {
        (self.plane, self.at, self.stop) = (plane, at, false);
    }

    /// Outputs the segments of a piece, and of the blocks after it that do not move in the plane.
    ///
    /// # Errors
    /// Returns `VALUE_NOT_FINITE`, at the block, if a length is not finite.
    pub fn build(&mut self, piece: &Piece, out: &mut Vec<Leg>) -> Result<(), Alarm> {
        self.stop |= piece.leg.stop_before;
        self.is_exact = piece.leg.is_exact;
        let segment = &piece.leg.segment;
        if let Some(way) = &piece.way {
            match &segment.motion {
                SegmentMotion::Feed { path, feed } => {
                    self.feed = *feed;
                    self.along(piece, way, path, out)
                }
                SegmentMotion::Rapid { to, .. } => self.rapid(segment, way, *to, out),
                SegmentMotion::Skip { .. } | SegmentMotion::Tap { .. } | SegmentMotion::Dwell { .. } => {
                    Ok(())
                }
            }
            .map_err(|alarm| alarm.at(segment.origin))?;
        }
        piece.stills.iter().try_for_each(|leg| self.still(leg, out))
    }

    fn along(
        &mut self,
        piece: &Piece,
        way: &CentrePath,
        path: &Path,
        out: &mut Vec<Leg>,
    ) -> Result<(), Alarm> {
        let segment = &piece.leg.segment;
        let (start, end) = (path.start(), path.end());
        let [head, second, curve, tail] = &way.parts;
        for head in [head, second].into_iter().flatten() {
            self.cut(segment, head, start, self.feed, out)?;
        }
        if let Some(curve) = curve {
            let feed = self.curve_feed(&piece.wall, curve, end.minus(start));
            self.cut(segment, curve, end, feed, out)?;
        }
        (tail.iter()).try_for_each(|tail| self.cut(segment, tail, end, self.feed, out))
    }

    /// Outputs a rapid. An arc added to the rapid is cut at the last feedrate.
    fn rapid(
        &mut self,
        segment: &Segment,
        way: &CentrePath,
        to: AxisVector,
        out: &mut Vec<Leg>,
    ) -> Result<(), Alarm> {
        let last = way.parts.iter().rposition(Option::is_some);
        for (place, part) in way.parts.iter().enumerate() {
            match part {
                Some(arc @ Curve::Arc(_)) => self.cut(segment, arc, self.at, self.feed, out)?,
                Some(Curve::Line(line)) => {
                    let others = if Some(place) == last { to } else { self.at };
                    let to = line.to.onto_plane(others, self.plane);
                    let motion = SegmentMotion::Rapid { from: self.at, to };
                    self.push_leg(segment, motion, to, out);
                }
                None => {}
            }
        }
        Ok(())
    }

    /// Outputs a cut along a curve; the axes outside the plane move to their values in `others`.
    fn cut(
        &mut self,
        segment: &Segment,
        curve: &Curve,
        others: AxisVector,
        feed: SegmentFeed,
        out: &mut Vec<Leg>,
    ) -> Result<(), Alarm> {
        let to = curve.to().onto_plane(others, self.plane);
        let path = match curve {
            Curve::Arc(arc) if curve.length() >= ARC_MIN => {
                let turn = if arc.sweep > 0.0 {
                    Turn::CounterClockwise
                } else {
                    Turn::Clockwise
                };
                let Vec2(first, second) = arc.centre;
                Path::Arc(ArcPath::new(self.at, to, self.plane, [first, second], turn))
            }
            _ => match line_between(self.at, to)? {
                Some(line) => line,
                None => return Ok(()),
            },
        };
        self.push_leg(segment, SegmentMotion::Feed { path, feed }, to, out);
        Ok(())
    }

    /// Outputs a block that moves no axis of the plane; in the plane, the centre stays where it is.
    fn still(&mut self, leg: &Leg, out: &mut Vec<Leg>) -> Result<(), Alarm> {
        self.stop |= leg.stop_before;
        let (segment, centre) = (&leg.segment, Vec2::project(self.at, self.plane));
        let there = |to: AxisVector| centre.onto_plane(to, self.plane);
        match &segment.motion {
            SegmentMotion::Feed { path, feed } => {
                let to = there(path.end());
                if let Some(path) = line_between(self.at, to).map_err(|alarm| alarm.at(segment.origin))? {
                    let feed = *feed;
                    self.push_leg(segment, SegmentMotion::Feed { path, feed }, to, out);
                }
            }
            SegmentMotion::Rapid { to, .. }
            | SegmentMotion::Skip { to, .. }
            | SegmentMotion::Tap { to, .. } => {
                let to = there(*to);
                self.push_leg(segment, SegmentMotion::Rapid { from: self.at, to }, to, out);
            }
            SegmentMotion::Dwell { dwell_s, .. } => {
                let (at, dwell_s) = (self.at, *dwell_s);
                self.push_leg(segment, SegmentMotion::Dwell { at, dwell_s }, at, out);
            }
        }
        Ok(())
    }

    fn push_leg(&mut self, segment: &Segment, motion: SegmentMotion, to: AxisVector, out: &mut Vec<Leg>) {
        out.push(Leg {
            segment: Segment {
                origin: segment.origin,
                motion,
                end: segment.end,
                multi_block: segment.multi_block,
                serial: segment.serial,
            },
            stop_before: std::mem::take(&mut self.stop) || self.is_exact,
            is_exact: self.is_exact,
        });
        self.at = to;
    }

    /// Returns the feedrate of the centre on an offset curve. If F applies to the edge of the tool, the
    /// centre and the edge need the same time for the same angle: `F |R -+ r|/R` in the plane, with the other
    /// axes included.
    fn curve_feed(&self, wall: &Curve, centre: &Curve, way: AxisVector) -> SegmentFeed {
        let (Curve::Arc(wall), Curve::Arc(centre), CompensationFeed::Edge) = (wall, centre, self.basis)
        else {
            return self.feed;
        };
        let height = way[self.plane.normal()];
        let mean = |radii: [f64; 2]| f64::midpoint(radii[0], radii[1]);
        let rate = |radius: f64| (radius * centre.sweep).hypot(height);
        let programmed = self.feed.feedrate_mm_min;
        let feedrate = programmed * rate(mean(centre.radii)) / rate(mean(wall.radii));
        SegmentFeed {
            feedrate_mm_min: if feedrate.is_finite() && feedrate > 0.0 {
                feedrate.min((self.max_feedrate_mm_min * self.feed.unit_mm).max(programmed))
            } else {
                programmed
            },
            ..self.feed
        }
    }
}
