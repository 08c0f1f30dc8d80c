//! Converts blocks to segments in machine coordinates.

use tandem_model::alarm::{COMPENSATION_REFUSED, FEEDRATE_MISSING, VALUE_OUT_OF_RANGE, check_finite};
use tandem_model::flow::{
    Action, AxisWords, Block, Compensation, MultiBlock, Path, PathControl, ProgrammedFeed, Segment,
    SegmentEnd, SegmentFeed, SegmentMotion, Transform,
};
use tandem_model::settings::{CoordinateSystemSettings, RotaryFeed};
use tandem_model::{Alarm, Axis, AxisSet, AxisVector, MachinePosition, WorkPosition};

use crate::compensation::{CompensationSide, Compensator, Leg, Rounding};
use crate::length::{line_between, moves, turns_only};
use crate::transform::{self, finite};

/// The path stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct PathStage {
    pub(crate) settings: CoordinateSystemSettings,
    pub(crate) axes: AxisSet,
    dry_run: bool,
    pub(crate) transform: Transform,
    /// Programmed end of the last block. With cutter compensation, the tool's centre is at another position.
    pub(crate) at: AxisVector,
    /// Change of the tool length that no motion block has applied yet (D22), mm.
    pub(crate) tool_shift: f64,
    /// Cutter compensation (G41, G42), applied to the segments of blocks.
    pub(crate) compensator: Compensator,
    /// Output of the compensator for one block; kept from block to block to reuse the memory.
    legs: Vec<Leg>,
    /// The last segment, held back until the next block determines whether this segment ends in a stop.
    held_back: Option<Segment>,
    /// Serial number of the last motion.
    serial: u64,
    /// True if the last segment is a G31 whose end is not yet known.
    is_skipping: bool,
    /// Alarms of permitted moves beyond soft limits. If the field is `None`, such moves are rejected.
    pub(crate) passed_limits: Option<Vec<Alarm>>,
}

impl PathStage {
    /// Creates a stage at a machine position, with the identity transform.
    pub fn new(settings: &CoordinateSystemSettings, at: MachinePosition) -> Self {
        Self {
            settings: settings.clone(),
            axes: settings.axes(),
            dry_run: false,
            transform: Transform::default(),
            at: at.0,
            tool_shift: 0.0,
            compensator: Compensator::new(settings),
            legs: Vec::new(),
            held_back: None,
            serial: 0,
            is_skipping: false,
            passed_limits: None,
        }
    }

    /// Switches dry run on or off. In dry run, further cutting blocks move at the feedrate of dry run instead
    /// of F. A thread keeps F and S, and so its pitch.
    pub fn set_dry_run(&mut self, on: bool) {
        self.dry_run = on;
    }

    /// Returns true if dry run is on.
    pub fn is_dry_run(&self) -> bool {
        self.dry_run
    }

    /// Processes a block, and outputs the segments that are final. The last block of a chain is held back
    /// until the next block determines whether the motion stops between them: see [`PathStage::flush`]. With
    /// cutter compensation, up to [`LOOK_AHEAD_MAX`] blocks are held back.
    ///
    /// # Errors
    /// Returns an alarm at the origin of a block that cannot run; the stage is then unchanged, and the block
    /// outputs nothing: `VALUE_NOT_FINITE`, `VALUE_OUT_OF_RANGE` (negative dwell, scale factor 0, reference
    /// point not 1 to 4), `AXIS_MISSING`, `SOFT_LIMIT`, `FEEDRATE_MISSING`, `OFFSET_IN_FORCE` (D23),
    /// `ARC_IMPOSSIBLE`, `ARC_DISTORTED` (D21), `SPINDLE_SPEED_MISSING`, `TAP_OFF_AXIS`.
    ///
    /// With cutter compensation also `COMPENSATION_REFUSED`, `COMPENSATION_LEAD_SHORT`,
    /// `COMPENSATION_ARC_SMALL`, `COMPENSATION_CORNER`, `COMPENSATION_SPIRAL`, `COMPENSATION_LOOK_AHEAD` and
    /// `OVERCUT`, at the first block that cannot move. The final segments before this block have been output,
    /// and the compensation has ended. The block just before it is not output, because its end depends on the
    /// rejected block.
    ///
    /// [`LOOK_AHEAD_MAX`]: crate::LOOK_AHEAD_MAX
    pub fn push(&mut self, block: &Block, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let taken = self.process_block(block, out);
        taken.map_err(|alarm| {
            self.compensator.abandon(&mut self.legs);
            // A segment beyond a soft limit also ends the path, but only the first alarm is reported.
            let _ = self.join_legs(out);
            match alarm.origin {
                Some(_) => alarm,
                None => alarm.at(block.origin),
            }
        })
    }

