//! The fastest motion through a number of cells, by an interior-point method.
//!
//! The states `[x, b]` at the borders of the cells follow from the changes c of the cells: `x' = x + 2 b h + c h^2` and
//! `b' = b + c h`. A Newton step of the sum of all cells is then the solution of a linear control problem, which a
//! backward recursion over the cells gives in linear time. The jerk limit is not convex; each step replaces it by a
//! tangent inside of it, so that each step stays within the limits.

use tandem_model::hyperbolic;

use super::barrier::{self, CellMotion, Model};
use super::cell::Cell;
use super::rest::RestLaw;

/// Largest number of Newton steps.
const STEPS_MAX: u32 = 250;

/// Share of the time by which the result may exceed the optimum.
const GAP: f64 = 4e-4;

/// Factor of the weight of time from one minimum to the next.
const WEIGHT_FACTOR: f64 = 8.0;

/// Newton decrement below which a minimum is near enough.
const DECREMENT: f64 = 0.3;

/// Number of Newton steps away from the limits.
const CENTRE_STEPS: u32 = 6;

/// Halvings of a step.
const BACK_MAX: u32 = 40;

/// Largest multiple of a Newton step.
const LONGER_MAX: f64 = 16.0;

/// Start of the motion.
#[derive(Debug, Clone, Copy)]
pub(super) enum Start {
    /// From rest, with a cell of constant jerk.
    Rest(RestLaw),
    /// In the state of the first motion.
    Moving,
    /// With the speed and acceleration that give the shortest time.
    Open,
}

/// Cells between the start and the end of a motion.
#[derive(Debug)]
pub(super) struct Run<'a> {
    pub(super) start: Start,
    pub(super) cells: &'a [Cell],
    /// The cell to rest; `None` if the motion ends on a ramp to rest, at any speed along it.
    pub(super) stop: Option<RestLaw>,
}

/// The motion of a run.
#[derive(Debug, Clone, Default)]
pub(super) struct Solution {
    /// Square of the speed and acceleration at the start of each cell, and at the end of the last.
    pub(super) states: Vec<[f64; 2]>,
    /// Change of the acceleration per distance in each cell.
    pub(super) changes: Vec<f64>,
}

/// Direction of a Newton step.
pub(super) struct Direction {
    states: Vec<[f64; 2]>,
    changes: Vec<f64>,
    /// Derivative of the function in this direction.
    slope: f64,
}

/// Recursion of one cell: the change is `offset + gains . state`.
#[derive(Debug, Clone, Copy, Default)]
struct Gain {
    offset: f64,
    gains: [f64; 2],
}

/// Quadratic function of a state: `gradient . d + d . second d/2`.
#[derive(Debug, Clone, Copy)]
struct Ahead {
    gradient: [f64; 2],
    second: [[f64; 2]; 2],
}

/// Returns the state at the end of a cell.
pub(super) fn step([x, b]: [f64; 2], change: f64, cell: &Cell) -> [f64; 2] {
    let h = cell.length;
    let [by_square, by_acceleration] = effect(cell);
    [x + 2.0 * b * h + by_square * change, b + by_acceleration * change]
}

/// Returns the effect of the change on the state at the end of a cell.
fn effect(cell: &Cell) -> [f64; 2] {
    if cell.is_joint() {
        [0.0, 1.0]
    } else {
        [cell.length * cell.length, cell.length]
    }
}

impl Solution {
    pub(super) fn motion(&self, k: usize) -> CellMotion {
        let [x, b] = self.states[k];
        [x, b, self.changes[k]]
    }

    /// Returns the motion with all squares of the speed and accelerations multiplied by a factor.
    pub(super) fn slowed(mut self, factor: f64) -> Self {
        for [square, acceleration] in &mut self.states {
            *square *= factor;
            *acceleration *= factor;
        }
        for change in &mut self.changes {
            *change *= factor;
        }
        self
    }

    pub(super) fn moved(&self, by: &Direction, share: f64) -> Self {
        let states = self.states.iter().zip(&by.states);
        let changes = self.changes.iter().zip(&by.changes);
        Self {
            states: states
                .map(|(state, by)| [state[0] + share * by[0], state[1] + share * by[1]])
                .collect(),
            changes: changes.map(|(change, by)| change + share * by).collect(),
        }
    }
}

