//! Speed along the path of a chain for motors with a maximum jerk (M1d.9).
//!
//! The path consists of pieces ([`path`]), on which each axis is a polynomial of third degree in distance. On the
//! programmed path, the distance is plan time. The motion is planned in *cells* ([`cells`]), short against the distance in
//! which a motor changes its acceleration. In a cell, the acceleration b along the path is linear in distance, so the
//! square x of the speed is quadratic, and the jerk of a motor is `sqrt(x) (q''' x + 3 q'' b + q' c)` with the constant
//! change c of b. At rest, a cell has a constant jerk along the path instead ([`rest`]). Where `q''` steps, cells meet in a
//! joint ([`joint`]).
//!
//! The fastest motion within the limits follows from an interior-point method ([`solve`]). A window of blocks always ends
//! at rest; when more blocks are known, the part that the stop does not affect becomes final, and the rest is planned
//! again together with the new blocks.

mod barrier;
mod cell;
mod cells;
mod guess;
mod joint;
mod law;
mod path;
mod rest;
mod solve;

use std::collections::VecDeque;

use tandem_model::{AXES_MAX, AxisVector};

use self::cell::Cell;
use self::cells::{Begin, End, Times};
use self::joint::Step;
use self::law::{CellLaw, Kind};
use self::path::PathPiece;
use self::rest::RestLaw;
use self::solve::{Run, Solution, Start};
use super::held_block::HeldBlock;
use super::limits::Motors;
use super::step::RateStep;
use super::way::Way;

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
const CHECKS_MAX: u32 = 6;

/// Largest number of times that the limits are lowered for a motion that exceeds them.
const SLOWER_MAX: u32 = 60;

/// Limits of the cells relative to what such a motion uses.
const RELAXED: f64 = 1.02;

/// Largest share of a limit between the points of a cell, of which the plan leaves a part.
const BETWEEN_MAX: f64 = 1.0025;

/// The motion along a chain, planned with the jerk of the motors limited.
#[derive(Debug, Clone, Default)]
pub(super) struct JerkPlan {
    /// Distance along the chain up to which blocks have been added.
    length: f64,
    /// Plan time of the blocks that have been read since the last plan, s.
    new_s: f64,
    begins: Begins,
    /// Second derivative of the position at the end of the known path; `None` before the path is known.
    second: Option<AxisVector>,
    /// Distance along the chain of the last step of the second derivative.
    last_step: f64,
    /// Largest speed of each motor along the known path.
    speeds: [f64; AXES_MAX],
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
    /// On a ramp of the path from rest, at any speed along it.
    OnRamp,
}

/// How the known path of a chain ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ends {
    /// More blocks follow.
    Open,
    /// The motion comes to rest where the path moves.
    AtRest,
    /// On a ramp of the path to rest.
    OnRamp,
}

/// Range of a block along its chain.
pub(super) type Range = [f64; 2];

impl JerkPlan {
    pub(super) fn new(begins: Begins) -> Self {
        Self {
            begins,
            second: (begins == Begins::OnRamp).then_some(AxisVector::ZERO),
            last_step: f64::NEG_INFINITY,
            ..Self::default()
        }
    }

    /// Returns true if enough blocks have been read for a plan, so that a plan takes a short time. The last of the `new`
    /// blocks has this plan time; `seen` blocks are in the window.
    pub(super) fn is_due(&mut self, plan_s: f64, new: usize, seen: usize, motors: &Motors) -> bool {
        self.new_s += plan_s;
        new >= seen.max(BLOCKS_MIN) || self.new_s >= CELLS_MIN * Times::new(&self.speeds, motors).cell_s
    }

