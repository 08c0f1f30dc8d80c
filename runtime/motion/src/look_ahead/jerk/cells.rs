//! Division of the path into cells, with the limits of the motors in each cell.

use tandem_model::profile::JERK_RESERVE;
use tandem_model::{AXES_MAX, Axis, AxisVector};

use super::cell::{Cell, Row};
use super::joint::{Joint, Step};
use super::path::PathPiece;
use crate::limit::USED_WITHIN_JERK;
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

/// Speed at a joint below which the cells next to it are not shorter.
const SLOWEST: f64 = 1e-3;

/// Largest number of cells of the blocks that are planned at a time, except for the grading between them.
const CELLS_MAX: f64 = 1000.0;

/// Largest number of cells in the time after which a stop no longer affects the motion.
const HORIZON_CELLS: f64 = 200.0;

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
    /// Adds the constraints at a distance within the piece to a cell. The distances to the points before and after it are
    /// `before` and `reach`.
    fn constrain(&self, at: f64, [before, reach]: [f64; 2], motors: &Motors, cell: &mut Cell) {
        let derivatives = self.derivatives_at(at);
        let offset = at - cell.from;
        let [first, second, _] = derivatives;
        // The velocities halfway to the neighbouring points, by the tangent, bound those between.
        let cap = [-before / 2.0, 0.0, reach / 2.0]
            .into_iter()
            .map(|by| self.cap_at(first.plus(second.scaled(by)), motors))
            .fold(f64::INFINITY, f64::min);
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
                by_change: 0.0,
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

    /// Returns the number of parts of a stretch of the piece within a cell, between which the constraints are points.
    fn parts(&self, length: f64, cell: &Cell) -> u32 {
        let parts = if self.is_straight() { STRAIGHT_PARTS } else { PARTS };
        (1..parts)
            .rev()
            .find(|k| length * f64::from(parts) > cell.length * f64::from(*k))
            .unwrap_or(0)
            + 1
    }

    /// Returns the joint at the start of the piece, if the second derivative steps there.
    fn joint(&self, motors: &Motors) -> Option<Joint> {
        Joint::new(&self.step, self.derivatives[0], self.speed_square, motors)
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
        [&motors.inverse, &motors.inverse_jerks].map(|of_each| of_each[axis.index()] / USED_WITHIN_JERK);
    let inverse_jerk = inverse_jerk / (1.0 - JERK_RESERVE);
    let [q1, q2, q3] = [first[axis], second[axis], third[axis]];
    let moves = q1 != 0.0 || q2 != 0.0 || q3 != 0.0;
    (moves && (inverse > 0.0 || inverse_jerk > 0.0)).then(|| Row {
        at,
        reach,
        third: q3 * inverse,
        second: q2 * inverse,
        first: q1 * inverse,
        by_change: 0.0,
        jerk: [q3, 3.0 * q2, q1].map(|factor| factor * inverse_jerk),
    })
}

/// Times by which a path is divided.
#[derive(Debug, Clone, Copy)]
pub(super) struct Times {
    /// Time in which a cell is passed, s.
    pub(super) cell_s: f64,
    /// Time after which a stop no longer affects the motion, s.
    pub(super) horizon_s: f64,
}

/// How the motion along a part of the path begins.
#[derive(Debug, Clone, Copy)]
pub(super) enum Begin {
    AtRest,
    /// With the speed and acceleration that give the shortest time.
    Open,
    /// After a cell of this length.
    After(f64),
}

/// How the motion along a part of the path ends.
#[derive(Debug, Clone, Copy)]
pub(super) enum End {
    /// At rest, but more of the path may follow.
    Open,
    AtRest,
    /// On a ramp to rest: any speed along it ends the motion at rest. The second derivative steps by this vector.
    OnRamp(Step),
}

impl End {
    /// Removes the cell to rest, if the motion ends with it.
    pub(super) fn last_cell(self, cells: &mut Vec<Cell>) -> Option<Cell> {
        match self {
            Self::Open | Self::AtRest => cells.pop(),
            Self::OnRamp(_) => None,
        }
    }
}

/// Divides a path into cells. A first cell from rest and a last cell to rest are passed by a constant jerk.
pub(super) fn cut(pieces: &[PathPiece], begin: Begin, end: End, cell_s: f64, motors: &Motors) -> Vec<Cell> {
    let [Some(first), Some(last)] = [pieces.first(), pieces.last()] else {
        return Vec::new();
    };
    let length = last.to - first.from;
    let mut joints: Vec<Option<Joint>> = pieces.iter().map(|piece| piece.joint(motors)).collect();
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
    let before = match begin {
        Begin::AtRest => {
            joints[0] = None;
            rest(first, first.from)
        }
        Begin::Open => f64::INFINITY,
        Begin::After(before) => before.min(CELL_SHARE * length),
    };
    let first_joint = match begin {
        Begin::Open => joints[0].take(),
        _ => None,
    };
    let last_joint = match end {
        End::Open | End::AtRest => None,
        End::OnRamp(step) => Joint::new(&step, AxisVector::ZERO, last.speed_square, motors),
    };
    let square = |joint: &Option<Joint>| joint.as_ref().map_or(f64::INFINITY, |joint| joint.square_even);
    let before = (before.min(cell_s * square(&first_joint).sqrt())).min(CELL_SHARE * length);
    let after = match end {
        End::Open | End::AtRest => rest(last, last.to),
        End::OnRamp(_) => (cell_s * square(&last_joint).sqrt()).min(CELL_SHARE * length),
    };
    let borders = graded(pieces, &targets, &joints, [before, after], cell_s);
    let rests = [matches!(begin, Begin::AtRest), !matches!(end, End::OnRamp(_))];
    let ends =
        [(rests[0], before), (rests[1], after)].map(|(rests, length)| if rests { length } else { 0.0 });
    let nodes = nodes(pieces, &targets, &joints, &borders, ends);
    let mut cells = fill(pieces, &joints, &nodes, motors);
    if let (Some(joint), Some(cell)) = (&first_joint, cells.first_mut()) {
        cell.caps.push([0.0, joint.square_even]);
        joint.leave_room(cells.iter_mut(), first.from);
    }
    if let (Some(joint), Some(cell)) = (&last_joint, cells.last_mut()) {
        cell.caps.push([cell.length, joint.square_even]);
        joint.leave_room(cells.iter_mut().rev(), last.to);
    }
    cells
}

impl Times {
    /// Returns the times for motors that move at most at these speeds.
    pub(super) fn new(speeds: &[f64; AXES_MAX], motors: &Motors) -> Self {
        let horizon_s = motors.horizon_s(speeds);
        let shortest_s = (motors.inverse.iter())
            .zip(&motors.inverse_jerks)
            .filter(|(inverse, inverse_jerk)| **inverse > 0.0 && **inverse_jerk > 0.0)
            .fold(f64::INFINITY, |least, (inverse, inverse_jerk)| {
                least.min(inverse_jerk / inverse)
            });
        let at_least = (PERIODS_MIN * motors.period_s).max(horizon_s / HORIZON_CELLS);
        let cell_s = if shortest_s.is_finite() {
            (CELL_TIME * shortest_s).max(at_least)
        } else {
            at_least
        };
        Self { cell_s, horizon_s }
    }
}

/// Returns the length of a cell at each border of the pieces, so that neighbouring cells differ little.
fn graded(
    pieces: &[PathPiece],
    targets: &[Target],
    joints: &[Option<Joint>],
    [first, last]: [f64; 2],
    cell_s: f64,
) -> Vec<f64> {
    let mut borders = vec![f64::INFINITY; pieces.len() + 1];
    let mut limit = first;
    for (k, (piece, target)) in pieces.iter().zip(targets).enumerate() {
        let at_joint = joints[k].as_ref().map_or(f64::INFINITY, |joint| {
            cell_s * joint.square_max.sqrt().max(SLOWEST)
        });
        borders[k] = limit.min(target.length).min(at_joint);
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

/// Returns the borders of the cells. Each joint is a border, except in a first and last cell of these lengths.
fn nodes(
    pieces: &[PathPiece],
    targets: &[Target],
    joints: &[Option<Joint>],
    borders: &[f64],
    [first, last]: [f64; 2],
) -> Vec<f64> {
    let [from, to] = [pieces[0].from, pieces[pieces.len() - 1].to];
    let end = to - last;
    let mut nodes = vec![from];
    let mut at = from + first;
    if first > 0.0 {
        nodes.push(at);
    }
    let mut k = 0;
    let mut next_joint = 0;
    while at < end {
        while k + 1 < pieces.len() && pieces[k].to <= at {
            k += 1;
        }
        while next_joint < pieces.len() && (joints[next_joint].is_none() || pieces[next_joint].from <= at) {
            next_joint += 1;
        }
        let stop = pieces.get(next_joint).map_or(end, |piece| piece.from.min(end));
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
    if last > 0.0 {
        nodes.push(to);
    }
    nodes
}

fn fill(pieces: &[PathPiece], joints: &[Option<Joint>], nodes: &[f64], motors: &Motors) -> Vec<Cell> {
    let mut cells = Vec::with_capacity(nodes.len());
    let mut k = 0;
    for range in nodes.windows(2) {
        let [from, to] = [range[0], range[1]];
        let mut cell = Cell {
            from,
            length: to - from,
            cap: f64::INFINITY,
            limit: 1.0,
            jerk_left: 1.0,
            ..Cell::default()
        };
        while k > 0 && pieces[k].from > from {
            k -= 1;
        }
        while k + 1 < pieces.len() && pieces[k].to <= from {
            k += 1;
        }
        if let Some(joint) = joints[k].as_ref().filter(|_| pieces[k].from >= from) {
            cells.push(joint.cell(from, pieces[k].cap_at(pieces[k].derivatives[0], motors)));
        }
        let mut at_joint = f64::INFINITY;
        loop {
            let piece = &pieces[k];
            let [begin, end] = [piece.from.max(from), piece.to.min(to)];
            if end > begin {
                let parts = piece.parts(end - begin, &cell);
                let part = (end - begin) / f64::from(parts);
                for k in 0..parts {
                    let before = if k == 0 { 0.0 } else { part };
                    piece.constrain(begin + f64::from(k) * part, [before, part], motors, &mut cell);
                }
                piece.constrain(end, [part, 0.0], motors, &mut cell);
            }
            if piece.to >= to || k + 1 == pieces.len() {
                break;
            }
            k += 1;
            // A joint within a cell from rest or to rest
            if let Some(joint) = joints[k].as_ref().filter(|_| pieces[k].from < to) {
                at_joint = at_joint.min(joint.square_even);
                cell.jerk_left = cell.jerk_left.min(1.0 - joint.share);
            }
        }
        cell.cap = cell.cap.min(at_joint);
        for [_, cap] in &mut cell.caps {
            *cap = cap.min(at_joint);
        }
        cells.push(cell);
    }
    cells
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