impl Run<'_> {
    /// Returns the fastest motion, beginning with a motion within the limits. Returns `None` if the first motion is not
    /// within them.
    pub(super) fn solve(&self, first: Solution) -> Option<Solution> {
        let mut now = first;
        let count = self.cells.iter().map(barrier::count).sum::<usize>() as f64;
        let mut time = count / self.time_s(&now);
        let mut value = self.value(&now, time)?;
        for _ in 0..STEPS_MAX {
            let direction = self.direction(&now, time);
            let Some((next, next_value)) = self.search(&now, value, &direction, time) else {
                break;
            };
            now = next;
            value = next_value;
            if -direction.slope < DECREMENT {
                if count / time < GAP * self.time_s(&now) {
                    break;
                }
                time *= WEIGHT_FACTOR;
                value = self.value(&now, time)?;
            }
        }
        Some(now)
    }

    /// Returns a motion farther from the limits, whatever its time.
    pub(super) fn centre(&self, first: Solution) -> Option<Solution> {
        let mut now = first;
        let mut value = self.value(&now, 0.0)?;
        for _ in 0..CENTRE_STEPS {
            let direction = self.direction(&now, 0.0);
            let Some((next, next_value)) = self.search(&now, value, &direction, 0.0) else {
                break;
            };
            (now, value) = (next, next_value);
        }
        Some(now)
    }

    /// Returns the largest share of a limit that a motion uses.
    pub(super) fn usage(&self, motion: &Solution) -> f64 {
        let [square, cubed] = self.usage_by_power(motion);
        square.max(cubed)
    }

    /// Returns the largest share of the limits that grow with the square of the speed, and of the jerks, which grow with
    /// its third power.
    pub(super) fn usage_by_power(&self, motion: &Solution) -> [f64; 2] {
        let cells = self.cells.iter().enumerate();
        let [mut square, cubed] = cells.fold([0.0_f64; 2], |most, (k, cell)| {
            let usage = barrier::usage(cell, motion.motion(k));
            [most[0].max(usage[0]), most[1].max(usage[1])]
        });
        if let Some(law) = &self.stop {
            square = square.max(motion.states[self.cells.len()][0] / law.square_max);
        }
        if let Start::Rest(law) = &self.start {
            square = square.max(motion.states[0][0] / law.square_max);
        }
        [square, cubed]
    }

    /// Returns the time of a motion, s.
    pub(super) fn time_s(&self, motion: &Solution) -> f64 {
        let between: f64 = (0..self.cells.len())
            .filter(|k| !self.cells[*k].is_joint())
            .map(|k| {
                let speeds = [motion.states[k][0], motion.states[k + 1][0]].map(f64::sqrt);
                hyperbolic::duration(speeds, motion.changes[k], self.cells[k].length)
            })
            .sum();
        let end = motion.states[self.cells.len()][0];
        let stop_s = self.stop.map_or(0.0, |law| law.duration_s(end));
        let start_s = match &self.start {
            Start::Rest(law) => law.duration_s(motion.states[0][0]),
            _ => 0.0,
        };
        start_s + between + stop_s
    }

    fn value(&self, motion: &Solution, time: f64) -> Option<f64> {
        let mut sum = match &self.stop {
            Some(law) => law.barrier(motion.states[self.cells.len()][0], time)?[0],
            None => 0.0,
        };
        if let Start::Rest(law) = &self.start {
            sum += law.barrier(motion.states[0][0], time)?[0];
        }
        for (k, cell) in self.cells.iter().enumerate() {
            sum += barrier::value(cell, motion.motion(k), time)?;
        }
        Some(sum)
    }

    /// Returns the motion after a part of a step that lowers the function, and its value.
    fn search(&self, now: &Solution, value: f64, by: &Direction, time: f64) -> Option<(Solution, f64)> {
        let at = |share: f64| {
            let next = now.moved(by, share);
            let value = self.value(&next, time)?;
            Some((next, value))
        };
        let mut share = 1.0;
        let mut best = None;
        for _ in 0..BACK_MAX {
            if let Some(found) = at(share)
                && found.1 <= value + 0.05 * share * by.slope
            {
                best = Some(found);
                break;
            }
            share *= 0.6;
        }
        // The model overestimates the second derivative of the jerk limits, so a longer step may be better.
        while let Some((_, least)) = &best
            && share < LONGER_MAX
            && let Some(found) = at(2.0 * share)
            && found.1 < *least
        {
            share *= 2.0;
            best = Some(found);
        }
        best.map(|(next, value)| (self.consistent(next), value))
    }

    /// Returns the motion without the rounding errors of many steps.
    fn consistent(&self, mut motion: Solution) -> Solution {
        if let Start::Rest(law) = &self.start {
            motion.states[0][1] = law.slope() * motion.states[0][0];
        }
        motion
    }

    /// Returns the Newton direction.
    fn direction(&self, now: &Solution, time: f64) -> Direction {
        let n = self.cells.len();
        let models: Vec<Model> = (0..n)
            .map(|k| barrier::model(&self.cells[k], now.motion(k), time))
            .collect();
        let by_stop = match &self.stop {
            Some(law) => law.barrier(now.states[n][0], time).unwrap_or_default(),
            None => [0.0; 3],
        };
        let by_start = match &self.start {
            Start::Rest(law) => law.barrier(now.states[0][0], time).unwrap_or_default(),
            _ => [0.0; 3],
        };
        self.minimum(&models, [by_start, by_stop])
    }

    /// Returns the direction to the minimum of the sum of the models of all cells. `ends` are value, first and second
    /// derivative of a function of the first and of the last square of the speed.
    pub(super) fn minimum(&self, models: &[Model], [by_start, by_stop]: [[f64; 3]; 2]) -> Direction {
        let n = self.cells.len();
        let mut gains = vec![Gain::default(); n];
        // Before a cell to rest the acceleration is a multiple of the square of the speed.
        let mut ahead = Ahead {
            gradient: [by_stop[1], 0.0],
            second: [[by_stop[2], 0.0], [0.0, 0.0]],
        };
        for k in (0..n).rev() {
            let cell = &self.cells[k];
            let gain = self.stop.filter(|_| k + 1 == n).map(|law| {
                let (h, slope) = (cell.length, law.slope());
                let [by_square, by_acceleration] = effect(cell);
                let divisor = by_acceleration + slope * by_square;
                Gain {
                    offset: 0.0,
                    gains: [-slope / divisor, -(1.0 + 2.0 * slope * h) / divisor],
                }
            });
            (gains[k], ahead) = recursion(&models[k], cell, &ahead, gain);
        }
        let first = self.first_state(&ahead, by_start);
        let mut direction = Direction {
            states: Vec::with_capacity(n + 1),
            changes: Vec::with_capacity(n),
            slope: by_start[1] * first[0],
        };
        let mut state = first;
        for k in 0..n {
            let Gain {
                offset,
                gains: [g0, g1],
            } = gains[k];
            let change = offset + g0 * state[0] + g1 * state[1];
            let gradient = models[k].gradient;
            direction.slope += gradient[0] * state[0] + gradient[1] * state[1] + gradient[2] * change;
            direction.states.push(state);
            direction.changes.push(change);
            state = step(state, change, &self.cells[k]);
        }
        direction.slope += by_stop[1] * state[0];
        direction.states.push(state);
        direction
    }

    /// Returns the first state of the direction.
    fn first_state(&self, ahead: &Ahead, by_start: [f64; 3]) -> [f64; 2] {
        let Ahead {
            gradient: [g0, g1],
            second: [[a, b], [_, d]],
        } = *ahead;
        match &self.start {
            Start::Moving => [0.0; 2],
            Start::Open => {
                let determinant = a * d - b * b;
                [(b * g1 - d * g0) / determinant, (b * g0 - a * g1) / determinant]
            }
            Start::Rest(law) => {
                let slope = law.slope();
                let second = a + 2.0 * slope * b + slope * slope * d + by_start[2];
                let x = -(g0 + slope * g1 + by_start[1]) / second;
                [x, slope * x]
            }
        }
    }
}