    /// Adds blocks to the end of the path, and plans the motion to a stop at its end. Returns the range of each block.
    pub(super) fn extend<'a>(
        &mut self,
        blocks: impl Iterator<Item = &'a HeldBlock>,
        ends: Ends,
        motors: &Motors,
    ) -> Vec<Range> {
        self.new_s = 0.0;
        let mut pieces = Vec::new();
        let ranges = blocks
            .map(|held| {
                let from = self.length;
                self.add_pieces(held, motors, &mut pieces);
                [from, self.length]
            })
            .collect();
        let end = match ends {
            Ends::Open => End::Open,
            Ends::AtRest => End::AtRest,
            Ends::OnRamp => End::OnRamp(Step {
                change: self.second.unwrap_or(AxisVector::ZERO).scaled(-1.0),
                since: self.length - self.last_step,
            }),
        };
        self.plan(&pieces, end, motors);
        ranges
    }

    /// Adds the path of a block to `pieces`, and to the length of the known path.
    fn add_pieces(&mut self, held: &HeldBlock, motors: &Motors, pieces: &mut Vec<PathPiece>) {
        let first = pieces.len();
        self.length = path::add_pieces(held, self.length, motors, pieces);
        for piece in &mut pieces[first..] {
            let speeds = piece.speeds();
            self.speeds = std::array::from_fn(|i| self.speeds[i].max(speeds[i]));
            if let Some(second) = self.second {
                let step = Step {
                    change: piece.derivatives[1].minus(second),
                    since: piece.from - self.last_step,
                };
                if step.is_felt(piece.speed_square, motors) {
                    piece.step = step;
                    self.last_step = piece.from;
                }
            }
            self.second = Some(piece.second_at_end());
        }
    }

    fn plan(&mut self, pieces: &[PathPiece], end: End, motors: &Motors) {
        let times = Times::new(&self.speeds, motors);
        let Some(last) = self.window.back() else {
            self.window = plan_anew(pieces, self.begins, end, times, motors);
            return;
        };
        let cells = cells::cut(pieces, Begin::After(last.cell.length), end, times.cell_s, motors);
        if let Some(window) = plan_on(&self.window, self.begins, cells, end, times) {
            self.window = window;
            return;
        }
        // No motion through the end of the window was found: the machine stops there.
        self.finals.append(&mut self.window);
        self.begins = Begins::AtRest;
        self.window = plan_anew(pieces, self.begins, end, times, motors);
    }

    /// Makes the motion final, except in the last cells of the window, which a stop at its end may affect. All of it is
    /// final if the path ends. Returns the distance along the chain up to which the motion is final.
    pub(super) fn finish(&mut self, is_end: bool, motors: &Motors) -> f64 {
        let count = if is_end {
            self.window.len()
        } else {
            before_tail(
                self.window.iter().map(|law| &law.cell),
                Times::new(&self.speeds, motors),
            )
        };
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
        let way = Way::new(&held.block.motion, held.passage);
        let (begins_s, speed) = (way.begins_s(), path::speed(&way));
        for piece_to_s in path::ends_s(&way) {
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

/// Plans the motion along the path.
fn plan_anew(
    pieces: &[PathPiece],
    begins: Begins,
    end: End,
    times: Times,
    motors: &Motors,
) -> VecDeque<CellLaw> {
    let rests = begins == Begins::AtRest;
    let begin = if rests { Begin::AtRest } else { Begin::Open };
    let mut cells = cells::cut(pieces, begin, end, times.cell_s, motors);
    if cells.is_empty() {
        return VecDeque::new();
    }
    joint::leave_room(&mut cells);
    let last = end.last_cell(&mut cells);
    let stop = last.as_ref().map(|cell| RestLaw::at_end(cell, end));
    set_limits(&mut cells, end, times);
    let (start, first) = if rests && !cells.is_empty() {
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
    let motion = if let Some(even) = run.even_motion_at_cap() {
        even
    } else {
        let guess = run.slow_motion();
        let guess = run.towards_estimate(guess, 0, times.cell_s);
        solve_and_check(start, &mut cells, stop, &guess).unwrap_or(guess)
    };
    laws([first, last], cells, stop, &motion)
}

/// Plans a window again, with more cells at its end. Returns `None` if no motion within the limits is found.
fn plan_on(
    window: &VecDeque<CellLaw>,
    begins: Begins,
    new: Vec<Cell>,
    end: End,
    times: Times,
) -> Option<VecDeque<CellLaw>> {
    let mut cells: Vec<Cell> = window.iter().map(|law| law.cell.clone()).collect();
    cells.extend(new);
    joint::leave_room(&mut cells);
    let last = end.last_cell(&mut cells);
    let stop = last.as_ref().map(|cell| RestLaw::at_end(cell, end));
    set_limits(&mut cells, end, times);
    let mut guess = Solution::default();
    let (start, first) = match window.front()?.kind {
        Kind::FromRest { .. } => {
            let cell = cells.remove(0);
            (Start::Rest(RestLaw::new(&cell)), Some(cell))
        }
        _ if begins == Begins::AtRest => (Start::Moving, None),
        _ => (Start::Open, None),
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
    let before = guess.states.last()?;
    let creep = before[0] + before[1] * window.back()?.cell.length;
    let run = Run {
        start,
        cells: &cells,
        stop,
    };
    run.creep(&mut guess, creep);
    let guess = if run.usage(&guess) < 1.0 {
        run.towards_estimate(guess, window.len() - skipped, times.cell_s)
    } else {
        slowed(start, &mut cells, stop, guess)?
    };
    let motion = solve_and_check(start, &mut cells, stop, &guess)?;
    Some(laws([first, last], cells, stop, &motion))
}

/// Returns a motion within the limits, from a motion that exceeds them. The limits of the cells begin at what the motion uses,
/// and are lowered as it slows down. Returns `None` if no such motion is found.
fn slowed(start: Start, cells: &mut [Cell], stop: Option<RestLaw>, motion: Solution) -> Option<Solution> {
    let limits: Vec<f64> = cells.iter().map(|cell| cell.limit).collect();
    let mut now = motion;
    for _ in 0..SLOWER_MAX {
        let mut is_within = true;
        for (k, cell) in cells.iter_mut().enumerate() {
            cell.limit = 1.0;
            let [square, cubed] = barrier::usage(cell, now.motion(k));
            cell.limit = limits[k].max(RELAXED * square.max(cubed));
            is_within &= cell.limit <= limits[k];
        }
        let end = now.states[cells.len()][0];
        let relaxed = stop.map(|law| law.relaxed(RELAXED * end));
        is_within &= stop.is_none_or(|law| RELAXED * end <= law.square_max);
        if is_within {
            return Some(now);
        }
        let run = Run {
            start,
            cells,
            stop: relaxed,
        };
        now = run.centre(now)?;
    }
    for (cell, limit) in cells.iter_mut().zip(limits) {
        cell.limit = limit;
    }
    None
}

/// Returns the fastest motion. Where it exceeds a limit between the points of a cell, the limits of the cell are tightened.
fn solve_and_check(
    start: Start,
    cells: &mut [Cell],
    stop: Option<RestLaw>,
    guess: &Solution,
) -> Option<Solution> {
    let solve = |cells: &[Cell], first: Solution| Run { start, cells, stop }.solve(first);
    let mut motion = solve(cells, guess.clone())?;
    for _ in 0..CHECKS_MAX {
        let mut exceeds = false;
        for (k, cell) in cells.iter_mut().enumerate() {
            let [by_acceleration, by_jerk] = barrier::usage_between(cell, motion.motion(k));
            if by_acceleration > BETWEEN_MAX {
                cell.tighten_acceleration(by_acceleration);
                exceeds = true;
            }
            if by_jerk > BETWEEN_MAX {
                cell.tighten(by_jerk);
                exceeds = true;
            }
        }
        if !exceeds {
            break;
        }
        let run = Run { start, cells, stop };
        let within = if run.usage(guess) < 1.0 {
            Some(guess.clone())
        } else {
            slowed(start, cells, stop, guess.clone())
        };
        let Some(slower) = within.and_then(|first| solve(cells, first)) else {
            break;
        };
        motion = slower;
    }
    Some(motion)
}

/// Returns the number of cells before the end of a window that a stop at its end may affect.
fn before_tail<'a>(
    cells: impl DoubleEndedIterator<Item = &'a Cell> + ExactSizeIterator,
    times: Times,
) -> usize {
    let least = times.horizon_s / times.cell_s * CELLS_PER_TIME;
    let mut count = 0.0;
    let mut left = cells.len();
    for cell in cells.rev() {
        if count >= least.min(TAIL_MAX) {
            return left;
        }
        left -= 1;
        if !cell.is_joint() {
            count += 1.0;
        }
    }
    0
}

/// Sets the limits of the cells: in the last cells of a window a part of the limits is kept, with which the next plan
/// begins.
fn set_limits(cells: &mut [Cell], end: End, times: Times) {
    let first = match end {
        End::Open => before_tail(cells.iter(), times),
        _ => cells.len(),
    };
    for (k, cell) in cells.iter_mut().enumerate() {
        cell.limit = if k < first { 1.0 } else { TAIL_LIMIT };
    }
}

/// Returns the motion in all cells, with those from rest and to rest.
fn laws(
    [first, last]: [Option<Cell>; 2],
    cells: Vec<Cell>,
    stop: Option<RestLaw>,
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
    let end = last.zip(stop).map(|(cell, stop)| CellLaw {
        cell,
        kind: Kind::ToRest { jerk: stop.jerk(end) },
    });
    begin.into_iter().chain(between).chain(end).collect()
}
