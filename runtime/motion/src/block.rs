//! A planned block of a chain, before look-ahead sets its pace.

use tandem_model::Origin;
use tandem_model::profile::{ChainPlace, Law, Pace, Profile, RampedMotion};

/// The contents of a ramped profile without a pace. Tens of thousands of these blocks are held back and
/// recorded, so they must be small.
#[derive(Debug, Clone)]
pub(crate) struct RampedBlock {
    pub(crate) segment: u64,
    pub(crate) epoch: u32,
    pub(crate) origin: Origin,
    pub(crate) ramped: RampedMotion,
    pub(crate) place: ChainPlace,
}

impl RampedBlock {
    /// Returns true if the block's own path is at rest at this plan time.
    pub(crate) fn begins_at_rest(&self, plan_s: f64) -> bool {
        self.ramped.begun_s + plan_s == 0.0
    }

    pub(crate) fn ends_at_rest(&self) -> bool {
        self.ramped.next.is_none()
    }

    /// Returns the profile as planned, without look-ahead.
    pub(crate) fn profile(&self) -> Profile {
        let law = Law::Ramped {
            block: self.ramped.clone(),
            place: self.place,
        };
        self.by(law, self.ramped.plan_s, self.ends_at_rest())
    }

    /// Converts the block to a profile that passes it at this pace, in this time.
    #[inline]
    pub(crate) fn paced(&self, pace: Pace, duration_s: f64, exact_stop: bool) -> Profile {
        let block = self.ramped.clone();
        self.by(Law::Paced { block, pace }, duration_s, exact_stop)
    }

    #[inline]
    fn by(&self, law: Law, duration_s: f64, exact_stop: bool) -> Profile {
        Profile {
            segment: self.segment,
            epoch: self.epoch,
            origin: self.origin,
            law,
            duration_s,
            exact_stop,
        }
    }
}
