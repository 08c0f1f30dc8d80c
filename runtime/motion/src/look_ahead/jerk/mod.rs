//! Speed along a smoothed path for motors with a maximum jerk (M1d.9).
//!
//! The path of a chain has a continuous curvature, and each axis is a polynomial of third degree in distance between the
//! ends of its curves ([`crate::smooth`]). The motion is planned in *cells* ([`cells`]), short against the distance in
//! which a motor changes its acceleration. In a cell, the acceleration b along the path is linear in distance, so the
//! square x of the speed is quadratic, and the jerk of a motor is `sqrt(x) (q''' x + 3 q'' b + q' c)` with the constant
//! change c of b. At rest, a cell has a constant jerk along the path instead ([`rest`]).
//!
//! The fastest motion within the limits follows from an interior-point method ([`solve`]). A window of blocks always ends
//! at rest; when more blocks are known, the part that the stop does not affect becomes final, and the rest is planned
//! again together with the new blocks.

mod barrier;
mod cells;
mod guess;
mod law;
mod rest;
mod solve;

use std::collections::VecDeque;

use tandem_model::AxisVector;

use self::cells::{Cell, PathPiece};
use self::law::{CellLaw, Kind};
use self::rest::RestLaw;
use self::solve::{Run, Solution, Start};
use super::held_block::HeldBlock;
use super::limits::Motors;
use super::step::RateStep;
use super::way::{SmoothedWay, Way};

/// Number of new blocks for a plan.
const BLOCKS_MIN: usize = 48;

/// Number of new cells for a plan, whatever the number of blocks.
const CELLS_MIN: f64 = 400.0;

/// Number of cells that are passed in the time of one cell.
const CELLS_PER_TIME: f64 = 1.4;

/// Largest number of cells at the end of a window whose motion is not final.
const TAIL_MAX: f64 = 10_000.0;

/// Part of the limits that the motion uses in the last cells of a window.
const TAIL_LIMIT: f64 = 0.97;

/// Largest number of times that the limits of cells are tightened.
const CHECKS_MAX: u32 = 2;

/// Largest share of a jerk limit between the points of a cell, of which the plan leaves a part.
const BETWEEN_MAX: f64 = 1.0025;

/// The motion along a chain, planned with the jerk of the motors limited.
#[derive(Debug, Clone, Default)]
pub(super) struct JerkPlan {
    /// Distance along the chain up to which blocks have been added.
    length: f64,
    /// Plan time of the blocks that have been read since the last plan, s.
    new_s: f64,
    begins: Begins,
    /// The final motion that no block has received yet.
    finals: VecDeque<CellLaw>,
    /// The motion that may still change, up to a stop at the end of the known path.
    window: VecDeque<CellLaw>,
}

/// How the motion of a window begins that has no final motion yet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Begins {
    #[default]
    AtRest,
    /// At the speed that the limits allow.
    Moving,
}

/// Range of a block along its chain.
pub(super) type Range = [f64; 2];

impl JerkPlan {
    pub(super) fn new(begins: Begins) -> Self {
        Self {
            begins,
            ..Self::default()
        }
    }

    /// Returns true if enough blocks have been read for a plan, so that a plan takes a short time. The last of the `new`
    /// blocks has this plan time; `seen` blocks are in the window.
    pub(super) fn is_due(&mut self, plan_s: f64, new: usize, seen: usize, motors: &Motors) -> bool {
        self.new_s += plan_s;
        new >= seen.max(BLOCKS_MIN) || self.new_s >= CELLS_MIN * cells::cell_time(motors)
    }

