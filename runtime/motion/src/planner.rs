//! Conversion of segments to profiles.

use std::collections::VecDeque;

use tandem_model::Alarm;
use tandem_model::alarm::{VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentMotion};
use tandem_model::profile::{Law, PathPlace, Profile, Stretch};
use tandem_model::settings::CoordinateSystemSettings;

use crate::block::RampedBlock;
use crate::chain::{Chain, ChainBlock};
use crate::look_ahead::LookAhead;
use crate::ramped::{self, SingleBlock};
use crate::record::{Entry, Record};
use crate::replan::Replan;
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
    /// Multi-block setting (G500 or G501) of the blocks in the chain.
    multi_block: MultiBlock,
    look_ahead: LookAhead,
    record: Record,
}

impl Planner {
    /// Creates a planner whose first profile has segment number 1 and epoch 0.
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        Self {
            settings: settings.clone(),
            epoch: 0,
            last_segment: 0,
            chain: Chain::default(),
            multi_block: MultiBlock::Off,
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
        self.look_ahead.clear();
        self.record.clear();
    }

    /// Plans further G500 blocks for this feed override: 1.0 is 100 percent, 2.0 the maximum. Up to 100
    /// percent the plan is the same, because the servo scales its time.
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
    /// decides how it ends, with G500 until no later block can change its speed. A chain ends at rest where
    /// G500 changes to G501, or G501 to G500. Segment numbers follow the order of the segments in any case.
    ///
    /// # Errors
    /// Returns an alarm at the segment's origin. The segment then outputs nothing, and the blocks held back
    /// end at rest. Alarms: `LIMIT_ZERO` if a moving motor has a limit that is not above zero,
    /// `VALUE_NOT_FINITE`, and `VALUE_OUT_OF_RANGE` for a negative time, a feedrate that is not above zero,
    /// or a duration above 1e9 s.
    pub fn push(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let pushed = self.plan_segment(segment, out);
        if pushed.is_err() || segment.end == SegmentEnd::ExactStop {
            self.flush(out);
        }
        pushed.map_err(|alarm| alarm.at(segment.origin))
    }

    /// Outputs the blocks held back; the last of them ends at rest.
    pub fn flush(&mut self, out: &mut VecDeque<Profile>) {
        let onward = onward(self.multi_block, &mut self.look_ahead, &mut self.record, out);
        self.chain.finish(self.settings.motion.short_block, onward);
    }

    fn plan_segment(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let (law, duration_s) = match &segment.motion {
            SegmentMotion::Feed { path, feed } => {
                let alone = ramped::plan(&self.settings, path, *feed, segment.multi_block)?;
                return self.blend(segment, path, alone, out);
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
        out: &mut VecDeque<Profile>,
    ) -> Result<(), Alarm> {
        check_duration(alone.duration_s_max(path.length()))?;
        if segment.multi_block != self.multi_block {
            self.flush(out);
            self.multi_block = segment.multi_block;
        }
        self.last_segment += 1;
        let block = ChainBlock {
            segment: self.last_segment,
            epoch: self.epoch,
            origin: segment.origin,
            path: path.clone(),
            alone,
        };
        let onward = onward(self.multi_block, &mut self.look_ahead, &mut self.record, out);
        self.chain.push(self.settings.motion.short_block, block, onward);
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
    multi_block: MultiBlock,
    look_ahead: &mut LookAhead,
    record: &mut Record,
    out: &mut VecDeque<Profile>,
) -> impl FnMut(RampedBlock) {
    move |block| match multi_block {
        MultiBlock::On => look_ahead.push(block, record, out),
        MultiBlock::Off => {
            out.push_back(block.profile());
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
