//! Switch of a channel to another plan: at a position ahead on the path, or at once if the channel is at
//! rest.

use tandem_model::profile::{Law, PathPlace, Profile};

use crate::channel::{Channel, Hold};
use crate::control::Event;
use crate::profile_queue::ProfileConsumer;
use crate::rest;
use crate::splice::Joint;

/// Tolerance for rounding of the override factor.
const ROUNDING: f64 = 1e-9;

impl Channel {
    /// Takes the splice that [`Control::Splice`](crate::Control::Splice) announced.
    pub(crate) fn take_splice(&mut self) {
        let Ok(splice) = self.splices.pop() else { return };
        let Some(place) = splice.at else {
            self.abandon_splice();
            let rests = self.braking.is_none() && (self.current.is_none() || self.hold == Hold::AtRest);
            if rests {
                self.abandon_profile();
            }
            return self.settle(splice.profiles, rests);
        };
        if self.splice.is_none() && self.stopping.is_none() && self.is_ahead(place) {
            self.splice = Some(splice);
        } else {
            self.settle(splice.profiles, false);
        }
    }

    /// Returns true if the motion has not reached this position.
    fn is_ahead(&self, place: PathPlace) -> bool {
        if place.segment != self.last_segment {
            return place.segment > self.last_segment;
        }
        match self.current.as_ref().map(|profile| &profile.law) {
            Some(Law::Paced { pace, .. }) => place.plan_s > pace.plan_time(self.time.now_s()),
            _ => false,
        }
    }

    /// Returns the joint of this profile with the new plan.
    pub(crate) fn joint(&self, profile: &Profile) -> Option<Joint> {
        self.splice.as_ref()?.joint(profile)
    }

    /// Switches to the new plan at the joint; `beyond_s` is the profile time after the joint. Returns false
    /// if the new plan is slower there.
    pub(crate) fn switch_over(&mut self, joint: Joint, beyond_s: f64) -> bool {
        let Some(mut splice) = self.splice.take() else {
            return false;
        };
        let factor = self.time.rate() * joint.ratio;
        let at_s = beyond_s * joint.ratio;
        let taken = factor <= 1.0 + ROUNDING
            && rest::may_switch_over(&mut splice.profiles, factor, at_s, self.period_s);
        // A plan to which the motion may switch has a first profile.
        if taken && let Ok(first) = splice.profiles.pop() {
            self.current = Some(first);
            self.time.start_profile(factor.min(1.0), at_s);
            self.history.check();
        }
        self.settle(splice.profiles, taken);
        taken
    }

    /// Discards the new plan, and reports it as rejected.
    pub(crate) fn abandon_splice(&mut self) {
        if let Some(splice) = self.splice.take() {
            self.settle(splice.profiles, false);
        }
    }

    /// Reports the result of a splice, and returns the ring that the servo no longer reads to the
    /// coordinator.
    fn settle(&mut self, profiles: ProfileConsumer, taken: bool) {
        let unread = if taken {
            std::mem::replace(&mut self.profiles, profiles)
        } else {
            profiles
        };
        // The ring has room, because the coordinator sends one splice at a time.
        let _ = self.unread.push(unread);
        self.report_event(Event::Spliced { taken });
    }
}
