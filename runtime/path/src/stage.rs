//! Blocks in, segments out.

use tandem_model::alarm::{
    AXIS_MISSING, FEEDRATE_MISSING, MOTION_NOT_SUPPORTED, SOFT_LIMIT, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE,
};
use tandem_model::flow::{
    Action, AxisWords, Block, Distance, Feed, Path, PathControl, Segment, SegmentEnd, SegmentMotion,
    Transform,
};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis, AxisSet, AxisVector, MachinePosition, Origin, WorkPosition};

/// Distances below this are rounding, not motion: mm or degrees. It is also the tolerance of the soft limits.
///
/// Reason: sums of incremental words and work offsets err by about 1e-12 of the position; a millionth of a
/// micrometre is below what any motor resolves. Without it a block of rotary axes whose X is off by a rounding
/// error would count F over that error.
pub const LENGTH_MIN: f64 = 1e-9;

/// The path stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct PathStage {
    axes: AxisSet,
    soft_limits: [Option<[f64; 2]>; tandem_model::AXES_MAX],
    default_feedrate_mm_min: f64,
    rotary_feedrate_deg_min: f64,
    transform: Transform,
    at: AxisVector,
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
            default_feedrate_mm_min: settings.default_feedrate_mm_min,
            rotary_feedrate_deg_min: settings.rotary_feedrate_deg_min,
            transform: Transform::default(),
            at: at.0,
            held_back: None,
        }
    }

    /// Takes a block; what is certain of the way comes out. The last block of a chain is held back until the next
    /// one tells whether it stops there: see [`PathStage::flush`].
    ///
    /// # Errors
    /// An alarm at the block's origin when it cannot run; the stage is as before the block then, and nothing was
    /// put out for it: `VALUE_NOT_FINITE`, `VALUE_OUT_OF_RANGE` (negative dwell), `AXIS_MISSING`, `SOFT_LIMIT`, `FEEDRATE_MISSING`.
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

    /// Where the last block ends.
    pub fn position(&self) -> MachinePosition {
        MachinePosition(self.at)
    }

    fn take(&mut self, block: &Block, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        match &block.action {
            Action::None => self.release(SegmentEnd::ExactStop, out),
            Action::Transform(transform) => {
                finite(transform.work_offset, "work offset")?;
                self.release(SegmentEnd::ExactStop, out);
                self.transform = **transform;
            }
            Action::Dwell { dwell_s } => self.dwell(block.origin, *dwell_s, out)?,
            Action::Rapid(words) => self.rapid(block.origin, words, out)?,
            Action::Linear(words) => self.linear(block, words, out)?,
            Action::Arc(_) | Action::Skip(_) | Action::Reference { .. } | Action::Tap(_) => {
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

    fn rapid(&mut self, origin: Origin, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(words)?;
        // G00 is never blended (motion-semantics 1c), so it waits for no other block.
        self.release(SegmentEnd::ExactStop, out);
        if moves(self.at, to) {
            let motion = SegmentMotion::Rapid { from: self.at, to };
            out.push(Segment {
                origin,
                motion,
                end: SegmentEnd::ExactStop,
            });
            self.at = to;
        }
        Ok(())
    }

    fn linear(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(words)?;
        let segment = if moves(self.at, to) {
            Some(self.line(block, to)?)
        } else {
            None
        };
        let each_block_stops = block.path_control == PathControl::ExactStop;
        // Two blocks blend only when both are in G64.
        let stop_before = each_block_stops || block.exact_stop_before || words.named.is_empty();
        if let Some(segment) = segment {
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
        if each_block_stops || block.exact_stop_after {
            self.release(SegmentEnd::ExactStop, out);
        }
        Ok(())
    }

    fn line(&self, block: &Block, to: AxisVector) -> Result<Segment, Alarm> {
        let Feed {
            feedrate_mm_min: programmed,
            ta_ms,
            td_ms,
            ts_ms,
        } = block.feed;
        let distance = to.minus(self.at);
        let orthogonal = distance.orthogonal_length();
        let rotary_only = orthogonal < LENGTH_MIN;
        let length = if rotary_only {
            distance.rotary_length()
        } else {
            orthogonal
        };
        let feedrate = if rotary_only && self.rotary_feedrate_deg_min > 0.0 {
            self.rotary_feedrate_deg_min
        } else if programmed == 0.0 {
            self.default_feedrate_mm_min
        } else {
            programmed
        };
        for (name, value) in [
            ("length of the block", length),
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
        let path = Path::Line {
            from: self.at,
            to,
            length,
        };
        let feed = Feed {
            feedrate_mm_min: feedrate,
            ..block.feed
        };
        Ok(Segment {
            origin: block.origin,
            motion: SegmentMotion::Feed { path, feed },
            end: SegmentEnd::Continuous,
        })
    }

    /// The machine position that axis words lead to, within what the coordinate system has.
    fn target(&self, words: &AxisWords) -> Result<AxisVector, Alarm> {
        let mut to = self.at;
        for axis in words.named.iter() {
            if !self.axes.contains(axis) {
                let text = format!("The block moves axis {}", axis.letter());
                return Err(Alarm::new(&AXIS_MISSING, text));
            }
            to[axis] = words.values[axis]
                + match words.distance {
                    Distance::Absolute => self.transform.work_offset[axis],
                    Distance::Incremental => self.at[axis],
                };
        }
        finite(to, "target")?;
        Axis::ALL
            .into_iter()
            .filter(|&axis| (to[axis] - self.at[axis]).abs() >= LENGTH_MIN)
            .try_for_each(|axis| self.within_soft_limits(axis, to[axis]))?;
        Ok(to)
    }

    fn within_soft_limits(&self, axis: Axis, value: f64) -> Result<(), Alarm> {
        let Some([lowest, highest]) = self.soft_limits[axis.index()] else {
            return Ok(());
        };
        let (which, limit) = if value < lowest - LENGTH_MIN {
            ("lower", lowest)
        } else if value > highest + LENGTH_MIN {
            ("upper", highest)
        } else {
            return Ok(());
        };
        let letter = axis.letter();
        let text =
            format!("Axis {letter} would go to {value:.6} (machine), beyond its {which} limit {limit:.6}");
        Err(Alarm::new(&SOFT_LIMIT, text))
    }

    fn release(&mut self, end: SegmentEnd, out: &mut Vec<Segment>) {
        if let Some(segment) = self.held_back.take() {
            out.push(Segment { end, ..segment });
        }
    }
}

/// The work position of a machine position: the transform undone.
pub fn work_position(transform: &Transform, machine: MachinePosition) -> WorkPosition {
    WorkPosition(machine.0.minus(transform.work_offset))
}

fn moves(from: AxisVector, to: AxisVector) -> bool {
    to.minus(from)
        .0
        .iter()
        .any(|distance| distance.abs() >= LENGTH_MIN)
}

fn finite(vector: AxisVector, name: &str) -> Result<(), Alarm> {
    let not_finite = Axis::ALL.into_iter().find(|&axis| !vector[axis].is_finite());
    match not_finite {
        None => Ok(()),
        Some(axis) => {
            let text = format!("The {name} of axis {} is {}", axis.letter(), vector[axis]);
            Err(Alarm::new(&VALUE_NOT_FINITE, text))
        }
    }
}
