//! What a channel does when its cycles are late: it holds on its path.

use tandem_model::AxisVector;
use tandem_model::profile::{Law, Profile};

use crate::channel::{Channel, Hold};
use crate::control::Event;

impl Channel {
    /// Before the cycle after so many that were left out. `keeps_speed`: the motors still have the speed of the last cycle;
    /// otherwise they have come to rest at their last command. In a thread the hold waits until the tool is out. True when
    /// an event was put out.
    pub(crate) fn hold_after_missed(&mut self, cycles: u64, keeps_speed: bool) -> bool {
        if !self.is_in_motion() {
            return false;
        }
        if !keeps_speed {
            self.time.stand();
            self.braking = None;
            self.velocity = AxisVector::ZERO;
        }
        let goes_on = !self.hold.holds() && self.stopping.is_none() && !self.faulted;
        if goes_on {
            self.hold = Hold::ComingToRest;
            self.tell(Event::Late { cycles });
        } else {
            self.tell_joint(Event::Late { cycles });
        }
        true
    }

    /// True when set points move, or are about to: not in a dwell, under a hold, or before the drives have power.
    fn is_in_motion(&self) -> bool {
        let is_motion = |profile: &Profile| !matches!(profile.law, Law::Rest { .. });
        match &self.current {
            _ if self.braking.is_some() => true,
            _ if self.hold == Hold::AtRest => false,
            Some(profile) => is_motion(profile) && (self.ended_cycles.is_some() || self.time.rate() > 0.0),
            None => !self.faulted && !self.power.is_enabling() && self.profiles.peek().is_ok_and(is_motion),
        }
    }
}
