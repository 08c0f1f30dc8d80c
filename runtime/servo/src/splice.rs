//! A plan that replaces the running one from a certain place on the path.
//!
//! Its profiles are in a ring of their own, so nothing is discarded before the motion has switched over; the discarded ring then goes
//! back to the coordinator. At that place both plans have the same position, and the override factor changes so that the motion keeps
//! its velocity.

use tandem_model::profile::{Law, PathPlace, Profile};

use crate::profile_queue::ProfileConsumer;

/// Maximum number of waiting splices, and of rings that wait for their return: the coordinator sends one
/// splice at a time.
pub(crate) const SPLICES_MAX: usize = 4;

/// Share of the override at which the motion reaches the place, so that the new plan is never slower there.
pub(crate) const APPROACH: f64 = 0.99;

/// A plan that will replace the running one.
#[derive(Debug)]
pub struct Splice {
    /// Place within a paced block that is running or still follows. `None` for a machine at rest, under feed hold or
    /// between two blocks.
    pub at: Option<PathPlace>,
    /// The profiles that run from there on.
    pub profiles: ProfileConsumer,
}

impl Splice {
    /// Returns where this profile changes to the new plan.
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

/// Place where a profile changes to a new plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Joint {
    /// Time within the old profile, s.
    pub(crate) at_s: f64,
    /// Rate of the old plan divided by that of the new one: the override factor is multiplied by this ratio.
    pub(crate) ratio: f64,
}
