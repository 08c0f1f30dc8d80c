//! Converts axis words to machine positions, and checks the limits of these positions.

use tandem_model::alarm::{AXIS_MISSING, OFFSET_IN_FORCE, SOFT_LIMIT};
use tandem_model::flow::{Action, AxisWords, Block, Compensation, Distance, Frame, Path, SegmentMotion};
use tandem_model::{Alarm, ArcPath, Axis, AxisVector, Origin};

use crate::length::LENGTH_MIN;
use crate::stage::PathStage;
use crate::transform::{self, finite};

impl PathStage {
    /// Returns the machine position that axis words give. The words may name only axes of the coordinate
    /// system.
    pub(crate) fn target(&self, block: &Block, words: &AxisWords) -> Result<AxisVector, Alarm> {
        if let Some(axis) = words.named.iter().find(|axis| !self.axes.contains(*axis)) {
            return Err(Self::axis_missing(axis));
        }
        let to = match words.frame {
            Frame::Work => self.work_target(words, is_motion(block, words)),
            Frame::Machine => {
                let what = "A move to a machine position";
                self.without_compensation(block, what)?;
                self.without_tool_length(what)?;
                let mut to = self.at;
                for axis in words.named.iter() {
                    to[axis] = words.values[axis]
                        + match words.distance {
                            Distance::Absolute => 0.0,
                            Distance::Incremental => self.at[axis],
                        };
                }
                to
            }
        };
        finite(to, "target")?;
        let missing = Axis::ALL
            .into_iter()
            .find(|&axis| !self.axes.contains(axis) && (to[axis] - self.at[axis]).abs() >= LENGTH_MIN);
        match missing {
            Some(axis) => Err(Self::axis_missing(axis)),
            None => Ok(to),
        }
    }

    pub(crate) fn axis_missing(axis: Axis) -> Alarm {
        Alarm::new(&AXIS_MISSING, format!("The block moves axis {}", axis.letter())).of_words(axis.letter())
    }

    /// Returns the target in machine coordinates. Axes that no word moves keep their position to the last
    /// bit.
    pub(crate) fn work_target(&self, words: &AxisWords, moves: bool) -> AxisVector {
        let transform = &self.transform;
        let mut from = self.at;
        if moves && self.tool_shift != 0.0 {
            from[Axis::Z] += self.tool_shift;
        }
        let before = match words.distance {
            Distance::Absolute => transform.inverse(from),
            Distance::Incremental => AxisVector::ZERO,
        };
        let programmed = before.replaced(words.named, words.values);
        let target = match words.distance {
            Distance::Absolute => transform.forward(programmed),
            Distance::Incremental => from.plus(transform.linear(programmed)),
        };
        let moved = transform::moved(transform, words.named);
        let without_rounding = from.zip(target, |from, target| {
            if (target - from).abs() < LENGTH_MIN {
                from
            } else {
                target
            }
        });
        let to = from.replaced(moved, without_rounding);
        to.replaced(words.named, target)
    }

    /// Ends a motion block: Z has reached the position for the current tool length (D22), or the position of
    /// G53.
    pub(crate) fn arrived(&mut self, block: &Block, words: &AxisWords) {
        let reached = match words.frame {
            Frame::Work => is_motion(block, words),
            Frame::Machine => words.named.contains(Axis::Z),
        };
        if reached {
            self.tool_shift = 0.0;
        }
    }

    /// Rejects a block while cutter compensation is on (D23).
    pub(crate) fn without_compensation(&self, block: &Block, what: &str) -> Result<(), Alarm> {
        if block.compensation == Compensation::Off && !self.compensator.is_on() {
            return Ok(());
        }
        let text = format!("{what}: cutter compensation is on");
        Err(Alarm::new(&OFFSET_IN_FORCE, text))
    }

    /// Rejects a block while a tool length offset is in force (D23).
    pub(crate) fn without_tool_length(&self, what: &str) -> Result<(), Alarm> {
        let length = self.transform.tool_length;
        if length == 0.0 {
            return Ok(());
        }
        let text = format!("{what}: the tool length offset is {length} mm");
        Err(Alarm::new(&OFFSET_IN_FORCE, text))
    }

