//! Motions from which the solution of a run begins.

use super::barrier::Model;
use super::cell::Cell;
use super::solve::{Run, Solution, Start, step};

/// Relative difference between two speeds that is only rounding.
const ROUNDING: f64 = 1e-9;

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
        let mut squares: Vec<f64> = (self.cells.iter())
            .map(|cell| ESTIMATE * (cell.length / cell_s).powi(2))
            .collect();
        for k in 1..squares.len() {
            if self.cells[k].is_joint() {
                squares[k] = squares[k - 1];
            }
        }
        let models: Vec<Model> = (0..self.cells.len())
            .map(|k| {
                let [x, _, change] = motion.motion(k);
                let mut model = Model::default();
                let cell = &self.cells[k];
                let h = if cell.is_joint() {
                    self.cells[k.saturating_sub(1)].length.max(cell_s)
                } else {
                    cell.length
                };
                if k < known {
                    model.add(0.0, KNOWN / (x * x), [1.0, 0.0, 0.0]);
                    let powered = if cell.is_joint() { h.powi(2) } else { h.powi(4) };
                    model.add(0.0, KNOWN * powered / (x * x), [0.0, 0.0, 1.0]);
                    return model;
                }
                let square = squares[k].min(squares[k.saturating_sub(1)]);
                let weight = 1.0 / square;
                model.add(weight * (x * weight - 1.0), weight * weight, [1.0, 0.0, 0.0]);
                let weight = SMOOTHNESS * (if cell.is_joint() { h } else { h * h }) / square;
                model.add(weight * weight * change, weight * weight, [0.0, 0.0, 1.0]);
                model
            })
            .collect();
        let usage_max = f64::midpoint(1.0, self.usage(&motion)).max(ESTIMATE_USAGE_MAX);
        let way = self.minimum(&models, [[0.0; 3]; 2]);
        if known == 0
            && let Some(scaled) = self.slowed_to_limits(motion.moved(&way, 1.0))
            && self.time_s(&scaled) < self.time_s(&motion)
        {
            return scaled;
        }
        let found = WAYS.into_iter().find_map(|share| {
            let faster = motion.moved(&way, share);
            (self.usage(&faster) < usage_max).then_some(faster)
        });
        found.unwrap_or(motion)
    }

    /// Returns a motion along the same speeds, slowed down as a whole to within the limits. Returns `None` if a speed is not
    /// above 0.
    fn slowed_to_limits(&self, motion: Solution) -> Option<Solution> {
        let [square, cubed] = self.usage_by_power(&motion);
        let factor = (SHARE / square).min((SHARE / cubed).powf(2.0 / 3.0));
        (factor > 0.0).then(|| motion.slowed(factor.min(1.0)))
    }

    /// Returns a motion within the limits that is slow and even between its start and its stop.
    pub(super) fn slow_motion(&self) -> Solution {
        let even = self.even_motion(1.0);
        let [square, cubed] = self.usage_by_power(&even);
        let factor = (SHARE / square).min((SHARE / cubed).powf(2.0 / 3.0));
        self.even_motion(factor)
    }

    /// Returns the motion at the largest speed throughout, if it is within the limits.
    pub(super) fn even_motion_at_cap(&self) -> Option<Solution> {
        let runs_out = matches!(self.start, Start::Open) && self.stop.is_none();
        let cap = self
            .cells
            .iter()
            .fold(f64::INFINITY, |cap, cell| cap.min(cell.cap));
        let is_even = |cell: &Cell| cell.cap <= cap * (1.0 + ROUNDING);
        if !runs_out || !self.cells.iter().all(is_even) {
            return None;
        }
        let motion = self.even_motion(cap);
        (self.usage(&motion) <= 1.0 + ROUNDING).then_some(motion)
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
            let change = match &self.stop {
                Some(law) if k + 1 == self.cells.len() => {
                    let end = square / (1.0 + law.slope() * length);
                    -law.slope() * end / length
                }
                _ => 0.0,
            };
            motion.states.push(state);
            motion.changes.push(change);
            state = step(state, change, &self.cells[k]);
        }
        motion.states.push(state);
    }
}