    /// Outputs the segments that are final, ending in an exact stop, because the program waits and continues
    /// later. With cutter compensation, blocks stay held back until the next blocks show that they have no
    /// overcut.
    pub fn flush(&mut self, out: &mut Vec<Segment>) {
        self.release(SegmentEnd::ExactStop, out);
    }

    /// Outputs the segments that are final, ending in an exact stop, and drops all other segments, because
    /// the program ends here, with or without an alarm. Within cutter compensation, the last block is
    /// dropped, since its end is unknown.
    ///
    /// # Errors
    /// Returns `SOFT_LIMIT` if a block that was held back moves beyond a soft limit.
    pub fn finish(&mut self, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        self.compensator.abandon(&mut self.legs);
        let joined = self.join_legs(out);
        self.release(SegmentEnd::ExactStop, out);
        joined
    }

    /// Returns true from the lead-in of cutter compensation to its lead-out. During this time, the program
    /// must neither wait nor end.
    pub fn is_compensating(&self) -> bool {
        self.compensator.is_on()
    }

    /// Restarts the stage after a stop or reset: at this position, with the identity transform and no block
    /// held back.
    pub fn restart(&mut self, at: MachinePosition) {
        self.at = at.0;
        self.tool_shift = 0.0;
        self.transform = Transform::default();
        self.compensator.clear();
        self.held_back = None;
        self.is_skipping = false;
    }

    /// Restarts the stage at this position, with the transform and the pending change of tool length of
    /// another stage, and with no block held back.
    pub fn restore_transform(&mut self, at: MachinePosition, of: &PathStage) {
        self.restart(at);
        self.transform = of.transform;
        self.tool_shift = of.tool_shift;
    }

    /// Returns the transform for the next block.
    pub fn transform(&self) -> &Transform {
        &self.transform
    }

    /// Returns an upper bound of the number of segments still to come from the blocks pushed so far. Blocks
    /// left out to prevent an overcut reduce this number.
    pub fn held_back(&self) -> usize {
        usize::from(self.held_back.is_some()) + self.compensator.pending()
    }

    /// Returns the serial number of the last motion pushed.
    pub fn last_serial(&self) -> u64 {
        self.serial
    }

    fn next_serial(&mut self) -> u64 {
        self.serial += 1;
        self.serial
    }

    /// Returns the programmed end of the last block; for a G31 without a skip input, this is the target of
    /// the G31. With cutter compensation, the tool's centre is at another position.
    pub fn position(&self) -> MachinePosition {
        MachinePosition(self.at)
    }

    /// Returns the position from which the next block is measured: the end of the last block, with a change
    /// of tool length that no motion block has applied yet (D22).
    pub fn counts_from(&self) -> MachinePosition {
        let mut from = self.at;
        from[Axis::Z] += self.tool_shift;
        MachinePosition(from)
    }