    /// Permits and records moves beyond soft limits from now on. The check of a program, which moves nothing,
    /// uses this.
    pub fn let_limits_pass(&mut self) {
        self.passed_limits.get_or_insert_default();
    }

    /// Returns the alarms of the permitted moves since the last call, each at its block.
    pub fn take_passed_limits(&mut self) -> Vec<Alarm> {
        self.passed_limits.as_mut().map_or_else(Vec::new, std::mem::take)
    }

    /// Returns the alarm of a move beyond a soft limit. If such moves are permitted, records the alarm and
    /// returns `Ok`.
    pub(crate) fn refuse_beyond(&mut self, judged: Result<(), Alarm>, origin: Origin) -> Result<(), Alarm> {
        let refused = judged.map_err(|alarm| alarm.at(origin));
        match (refused, &mut self.passed_limits) {
            (Err(alarm), Some(passed)) => {
                passed.push(alarm);
                Ok(())
            }
            (refused, _) => refused,
        }
    }

    /// Checks that the axes that move end within their soft limits.
    pub(crate) fn within_all_soft_limits(&self, from: AxisVector, to: AxisVector) -> Result<(), Alarm> {
        (self.axes.iter())
            .filter(|&axis| (to[axis] - from[axis]).abs() >= LENGTH_MIN)
            .try_for_each(|axis| self.within_soft_limits(axis, to[axis]))
    }

    /// Checks that the axes that a segment moves stay within their soft limits.
    pub(crate) fn segment_within_soft_limits(&self, motion: &SegmentMotion) -> Result<(), Alarm> {
        match motion {
            SegmentMotion::Feed { path, .. } => match path {
                Path::Line { from, to, .. } => self.within_all_soft_limits(*from, *to),
                Path::Arc(arc) => self.arc_within_soft_limits(arc),
            },
            SegmentMotion::Rapid { from, to }
            | SegmentMotion::Skip { from, to }
            | SegmentMotion::Tap { from, to, .. } => self.within_all_soft_limits(*from, *to),
            SegmentMotion::Dwell { .. } => Ok(()),
        }
    }

    /// Checks that an arc stays within the soft limits of its axes, also at its turning points.
    fn arc_within_soft_limits(&self, arc: &ArcPath) -> Result<(), Alarm> {
        let from = arc.start();
        for axis in self.limited_axes() {
            let reach = arc.reach(axis);
            if reach.iter().any(|value| (value - from[axis]).abs() >= LENGTH_MIN) {
                (reach.iter()).try_for_each(|value| self.within_soft_limits(axis, *value))?;
            }
        }
        Ok(())
    }

    fn soft_limits(&self, axis: Axis) -> Option<[f64; 2]> {
        self.settings.motors[axis.index()].as_ref()?.soft_limits
    }

    /// Returns the axes that have soft limits.
    pub(crate) fn limited_axes(&self) -> impl Iterator<Item = Axis> {
        (self.axes.iter()).filter(|axis| self.soft_limits(*axis).is_some())
    }

    fn within_soft_limits(&self, axis: Axis, value: f64) -> Result<(), Alarm> {
        let Some((which, limit)) = self.limit_passed(axis, value) else {
            return Ok(());
        };
        let letter = axis.letter();
        let text =
            format!("Axis {letter} would move to {value:.6} (machine), beyond its {which} limit {limit:.6}");
        Err(Alarm::new(&SOFT_LIMIT, text).of_words(letter))
    }

    /// Returns the name and position of the soft limit that a value exceeds; `None` if it exceeds no limit.
    pub(crate) fn limit_passed(&self, axis: Axis, value: f64) -> Option<(&'static str, f64)> {
        let [lowest, highest] = self.soft_limits(axis)?;
        if value < lowest - LENGTH_MIN {
            Some(("lower", lowest))
        } else if value > highest + LENGTH_MIN {
            Some(("upper", highest))
        } else {
            None
        }
    }
}

/// Returns true for a block that moves. G02 and G03 move also without axis words.
fn is_motion(block: &Block, words: &AxisWords) -> bool {
    !words.named.is_empty() || matches!(block.action, Action::Arc(_))
}
