//! Converts segments to profiles.

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

/// The longest profile, s: about 31 years. A longer one is an alarm, so that counting servo periods stays exact.
const DURATION_MAX_S: f64 = 1e9;

/// The motion stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct Planner {
    settings: CoordinateSystemSettings,
    epoch: u32,
    last_segment: u64,
    chain: Chain,
    /// Multi-block setting of the chain's blocks.
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

    /// Replaces everything by a new planner, after a fault in this one. Segment numbers and epoch continue.
    pub fn renew(&mut self, settings: &CoordinateSystemSettings) {
        *self = Self {
            epoch: self.epoch,
            last_segment: self.last_segment,
            ..Self::new(settings)
        };
    }

    /// Drops the blocks held back; profiles carry this epoch from now on. Segment numbers continue.
    pub fn restart(&mut self, epoch: u32) {
        self.epoch = epoch;
        self.chain.clear();
        self.look_ahead.clear();
        self.record.clear();
    }

    /// Plans further G500 blocks for this feed override, 1.0 being 100 percent, at most 2.0. Up to 100 percent the plan is
    /// the same, since the servo scales its time.
    pub fn set_feed_override(&mut self, factor: f64) {
        self.look_ahead.set_feed_override(factor);
    }

    /// Records that the motion has passed this segment. The last 10,000 passed segments are kept, and fewer
    /// than 128 more.
    pub fn passed(&mut self, segment: u64) {
        self.record.passed(segment);
    }

    /// Prevents a return past the end of the last segment taken.
    pub fn forbid_retrace(&mut self) {
        self.record.bar(self.last_segment);
    }

    /// Returns a place within a G500 block already output, at least `ahead_s` of plan time beyond this one, where a
    /// [`Planner::replan`] may begin while the machine moves; `None` without such a place.
    pub fn place_ahead(&self, from: PathPlace, ahead_s: f64) -> Option<PathPlace> {
        self.record.place_ahead(from, ahead_s)
    }

    /// Plans the output profiles again from a place on, for the current feed override: from rest there, or for a motion
    /// that arrives no faster than the new plan allows. Nothing changes before [`Planner::adopt`].
    pub fn replan(&self, from: PathPlace, at_rest: bool) -> Replan {
        Replan::forward(&self.record, &self.look_ahead, from, at_rest)
    }

    /// Continues with a new plan; nothing may have been pushed since it was made.
    pub fn adopt(&mut self, new: Replan) {
        self.look_ahead = new.look_ahead;
        self.record.replace(new.from, new.record);
    }

    /// Returns true if [`Planner::retrace`] finds a return path from this place.
    pub fn can_retrace(&self, from: PathPlace) -> bool {
        self.record.can_retrace(from)
    }

    /// Returns the path back from a place at rest, along the blocks that moved with G500, to rest: up to a block with
    /// G501, a thread, a G31, a bar, or the oldest block kept. Dwells are skipped, and a later [`Planner::replan`] does
    /// not repeat the part of a dwell waited before this place. Empty if there is no path back.
    pub fn retrace(&mut self, from: PathPlace) -> VecDeque<Profile> {
        let back = Replan::backward(&self.record, &self.look_ahead, from);
        if !back.profiles.is_empty() {
            self.record.record_turn(from);
        }
        back.profiles
    }

    /// Plans a segment. One that may blend is held back until the next one, or [`Planner::flush`], decides how it ends;
    /// with G500 until no later block can change its speed. A chain ends at rest where G500 changes to G501 or back.
    /// Segment numbers follow the order of the segments in any case.
    ///
    /// # Errors
    /// Returns an alarm at the segment's origin; the segment outputs nothing, and those held back end at rest:
    /// `LIMIT_ZERO` when a motor that moves has a limit that is not above zero, `VALUE_NOT_FINITE`,
    /// `VALUE_OUT_OF_RANGE` for a negative time, a feedrate that is not above zero, or a duration above 1e9 s.
    pub fn push(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let pushed = self.plan_segment(segment, out);
        if pushed.is_err() || segment.end == SegmentEnd::ExactStop {
            self.flush(out);
        }
        pushed.map_err(|alarm| alarm.at(segment.origin))
    }

    /// Outputs the blocks held back, ending at rest.
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

    /// Returns the settings in use.
    pub fn settings(&self) -> &CoordinateSystemSettings {
        &self.settings
    }

    /// Plans with these settings from the next segment on.
    pub fn set_settings(&mut self, settings: &CoordinateSystemSettings) {
        self.settings = settings.clone();
    }

    /// Returns the number of the last segment pushed; 0 before the first.
    pub fn last_segment(&self) -> u64 {
        self.last_segment
    }
}

/// Returns the consumer of a chain's blocks.
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
