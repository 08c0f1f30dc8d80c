//! Motions from which the solution of a run begins.

use super::barrier::Model;
use super::solve::{Run, Solution, Start, step};

/// Largest share of a limit that the slow motion uses.
const SHARE: f64 = 0.5;

/// Largest share of a limit that a motion near the estimate uses.
const ESTIMATE_USAGE_MAX: f64 = 0.95;

/// Square of the speed of the estimate, as a share of the square at which a cell takes its time.
const ESTIMATE: f64 = 0.3;

/// Weight of the changes of the acceleration against the distance from the estimate.
const SMOOTHNESS: f64 = 1.0;

/// Weight of the motion in cells that were planned before.
const KNOWN: f64 = 1e4;

/// Shares of the way to the estimate that are tried.
const WAYS: [f64; 6] = [1.0, 0.8, 0.6, 0.4, 0.2, 0.1];

impl Run<'_> {
    /// Returns a faster motion within the limits, nearer to an estimate: the speed at which each cell takes the time for
    /// which it was cut. `motion` must be within the limits; in its first `known` cells it is hardly changed.
    pub(super) fn towards_estimate(&self, motion: Solution, known: usize, cell_s: f64) -> Solution {
        let squares: Vec<f64> = (self.cells.iter())
            .map(|cell| ESTIMATE * (cell.length / cell_s).powi(2))
            .collect();
        let models: Vec<Model> = (0..self.cells.len())
            .map(|k| {
                let h = self.cells[k].length;
                let [x, _, change] = motion.motion(k);
                let mut model = Model::default();
                if k < known {
                    model.add(0.0, KNOWN / (x * x), [1.0, 0.0, 0.0]);
                    model.add(0.0, KNOWN * h.powi(4) / (x * x), [0.0, 0.0, 1.0]);
                    return model;
                }
                let square = squares[k].min(squares[k.saturating_sub(1)]);
                let weight = 1.0 / square;
                model.add(weight * (x * weight - 1.0), weight * weight, [1.0, 0.0, 0.0]);
                let weight = SMOOTHNESS * h * h / square;
                model.add(weight * weight * change, weight * weight, [0.0, 0.0, 1.0]);
                model
            })
            .collect();
        let usage_max = f64::midpoint(1.0, self.usage(&motion)).max(ESTIMATE_USAGE_MAX);
        let way = self.minimum(&models, [[0.0; 3]; 2]);
        let found = WAYS.into_iter().find_map(|share| {
            let faster = motion.moved(&way, share);
            (self.usage(&faster) < usage_max).then_some(faster)
        });
        found.unwrap_or(motion)
    }

    /// Returns a motion within the limits that is slow and even between its start and its stop.
    pub(super) fn slow_motion(&self) -> Solution {
        let even = self.even_motion(1.0);
        let [square, cubed] = self.usage_by_power(&even);
        let factor = (SHARE / square).min((SHARE / cubed).powf(2.0 / 3.0));
        self.even_motion(factor)
    }

    /// Returns an even motion with this square of the speed.
    fn even_motion(&self, square: f64) -> Solution {
        let mut motion = Solution::default();
        let begin = match (&self.start, self.cells.first()) {
            (Start::Rest(law), Some(cell)) => {
                let begin = square / (1.0 + law.slope() * cell.length);
                let acceleration = law.slope() * begin;
                motion.changes.push(-acceleration / cell.length);
                motion.states.push([begin, acceleration]);
                [square, 0.0]
            }
            _ => [square, 0.0],
        };
        self.creep(&mut motion, begin[0]);
        motion
    }

    /// Completes a motion: after its last cell it continues at an even speed, and slows down in the last cell of the run.
    pub(super) fn creep(&self, motion: &mut Solution, square: f64) {
        let mut state = [square, 0.0];
        for k in motion.changes.len()..self.cells.len() {
            let length = self.cells[k].length;
            let change = if k + 1 == self.cells.len() {
                let end = square / (1.0 + self.stop.slope() * length);
                -self.stop.slope() * end / length
            } else {
                0.0
            };
            motion.states.push(state);
            motion.changes.push(change);
            state = step(state, change, length);
        }
        motion.states.push(state);
    }
}
