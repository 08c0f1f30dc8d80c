//! A piece of a line at one speed, as fast as it goes: up to a peak, along at it, and down.
//!
//! Where a motor has a maximum jerk, the acceleration goes into the peak and out of it with that; at the ends of the
//! piece it is what the ramps beside it have, since there the motion goes over to another direction.

use tandem_model::profile::{SlewRoom, SpeedGrowth};

use super::grid::Piece;
use super::paced::{self, Step};

/// The peak is found in so many halvings of what it may be: to the last bits that count.
const HALVINGS: u32 = 60;

/// What the motors allow on a straight piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Straight {
    /// The square of the rate changes by at most this per second of plan time.
    pub(super) change: f64,
    /// The change of the rate changes by at most this per second; infinite: without a limit.
    pub(super) jerk: f64,
}

/// The way from a rate to the peak, or from the peak to a rate.
#[derive(Debug, Clone, Copy)]
struct Flank {
    /// Square of the rate where the acceleration begins to fall.
    knee: f64,
    /// Change of the rate per second up to there.
    rate_change: f64,
    /// Change of that per second from there on.
    rate_jerk: f64,
    /// Plan time up to there, s.
    steady_s: f64,
    /// Plan time from there to the peak, s.
    bend_s: f64,
}

impl Flank {
    fn plan_s(self) -> f64 {
        self.steady_s + self.bend_s
    }
}

impl Straight {
    /// Adds the steps between these squares of the rate at both ends.
    pub(super) fn pass(self, piece: &Piece, [before, after]: [f64; 2], steps: &mut Vec<Step>) {
        let h_s = piece.length_s();
        let Some(peak) = self.peak(piece, [before, after]) else {
            return self.pass_evenly(piece, [before, after], steps);
        };
        let [up, down] = [before, after].map(|square| self.flank(square, peak));
        let bent_s = piece.from_s + up.steady_s;
        let even_s = bent_s + up.bend_s;
        let braked_s = (piece.to_s - down.steady_s).max(even_s);
        let left_s = (braked_s - down.bend_s).max(even_s);
        let [driving, braking, none] = [[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
        for ([from_s, to_s], [start, end], [rate_change, rate_jerk], room) in [
            (
                [piece.from_s, bent_s],
                [before, up.knee],
                [up.rate_change, 0.0],
                driving,
            ),
            (
                [bent_s, even_s],
                [up.knee, peak],
                [up.rate_change, up.rate_jerk],
                driving,
            ),
            ([even_s, left_s], [peak, peak], [0.0, 0.0], none),
            (
                [left_s, braked_s],
                [peak, down.knee],
                [0.0, down.rate_jerk],
                braking,
            ),
            (
                [braked_s, piece.to_s],
                [down.knee, after],
                [-down.rate_change, 0.0],
                braking,
            ),
        ] {
            let step = Step {
                from_s,
                to_s,
                start,
                end,
                growth: SpeedGrowth::default(),
                rate_change,
                rate_jerk,
                room: self.room(peak, room),
            };
            paced::push(steps, step, h_s);
        }
    }

    /// In one step: there is no room for a peak.
    fn pass_evenly(self, piece: &Piece, [before, after]: [f64; 2], steps: &mut Vec<Step>) {
        let h_s = piece.length_s();
        let share = (after - before) / (self.change * h_s);
        let step = Step {
            from_s: piece.from_s,
            to_s: piece.to_s,
            start: before,
            end: after,
            growth: SpeedGrowth::default(),
            rate_change: (after - before) / (2.0 * h_s),
            rate_jerk: 0.0,
            room: self.room(before.max(after), [(-share).max(0.0), share.max(0.0)]),
        };
        paced::push(steps, step, h_s);
    }

    fn room(self, peak: f64, [braking, driving]: [f64; 2]) -> SlewRoom {
        SlewRoom {
            // At the rate w the velocity of the motor that limits is w times 2 a/change.
            slope: self.change / (2.0 * peak.sqrt()),
            braking,
            driving,
        }
    }

    /// Largest square of the rate; `None`: not even the larger end can be one.
    fn peak(self, piece: &Piece, [before, after]: [f64; 2]) -> Option<f64> {
        let h_s = piece.length_s();
        let least = before.max(after);
        let most = f64::midpoint(before + after, self.change * h_s)
            .min(piece.cap)
            .max(least);
        if self.jerk.is_infinite() {
            return Some(most);
        }
        let fits = |peak: &f64| self.flank(before, *peak).plan_s() + self.flank(after, *peak).plan_s() <= h_s;
        if fits(&most) {
            return Some(most);
        }
        let mut low = Some(least).filter(fits)?;
        let mut high = most;
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(low, high);
            if fits(&middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(low)
    }

    /// From the rate w to the peak `w_p` at the maximum acceleration c, and the last of it with the maximum jerk j: that
    /// takes c/j and gains `c^2/(2 j)`. Short of that it begins with a smaller acceleration.
    fn flank(self, square: f64, peak: f64) -> Flank {
        let steepest = self.change / 2.0;
        let [rate, top] = [square.sqrt(), peak.sqrt()];
        if self.jerk.is_infinite() {
            return Flank {
                knee: peak,
                rate_change: steepest,
                rate_jerk: 0.0,
                steady_s: (peak - square) / self.change,
                bend_s: 0.0,
            };
        }
        let rate_change = steepest.min((2.0 * self.jerk * (top - rate)).max(0.0).sqrt());
        let time_s = rate_change / self.jerk;
        let knee = (top - rate_change * time_s / 2.0).max(rate).powi(2);
        Flank {
            knee,
            rate_change,
            rate_jerk: -self.jerk,
            steady_s: (knee - square).max(0.0) / self.change,
            bend_s: time_s * (top - rate_change * time_s / 6.0),
        }
    }
}
