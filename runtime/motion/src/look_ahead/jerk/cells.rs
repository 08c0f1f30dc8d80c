//! Division of a smoothed path into cells, with the limits of the motors in each cell.

use tandem_model::profile::JERK_RESERVE;
use tandem_model::{Axis, AxisVector};

use crate::look_ahead::limits::Motors;

/// Time in which a cell is passed, as a share of the shortest time in which a motor reaches its maximum acceleration.
const CELL_TIME: f64 = 0.06;

/// Smallest time in which a cell is passed, in servo periods.
const PERIODS_MIN: f64 = 1.5;

/// Largest growth of the cells per distance.
const GROWTH: f64 = 0.35;

/// Largest share of a run that the cell from rest or to rest covers.
const REST_SHARE: f64 = 0.03;

/// Largest share of a run that another cell covers.
const CELL_SHARE: f64 = 0.04;

/// Number of parts of a cell between which the constraints of a curved path are points.
const PARTS: u32 = 8;

/// Number of parts of a cell between which the constraints of a straight path are points.
const STRAIGHT_PARTS: u32 = 2;

/// Largest number of cells of the blocks that are planned at a time, except for the grading between them.
const CELLS_MAX: f64 = 1000.0;

/// Largest number of cells in the time after which a stop no longer affects the motion.
const HORIZON_CELLS: f64 = 200.0;

/// Part of the limits that the plan uses, apart from the reserves; the rest covers the deviations between the points of a
/// cell.
const USED: f64 = 0.997;

/// A stretch of the path on which each axis is a polynomial of third degree in the distance along the chain.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathPiece {
    pub(super) from: f64,
    pub(super) to: f64,
    /// First to third derivative of the position with respect to distance, at `from`.
    pub(super) derivatives: [AxisVector; 3],
    /// Square of the largest speed along the path.
    pub(super) speed_square: f64,
    /// Largest acceleration along the path; infinite if only the motors limit it.
    pub(super) acceleration: f64,
}

/// The constraints of one motor at one point of a cell. In shares of the limits, with the square x of the speed, the
/// acceleration b along the path and its change c per distance, the acceleration is `second x + first b`, and the jerk is
/// `sqrt(x) (jerk[0] x + jerk[1] b + jerk[2] c)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    /// Distance of the point from the start of the cell.
    pub(super) at: f64,
    /// Length after the point on which the third derivative is constant.
    pub(super) reach: f64,
    /// Change of `second` per distance.
    pub(super) third: f64,
    pub(super) second: f64,
    pub(super) first: f64,
    pub(super) jerk: [f64; 3],
}

/// A part of the path on which the acceleration along the path is linear in distance.
#[derive(Debug, Clone, Default)]
pub(super) struct Cell {
    pub(super) from: f64,
    pub(super) length: f64,
    pub(super) rows: Vec<Row>,
    /// Points of the cell, with the largest square of the speed at each.
    pub(super) caps: Vec<[f64; 2]>,
    /// Largest square of the speed in the whole cell.
    pub(super) cap: f64,
    /// Part of the limits that the motion in the cell may use.
    pub(super) limit: f64,
}

/// Length of the cells in a piece of the path.
#[derive(Debug, Clone, Copy)]
struct Target {
    length: f64,
    /// Length at the ends of a straight piece within which the speed changes; infinite for a curve.
    even: f64,
}

impl Target {
    /// Returns the length of a cell at these distances from the ends of the piece. Where the speed of a straight piece no
    /// longer changes, the cells grow.
    fn at(&self, since: f64, left: f64) -> f64 {
        let beyond = since.min(left) - self.even / 2.0;
        self.length + GROWTH * beyond.max(0.0)
    }
}

impl PathPiece {
    fn derivatives_at(&self, at: f64) -> [AxisVector; 3] {
        let t = at - self.from;
        let [first, second, third] = self.derivatives;
        [
            first.plus(second.scaled(t)).plus(third.scaled(t * t / 2.0)),
            second.plus(third.scaled(t)),
            third,
        ]
    }

    /// Returns the largest square of the speed at a distance, by the velocities.
    fn cap_at(&self, first: AxisVector, motors: &Motors) -> f64 {
        let cap = self.speed_square;
        Axis::ALL.into_iter().fold(cap, |cap, axis| {
            let (slope, velocity) = (first[axis].abs(), motors.velocities[axis.index()]);
            if slope > 0.0 && velocity > 0.0 {
                cap.min((velocity / slope).powi(2))
            } else {
                cap
            }
        })
    }

    /// Adds the constraints at a distance within the piece to a cell, into which the piece reaches further by `reach`.
    fn constrain(&self, at: f64, reach: f64, motors: &Motors, cell: &mut Cell) {
        let derivatives = self.derivatives_at(at);
        let offset = at - cell.from;
        let cap = self.cap_at(derivatives[0], motors);
        cell.cap = cell.cap.min(cap);
        cell.caps.push([offset, cap]);
        for axis in Axis::ALL {
            cell.rows.extend(row([offset, reach], derivatives, axis, motors));
        }
        if self.acceleration.is_finite() {
            cell.rows.push(Row {
                at: offset,
                reach: 0.0,
                third: 0.0,
                second: 0.0,
                first: 1.0 / self.acceleration,
                jerk: [0.0; 3],
            });
        }
    }

