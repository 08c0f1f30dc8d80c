//! Segments in, profiles out.

use std::collections::VecDeque;

use tandem_model::Alarm;
use tandem_model::alarm::{VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Segment, SegmentMotion};
use tandem_model::profile::{Law, Profile, TimeBase};
use tandem_model::settings::CoordinateSystemSettings;

use crate::{ramped, rapid};

/// The longest profile, s: about 31 years. A longer one is an alarm, so that counting servo periods stays exact.
pub(crate) const DURATION_MAX_S: f64 = 1e9;

/// A law with the time that it takes and what scales it.
pub(crate) struct Planned {
    pub(crate) law: Law,
    pub(crate) duration_s: f64,
    pub(crate) time_base: TimeBase,
}

/// The motion stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct Planner {
    settings: CoordinateSystemSettings,
    epoch: u32,
    last_segment: u64,
}

impl Planner {
    /// A planner whose first profile has segment number 1 and epoch 0.
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        Self {
            settings: settings.clone(),
            epoch: 0,
            last_segment: 0,
        }
    }

    /// Forgets what it holds back; profiles carry this epoch from here on. Segment numbers go on.
    pub fn restart(&mut self, epoch: u32) {
        self.epoch = epoch;
    }

    /// Plans a segment: one profile in this version.
    ///
    /// # Errors
    /// An alarm at the segment's origin, and nothing put out: `LIMIT_ZERO` when a motor that moves has a limit that
    /// is not above zero, `VALUE_NOT_FINITE`, `VALUE_OUT_OF_RANGE` for a negative time, a feedrate that is not above
    /// zero, or a duration above 1e9 s.
    pub fn push(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let planned = self.plan(segment).map_err(|alarm| alarm.at(segment.origin))?;
        self.last_segment += 1;
        out.push_back(Profile {
            segment: self.last_segment,
            epoch: self.epoch,
            origin: segment.origin,
            law: planned.law,
            duration_s: planned.duration_s,
            time_base: planned.time_base,
            exact_stop: true,
        });
        Ok(())
    }

    /// Puts out what is held back: nothing in this version, which plans each segment at once.
    ///
    /// # Errors
    /// None so far.
    pub fn flush(&mut self, _out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        Ok(())
    }

    /// Number of the last segment put out; 0 before the first.
    pub fn last_segment(&self) -> u64 {
        self.last_segment
    }

    fn plan(&self, segment: &Segment) -> Result<Planned, Alarm> {
        let planned = match &segment.motion {
            SegmentMotion::Feed { path, feed } => ramped::plan(&self.settings, path, *feed)?,
            SegmentMotion::Rapid { from, to } => rapid::plan(&self.settings, *from, *to)?,
            SegmentMotion::Dwell { at, dwell_s } => Planned {
                law: Law::Rest { at: *at },
                duration_s: *dwell_s,
                time_base: TimeBase::Fixed,
            },
        };
        let duration_s = planned.duration_s;
        if !duration_s.is_finite() {
            let text = format!("The block would take {duration_s} s");
            return Err(Alarm::new(&VALUE_NOT_FINITE, text));
        }
        if !(0.0..=DURATION_MAX_S).contains(&duration_s) {
            let text = format!("The block would take {duration_s} s, not 0 to {DURATION_MAX_S} s");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
        Ok(planned)
    }
}
