//! A planned block of a chain, before look-ahead sets its pace.

use tandem_model::Origin;
use tandem_model::flow::Path;
use tandem_model::profile::{ChainPlace, Law, Lead, Pace, Profile, TimeBase};
use tandem_model::ramp::UnitRamp;

/// What a ramped profile is made of, without room for a pace: held back and recorded by the ten thousand.
#[derive(Debug, Clone)]
pub(crate) struct RampedBlock {
    pub(crate) segment: u64,
    pub(crate) epoch: u32,
    pub(crate) origin: Origin,
    pub(crate) path: Path,
    pub(crate) speed: f64,
    pub(crate) start: UnitRamp,
    pub(crate) stop: UnitRamp,
    /// How far the start ramp has come at plan time 0, s.
    pub(crate) begun_s: f64,
    /// The block that begins along the stop ramp; `None`: this one ends at rest.
    pub(crate) next: Option<Lead>,
    /// Plan time at its end, s.
    pub(crate) plan_s: f64,
    pub(crate) place: ChainPlace,
}

impl RampedBlock {
    /// True when its path rests at a plan time by itself.
    pub(crate) fn begins_at_rest(&self, plan_s: f64) -> bool {
        self.begun_s + plan_s == 0.0
    }

    pub(crate) fn ends_at_rest(&self) -> bool {
        self.next.is_none()
    }

    /// As planned.
    pub(crate) fn profile(&self) -> Profile {
        let law = Law::Ramped {
            path: self.path.clone(),
            speed: self.speed,
            start: self.start,
            stop: self.stop,
            begun_s: self.begun_s,
            next: self.next.clone(),
            place: self.place,
        };
        self.by(law, self.plan_s, self.ends_at_rest())
    }

    /// At a pace that takes this time.
    #[inline]
    pub(crate) fn paced(&self, pace: &Pace, duration_s: f64, exact_stop: bool) -> Profile {
        let law = Law::Paced {
            path: self.path.clone(),
            speed: self.speed,
            start: self.start,
            stop: self.stop,
            begun_s: self.begun_s,
            next: self.next.clone(),
            plan_s: self.plan_s,
            pace: *pace,
        };
        self.by(law, duration_s, exact_stop)
    }

    #[inline]
    fn by(&self, law: Law, duration_s: f64, exact_stop: bool) -> Profile {
        Profile {
            segment: self.segment,
            epoch: self.epoch,
            origin: self.origin,
            law,
            duration_s,
            time_base: TimeBase::Feed,
            exact_stop,
        }
    }
}