    /// Adds blocks to the end of the path, and plans the motion to a stop at its end. Returns the range of each block.
    pub(super) fn extend<'a>(
        &mut self,
        blocks: impl Iterator<Item = &'a HeldBlock>,
        is_end: bool,
        motors: &Motors,
    ) -> Vec<Range> {
        self.new_s = 0.0;
        let mut pieces = Vec::new();
        let ranges = blocks
            .map(|held| {
                let from = self.length;
                self.length = add_pieces(held, from, motors, &mut pieces);
                [from, self.length]
            })
            .collect();
        self.plan(&pieces, is_end, motors);
        ranges
    }

    fn plan(&mut self, pieces: &[PathPiece], is_end: bool, motors: &Motors) {
        let Some(last) = self.window.back() else {
            self.window = plan_anew(pieces, self.begins, is_end, motors);
            return;
        };
        let cells = cells::cut(pieces, false, last.cell.length, motors);
        if let Some(window) = plan_on(&self.window, self.begins, cells, is_end, motors) {
            self.window = window;
            return;
        }
        // No motion through the end of the window was found: the machine stops there.
        self.finals.append(&mut self.window);
        self.begins = Begins::AtRest;
        self.window = plan_anew(pieces, self.begins, is_end, motors);
    }

    /// Makes the motion final, except in the last cells of the window, which a stop at its end may affect. All of it is
    /// final if the path ends. Returns the distance along the chain up to which the motion is final.
    pub(super) fn finish(&mut self, is_end: bool, motors: &Motors) -> f64 {
        let finals = if is_end { 0 } else { tail(motors) };
        let count = self.window.len().saturating_sub(finals);
        self.finish_cells(count);
        if is_end {
            return f64::INFINITY;
        }
        self.finals
            .back()
            .map_or(f64::NEG_INFINITY, CellLaw::end_distance)
    }

    /// Makes the first half of the motion final, although a stop at the end of the window may affect it.
    pub(super) fn finish_half(&mut self) -> f64 {
        self.finish_cells(self.window.len() / 2);
        self.finals
            .back()
            .map_or(f64::NEG_INFINITY, CellLaw::end_distance)
    }

    fn finish_cells(&mut self, count: usize) {
        if count > 0 {
            self.begins = Begins::AtRest;
        }
        self.finals.extend(self.window.drain(..count));
    }

    /// Returns the number of cells whose motion may still change.
    pub(super) fn cells(&self) -> usize {
        self.window.len()
    }

    /// Adds the final motion along the next block to `steps`.
    pub(super) fn steps(&mut self, held: &HeldBlock, [from, to]: Range, steps: &mut Vec<RateStep>) {
        let Way::Smoothed(way) = Way::new(&held.block.motion, held.passage) else {
            return;
        };
        let begins_s = held.passage.from_s;
        let speed = way.block.speed;
        for (_, [_, piece_to_s]) in way.stretches().filter(|(_, [_, to_s])| *to_s > begins_s) {
            let piece_to = (from + (piece_to_s - begins_s) * speed).min(to);
            while let Some(law) = self.finals.front() {
                let begin = law.cell.from.max(from);
                let at = steps
                    .last()
                    .map_or(begin, |last| from + (last.to_s - begins_s) * speed);
                let end = law.end_distance().min(piece_to);
                if end > at {
                    let offsets = [at - law.cell.from, end - law.cell.from].map(|offset| offset.max(0.0));
                    let at_s = steps.last().map_or(begins_s, |last| last.to_s);
                    let mut step = law.step(offsets, at_s, speed);
                    if end >= piece_to {
                        step.to_s = piece_to_s;
                    }
                    steps.push(step);
                }
                if law.end_distance() > piece_to {
                    break;
                }
                self.finals.pop_front();
            }
        }
    }
}

/// Plans the motion along a path that ends at rest.
fn plan_anew(pieces: &[PathPiece], begins: Begins, is_end: bool, motors: &Motors) -> VecDeque<CellLaw> {
    let rests = begins == Begins::AtRest;
    let mut cells = cells::cut(pieces, rests, f64::INFINITY, motors);
    let Some(last) = cells.pop() else {
        return VecDeque::new();
    };
    let stop = RestLaw::at_end(&last, is_end);
    set_limits(&mut cells, is_end, motors);
    let (start, first) = if rests {
        let first = cells.remove(0);
        (Start::Rest(RestLaw::new(&first)), Some(first))
    } else {
        (Start::Open, None)
    };
    let run = Run {
        start,
        cells: &cells,
        stop,
    };
    let guess = run.slow_motion();
    let guess = run.towards_estimate(guess, 0, cells::cell_time(motors));
    let motion = solve_and_check(start, &mut cells, stop, &guess).unwrap_or(guess);
    laws(first, cells, last, &stop, &motion)
}

/// Plans a window again, with more cells at its end. Returns `None` if no motion within the limits is found.
fn plan_on(
    window: &VecDeque<CellLaw>,
    begins: Begins,
    new: Vec<Cell>,
    is_end: bool,
    motors: &Motors,
) -> Option<VecDeque<CellLaw>> {
    let mut cells: Vec<Cell> = window.iter().map(|law| law.cell.clone()).collect();
    cells.extend(new);
    let last = cells.pop()?;
    let stop = RestLaw::at_end(&last, is_end);
    set_limits(&mut cells, is_end, motors);
    let mut guess = Solution::default();
    let (start, first) = match window.front()?.kind {
        Kind::FromRest { .. } => {
            let cell = cells.remove(0);
            (Start::Rest(RestLaw::new(&cell)), Some(cell))
        }
        _ if begins == Begins::Moving => (Start::Open, None),
        _ => (Start::Moving, None),
    };
    let skipped = usize::from(first.is_some());
    // The motion as planned, up to the cell that ends at rest. In this cell the acceleration ends, and the motion creeps on.
    for law in window.iter().skip(skipped) {
        let [square, acceleration] = law.state(0.0);
        guess.states.push([square, acceleration]);
        guess.changes.push(match law.kind {
            Kind::Linear { change, .. } => change,
            _ => -acceleration / law.cell.length,
        });
    }
    let end = guess.states.last()?;
    let creep = end[0] + end[1] * window.back()?.cell.length;
    let run = Run {
        start,
        cells: &cells,
        stop,
    };
    run.creep(&mut guess, creep);
    let guess = run.towards_estimate(guess, window.len() - skipped, cells::cell_time(motors));
    let motion = solve_and_check(start, &mut cells, stop, &guess)?;
    Some(laws(first, cells, last, &stop, &motion))
}