    fn process_block(&mut self, block: &Block, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let compensated = block.compensation != Compensation::Off || self.compensator.is_on();
        match &block.action {
            Action::Skip(_) | Action::ThreadAhead(_) | Action::Tap(_) if compensated => {
                let text = "a skip (G31) and a thread are not allowed during cutter compensation or before its lead-out";
                return Err(Alarm::new(&COMPENSATION_REFUSED, text));
            }
            Action::None => {
                if ends_chain(block) {
                    self.stop(out);
                }
            }
            Action::Transform(transform) => {
                transform::check(transform)?;
                let longer = transform.tool_length - self.transform.tool_length;
                // A change of tool length ends the chain (D22).
                if longer != 0.0 || ends_chain(block) {
                    self.stop(out);
                }
                self.tool_shift += longer;
                self.transform = **transform;
            }
            Action::Dwell { dwell_s } => self.dwell(block, *dwell_s, out)?,
            Action::Rapid(words) => self.rapid(block, words, out)?,
            Action::Linear(words) => self.linear(block, words, out)?,
            Action::Reference {
                middle,
                point,
                with_tool_length,
            } => {
                self.without_compensation(block, "A move to a reference point")?;
                if !with_tool_length {
                    self.without_tool_length("A move to a reference point")?;
                }
                self.reference(block, middle, *point, out)?;
            }
            Action::Corner(words) => self.corner(words),
            Action::Arc(arc) => {
                let path = self.arc(block, arc)?;
                self.feed(block, &arc.target, path, out)?;
            }
            Action::Skip(words) => self.skip(block, words, out)?,
            Action::ThreadAhead(ahead) => self.thread_ahead(block, ahead)?,
            Action::Tap(tap) => self.tap(block, tap, out)?,
        }
        Ok(())
    }