    /// Returns the length of the cells in the piece, each of which takes the time `cell_s`.
    fn target(&self, cell_s: f64, length_max: f64, motors: &Motors) -> Target {
        let speed = self.square_max(motors).sqrt();
        let [first, ..] = self.derivatives;
        let [inverse, inverse_jerk] = [&motors.inverse, &motors.inverse_jerks].map(|of_each| {
            let axes = Axis::ALL
                .into_iter()
                .map(|axis| first[axis].abs() * of_each[axis.index()]);
            axes.fold(0.0, f64::max)
        });
        let even = if self.is_straight() && inverse > 0.0 {
            // The distances of both ramps with the speed as their largest change
            2.0 * speed * (speed * inverse + (speed * inverse_jerk).sqrt() + inverse_jerk / inverse)
        } else {
            f64::INFINITY
        };
        Target {
            length: (speed * cell_s).min(length_max),
            even,
        }
    }

    fn is_straight(&self) -> bool {
        let [_, second, third] = self.derivatives;
        second == AxisVector::ZERO && third == AxisVector::ZERO
    }

    /// Returns the number of parts of a stretch of the piece within a cell, between which the constraints are points.
    fn parts(&self, length: f64, cell: &Cell) -> u32 {
        let parts = if self.is_straight() { STRAIGHT_PARTS } else { PARTS };
        (1..parts)
            .rev()
            .find(|k| length * f64::from(parts) > cell.length * f64::from(*k))
            .unwrap_or(0)
            + 1
    }

    /// Returns the largest square of the speed at which the curvature alone stays within the limits.
    fn square_max(&self, motors: &Motors) -> f64 {
        [self.from, self.to]
            .into_iter()
            .fold(self.speed_square, |square, at| {
                let derivatives = self.derivatives_at(at);
                let square = square.min(self.cap_at(derivatives[0], motors));
                let rows = Axis::ALL
                    .into_iter()
                    .filter_map(|axis| row([0.0; 2], derivatives, axis, motors));
                rows.fold(square, |square, row| {
                    let by_jerk = row.jerk[0].abs().powf(-2.0 / 3.0);
                    square.min(1.0 / row.second.abs()).min(by_jerk)
                })
            })
    }
}

fn row(
    [at, reach]: [f64; 2],
    [first, second, third]: [AxisVector; 3],
    axis: Axis,
    motors: &Motors,
) -> Option<Row> {
    let [inverse, inverse_jerk] =
        [&motors.inverse, &motors.inverse_jerks].map(|of_each| of_each[axis.index()] / USED);
    let inverse_jerk = inverse_jerk / (1.0 - JERK_RESERVE);
    let [q1, q2, q3] = [first[axis], second[axis], third[axis]];
    let moves = q1 != 0.0 || q2 != 0.0 || q3 != 0.0;
    (moves && (inverse > 0.0 || inverse_jerk > 0.0)).then(|| Row {
        at,
        reach,
        third: q3 * inverse,
        second: q2 * inverse,
        first: q1 * inverse,
        jerk: [q3, 3.0 * q2, q1].map(|factor| factor * inverse_jerk),
    })
}

impl Row {
    pub(super) fn limits_jerk(&self) -> bool {
        self.jerk.iter().any(|factor| factor.abs() > 0.0)
    }

    /// Returns the constraints at a distance after the point, within its reach.
    pub(super) fn shifted(&self, by: f64) -> Self {
        let [j0, j1, j2] = self.jerk;
        Self {
            at: self.at + by,
            reach: self.reach - by,
            second: self.second + self.third * by,
            first: self.first + by * (self.second + self.third * by / 2.0),
            jerk: [j0, j1 + 3.0 * j0 * by, j2 + by * (j1 / 3.0 + j0 * by / 2.0)],
            ..*self
        }
    }
}

impl Cell {
    /// Tightens the jerk limits of the cell by a factor.
    pub(super) fn tighten(&mut self, factor: f64) {
        for row in &mut self.rows {
            row.jerk = row.jerk.map(|value| value * factor);
        }
    }
}

/// Divides a path into cells. `rests` states whether the path begins and ends at rest; the first and the last cell are
/// then passed by a constant jerk. Otherwise the first cell is about as long as `before`.
pub(super) fn cut(pieces: &[PathPiece], rests: bool, before: f64, motors: &Motors) -> Vec<Cell> {
    let [Some(begin), Some(end)] = [pieces.first(), pieces.last()] else {
        return Vec::new();
    };
    let length = end.to - begin.from;
    let cell_s = cell_time(motors);
    let mut targets: Vec<Target> = (pieces.iter())
        .map(|piece| piece.target(cell_s, CELL_SHARE * length, motors))
        .collect();
    let count: f64 = (pieces.iter().zip(&targets))
        .map(|(piece, target)| (piece.to - piece.from).min(target.even) / target.length)
        .sum();
    if count > CELLS_MAX {
        for target in &mut targets {
            target.length *= count / CELLS_MAX;
        }
    }
    let rest = |piece: &PathPiece, at: f64| {
        let cell = rest_length(piece.derivatives_at(at)[0], cell_s, motors);
        cell.min(REST_SHARE * length)
    };
    let first = if rests {
        rest(begin, begin.from)
    } else {
        before.min(CELL_SHARE * length)
    };
    let last = rest(end, end.to);
    let borders = graded(pieces, &targets, [first, last]);
    let nodes = nodes(
        pieces,
        &targets,
        &borders,
        [if rests { first } else { 0.0 }, last],
    );
    fill(pieces, &nodes, motors)
}

