//! Conversion of segments to profiles.

use std::collections::VecDeque;

use tandem_model::Alarm;
use tandem_model::alarm::{VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentMotion};
use tandem_model::profile::{Law, PathPlace, Profile, Stretch};
use tandem_model::settings::CoordinateSystemSettings;

use crate::block::{ChainBlock, PlannedBlock};
use crate::chain::Chain;
use crate::look_ahead::LookAhead;
use crate::ramped::{self, SingleBlock};
use crate::record::{Entry, Record};
use crate::replan::Replan;
use crate::smooth::Smoothing;
use crate::{rapid, tapping};

/// Maximum duration of a profile, s: about 31 years. A longer profile raises an alarm, so that counting servo
/// periods stays exact.
const DURATION_MAX_S: f64 = 1e9;

/// The motion stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct Planner {
    settings: CoordinateSystemSettings,
    epoch: u32,
    last_segment: u64,
    chain: Chain,
    smoothing: Smoothing,
    /// Kind of the chain to which the blocks in `chain` or `smoothing` belong.
    kind: ChainKind,
    look_ahead: LookAhead,
    record: Record,
}

/// Kind of a chain of blended blocks. Between chains of different kinds the motion stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ChainKind {
    /// G501: the programmed path and ramps.
    Programmed,
    /// G500: the same path, with the speed of look-ahead.
    Paced,
    /// G500 with a path tolerance: a smoothed path, with the speed of look-ahead.
    Smoothed,
}

impl ChainKind {
    /// Returns the kind of chain to which a block belongs. Cutter compensation keeps the path.
    pub(crate) fn of_block(
        settings: &CoordinateSystemSettings,
        multi_block: MultiBlock,
        keeps_path: bool,
    ) -> Self {
        match multi_block {
            MultiBlock::Off => Self::Programmed,
            MultiBlock::On if keeps_path || settings.motion.path_tolerance_mm <= 0.0 => Self::Paced,
            MultiBlock::On => Self::Smoothed,
        }
    }
}

