//! Blocks in, segments out.

use tandem_model::alarm::{FEEDRATE_MISSING, MOTION_NOT_SUPPORTED, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{
    Action, AxisWords, Block, Feed, MultiBlock, Path, PathControl, Segment, SegmentEnd, SegmentMotion,
    Transform,
};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, AxisSet, AxisVector, MachinePosition, Origin, WorkPosition};

use crate::transform::{self, finite};

/// Distances below this are rounding, not motion: mm or degrees. It is also the tolerance of the soft limits.
///
/// Reason: sums of incremental words and work offsets err by about 1e-12 of the position; a millionth of a
/// micrometre is below what any motor resolves. Without it a block of rotary axes whose X is off by a rounding
/// error would count F over that error.
pub const LENGTH_MIN: f64 = 1e-9;

/// The path stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct PathStage {
    pub(crate) axes: AxisSet,
    pub(crate) soft_limits: [Option<[f64; 2]>; tandem_model::AXES_MAX],
    /// First to fourth, machine positions.
    reference_points: [AxisVector; 4],
    pub(crate) arc_radius_tolerance_mm: f64,
    default_feedrate_mm_min: f64,
    rotary_feedrate_deg_min: f64,
    pub(crate) transform: Transform,
    pub(crate) at: AxisVector,
    /// Change of the tool length that no motion block has made good yet (D22), mm.
    pub(crate) tool_shift: f64,
    /// The last segment, while it is open whether it ends in a stop.
    held_back: Option<Segment>,
}

impl PathStage {
    /// A stage at a machine position, with the identity transform.
    pub fn new(settings: &CoordinateSystemSettings, at: MachinePosition) -> Self {
        Self {
            axes: settings.axes(),
            soft_limits: std::array::from_fn(|i| {
                settings.motors[i].as_ref().and_then(|motor| motor.soft_limits)
            }),
            reference_points: std::array::from_fn(|point| {
                AxisVector(std::array::from_fn(|i| {
                    settings.motors[i]
                        .as_ref()
                        .map_or(0.0, |motor| motor.reference_points[point])
                }))
            }),
            arc_radius_tolerance_mm: settings.motion.arc_radius_tolerance_mm,
            default_feedrate_mm_min: settings.default_feedrate_mm_min,
            rotary_feedrate_deg_min: settings.rotary_feedrate_deg_min,
            transform: Transform::default(),
            at: at.0,
            tool_shift: 0.0,
            held_back: None,
        }
    }

    /// Takes a block; what is certain of the way comes out. The last block of a chain is held back until the next
    /// one tells whether it stops there: see [`PathStage::flush`].
    ///
    /// # Errors
    /// An alarm at the block's origin when it cannot run; the stage is as before the block then, and nothing was
    /// put out for it: `VALUE_NOT_FINITE`, `VALUE_OUT_OF_RANGE` (negative dwell, scale factor 0, reference point not
    /// 1 to 4), `AXIS_MISSING`, `SOFT_LIMIT`, `FEEDRATE_MISSING`, `OFFSET_IN_FORCE` (D23), `ARC_IMPOSSIBLE`,
    /// `ARC_DISTORTED` (D21), `MOTION_NOT_SUPPORTED`.
    pub fn push(&mut self, block: &Block, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        self.take(block, out).map_err(|alarm| alarm.at(block.origin))
    }

    /// Puts out what is held back, ending in an exact stop: an output, a stop or the end follows.
    ///
    /// # Errors
    /// None so far: each alarm is raised by the block's own [`PathStage::push`].
    pub fn flush(&mut self, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        self.release(SegmentEnd::ExactStop, out);
        Ok(())
    }

    /// After a stop or reset: this position, the identity transform, nothing held back.
    pub fn restart(&mut self, at: MachinePosition) {
        self.at = at.0;
        self.tool_shift = 0.0;
        self.transform = Transform::default();
        self.held_back = None;
    }

    /// The transform in force for the next block.
    pub fn transform(&self) -> &Transform {
        &self.transform
    }

    /// True while a segment is held back: the next segment put out is that one.
    pub fn holds_back(&self) -> bool {
        self.held_back.is_some()
    }

    /// Where the last block ends; after G31 without a skip input, its target.
    pub fn position(&self) -> MachinePosition {
        MachinePosition(self.at)
    }