/// Returns the time in which a cell is passed, s.
pub(super) fn cell_time(motors: &Motors) -> f64 {
    let shortest_s = (motors.inverse.iter())
        .zip(&motors.inverse_jerks)
        .filter(|(inverse, inverse_jerk)| **inverse > 0.0 && **inverse_jerk > 0.0)
        .fold(f64::INFINITY, |least, (inverse, inverse_jerk)| {
            least.min(inverse_jerk / inverse)
        });
    let at_least = (PERIODS_MIN * motors.period_s).max(motors.horizon_s() / HORIZON_CELLS);
    if shortest_s.is_finite() {
        (CELL_TIME * shortest_s).max(at_least)
    } else {
        at_least
    }
}

/// Returns the length of a cell at each border of the pieces, so that neighbouring cells differ little.
fn graded(pieces: &[PathPiece], targets: &[Target], [first, last]: [f64; 2]) -> Vec<f64> {
    let mut borders = vec![f64::INFINITY; pieces.len() + 1];
    let mut limit = first;
    for (k, (piece, target)) in pieces.iter().zip(targets).enumerate() {
        borders[k] = limit.min(target.length);
        limit = (borders[k] + GROWTH * (piece.to - piece.from)).min(target.length);
    }
    let mut limit = last.min(limit);
    borders[pieces.len()] = limit;
    for (k, (piece, target)) in pieces.iter().zip(targets).enumerate().rev() {
        limit = (limit + GROWTH * (piece.to - piece.from))
            .min(target.length)
            .min(borders[k]);
        borders[k] = limit;
    }
    borders
}

/// Returns the borders of the cells.
fn nodes(pieces: &[PathPiece], targets: &[Target], borders: &[f64], [first, last]: [f64; 2]) -> Vec<f64> {
    let [from, to] = [pieces[0].from, pieces[pieces.len() - 1].to];
    let stop = to - last;
    let mut nodes = vec![from];
    let mut at = from + first;
    if first > 0.0 {
        nodes.push(at);
    }
    let mut k = 0;
    while at < stop {
        while k + 1 < pieces.len() && pieces[k].to <= at {
            k += 1;
        }
        let piece = &pieces[k];
        let limit = (targets[k].at(at - piece.from, piece.to - at))
            .min(borders[k] + GROWTH * (at - piece.from))
            .min(borders[k + 1] + GROWTH * (piece.to - at));
        let next = at + limit / (1.0 + GROWTH);
        // The last two cells share the remaining distance.
        let left = stop - at;
        at = if next + 0.5 * (next - at) >= stop {
            stop
        } else if next + 1.2 * (next - at) >= stop {
            at + left / 2.0
        } else {
            next
        };
        nodes.push(at);
    }
    nodes.push(to);
    nodes
}

fn fill(pieces: &[PathPiece], nodes: &[f64], motors: &Motors) -> Vec<Cell> {
    let mut k = 0;
    nodes
        .windows(2)
        .map(|range| {
            let [from, to] = [range[0], range[1]];
            let mut cell = Cell {
                from,
                length: to - from,
                cap: f64::INFINITY,
                limit: 1.0,
                ..Cell::default()
            };
            while k > 0 && pieces[k].from > from {
                k -= 1;
            }
            while k + 1 < pieces.len() && pieces[k].to <= from {
                k += 1;
            }
            loop {
                let piece = &pieces[k];
                let [begin, end] = [piece.from.max(from), piece.to.min(to)];
                if end > begin {
                    let parts = piece.parts(end - begin, &cell);
                    let part = (end - begin) / f64::from(parts);
                    for k in 0..parts {
                        piece.constrain(begin + f64::from(k) * part, part, motors, &mut cell);
                    }
                    piece.constrain(end, 0.0, motors, &mut cell);
                }
                if piece.to >= to || k + 1 == pieces.len() {
                    break;
                }
                k += 1;
            }
            cell
        })
        .collect()
}

/// Returns the length of a cell from rest or to rest that takes this time at the largest jerk.
fn rest_length(first: AxisVector, time_s: f64, motors: &Motors) -> f64 {
    let inverse = Axis::ALL.into_iter().fold(0.0_f64, |most, axis| {
        most.max(first[axis].abs() * motors.inverse_jerks[axis.index()])
    });
    if inverse > 0.0 {
        time_s.powi(3) / (6.0 * inverse)
    } else {
        f64::INFINITY
    }
}
