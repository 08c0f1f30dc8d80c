//! Segments in, profiles out.

use std::collections::VecDeque;

use tandem_model::Alarm;
use tandem_model::flow::Segment;
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;

/// The motion stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct Planner {
    epoch: u32,
    last_segment: u64,
}

impl Planner {
    /// A planner whose first profile has segment number 1 and epoch 0.
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        let _ = settings;
        Self {
            epoch: 0,
            last_segment: 0,
        }
    }

    /// Forgets what it holds back; profiles carry this epoch from here on. Segment numbers go on.
    pub fn restart(&mut self, epoch: u32) {
        self.epoch = epoch;
    }

    /// Plans a segment.
    ///
    /// # Errors
    /// An alarm when the segment cannot be planned; nothing is put out then.
    pub fn push(&mut self, segment: &Segment, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let _ = (segment, out);
        Ok(())
    }

    /// Puts out what is held back.
    ///
    /// # Errors
    /// An alarm when it cannot be planned.
    pub fn flush(&mut self, out: &mut VecDeque<Profile>) -> Result<(), Alarm> {
        let _ = out;
        Ok(())
    }

    /// Number of the last segment put out; 0 before the first.
    pub fn last_segment(&self) -> u64 {
        self.last_segment
    }
}
