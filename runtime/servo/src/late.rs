//! Reaction of a channel to late cycles: the channel holds on its path.

use tandem_model::AxisVector;
use tandem_model::profile::{Law, Profile};

use crate::channel::{Channel, Hold};
use crate::control::Event;

/// Time after the last change of setpoints during which a run is treated as moving, s. Reason: at the turning
/// point of an axis the next motion may not have arrived yet. The time exceeds the time in which a task
/// passes on the next motion.
const RECENT_S: f64 = 0.1;

impl Channel {
    /// Prepares the cycle after missed cycles. If `keeps_speed`, the motors still have the speed of the last
    /// cycle; otherwise they have stopped at their last command. In a thread the motion decelerates in phase.
    /// Returns true if the channel was in motion.
    pub(crate) fn hold_after_missed(&mut self, cycles: u64, keeps_speed: bool) -> bool {
        if !self.is_in_motion() {
            return false;
        }
        if !keeps_speed {
            self.time.stop();
            self.braking = None;
            self.velocity = AxisVector::ZERO;
        }
        let goes_on = !self.hold.holds() && self.stopping.is_none() && !self.faulted;
        if goes_on {
            self.hold_in_phase();
            self.report_event(Event::Late { cycles });
        } else {
            // A feed hold that waits for the end of a thread now acts in the thread.
            self.holds_in_thread |= self.hold == Hold::ComingToRest;
            self.report_joint(Event::Late { cycles });
        }
        true
    }

    /// Returns true if setpoints change, are about to change, or have just changed. Returns false in a dwell,
    /// under a hold, and before the drives have power.
    fn is_in_motion(&self) -> bool {
        let is_motion = |profile: &Profile| !matches!(profile.law, Law::Rest { .. });
        match &self.current {
            _ if self.braking.is_some() => true,
            _ if self.hold == Hold::AtRest => false,
            Some(profile) => {
                let is_about_to = || self.override_of(profile) > 0.0 && !self.hold.holds();
                is_motion(profile) && (self.ended_cycles.is_some() || self.time.rate() > 0.0 || is_about_to())
            }
            None if self.faulted || self.power.is_enabling() => false,
            None => match self.profiles.peek() {
                Ok(next) => is_motion(next),
                Err(_) => self.still_cycles as f64 * self.period_s <= RECENT_S,
            },
        }
    }
}
