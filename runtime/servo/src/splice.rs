//! Another plan in place of the one that runs: behind a place on the path that is still to come, or at rest at once.
//!
//! The profiles of the new plan stand in a ring of their own, so nothing is thrown away before the motion has gone over,
//! and what is thrown away then goes back to the coordinator with its ring. At the place both plans have the same
//! position, and the override factor changes so that the motion keeps its velocity.

use rtrb::Consumer;
use tandem_model::profile::{Law, PathPlace, Profile};

use crate::channel::{Channel, Hold};
use crate::control::Event;
use crate::rest;

/// Splices that may wait, and rings that may wait to be taken back: the coordinator gives one at a time.
pub(crate) const SPLICES_MAX: usize = 4;

/// Share of the override at which the motion comes to the place, so that the new plan is never slower there.
pub(crate) const APPROACH: f64 = 0.99;

/// Rounding of the override factor.
const ROUNDING: f64 = 1e-9;

/// A plan that is to take the place of the one that runs.
#[derive(Debug)]
pub struct Splice {
    /// Within a paced block that is still to come or runs; `None`: where the machine rests, under feed hold or between
    /// two blocks.
    pub at: Option<PathPlace>,
    /// What runs from there on.
    pub profiles: Consumer<Profile>,
}

impl Splice {
    /// Where this profile goes over to the new plan.
    pub(crate) fn joint(&self, profile: &Profile) -> Option<Joint> {
        let place = self.at.filter(|place| place.segment == profile.segment)?;
        let Law::Paced { pace, .. } = &profile.law else {
            return None;
        };
        let (at_s, rate) = pace.when(place.plan_s)?;
        let first = self.profiles.peek().ok()?;
        let Law::Paced { pace: new, .. } = &first.law else {
            return None;
        };
        let ratio = rate / new.pieces().first()?.rate;
        Some(Joint { at_s, ratio })
    }
}

/// Where a profile goes over to a new plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Joint {
    /// Time within the old profile, s.
    pub(crate) at_s: f64,
    /// Rate of the old plan over that of the new one: times the override factor it is the new one.
    pub(crate) ratio: f64,
}

impl Channel {
    /// Takes the splice that the control told of.
    pub(crate) fn take_splice(&mut self) {
        let Ok(splice) = self.splices.pop() else { return };
        match splice.at {
            None => {
                self.give_up_splice();
                let may = self.rests();
                if may {
                    self.give_up();
                }
                self.settle(splice.profiles, may);
            }
            Some(place) => {
                if self.splice.is_none() && self.stopping.is_none() && self.is_ahead(place) {
                    self.splice = Some(splice);
                } else {
                    self.settle(splice.profiles, false);
                }
            }
        }
    }

    fn rests(&self) -> bool {
        self.braking.is_none() && (self.current.is_none() || self.hold == Hold::AtRest)
    }

    /// True when the motion has not come to this place.
    fn is_ahead(&self, place: PathPlace) -> bool {
        if place.segment != self.last_segment {
            return place.segment > self.last_segment;
        }
        match &self.current {
            Some(Profile {
                law: Law::Paced { pace, .. },
                ..
            }) => place.plan_s > pace.plan_time(self.time.now_s()),
            _ => false,
        }
    }

    /// Where this profile goes over to the new plan.
    pub(crate) fn joint(&self, profile: &Profile) -> Option<Joint> {
        self.splice.as_ref()?.joint(profile)
    }

    /// Goes over at the joint, with the profile time beyond it. False: not, since the new plan is slower there.
    pub(crate) fn go_over(&mut self, joint: Joint, beyond_s: f64) -> bool {
        let Some(mut splice) = self.splice.take() else {
            return false;
        };
        let factor = self.time.rate() * joint.ratio;
        let at_s = beyond_s * joint.ratio;
        let first = if factor <= 1.0 + ROUNDING
            && rest::may_go_over(&mut splice.profiles, factor, at_s, self.period_s)
        {
            splice.profiles.pop().ok()
        } else {
            None
        };
        let Some(first) = first else {
            self.settle(splice.profiles, false);
            return false;
        };
        self.current = Some(first);
        self.time.rescale(factor.min(1.0), at_s);
        self.settle(splice.profiles, true);
        true
    }

    /// A splice that has not come about never will: the plan is given up.
    pub(crate) fn give_up_splice(&mut self) {
        if let Some(splice) = self.splice.take() {
            self.settle(splice.profiles, false);
        }
    }

    /// Says what has become of a splice, and gives back the ring that is not read any more.
    fn settle(&mut self, profiles: Consumer<Profile>, taken: bool) {
        let unread = if taken {
            std::mem::replace(&mut self.profiles, profiles)
        } else {
            profiles
        };
        // There is room: one splice at a time.
        let _ = self.unread.push(unread);
        self.tell(Event::Spliced { taken });
    }
}
