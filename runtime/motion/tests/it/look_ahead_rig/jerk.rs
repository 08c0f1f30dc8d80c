//! The effect of a maximum jerk (M1d), checked against an independent implementation.

use tandem_model::profile::{PacePiece, Profile};
use tandem_model::{Axis, AxisVector};

use super::{Chain, Shape, pieces, plan_time, rate_of_plan};
use crate::rig::PERIOD_S;

impl Chain {
    /// Returns the largest rate on the ramp between block i - 1 and block i, one of which may be rest, for a
    /// chain without arcs. If a moving motor has a maximum jerk, it is a constant rate at which neither
    /// `|dv|/ta w^2` nor `|dv|/(ta ts) w^3` exceeds a limit.
    pub fn rate_in_corner(&self, i: usize) -> f64 {
        let [ta, ts] = self.formula.ramps[i];
        let before = i.checked_sub(1);
        if before.is_some_and(|i| self.is_arc(i)) || self.is_arc(i) || ts < PERIOD_S {
            return f64::INFINITY;
        }
        let velocity = |k: Option<usize>| {
            let k = k.filter(|k| *k < self.shapes.len());
            k.map_or(AxisVector::ZERO, |k| {
                self.path_derivatives(k, 0.0)[0].scaled(self.formula.speeds[k])
            })
        };
        let [own, next] = [velocity(before), velocity(Some(i))];
        let mut rate = f64::INFINITY;
        let mut has_jerk = false;
        for (axis, motor) in self.settings.motors.iter().flatten().enumerate() {
            let [own, next] = [own.0[axis], next.0[axis]];
            let turn = (next - own).abs();
            rate = rate.min((motor.max_acceleration * ta / turn).sqrt());
            if let Some(jerk) = motor.max_jerk {
                has_jerk |= own != 0.0 || next != 0.0;
                rate = rate.min((jerk * ta * ts / turn).cbrt());
            }
        }
        if has_jerk { rate } else { f64::INFINITY }
    }

    pub fn has_arcs(&self) -> bool {
        (0..self.shapes.len()).any(|i| self.is_arc(i))
    }

    /// Returns true if the plan bounds the jerk of a block: a line, or an arc whose radius does not change by
    /// more than half.
    fn is_bounded(&self, i: usize) -> bool {
        match self.shapes[i] {
            Shape::Line => true,
            Shape::Arc { radius, growth, .. } => {
                let end = radius + growth;
                radius.max(end) <= 1.5 * radius.min(end)
            }
        }
    }

    fn is_arc(&self, i: usize) -> bool {
        matches!(self.shapes.get(i), Some(Shape::Arc { .. }))
    }

    /// Returns the plan times at which the phases of block i begin and end, from the start of its profile.
    /// The phases are those of its start ramp, the part between its ramps, and those of its stop ramp.
    fn phases(&self, i: usize) -> [f64; 8] {
        let [[a, b], [c, d]] = [self.formula.ramps[i], self.formula.ramps[i + 1]];
        let from_rest = if i == 0 { [0.0, b, a, a + b] } else { [0.0; 4] };
        let half = if i == 0 { a + b } else { -(a + b) } / 2.0;
        let end = self.formula.paths[i].length() / self.formula.speeds[i] + half - f64::midpoint(c, d);
        let [e, f, g, h] = from_rest;
        [e, f, g, h, end, end + d, end + c, end + c + d]
    }

    /// Returns the largest share of a maximum jerk at a plan time within a piece, if the jerk is bounded
    /// there.
    fn share_of_jerk(&self, i: usize, piece: &PacePiece, t: f64) -> f64 {
        let s = plan_time(piece, t);
        let phases = self.phases(i);
        let Some(n) = phases.windows(2).position(|phase| phase[0] < s && s < phase[1]) else {
            return 0.0;
        };
        let is_bounded = match n {
            0..3 => self.formula.ramps[i][1] >= PERIOD_S,
            3 => self.is_bounded(i),
            _ => self.formula.ramps[i + 1][1] >= PERIOD_S,
        };
        if !is_bounded {
            return 0.0;
        }
        let h = 0.01 * (s - phases[n]).min(phases[n + 1] - s);
        let [q1, q2] = self.derivatives(i, s, s);
        let [before, after] = [s - h, s + h].map(|s| self.derivatives(i, s, s)[1]);
        let [rate, rate_change] = rate_of_plan(piece, t);
        let motors = self.settings.motors.iter().flatten().enumerate();
        motors.fold(0.0_f64, |most, (axis, motor)| {
            let Some(limit) = motor.max_jerk else { return most };
            let third = (after.0[axis] - before.0[axis]) / (2.0 * h);
            let rounding = 1e3 * f64::EPSILON * (q2.0[axis].abs() + before.0[axis].abs()) / h;
            let third = (third.abs() - rounding).max(0.0).copysign(third);
            let changed = if n == 3 {
                3.0 * q2.0[axis] * rate * rate_change + q1.0[axis] * piece.rate_jerk
            } else {
                0.0
            };
            most.max((third * rate.powi(3) + changed).abs() / limit)
        })
    }
}

/// Checks lines and arcs. Between the ramps the accelerations do not step, and change within the maximum
/// jerks. On a ramp the rate is at most one at which the limits hold, and without arcs equal to the rate of
/// the formulas.
pub fn check_jerk(chain: &Chain, profiles: &[Profile]) -> Result<(), String> {
    let mut before: Option<(u64, f64)> = None;
    for profile in profiles {
        let block = usize::try_from(profile.segment).unwrap() - 1;
        let path = &chain.formula.paths[block];
        let [_, _, _, begin, end, ..] = chain.phases(block);
        for (piece, duration_s) in pieces(profile) {
            for k in 1..=5 {
                let t = duration_s * f64::from(k) / 6.0;
                let share = chain.share_of_jerk(block, &piece, t);
                if share > 1.0 + 1e-3 {
                    return Err(format!(
                        "{share} of a jerk in segment {} at {t} of {duration_s} s",
                        profile.segment
                    ));
                }
            }
            let ends_s = plan_time(&piece, duration_s);
            let rounding = 1e-9 * end.abs();
            let middle = f64::midpoint(piece.plan_s, ends_s);
            let fastest = [0.0, duration_s].map(|t| rate_of_plan(&piece, t)[0]);
            let most = chain.rate_in_corner(block + 1);
            if middle > end + rounding && fastest[0].max(fastest[1]) > most * (1.0 + 1e-6) {
                return Err(format!("{fastest:?} in a corner, above {most}"));
            }
            let is_within = middle > begin + rounding && middle < end - rounding;
            if !is_within || !chain.is_bounded(block) {
                before = None;
                continue;
            }
            let [_, first] = rate_of_plan(&piece, 0.0);
            let [_, last] = rate_of_plan(&piece, duration_s);
            let step = match before {
                Some((segment, change)) if segment == profile.segment => first - change,
                _ => 0.0,
            };
            before = Some((profile.segment, last));
            for axis in 0..chain.axes() {
                let motor = chain.settings.motors[axis].as_ref().unwrap();
                if motor.max_jerk.is_none() {
                    continue;
                }
                let speed = chain.formula.speeds[block] * path.steepest(Axis::ALL[axis]);
                let step = (step * speed).abs() / motor.max_acceleration;
                if step > 1e-5 {
                    return Err(format!("axis {axis} steps by {step} in {}", profile.segment));
                }
            }
        }
    }
    Ok(())
}