    fn take(&mut self, block: &Block, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        match &block.action {
            Action::None => self.release(SegmentEnd::ExactStop, out),
            Action::Transform(transform) => {
                transform::check(transform)?;
                self.release(SegmentEnd::ExactStop, out);
                self.tool_shift += transform.tool_length - self.transform.tool_length;
                self.transform = **transform;
            }
            Action::Dwell { dwell_s } => self.dwell(block.origin, *dwell_s, out)?,
            Action::Rapid(words) => self.rapid(block, words, out)?,
            Action::Linear(words) => self.linear(block, words, out)?,
            Action::Reference { middle, point } => self.reference(block, middle, *point, out)?,
            Action::Arc(arc) => {
                let path = self.arc(block, arc)?;
                self.feed(block, &arc.target, path, out)?;
            }
            Action::Skip(words) => self.skip(block, words, out)?,
            Action::Tap(_) => {
                return Err(Alarm::new(&MOTION_NOT_SUPPORTED, "The block cannot be moved"));
            }
        }
        Ok(())
    }

    fn dwell(&mut self, origin: Origin, dwell_s: f64, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        if !dwell_s.is_finite() {
            return Err(Alarm::new(
                &VALUE_NOT_FINITE,
                format!("The dwell time is {dwell_s}"),
            ));
        }
        if dwell_s < 0.0 {
            let text = format!("The dwell time {dwell_s} s is below 0");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
        self.release(SegmentEnd::ExactStop, out);
        if dwell_s > 0.0 {
            let motion = SegmentMotion::Dwell { at: self.at, dwell_s };
            out.push(Segment {
                origin,
                motion,
                end: SegmentEnd::ExactStop,
            });
        }
        Ok(())
    }

    fn rapid(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        self.within_all_soft_limits(self.at, to)?;
        // G00 is never blended (motion-semantics 1c), so it waits for no other block.
        self.release(SegmentEnd::ExactStop, out);
        self.rapid_to(block.origin, to, out);
        self.arrived(block, words);
        Ok(())
    }

    fn skip(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        self.within_all_soft_limits(self.at, to)?;
        self.release(SegmentEnd::ExactStop, out);
        if moves(self.at, to) {
            let motion = SegmentMotion::Skip { from: self.at, to };
            out.push(Segment {
                origin: block.origin,
                motion,
                end: SegmentEnd::ExactStop,
            });
            self.at = to;
        }
        self.arrived(block, words);
        Ok(())
    }

    /// After G31: the machine rests here, perhaps short of the target. The transform stays.
    pub fn skipped_to(&mut self, at: MachinePosition) {
        self.at = at.0;
    }

    fn rapid_to(&mut self, origin: Origin, to: AxisVector, out: &mut Vec<Segment>) {
        if moves(self.at, to) {
            let motion = SegmentMotion::Rapid { from: self.at, to };
            out.push(Segment {
                origin,
                motion,
                end: SegmentEnd::ExactStop,
            });
            self.at = to;
        }
    }

    /// G28, G30: G00 to the middle point, then to the reference point, named axes only; none named: all, and straight
    /// to the reference point (D24).
    fn reference(
        &mut self,
        block: &Block,
        words: &AxisWords,
        point: u8,
        out: &mut Vec<Segment>,
    ) -> Result<(), Alarm> {
        self.without_offsets(block, "G28 and G30")?;
        let reference = usize::from(point)
            .checked_sub(1)
            .and_then(|i| self.reference_points.get(i).copied());
        let Some(reference) = reference else {
            let text = format!("The reference point {point} is not 1 to 4");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        };
        let (middle, named) = if words.named.is_empty() {
            (self.at, self.axes)
        } else {
            (self.target(block, words)?, words.named)
        };
        let mut to = middle;
        for axis in named.iter() {
            to[axis] = reference[axis];
        }
        finite(to, "reference point")?;
        self.within_all_soft_limits(self.at, middle)?;
        self.within_all_soft_limits(middle, to)?;
        self.release(SegmentEnd::ExactStop, out);
        self.rapid_to(block.origin, middle, out);
        self.rapid_to(block.origin, to, out);
        if words.named.is_empty() {
            self.tool_shift = 0.0;
        } else {
            self.arrived(block, words);
        }
        Ok(())
    }

    fn linear(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        self.within_all_soft_limits(self.at, to)?;
        let path = self.line(to)?;
        self.feed(block, words, path, out)
    }

    /// Takes a cutting block along this path; `None`: it does not move.
    fn feed(
        &mut self,
        block: &Block,
        words: &AxisWords,
        path: Option<Path>,
        out: &mut Vec<Segment>,
    ) -> Result<(), Alarm> {
        let segment = path.map(|path| self.segment(block, path)).transpose()?;
        let each_block_stops = block.path_control == PathControl::ExactStop;
        // Two blocks blend only when both are in G64.
        let no_movement = segment.is_none() && words.named.is_empty();
        let stop_before = each_block_stops || block.exact_stop_before || no_movement;
        if let Some((segment, to)) = segment {
            let end = if stop_before {
                SegmentEnd::ExactStop
            } else {
                SegmentEnd::Continuous
            };
            self.release(end, out);
            self.held_back = Some(segment);
            self.at = to;
        } else if stop_before {
            self.release(SegmentEnd::ExactStop, out);
        }
        self.arrived(block, words);
        if each_block_stops || block.exact_stop_after {
            self.release(SegmentEnd::ExactStop, out);
        }
        Ok(())
    }

    /// The straight line to a machine position; `None` when that is no move.
    pub(crate) fn line(&self, to: AxisVector) -> Result<Option<Path>, Alarm> {
        if !moves(self.at, to) {
            return Ok(None);
        }
        let distance = to.minus(self.at);
        let orthogonal = distance.orthogonal_length();
        let length = if orthogonal < LENGTH_MIN {
            distance.rotary_length()
        } else {
            orthogonal
        };
        if !length.is_finite() {
            let text = format!("The length of the block is {length}");
            return Err(Alarm::new(&VALUE_NOT_FINITE, text));
        }
        Ok(Some(Path::Line {
            from: self.at,
            to,
            length,
        }))
    }

    /// The segment of a path with its feedrate, and where it ends.
    fn segment(&self, block: &Block, path: Path) -> Result<(Segment, AxisVector), Alarm> {
        if block.multi_block == MultiBlock::On {
            return Err(Alarm::new(&MOTION_NOT_SUPPORTED, "G500 is on"));
        }
        let Feed {
            feedrate_mm_min: programmed,
            ta_ms,
            td_ms,
            ts_ms,
        } = block.feed;
        let to = path.end();
        let rotary_only =
            to.minus(path.start()).orthogonal_length() < LENGTH_MIN && matches!(path, Path::Line { .. });
        let feedrate = if rotary_only && self.rotary_feedrate_deg_min > 0.0 {
            self.rotary_feedrate_deg_min
        } else if programmed == 0.0 {
            self.default_feedrate_mm_min
        } else {
            programmed
        };
        for (name, value) in [
            ("feedrate", feedrate),
            ("ta", ta_ms),
            ("td", td_ms),
            ("ts", ts_ms),
        ] {
            if !value.is_finite() {
                return Err(Alarm::new(&VALUE_NOT_FINITE, format!("The {name} is {value}")));
            }
        }
        if feedrate <= 0.0 {
            return Err(Alarm::new(
                &FEEDRATE_MISSING,
                format!("The feedrate is {feedrate}"),
            ));
        }
        let feed = Feed {
            feedrate_mm_min: feedrate,
            ..block.feed
        };
        let segment = Segment {
            origin: block.origin,
            motion: SegmentMotion::Feed { path, feed },
            end: SegmentEnd::Continuous,
        };
        Ok((segment, to))
    }

    fn release(&mut self, end: SegmentEnd, out: &mut Vec<Segment>) {
        if let Some(segment) = self.held_back.take() {
            out.push(Segment { end, ..segment });
        }
    }
}

/// The work position of a machine position: the transform undone (D20), tool length included.
pub fn work_position(transform: &Transform, machine: MachinePosition) -> WorkPosition {
    WorkPosition(transform::inverse(transform, machine.0))
}

fn moves(from: AxisVector, to: AxisVector) -> bool {
    to.minus(from)
        .0
        .iter()
        .any(|distance| distance.abs() >= LENGTH_MIN)
}
