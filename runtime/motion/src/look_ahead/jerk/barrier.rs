//! Objective and constraints of one cell as a smooth function of the motion in the cell.
//!
//! The motion in a cell is `[x, b, c]`: the square of the speed and the acceleration along the path at the start of the
//! cell, and the change of the acceleration per distance. At the offset d the square is `x + 2 b d + c d^2`, and the
//! acceleration is `b + c d`.

use super::cell::{Cell, Row};
use super::rest::RestLaw;

/// Points and weights at which the time of a cell is integrated (Gauss), as shares of its length.
const GAUSS: [[f64; 2]; 3] = [
    [0.112_701_665_379_258_3, 5.0 / 18.0],
    [0.5, 8.0 / 18.0],
    [0.887_298_334_620_741_7, 5.0 / 18.0],
];

/// Number of parts into which a stretch of a cell is divided for a check between its points.
const SAMPLES: u32 = 8;

/// Motion in a cell.
pub(super) type CellMotion = [f64; 3];

/// Second-order model of a function of the motion in a cell. The second derivative is symmetric and never negative.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Model {
    pub(super) gradient: [f64; 3],
    pub(super) second: [[f64; 3]; 3],
}

impl Model {
    /// Adds a function of a linear form of the motion, given by its first and second derivative.
    pub(super) fn add(&mut self, factor: f64, curvature: f64, form: [f64; 3]) {
        for i in 0..3 {
            self.gradient[i] += factor * form[i];
            for j in 0..3 {
                self.second[i][j] += curvature * form[i] * form[j];
            }
        }
    }
}

/// Returns the coefficients of the square of the speed at an offset.
fn square_form(at: f64) -> [f64; 3] {
    [1.0, 2.0 * at, at * at]
}

pub(super) fn square_at([x, b, c]: CellMotion, at: f64) -> f64 {
    x + at * (2.0 * b + c * at)
}

/// Returns the middle control point of the square of the speed over a cell. If this point and both ends are above 0 or below
/// a cap, so is the whole cell.
fn square_between(cell: &Cell, [x, b, _]: CellMotion) -> f64 {
    x + b * cell.length
}

/// Returns acceleration and jerk of a row without the factor of the speed, and the square of the speed.
fn values(row: &Row, motion: CellMotion) -> [f64; 3] {
    let [_, b, c] = motion;
    let x = square_at(motion, row.at);
    let b = b + c * row.at;
    [
        row.second * x + row.first * b + row.by_change * c,
        row.jerk[0] * x + row.jerk[1] * b + row.jerk[2] * c,
        x,
    ]
}

/// Returns the coefficients of acceleration and jerk of a row.
fn forms(row: &Row) -> [[f64; 3]; 2] {
    let square = square_form(row.at);
    let [j0, j1, j2] = row.jerk;
    let mut acceleration = square.map(|factor| row.second * factor);
    acceleration[1] += row.first;
    acceleration[2] += row.first * row.at + row.by_change;
    let mut jerk = square.map(|factor| j0 * factor);
    jerk[1] += j1;
    jerk[2] += j1 * row.at + j2;
    [acceleration, jerk]
}

/// Returns the largest share of a limit of speed or acceleration that the motion in a cell uses, and of a jerk. Both are
/// infinite if the speed is not above 0.
pub(super) fn usage(cell: &Cell, motion: CellMotion) -> [f64; 2] {
    let between = square_between(cell, motion);
    if between.is_nan() || between <= 0.0 {
        return [f64::INFINITY; 2];
    }
    let mut most = [between / cell.cap, 0.0];
    for [at, cap] in &cell.caps {
        let x = square_at(motion, *at);
        if x.is_nan() || x <= 0.0 {
            return [f64::INFINITY; 2];
        }
        most[0] = most[0].max(x / cap);
    }
    for row in &cell.rows {
        let [a, j, x] = values(row, motion);
        most = [most[0].max(a.abs()), most[1].max(j.abs() * x.sqrt())];
    }
    [most[0] / cell.limit, most[1] / (cell.limit * cell.jerk_left)]
}

/// Returns the largest shares of an acceleration limit and of a jerk limit that the motion in a cell uses between the points
/// of the cell.
pub(super) fn usage_between(cell: &Cell, motion: CellMotion) -> [f64; 2] {
    let reaching = cell.rows.iter().filter(|row| row.reach > 0.0);
    reaching.fold([0.0_f64; 2], |most, row| {
        (1..SAMPLES).fold(most, |most, k| {
            let share = f64::from(k) / f64::from(SAMPLES);
            let [a, j, x] = values(&row.shifted(share * row.reach), motion);
            let jerk = j.abs() * x.max(0.0).sqrt() / cell.jerk_left;
            [most[0].max(a.abs()), most[1].max(jerk)]
        })
    })
}

