//! A piece of a block at one programmed speed, passed as fast as possible: the rate rises to a peak, stays
//! there, and falls.

use tandem_model::profile::SlewRoom;

use super::step::{self, RateStep};

/// The limits of the rate on a piece, if they are constant over the piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Straight {
    /// Largest change of the square of the rate per second of plan time.
    pub(super) change: f64,
}

impl Straight {
    /// Adds the steps between the squares of the rate at both ends, up to the square `cap`.
    pub(super) fn pass(
        self,
        [from_s, to_s]: [f64; 2],
        cap: f64,
        [before, after]: [f64; 2],
        steps: &mut Vec<RateStep>,
    ) {
        let h_s = to_s - from_s;
        let peak = f64::midpoint(before + after, self.change * h_s)
            .min(cap)
            .max(before.max(after));
        let rises_to_s = from_s + (peak - before) / self.change;
        let falls_from_s = (to_s - (peak - after) / self.change).max(rises_to_s);
        let step = |from_s: f64, to_s: f64, [start, end]: [f64; 2], sign: f64| RateStep {
            from_s,
            to_s,
            start,
            end,
            rate_change: sign * self.change / 2.0,
            room: self.room(peak, [(-sign).max(0.0), sign.max(0.0)]),
            ..RateStep::default()
        };
        for step in [
            step(from_s, rises_to_s, [before, peak], 1.0),
            step(rises_to_s, falls_from_s, [peak; 2], 0.0),
            step(falls_from_s, to_s, [peak, after], -1.0),
        ] {
            step::push(steps, step, h_s);
        }
    }

    /// Returns the room that the motors leave, up to this square of the rate, if the motion uses these shares
    /// of the maximum acceleration.
    pub(super) fn room(self, peak: f64, [braking, driving]: [f64; 2]) -> SlewRoom {
        SlewRoom {
            // At the rate w the velocity of the limiting motor is w times 2 a/change.
            slope: self.change / (2.0 * peak.sqrt()),
            braking,
            driving,
        }
    }
}