/// Returns the fastest motion. Where its jerk exceeds a limit between the points of a cell, the limits of the cell are
/// tightened.
fn solve_and_check(start: Start, cells: &mut [Cell], stop: RestLaw, guess: &Solution) -> Option<Solution> {
    let solve = |cells: &[Cell], first: Solution| Run { start, cells, stop }.solve(first);
    let mut motion = solve(cells, guess.clone())?;
    for _ in 0..CHECKS_MAX {
        let mut exceeds = false;
        for (k, cell) in cells.iter_mut().enumerate() {
            let used = barrier::jerk_between(cell, motion.motion(k));
            if used > BETWEEN_MAX {
                cell.tighten(used);
                exceeds = true;
            }
        }
        if !exceeds {
            break;
        }
        let Some(slower) = solve(cells, guess.clone()) else {
            break;
        };
        motion = slower;
    }
    Some(motion)
}

/// Returns the number of cells at the end of a window that a stop at its end may affect.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a quotient of positive times, limited"
)]
fn tail(motors: &Motors) -> usize {
    let cells = motors.horizon_s() / cells::cell_time(motors) * CELLS_PER_TIME;
    cells.ceil().min(TAIL_MAX) as usize
}

/// Sets the limits of the cells: in the last cells of a window a part of the limits is kept, with which the next plan
/// begins.
fn set_limits(cells: &mut [Cell], is_end: bool, motors: &Motors) {
    let tail = if is_end { 0 } else { tail(motors) };
    let first = cells.len().saturating_sub(tail);
    for (k, cell) in cells.iter_mut().enumerate() {
        cell.limit = if k < first { 1.0 } else { TAIL_LIMIT };
    }
}

fn laws(
    first: Option<Cell>,
    cells: Vec<Cell>,
    last: Cell,
    stop: &RestLaw,
    motion: &Solution,
) -> VecDeque<CellLaw> {
    let end = motion.states[cells.len()][0];
    let begin = first.map(|cell| CellLaw {
        kind: Kind::FromRest {
            jerk: RestLaw::new(&cell).jerk(motion.states[0][0]),
        },
        cell,
    });
    let between = cells.into_iter().enumerate().map(|(k, cell)| {
        let [square, acceleration, change] = motion.motion(k);
        CellLaw {
            cell,
            kind: Kind::Linear {
                square,
                acceleration,
                change,
            },
        }
    });
    let end = CellLaw {
        cell: last,
        kind: Kind::ToRest { jerk: stop.jerk(end) },
    };
    begin.into_iter().chain(between).chain([end]).collect()
}

/// Adds the path of a block. Returns the distance along the chain at its end.
fn add_pieces(held: &HeldBlock, from: f64, motors: &Motors, pieces: &mut Vec<PathPiece>) -> f64 {
    let Way::Smoothed(way) = Way::new(&held.block.motion, held.passage) else {
        return from;
    };
    let speed = way.block.speed;
    let bounds = Way::Smoothed(way).bounds(motors, held.cap);
    let begins_s = held.passage.from_s;
    let mut at = from;
    for (stretch, [from_s, to_s]) in way.stretches().filter(|(_, [_, to_s])| *to_s > begins_s) {
        let to = from + (to_s - begins_s) * speed;
        if to <= at {
            continue;
        }
        pieces.push(PathPiece {
            from: at,
            to,
            derivatives: derivatives_at(&way, stretch, from_s.max(begins_s), speed),
            speed_square: held.cap * speed * speed,
            acceleration: bounds.change / 2.0 * speed,
        });
        at = to;
    }
    at
}

/// Returns the derivatives of the position by distance in the direction of the motion, at a plan time of the motion.
fn derivatives_at(
    way: &SmoothedWay<'_>,
    stretch: &crate::smooth_block::Stretch,
    t_s: f64,
    speed: f64,
) -> [AxisVector; 3] {
    let [velocity, acceleration] = stretch.motion_at(way.forward_s(t_s));
    let [.., third] = stretch.derivatives;
    let sign = if way.is_backward() { -1.0 } else { 1.0 };
    [
        velocity.scaled(sign / speed),
        acceleration.scaled(1.0 / (speed * speed)),
        third.scaled(sign / (speed * speed * speed)),
    ]
}
