//! A plan that replaces the running plan, from a position on the path.
//!
//! The profiles of the new plan are in a separate ring, so no profile is discarded before the motion has
//! switched over. Then the old ring returns to the coordinator. At the position, both plans have the same
//! setpoint. The override factor changes so that the motion keeps its velocity.

use tandem_model::profile::{Law, PathPlace, Profile};

use crate::profile_queue::ProfileConsumer;

/// Maximum number of waiting splices, and of rings that wait for their return. The coordinator sends only one
/// splice at a time.
pub(crate) const SPLICES_MAX: usize = 4;

/// Share of the override at which the motion arrives at the position. It ensures that the new plan is never
/// slower there.
pub(crate) const APPROACH: f64 = 0.99;

/// A plan that will replace the running plan.
#[derive(Debug)]
pub struct Splice {
    /// Position in a paced block that runs or is still ahead. `None` for a machine at rest, under feed hold
    /// or between two blocks.
    pub at: Option<PathPlace>,
    /// The profiles that run from this position on.
    pub profiles: ProfileConsumer,
}

impl Splice {
    /// Returns the joint at which this profile changes to the new plan.
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

/// Joint at which a profile changes to a new plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Joint {
    /// Time of the joint within the old profile, s.
    pub(crate) at_s: f64,
    /// Rate of the old plan divided by the rate of the new plan. The override factor is multiplied by this
    /// ratio.
    pub(crate) ratio: f64,
}