impl Planner {
    /// Creates a planner whose first profile has segment number 1 and epoch 0.
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        Self {
            settings: settings.clone(),
            epoch: 0,
            last_segment: 0,
            chain: Chain::default(),
            smoothing: Smoothing::new(settings.motion.path_tolerance_mm),
            kind: ChainKind::Programmed,
            look_ahead: LookAhead::new(settings),
            record: Record::default(),
        }
    }

    /// Replaces the planner by a new one after a fault. Segment numbers and epoch continue.
    pub fn renew(&mut self, settings: &CoordinateSystemSettings) {
        *self = Self {
            epoch: self.epoch,
            last_segment: self.last_segment,
            ..Self::new(settings)
        };
    }

    /// Drops all blocks that are held back. All further profiles have this epoch. Segment numbers continue.
    pub fn restart(&mut self, epoch: u32) {
        self.epoch = epoch;
        self.chain.clear();
        self.smoothing.clear();
        self.look_ahead.clear();
        self.record.clear();
    }

    /// Plans further G500 blocks for this feed override: 1.0 is 100 percent, 2.0 the maximum, 0.01 the minimum.
    pub fn set_feed_override(&mut self, factor: f64) {
        self.look_ahead.set_feed_override(factor);
    }

    /// Records that the motion has passed this segment. The planner keeps the last 10,000 passed segments,
    /// and at most 127 more.
    pub fn passed(&mut self, segment: u64) {
        self.record.passed(segment);
    }

    /// Prevents backward motion into the last pushed segment and all segments before it.
    pub fn forbid_retrace(&mut self) {
        self.record.bar(self.last_segment);
    }

    /// Returns a position within an output G500 block, at least `ahead_s` of plan time after `from`. There a
    /// [`Planner::replan`] may begin while the machine moves. Returns `None` if there is no such position.
    pub fn place_ahead(&self, from: PathPlace, ahead_s: f64) -> Option<PathPlace> {
        self.record.place_ahead(from, ahead_s)
    }

    /// Plans the output profiles again, beginning at `from`, for the current feed override. If `at_rest`, the
    /// motion begins at rest; otherwise it must arrive no faster than the new plan allows. Nothing changes
    /// before [`Planner::adopt`].
    pub fn replan(&self, from: PathPlace, at_rest: bool) -> Replan {
        Replan::forward(&self.record, &self.look_ahead, from, at_rest)
    }

    /// Adopts a new plan. The caller must not have pushed a segment since the plan was made.
    pub fn adopt(&mut self, new: Replan) {
        self.look_ahead = new.look_ahead;
        self.record.replace(new.from, new.record);
    }

    /// Returns true if [`Planner::retrace`] finds a backward path from this position.
    pub fn can_retrace(&self, from: PathPlace) -> bool {
        self.record.can_retrace(from)
    }

    /// Returns the profiles of backward motion from `from`, where the machine is at rest, along blocks that
    /// moved with G500. The motion ends at rest at a block with G501, a thread, a G31, a bar, or the oldest
    /// block kept. Dwells are skipped. A later [`Planner::replan`] does not repeat the part of a dwell that
    /// was waited before `from`. The result is empty if no backward motion is possible.
    pub fn retrace(&mut self, from: PathPlace) -> VecDeque<Profile> {
        let back = Replan::backward(&self.record, &self.look_ahead, from);
        if !back.profiles.is_empty() {
            self.record.record_turn(from);
        }
        back.profiles
    }

    /// Plans a segment. A segment that may blend is held back until the next segment or [`Planner::flush`]
    /// decides how it ends, with G500 until no later block can change its path or speed. A chain ends at rest
    /// where G500 changes to G501, or G501 to G500, and with a path tolerance where cutter compensation
    /// begins or ends. Segment numbers follow the order of the segments in any case.
    ///
    /// # Errors
    /// Returns an alarm at the segment's origin. The segment then outputs nothing, and the blocks held back
    /// end at rest. Alarms: `LIMIT_ZERO` if a moving motor has a limit that is not above zero,
    /// `VALUE_NOT_FINITE`, and `VALUE_OUT_OF_RANGE` for a negative time, a feedrate that is not above zero,
    /// or a duration above 1e9 s.
    pub fn push(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let before = out.len();
        let pushed = self.plan_segment(segment, out);
        if pushed.is_err() || segment.end == SegmentEnd::ExactStop {
            self.flush(out);
        }
        self.assert_invariants(out.range(before..));
        pushed.map_err(|alarm| alarm.at(segment.origin))
    }

    /// Outputs the blocks held back; the last of them ends at rest.
    pub fn flush(&mut self, out: &mut VecDeque<Profile>) {
        let before = out.len();
        let onward = onward(self.kind, &mut self.look_ahead, &mut self.record, out);
        match self.kind {
            ChainKind::Smoothed => self.smoothing.finish(onward),
            _ => self.chain.finish(self.settings.motion.short_block, onward),
        }
        self.assert_invariants(out.range(before..));
    }

    /// Asserts in debug builds that new profiles belong to the current epoch, keep the order of their segments, and have
    /// a valid duration. A segment may have several profiles.
    fn assert_invariants<'a>(&self, new: impl Iterator<Item = &'a Profile>) {
        if !cfg!(debug_assertions) {
            return;
        }
        let mut last = None;
        for profile in new {
            let segment = profile.segment;
            assert_eq!(profile.epoch, self.epoch, "segment {segment} is of another epoch");
            assert!(
                last.is_none_or(|last| last == segment || last + 1 == segment)
                    && segment <= self.last_segment,
                "segment {segment} does not follow segment {last:?}"
            );
            assert!(
                (0.0..=DURATION_MAX_S).contains(&profile.duration_s),
                "segment {segment} takes {} s",
                profile.duration_s
            );
            last = Some(segment);
        }
    }

    fn plan_segment(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let (law, duration_s) = match &segment.motion {
            SegmentMotion::Feed { path, feed } => {
                let alone = ramped::plan(&self.settings, path, *feed, segment.multi_block)?;
                let kind = ChainKind::of_block(&self.settings, segment.multi_block, feed.keeps_path);
                return self.blend(segment, path, alone, kind, out);
            }
            SegmentMotion::Rapid { from, to } => rapid::plan(&self.settings, *from, *to)?,
            SegmentMotion::Skip { from, to } => rapid::plan_skip(&self.settings, *from, *to)?,
            SegmentMotion::Tap {
                from,
                to,
                feed,
                revolutions,
                leg,
            } => tapping::plan(&self.settings, [*from, *to], *feed, *revolutions, *leg)?,
            SegmentMotion::Dwell { at, dwell_s } => {
                let stretch = Stretch::whole(*dwell_s);
                (Law::Rest { at: *at, stretch }, *dwell_s)
            }
        };
        check_duration(duration_s)?;
        self.flush(out);
        self.last_segment += 1;
        let profile = Profile {
            segment: self.last_segment,
            epoch: self.epoch,
            origin: segment.origin,
            law,
            duration_s,
            exact_stop: true,
        };
        let is_either_way = segment.multi_block == MultiBlock::On
            && matches!(profile.law, Law::Motors { .. } | Law::Rest { .. });
        let entry = if is_either_way {
            Entry::Alone
        } else {
            Entry::OneWay
        };
        self.record.push(entry(Box::new(profile.clone())));
        out.push_back(profile);
        Ok(())
    }

    fn blend(
        &mut self,
        segment: &Segment,
        path: &Path,
        alone: SingleBlock,
        kind: ChainKind,
        out: &mut VecDeque<Profile>,
    ) -> Result<(), Alarm> {
        check_duration(alone.duration_s_max(path.length()))?;
        if kind != self.kind {
            self.flush(out);
            self.kind = kind;
        }
        self.last_segment += 1;
        let block = ChainBlock {
            segment: self.last_segment,
            epoch: self.epoch,
            origin: segment.origin,
            path: path.clone(),
            alone,
        };
        let onward = onward(kind, &mut self.look_ahead, &mut self.record, out);
        match kind {
            ChainKind::Smoothed => self.smoothing.push(&block, onward),
            _ => self.chain.push(self.settings.motion.short_block, block, onward),
        }
        Ok(())
    }

    /// Returns the current settings.
    pub fn settings(&self) -> &CoordinateSystemSettings {
        &self.settings
    }

    /// Replaces the settings, which apply from the next segment on.
    pub fn set_settings(&mut self, settings: &CoordinateSystemSettings) {
        self.settings = settings.clone();
    }

    /// Returns the number of the last segment pushed; 0 before the first segment.
    pub fn last_segment(&self) -> u64 {
        self.last_segment
    }
}

/// Returns the function that receives the planned blocks of a chain.
fn onward(
    kind: ChainKind,
    look_ahead: &mut LookAhead,
    record: &mut Record,
    out: &mut VecDeque<Profile>,
) -> impl FnMut(PlannedBlock) {
    move |block| match kind {
        ChainKind::Paced | ChainKind::Smoothed => look_ahead.push(block, record, out),
        ChainKind::Programmed => {
            out.extend(block.profile());
            record.push(Entry::Ramped(block));
        }
    }
}

fn check_duration(duration_s: f64) -> Result<(), Alarm> {
    if !duration_s.is_finite() {
        let text = format!("The block would take {duration_s} s");
        return Err(Alarm::new(&VALUE_NOT_FINITE, text));
    }
    if !(0.0..=DURATION_MAX_S).contains(&duration_s) {
        let text = format!("The block would take {duration_s} s, not 0 to {DURATION_MAX_S} s");
        return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
    }
    Ok(())
}
