//! Steps of the rate: the parts into which a piece is divided for output.

use tandem_model::profile::{SlewRoom, SpeedGrowth};

use crate::limit::ACCELERATION_RESERVE;

/// Relative difference below which two squares of rates differ only by rounding.
const SAME_RATE: f64 = 1e-12;

/// Share of a piece below which a step is only rounding.
const SHARE_MIN: f64 = 1e-12;

/// Share of a motor's acceleration above which a step is not joined with steps that use less. Reason: joined,
/// these steps would allow only slow changes of the override.
const KEPT_APART: f64 = 0.5;

/// A part of a block on which the square of the rate changes linearly from `start` to `end`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RateStep {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) start: f64,
    pub(super) end: f64,
    /// Growth of the programmed speed from the start of the step; none if the rate is by plan time.
    pub(super) growth: SpeedGrowth,
    /// Change of the rate per second; rate by plan time or by distance.
    pub(super) rate_change: f64,
    /// Change of `rate_change` per second.
    pub(super) rate_jerk: f64,
    /// Change of `rate_change` per second of plan time.
    pub(super) rate_slope: f64,
    /// Duration, s, if the planner knows it; otherwise it follows from the rates.
    pub(super) duration_s: Option<f64>,
    pub(super) room: SlewRoom,
}

impl RateStep {
    fn is_at(&self, square: f64) -> bool {
        (self.start - square).abs() < SAME_RATE * square && (self.end - square).abs() < SAME_RATE * square
    }

    /// Returns the duration, s: plan time or distance, divided by the mean rate. For a rate linear in time
    /// the mean rate is the mean of the end rates w0 and w1. For a rate of second degree, with the change c
    /// at the start and the duration t, the mean is `(2 w0 + w1)/3 + c t/6`.
    pub(super) fn duration_s(&self) -> f64 {
        if let Some(duration_s) = self.duration_s {
            return duration_s;
        }
        let plan_s = self.to_s - self.from_s;
        if self.rate_jerk != 0.0 {
            let ends = (2.0 * self.start.sqrt() + self.end.sqrt()) / 3.0;
            let root = (ends * ends + self.rate_change * plan_s * 2.0 / 3.0)
                .max(0.0)
                .sqrt();
            return 2.0 * plan_s / (ends + root);
        }
        let end = self.end.sqrt() * self.growth.speed(plan_s);
        2.0 * self.growth.distance_s(plan_s) / (self.start.sqrt() + end)
    }

    /// Returns true if the rate is constant.
    pub(super) fn is_even(&self) -> bool {
        self.growth.is_none() && self.rate_change == 0.0 && self.rate_jerk == 0.0 && self.rate_slope == 0.0
    }

    /// Removes the part before a plan time from a step at a constant rate, and returns this part. Returns `None`
    /// if the rate changes, or if the step does not extend beyond the plan time.
    pub(super) fn split(&mut self, at_s: f64) -> Option<Self> {
        if !self.is_even() || self.to_s <= at_s || self.from_s >= at_s {
            return None;
        }
        let first = Self { to_s: at_s, ..*self };
        self.from_s = at_s;
        Some(first)
    }

    fn joins(&self, next: &RateStep) -> bool {
        let busy = |step: &RateStep| step.room.braking.max(step.room.driving) > KEPT_APART;
        let as_planned = |step: &RateStep| step.growth.is_none() && step.is_at(self.start);
        as_planned(self) && as_planned(next) && busy(self) == busy(next)
    }
}

/// Adds a step, unless it is only rounding. Joins consecutive steps at the same constant rate.
pub(super) fn push(steps: &mut Vec<RateStep>, step: RateStep, piece_s: f64) {
    if step.to_s - step.from_s <= SHARE_MIN * piece_s {
        return;
    }
    // The step is planned in shares of the acceleration without the reserve; the output is in shares of the
    // whole acceleration.
    let room = SlewRoom {
        braking: step.room.braking * (1.0 - ACCELERATION_RESERVE),
        driving: step.room.driving * (1.0 - ACCELERATION_RESERVE),
        ..step.room
    };
    let step = RateStep { room, ..step };
    if let Some(last) = steps.last_mut()
        && last.joins(&step)
    {
        last.to_s = step.to_s;
        // The rates are equal except for rounding. A rate change that was planned for a short step must not
        // apply to the longer one.
        (last.rate_change, last.rate_jerk) = (0.0, 0.0);
        last.room = last.room.worst(step.room);
        return;
    }
    steps.push(step);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_at_one_rate_join_to_one_without_change() {
        let step = |from_s, to_s, end, rate_change, rate_jerk| RateStep {
            from_s,
            to_s,
            start: 0.25,
            end,
            rate_change,
            rate_jerk,
            ..RateStep::default()
        };
        let mut steps = Vec::new();
        // A deceleration caused by rounding, in a step too long to be omitted as rounding.
        push(&mut steps, step(0.0, 1e-11, 0.25 - 1e-14, -10.0, 100.0), 1.0);
        push(&mut steps, step(1e-11, 1.0, 0.25, 0.0, 0.0), 1.0);
        assert_eq!(steps.len(), 1);
        assert!(steps[0].rate_change.abs() < 1e-9, "{}", steps[0].rate_change);
        assert!(steps[0].rate_jerk.abs() < 1e-9, "{}", steps[0].rate_jerk);
        assert!((steps[0].duration_s() - 2.0).abs() < 1e-9);
    }
}