/// Returns the best change of a cell as a function of its first state, and the function of that state. `gain` prescribes
/// the change.
fn recursion(model: &Model, cell: &Cell, ahead: &Ahead, gain: Option<Gain>) -> (Gain, Ahead) {
    let [[p00, p01], [_, p11]] = ahead.second;
    let [g0, g1] = ahead.gradient;
    // The next state is A state + B change, with A = [[1, 2h], [0, 1]] and B = [h^2, h], or [0, 1] at a joint.
    let h = cell.length;
    let [b0, b1] = effect(cell);
    let pb = [p00 * b0 + p01 * b1, p01 * b0 + p11 * b1];
    // A'P A, A'P B, B'P B
    let a00 = p00;
    let a01 = 2.0 * h * p00 + p01;
    let a11 = 4.0 * h * h * p00 + 4.0 * h * p01 + p11;
    let cross = [pb[0], 2.0 * h * pb[0] + pb[1]];
    let square = b0 * pb[0] + b1 * pb[1];
    let m = &model.second;
    let q = [[m[0][0] + a00, m[0][1] + a01], [m[0][1] + a01, m[1][1] + a11]];
    let s = [m[0][2] + cross[0], m[1][2] + cross[1]];
    let r = m[2][2] + square;
    let gradient = [model.gradient[0] + g0, model.gradient[1] + 2.0 * h * g0 + g1];
    let by_change = model.gradient[2] + b0 * g0 + b1 * g1;
    let gain = gain.unwrap_or_else(|| Gain {
        offset: -by_change / r,
        gains: [-s[0] / r, -s[1] / r],
    });
    let Gain { offset, gains: k } = gain;
    let second = |i: usize, j: usize| q[i][j] + s[i] * k[j] + s[j] * k[i] + r * k[i] * k[j];
    let first = |i: usize| gradient[i] + s[i] * offset + k[i] * (by_change + r * offset);
    let mixed = second(0, 1);
    let ahead = Ahead {
        gradient: [first(0), first(1)],
        second: [[second(0, 0), mixed], [mixed, second(1, 1)]],
    };
    (gain, ahead)
}
