//! A block on a smoothed path (`smooth`).

use tandem_model::AxisVector;
use tandem_model::profile::CubicMotion;

/// A block on a smoothed path. Plan time is the distance along the chain divided by the speed of the block.
#[derive(Debug)]
pub(crate) struct SmoothBlock {
    /// Programmed start and end.
    pub(crate) programmed: [AxisVector; 2],
    /// Speed, path units per second.
    pub(crate) speed: f64,
    pub(crate) begins_at_rest: bool,
    pub(crate) ends_at_rest: bool,
    /// Shortest time in which the speed may change by [`SmoothBlock::speed`], s: the ramp from rest or to rest.
    pub(crate) ramp_s: f64,
    /// The stretches in order; at least one.
    pub(crate) stretches: Box<[Stretch]>,
    /// Plan time at the end of the block, s.
    pub(crate) plan_s: f64,
}

/// A stretch of a block on which each axis is a polynomial of third degree in plan time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stretch {
    /// Plan time at its start, s.
    pub(crate) from_s: f64,
    /// Position and its first to third derivative at its start.
    pub(crate) derivatives: [AxisVector; 4],
}

impl SmoothBlock {
    /// Returns the distance of the path from the programmed end of the block, mm.
    pub(crate) fn corner_distance(&self) -> f64 {
        let last = self.stretches.last();
        last.map_or(0.0, |last| self.motion(last, self.plan_s).corner_distance())
    }

    /// Returns a stretch by its index, and the plan time at its end, s.
    pub(crate) fn stretch(&self, index: usize) -> Option<(&Stretch, f64)> {
        let end_s = self
            .stretches
            .get(index + 1)
            .map_or(self.plan_s, |next| next.from_s);
        Some((self.stretches.get(index)?, end_s))
    }

    /// Returns the stretch at a plan time.
    pub(crate) fn stretch_at(&self, plan_s: f64) -> &Stretch {
        let after = self.stretches.partition_point(|stretch| stretch.from_s <= plan_s);
        &self.stretches[after.saturating_sub(1)]
    }

    /// Returns the motion along a stretch that ends at a plan time, for a profile.
    pub(crate) fn motion(&self, stretch: &Stretch, to_s: f64) -> CubicMotion {
        CubicMotion {
            programmed: self.programmed,
            speed: self.speed,
            from_s: stretch.from_s,
            to_s,
            derivatives: stretch.derivatives,
            plan_s: self.plan_s,
            ends_at_rest: self.ends_at_rest,
        }
    }
}

impl Stretch {
    /// Returns velocity and acceleration with respect to plan time, at this plan time.
    pub(crate) fn motion_at(&self, plan_s: f64) -> [AxisVector; 2] {
        let t = plan_s - self.from_s;
        let [_, first, second, third] = &self.derivatives;
        let acceleration = second.plus(third.scaled(t));
        let velocity = first.plus(second.scaled(t)).plus(third.scaled(t * t / 2.0));
        [velocity, acceleration]
    }

    /// Returns true if each axis moves at a constant velocity.
    pub(crate) fn is_straight(&self) -> bool {
        let [_, _, second, third] = &self.derivatives;
        *second == AxisVector::ZERO && *third == AxisVector::ZERO
    }
}