    fn dwell(&mut self, block: &Block, dwell_s: f64, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        check_finite("The dwell time", dwell_s)?;
        if dwell_s < 0.0 {
            let text = format!("The dwell time {dwell_s} s is below 0");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
        self.stop(out);
        if dwell_s > 0.0 {
            let motion = SegmentMotion::Dwell { at: self.at, dwell_s };
            self.advance(block, motion, true, out)?;
            self.stop(out);
        }
        Ok(())
    }

    fn rapid(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        // G00 is never blended (M1c), so it is not held back.
        if moves(self.at, to) {
            self.advance(block, SegmentMotion::Rapid { from: self.at, to }, true, out)?;
            self.at = to;
        }
        self.stop(out);
        self.arrived(block, words);
        Ok(())
    }

    fn skip(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        self.refuse_beyond(self.within_all_soft_limits(self.at, to), block.origin)?;
        self.release(SegmentEnd::ExactStop, out);
        if moves(self.at, to) {
            self.push_move_to_rest(block, SegmentMotion::Skip { from: self.at, to }, to, out);
            self.is_skipping = true;
        }
        self.arrived(block, words);
        Ok(())
    }

    /// Returns true from a G31 that moves until [`PathStage::skipped_to`]. During this time, no block may be
    /// pushed.
    pub fn is_skipping(&self) -> bool {
        self.is_skipping
    }

    /// Sets the position at which the machine rests after a G31, possibly before the target. The transform
    /// does not change.
    pub fn skipped_to(&mut self, at: MachinePosition) {
        self.at = at.0;
        self.is_skipping = false;
    }

    /// Outputs a motion that always ends in an exact stop.
    pub(crate) fn push_move_to_rest(
        &mut self,
        block: &Block,
        motion: SegmentMotion,
        to: AxisVector,
        out: &mut Vec<Segment>,
    ) {
        let serial = self.next_serial();
        out.push(Segment {
            origin: block.origin,
            motion,
            end: SegmentEnd::ExactStop,
            multi_block: block.multi_block,
            serial,
        });
        self.at = to;
    }

    /// Outputs G28 or G30: G00 of the named axes to the middle point, then to the reference point. Without
    /// named axes, all axes move directly to the reference point (D24).
    fn reference(
        &mut self,
        block: &Block,
        words: &AxisWords,
        point: u8,
        out: &mut Vec<Segment>,
    ) -> Result<(), Alarm> {
        if !(1..=4).contains(&point) {
            let text = format!("The reference point {point} is not 1 to 4");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
        let (middle, named) = if words.named.is_empty() {
            (self.at, self.axes)
        } else {
            (self.target(block, words)?, words.named)
        };
        let mut to = middle;
        for axis in named.iter() {
            let motor = self.settings.motors[axis.index()].as_ref();
            to[axis] = motor.map_or(0.0, |motor| motor.reference_points[usize::from(point) - 1]);
        }
        finite(to, "reference point")?;
        self.refuse_beyond(self.within_all_soft_limits(self.at, middle), block.origin)?;
        self.refuse_beyond(self.within_all_soft_limits(middle, to), block.origin)?;
        self.release(SegmentEnd::ExactStop, out);
        for to in [middle, to] {
            if moves(self.at, to) {
                self.push_move_to_rest(block, SegmentMotion::Rapid { from: self.at, to }, to, out);
            }
        }
        if words.named.is_empty() {
            self.tool_shift = 0.0;
        } else {
            self.arrived(block, words);
        }
        Ok(())
    }

    fn linear(&mut self, block: &Block, words: &AxisWords, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        let path = self.line(to)?;
        self.feed(block, words, path, out)
    }

    /// Returns the straight line from the current position, with the length to which F refers.
    fn line(&self, to: AxisVector) -> Result<Option<Path>, Alarm> {
        let path = line_between(self.at, to)?;
        match self.settings.path.rotary_feed {
            RotaryFeed::Degrees => Ok(path),
            RotaryFeed::Surface => self.along_surface(path),
        }
    }

    /// Sets the direction of the motion after a rounded corner, if the words give a direction.
    fn corner(&mut self, words: &AxisWords) {
        let rounding = if words.named.is_empty() {
            Rounding::Free
        } else {
            Rounding::Towards(self.work_target(words, true).minus(self.at))
        };
        self.compensator.round_next(rounding);
    }

    /// Processes a cutting block along this path. If the path is `None`, the block does not move.
    fn feed(
        &mut self,
        block: &Block,
        words: &AxisWords,
        path: Option<Path>,
        out: &mut Vec<Segment>,
    ) -> Result<(), Alarm> {
        let each_block_stops = block.path_control == PathControl::ExactStop;
        // Two blocks blend only when both are in G64.
        let no_movement = path.is_none() && words.named.is_empty();
        let stop_before = each_block_stops || block.exact_stop_before || (no_movement && ends_chain(block));
        if let Some(path) = path {
            let (to, feed) = (path.end(), self.feed_along(block, &path)?);
            self.advance(block, SegmentMotion::Feed { path, feed }, stop_before, out)?;
            self.at = to;
        } else if stop_before {
            self.stop(out);
        }
        self.arrived(block, words);
        if each_block_stops || block.exact_stop_after {
            self.stop(out);
        }
        Ok(())
    }

    /// Passes the motion of a block through the compensation, and outputs the resulting segments.
    fn advance(
        &mut self,
        block: &Block,
        motion: SegmentMotion,
        stop_before: bool,
        out: &mut Vec<Segment>,
    ) -> Result<(), Alarm> {
        let end = match motion {
            SegmentMotion::Feed { .. } => SegmentEnd::Continuous,
            _ => SegmentEnd::ExactStop,
        };
        let serial = self.next_serial();
        let segment = Segment {
            origin: block.origin,
            motion,
            end,
            multi_block: block.multi_block,
            serial,
        };
        let wanted = self.side(block)?;
        let Some(side) = self.compensator.side.or(wanted) else {
            return self.join(segment, stop_before, out);
        };
        let leg = Leg {
            segment,
            stop_before,
            is_exact: block.path_control == PathControl::ExactStop,
        };
        let taken = self.compensator.compensate(leg, side, wanted, &mut self.legs);
        self.join_legs(out).and(taken)
    }

    fn join_legs(&mut self, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let mut legs = std::mem::take(&mut self.legs);
        let joined = legs.drain(..).try_for_each(|mut leg| {
            if let SegmentMotion::Feed { feed, .. } = &mut leg.segment.motion {
                feed.keeps_path = true;
            }
            self.join(leg.segment, leg.stop_before, out)
        });
        self.legs = legs;
        if joined.is_err() {
            self.compensator.clear();
        }
        joined
    }

    /// Processes the next segment, which determines how the segment held back ends.
    fn join(&mut self, segment: Segment, stop_before: bool, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        self.refuse_beyond(self.segment_within_soft_limits(&segment.motion), segment.origin)?;
        if let (Some(before), false) = (&self.held_back, stop_before) {
            let blended = self.blend_within_soft_limits(&before.motion, &segment.motion);
            self.refuse_beyond(blended, segment.origin)?;
        }
        let end = if stop_before {
            SegmentEnd::ExactStop
        } else {
            segment.end
        };
        self.release(end, out);
        match segment.end {
            SegmentEnd::ExactStop => out.push(segment),
            SegmentEnd::Continuous => self.held_back = Some(segment),
        }
        Ok(())
    }

    /// Requests a stop between the blocks pushed so far and the next block.
    fn stop(&mut self, out: &mut Vec<Segment>) {
        if self.compensator.is_on() {
            self.compensator.stop();
        } else {
            self.release(SegmentEnd::ExactStop, out);
        }
    }

    /// Returns the compensation that a block requests, in machine coordinates.
    fn side(&self, block: &Block) -> Result<Option<CompensationSide>, Alarm> {
        let (radius, plane, left) = match block.compensation {
            Compensation::Off => return Ok(None),
            Compensation::Left { radius, plane } => (radius, plane, true),
            Compensation::Right { radius, plane } => (radius, plane, false),
        };
        check_finite("The tool's radius", radius)?;
        if radius < 0.0 {
            let text = format!("The tool's radius {radius} mm is below 0");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
        let left = left != transform::swaps_sides(&self.transform, plane);
        let tool = if left { radius } else { -radius };
        Ok(Some(CompensationSide { plane, tool }))
    }

    /// Returns the feedrate of a block along its path, limited to the maximum feedrate.
    fn feed_along(&self, block: &Block, path: &Path) -> Result<SegmentFeed, Alarm> {
        let in_degrees = self.settings.path.rotary_feed == RotaryFeed::Degrees;
        let rotary_only = match path {
            Path::Line { from, to, .. } => in_degrees && turns_only(to.minus(*from)),
            Path::Arc(_) => false,
        };
        let mut feed = self.feed_in_force(block, rotary_only)?;
        if self.dry_run {
            feed.feedrate_mm_min = match self.settings.motion.dry_run_feedrate_mm_min {
                configured if configured > 0.0 => configured,
                _ => self.settings.max_feedrate_mm_min * feed.unit_mm,
            };
        }
        if self.turns_freely(path.start(), path.end()) {
            feed.feedrate_mm_min = self.settings.max_feedrate_mm_min;
        }
        feed.feedrate_mm_min = feed
            .feedrate_mm_min
            .min(self.settings.max_feedrate_mm_min * feed.unit_mm);
        Ok(feed)
    }

    /// Returns the programmed feedrate and ramp times. A block that moves only rotary axes has a separate
    /// feedrate.
    pub(crate) fn feed_in_force(&self, block: &Block, rotary_only: bool) -> Result<SegmentFeed, Alarm> {
        let programmed = if rotary_only {
            block.feedrate_deg_min
        } else {
            block.feed.feedrate_mm_min
        };
        let feedrate = if rotary_only && self.settings.rotary_feedrate_deg_min > 0.0 {
            self.settings.rotary_feedrate_deg_min
        } else if programmed == 0.0 {
            let unit_mm = if rotary_only { 1.0 } else { block.unit.mm() };
            self.settings.default_feedrate_mm_min * unit_mm
        } else {
            programmed
        };
        check_finite("The feedrate", feedrate)?;
        check_finite("The ta", block.feed.ta_ms)?;
        check_finite("The td", block.feed.td_ms)?;
        check_finite("The ts", block.feed.ts_ms)?;
        if feedrate <= 0.0 {
            let text = format!("The feedrate is {feedrate}");
            return Err(Alarm::new(&FEEDRATE_MISSING, text));
        }
        let ProgrammedFeed {
            ta_ms, td_ms, ts_ms, ..
        } = block.feed;
        Ok(SegmentFeed {
            feedrate_mm_min: feedrate,
            ta_ms,
            td_ms,
            ts_ms,
            unit_mm: block.unit.mm(),
            keeps_path: false,
        })
    }

    pub(crate) fn release(&mut self, end: SegmentEnd, out: &mut Vec<Segment>) {
        if let Some(mut segment) = self.held_back.take() {
            segment.end = end;
            out.push(segment);
        }
    }
}

/// Returns the work position of a machine position: applies the inverse transform (D20), including the tool
/// length.
pub fn work_position(transform: &Transform, machine: MachinePosition) -> WorkPosition {
    WorkPosition(transform.inverse(machine.0))
}

/// Returns true if the block ends a chain when it does not move: with G501 every block, with G500 only a
/// block with G09 (M1c).
fn ends_chain(block: &Block) -> bool {
    block.multi_block == MultiBlock::Off || block.exact_stop_before || block.exact_stop_after
}
