//! A piece of a block at one programmed speed, passed as fast as possible: the rate rises to a peak, stays
//! there, and falls.
//!
//! If a motor has a maximum jerk, it limits the acceleration on both flanks of the peak, and at an end beyond
//! which the rate is constant. At any other end the acceleration is that of the adjacent ramp, where the
//! motion turns into another direction.

use tandem_model::bisect;
use tandem_model::profile::SlewRoom;

use super::step::{self, RateStep};

/// Number of halvings of the range of the peak, enough for the last significant bits.
const HALVINGS: u32 = 60;

/// The limits of the rate on a piece, if they are constant over the piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Straight {
    /// Largest change of the square of the rate per second of plan time.
    pub(super) change: f64,
    /// Largest second derivative of the rate with respect to time; infinite without a limit.
    pub(super) jerk: f64,
}

/// A part of the flank from a rate up to the peak.
#[derive(Debug, Clone, Copy)]
struct FlankPart {
    /// Squares of the rate at both ends.
    squares: [f64; 2],
    /// Changes of the rate per second at both ends.
    rate_changes: [f64; 2],
    /// Change of the rate change per second.
    rate_jerk: f64,
    plan_s: f64,
}

impl FlankPart {
    /// Returns the step from one plan time to another, for the rising flank.
    fn step(&self, from_s: f64, to_s: f64, room: SlewRoom) -> RateStep {
        RateStep {
            from_s,
            to_s,
            start: self.squares[0],
            end: self.squares[1],
            rate_change: self.rate_changes[0],
            rate_jerk: self.rate_jerk,
            room,
            ..RateStep::default()
        }
    }

    /// Returns the same part of the falling flank.
    fn reversed(&self) -> Self {
        let [low, high] = self.squares;
        let [before, after] = self.rate_changes;
        Self {
            squares: [high, low],
            rate_changes: [-after, -before],
            ..*self
        }
    }
}

/// Returns the plan time of a flank with three parts: maximum jerk up to an acceleration, constant
/// acceleration, and maximum jerk down to zero acceleration.
fn plan_s(flank: &[FlankPart; 3]) -> f64 {
    flank.iter().map(|part| part.plan_s).sum()
}

impl Straight {
    /// Adds the steps between the squares `ends` of the rate, up to the square `cap`. `is_even` states for
    /// each end whether the rate is constant beyond it.
    pub(super) fn pass(
        self,
        [from_s, to_s]: [f64; 2],
        cap: f64,
        ends: [f64; 2],
        is_even: [bool; 2],
        steps: &mut Vec<RateStep>,
    ) {
        let h_s = to_s - from_s;
        let peak = |is_even| Some((self.peak(h_s, cap, ends, is_even)?, is_even));
        // Between two ramps at constant rates the smallest acceleration causes the smallest step of
        // acceleration.
        let with_steps = || peak([false; 2]).filter(|_| is_even != [true; 2]);
        let Some((peak, is_even)) = peak(is_even).or_else(with_steps) else {
            return self.pass_evenly([from_s, to_s], ends, steps);
        };
        let [driving, braking, none] = [[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]].map(|room| self.room(peak, room));
        let [up, down] = [0, 1].map(|k| self.flank(ends[k], peak, is_even[k]));
        let mut at_s = from_s;
        for part in &up {
            let next_s = at_s + part.plan_s;
            step::push(steps, part.step(at_s, next_s, driving), h_s);
            at_s = next_s;
        }
        let [rise, steady, bend] = down.map(|part| part.reversed());
        let steady_to_s = (to_s - rise.plan_s).max(at_s);
        let bend_to_s = (steady_to_s - steady.plan_s).max(at_s);
        let even_to_s = (bend_to_s - bend.plan_s).max(at_s);
        let even = FlankPart {
            squares: [peak; 2],
            rate_changes: [0.0; 2],
            rate_jerk: 0.0,
            plan_s: even_to_s - at_s,
        };
        for step in [
            even.step(at_s, even_to_s, none),
            bend.step(even_to_s, bend_to_s, braking),
            steady.step(bend_to_s, steady_to_s, braking),
            rise.step(steady_to_s, to_s, braking),
        ] {
            step::push(steps, step, h_s);
        }
    }

    /// Adds one step at a constant acceleration, without a peak.
    fn pass_evenly(self, [from_s, to_s]: [f64; 2], [before, after]: [f64; 2], steps: &mut Vec<RateStep>) {
        let h_s = to_s - from_s;
        let share = (after - before) / (self.change * h_s);
        let step = RateStep {
            from_s,
            to_s,
            start: before,
            end: after,
            rate_change: (after - before) / (2.0 * h_s),
            room: self.room(before.max(after), [(-share).max(0.0), share.max(0.0)]),
            ..RateStep::default()
        };
        step::push(steps, step, h_s);
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

    /// Returns the square of the peak rate. Returns `None` if not even the larger end rate is possible.
    fn peak(self, h_s: f64, cap: f64, [before, after]: [f64; 2], is_even: [bool; 2]) -> Option<f64> {
        let least = before.max(after);
        let most = f64::midpoint(before + after, self.change * h_s)
            .min(cap)
            .max(least);
        if self.jerk.is_infinite() {
            return Some(most);
        }
        let fits = |peak: f64| {
            let up_s = plan_s(&self.flank(before, peak, is_even[0]));
            up_s + plan_s(&self.flank(after, peak, is_even[1])) <= h_s
        };
        if fits(most) {
            return Some(most);
        }
        fits(least).then(|| bisect([least, most], HALVINGS, fits)[0])
    }

    /// Returns the flank from the rate w up to the peak `w_p`. At the maximum jerk j, an acceleration c rises
    /// and falls in the time c/j each, and the rate gains `c^2/(2 j)` each time. c is the largest possible
    /// acceleration, or the one with the required gain. If the rate is not constant before the flank, the
    /// flank begins with the acceleration c.
    fn flank(self, square: f64, peak: f64, is_even: bool) -> [FlankPart; 3] {
        let steepest = self.change / 2.0;
        let [rate, top] = [square.sqrt(), peak.sqrt()];
        let bends = if is_even { 1.0 } else { 2.0 };
        let rate_change = if self.jerk.is_infinite() {
            steepest
        } else {
            steepest.min((bends * self.jerk * (top - rate)).max(0.0).sqrt())
        };
        let time_s = rate_change / self.jerk;
        let gain = rate_change * time_s / 2.0;
        let knee = if gain > 0.0 {
            (top - gain).max(rate).powi(2)
        } else {
            peak
        };
        let (begin, rise_s) = if is_even && gain > 0.0 {
            let begin = (rate + gain).min(top).powi(2);
            (begin.min(knee), time_s * (rate + gain / 3.0))
        } else {
            (square, 0.0)
        };
        [
            ([square, begin], [0.0, rate_change], self.jerk, rise_s),
            (
                [begin, knee],
                [rate_change; 2],
                0.0,
                (knee - begin).max(0.0) / self.change,
            ),
            (
                [knee, peak],
                [rate_change, 0.0],
                -self.jerk,
                time_s * (top - gain / 3.0),
            ),
        ]
        .map(|(squares, rate_changes, rate_jerk, plan_s)| FlankPart {
            squares,
            rate_changes,
            rate_jerk,
            plan_s,
        })
    }
}