/// Returns the function of a cell at a motion, with the weight `time` of one second. Returns `None` outside of its domain.
pub(super) fn value(cell: &Cell, motion: CellMotion, time: f64) -> Option<f64> {
    let limit = cell.limit;
    let jerk_limit = limit * cell.jerk_left;
    let mut product = 1.0_f64;
    let mut sum = 0.0;
    let mut take = |slack: f64| {
        if slack.is_nan() || slack <= 0.0 {
            return false;
        }
        product *= slack;
        if !(1e-200..1e200).contains(&product) {
            sum -= product.ln();
            product = 1.0;
        }
        true
    };
    for [at, cap] in &cell.caps {
        let x = square_at(motion, *at);
        if x.is_nan() || x <= 0.0 || !take(limit - x / cap) {
            return None;
        }
    }
    let between = square_between(cell, motion) / cell.cap;
    if !take(limit - between) || !take(between) {
        return None;
    }
    for row in &cell.rows {
        let [a, j, x] = values(row, motion);
        if !take(limit - a) || !take(limit + a) {
            return None;
        }
        if row.limits_jerk() {
            let j = j * x.sqrt();
            if !take(jerk_limit - j) || !take(jerk_limit + j) {
                return None;
            }
        }
    }
    let mut time_s = 0.0;
    for [share, weight] in GAUSS {
        let x = square_at(motion, share * cell.length);
        if x.is_nan() || x <= 0.0 {
            return None;
        }
        time_s += weight * cell.length / x.sqrt();
    }
    Some(sum - product.ln() + time * time_s)
}

/// Returns the model of the function of a cell at a motion within its domain. The jerk limit `1/sqrt(x)` is replaced by
/// its tangent, which lies below it.
pub(super) fn model(cell: &Cell, motion: CellMotion, time: f64) -> Model {
    let limit = cell.limit;
    let jerk_limit = limit * cell.jerk_left;
    let mut model = Model::default();
    for [at, cap] in &cell.caps {
        let slack = 1.0 / (limit * cap - square_at(motion, *at));
        model.add(slack, slack * slack, square_form(*at));
    }
    let between = square_between(cell, motion);
    let [high, low] = [1.0 / (limit * cell.cap - between), 1.0 / between];
    model.add(high - low, high * high + low * low, [1.0, cell.length, 0.0]);
    for row in &cell.rows {
        let [a, j, x] = values(row, motion);
        let [by_acceleration, by_jerk] = forms(row);
        let [low, high] = [1.0 / (limit + a), 1.0 / (limit - a)];
        model.add(high - low, high * high + low * low, by_acceleration);
        if row.limits_jerk() {
            let root = jerk_limit / x.sqrt();
            let square = square_form(row.at);
            let tangent = -root / (2.0 * x);
            // jerk_limit -+ j sqrt(x) = (root -+ j) sqrt(x)
            model.add(-1.0 / x, 1.0 / (x * x), square);
            for sign in [1.0, -1.0] {
                let slack = 1.0 / (root - sign * j);
                let form: [f64; 3] = std::array::from_fn(|i| sign * by_jerk[i] - tangent * square[i]);
                model.add(slack, slack * slack, form);
            }
        }
    }
    for [share, weight] in GAUSS {
        let at = share * cell.length;
        let x = square_at(motion, at);
        let by_time = time * weight * cell.length / (x * x.sqrt());
        model.add(-by_time / 2.0, 0.75 * by_time / x, square_form(at));
    }
    model
}

/// Returns the number of constraints of a cell.
pub(super) fn count(cell: &Cell) -> usize {
    cell.caps.len() + 2 + 4 * cell.rows.len()
}

impl RestLaw {
    /// Returns value, first and second derivative of the function of the cell by the square of the speed at its end.
    /// Returns `None` outside of its domain.
    pub(super) fn barrier(&self, square: f64, time: f64) -> Option<[f64; 3]> {
        let slack = self.square_max - square;
        if square.is_nan() || square <= 0.0 || slack <= 0.0 {
            return None;
        }
        let time = time * self.duration_s(square);
        Some([
            time - (slack / self.square_max).ln(),
            1.0 / slack - time / (2.0 * square),
            1.0 / (slack * slack) + 0.75 * time / (square * square),
        ])
    }
}
