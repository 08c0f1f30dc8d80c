//! The plan time of a block, cut into pieces on which the square of the rate is linear.

use std::collections::VecDeque;

use tandem_model::flow::Path;
use tandem_model::{AXES_MAX, Axis};

use super::blended_block::{BlendedBlock, BlockPart, Phase, PieceEnd};
use super::course::Course;
use super::limits::{self, Bounds, Spread};
use super::piece::{Piece, Shape};
use super::straight::Straight;
use super::{corner, curve};

/// The largest change of a velocity on one piece of a ramp, as a share of it.
const CHANGE_MAX: f64 = 0.25;

/// The largest share of a limit for the deviation between the ends of a piece before it is halved.
const BEND_MAX: f64 = 0.04;

/// The same, as a share of the part of a limit that the motion at the ends does not use.
const LEFT_MAX: f64 = 0.25;

/// The largest share by which the square of the rate may exceed those at the ends of a piece.
const EXCESS_MAX: f64 = 0.1;

/// Most halvings of a ramp.
const HALVINGS_MAX: u32 = 4;

/// The resulting number of parts.
const PARTS_MAX: f64 = 16.0;

/// The largest turn of an arc on one piece, rad: it reserves 0.6 percent of the centripetal acceleration for the deviation
/// between the ends.
const TURN_MAX: f64 = 0.4;

/// Most parts of a piece that is halved for its rate.
const LEAST: f64 = 256.0;

/// Most pieces of one phase.
const PIECES_MAX: f64 = 512.0;

/// A ramp shorter than this share of its block's plan time is rounding.
const RAMP_MIN: f64 = 1e-14;

/// A way between ramps shorter than this share of its block's plan time is rounding.
const BETWEEN_MIN: f64 = 1e-8;

/// Adds the pieces of a block, and returns their number.
pub(super) fn cut(way: &BlendedBlock<'_>, bounds: Bounds<'_>, pieces: &mut VecDeque<Piece>) -> usize {
    let before = pieces.len();
    let begin_s = way.passage.from_s;
    let mut at_s = begin_s;
    let at_most = |square: f64| Bounds {
        cap: bounds.cap.min(square),
        ..bounds
    };
    let from_rest = at_most(corner::from_rest(way, bounds.motors));
    let at_end = at_most(corner::at_end(way, bounds.motors));
    for phase in way.phases() {
        let least = match phase.part {
            BlockPart::Between => BETWEEN_MIN,
            BlockPart::Start | BlockPart::Stop => RAMP_MIN,
        };
        if phase.to_s - phase.from_s.max(at_s) <= least * way.block.plan_s {
            continue;
        }
        let phase = Phase {
            from_s: at_s,
            ..phase
        };
        at_s = phase.to_s;
        let bounds = match phase.part {
            BlockPart::Start => from_rest,
            BlockPart::Between => bounds,
            BlockPart::Stop => at_end,
        };
        let mut cutter = Cutter::new(way, bounds, [phase.from_s, phase.to_s], pieces);
        match (phase.part, &way.block.path) {
            (BlockPart::Between, Path::Line { .. }) => {
                let (straight, cap) = on_line(way, bounds);
                cutter.pieces.push_back(Piece::straight(straight, cap, phase));
            }
            (BlockPart::Between, Path::Arc(arc)) => {
                if let Some((straight, cap)) = curve::straightened(way, arc, bounds) {
                    cutter.pieces.push_back(Piece::straight(straight, cap, phase));
                    continue;
                }
                let swept = arc.sweep().abs() * way.block.speed * (phase.to_s - phase.from_s) / arc.length();
                cutter.whole((swept / TURN_MAX).ceil().clamp(1.0, PIECES_MAX), false);
            }
            (BlockPart::Start | BlockPart::Stop, _) => cutter.whole(1.0, false),
        }
    }
    if pieces.len() == before && way.block.plan_s > begin_s {
        Cutter::new(way, bounds, [begin_s, way.block.plan_s], pieces).whole(1.0, true);
    }
    // Parts left out as rounding belong to the last piece.
    if let Some(last) = pieces.back_mut().filter(|_| at_s > begin_s) {
        last.to_s = way.block.plan_s;
    }
    pieces.len() - before
}

/// Cuts a piece that was planned as a whole, because its rate changes.
pub(super) fn cut_finer(
    way: &BlendedBlock<'_>,
    bounds: Bounds<'_>,
    piece: &Piece,
    pieces: &mut VecDeque<Piece>,
) {
    let bounds = Bounds {
        cap: piece.cap,
        ..bounds
    };
    Cutter::new(way, bounds, [piece.from_s, piece.to_s], pieces).whole(1.0, true);
}

/// Returns the limits of the rate on a line, and its largest square.
fn on_line(way: &BlendedBlock<'_>, bounds: Bounds<'_>) -> (Straight, f64) {
    let most = |inverse: &[f64; AXES_MAX]| {
        Axis::ALL.into_iter().fold(0.0, |most: f64, axis| {
            most.max(way.block.path.steepest(axis) * inverse[axis.index()])
        })
    };
    let straight = Straight {
        change: 2.0 / (most(&bounds.motors.inverse) * way.block.speed),
        jerk: if bounds.motors.has_jerk {
            1.0 / (most(&bounds.motors.inverse_jerks) * way.block.speed)
        } else {
            f64::INFINITY
        },
    };
    (
        straight,
        bounds.cap_at(|axis| way.block.path.steepest(axis) * way.block.speed),
    )
}

/// Cuts an interval within one phase.
struct Cutter<'a> {
    way: &'a BlendedBlock<'a>,
    bounds: Bounds<'a>,
    from_s: f64,
    to_s: f64,
    pieces: &'a mut VecDeque<Piece>,
}

impl<'a> Cutter<'a> {
    fn new(
        way: &'a BlendedBlock<'a>,
        bounds: Bounds<'a>,
        [from_s, to_s]: [f64; 2],
        pieces: &'a mut VecDeque<Piece>,
    ) -> Self {
        Self {
            way,
            bounds,
            from_s,
            to_s,
            pieces,
        }
    }

    /// Returns an end of a piece.
    fn piece_end(&self, t_s: f64) -> PieceEnd {
        self.way.piece_end(t_s, f64::midpoint(self.from_s, self.to_s))
    }

    /// Cuts all of it into n parts. `finer`: for a rate that changes.
    fn whole(&mut self, n: f64, finer: bool) {
        let (from, to) = (self.piece_end(self.from_s), self.piece_end(self.to_s));
        self.even([&from, &to], n, 0, finer);
    }

    /// Cuts into n parts of equal length, and each further where needed.
    fn even(&mut self, [from, to]: [&PieceEnd; 2], n: f64, depth: u32, finer: bool) {
        let mut middle = None;
        let mut k = 1.0;
        while k < n {
            let right = self.piece_end(from.t_s + (to.t_s - from.t_s) * k / n);
            self.part([middle.as_ref().unwrap_or(from), &right], depth, finer);
            middle = Some(right);
            k += 1.0;
        }
        self.part([middle.as_ref().unwrap_or(from), to], depth, finer);
    }

    /// Cuts until an arc bends little. A piece on which no motor exceeds its limit at the block's largest rate stays whole;
    /// any other is also cut until its velocity changes little against the slower end: evenly where its direction stays,
    /// else in halves.
    fn part(&mut self, ends: [&PieceEnd; 2], depth: u32, finer: bool) {
        let [from, to] = ends;
        let h_s = to.t_s - from.t_s;
        let planned = Course::by_plan_time(&self.way.between(from, to), h_s);
        let by_distance = finer.then(|| self.way.by_distance(from.t_s, to.t_s)).flatten();
        if let Some((n, depth)) = self.parts(by_distance.as_ref().unwrap_or(&planned), depth, finer) {
            return self.even(ends, n, depth, finer);
        }
        let cap = self.bounds.cap_at(|axis| planned.motion.fastest(axis, h_s));
        let room = limits::room(&planned, &self.bounds.motors.inverse, [cap; 2]);
        let within = room.braking.max(room.driving) <= 1.0;
        let shape = if finer {
            Shape::Bent {
                planned: within.then_some(room),
            }
        } else if within && cap >= self.bounds.cap {
            Shape::Whole { room }
        } else {
            return self.part(ends, 0, true);
        };
        self.pieces.push_back(Piece {
            from_s: from.t_s,
            to_s: to.t_s,
            whole_to_s: self.to_s,
            shape,
            least_s: h_s / LEAST,
            cap,
            limit: f64::NAN,
        });
    }

    /// Returns the number of parts into which a piece must be cut, and their depth.
    fn parts(&self, course: &Course, depth: u32, finer: bool) -> Option<(f64, u32)> {
        if !finer && !self.way.bends() {
            return None;
        }
        let (motion, h_s) = (&course.motion, course.length_s);
        let spread = Spread::new(motion, &self.bounds.motors.inverse);
        // Change of the velocity between the ends against the slower one, over the largest allowed.
        let uneven = spread.change_s.max(h_s / 4.0) / (CHANGE_MAX * spread.slower_s);
        if finer && uneven > 1.0 && depth < HALVINGS_MAX {
            let keeps_direction = spread.change_s < spread.slower_s;
            return Some(if keeps_direction {
                (uneven.min(PARTS_MAX).ceil(), HALVINGS_MAX)
            } else {
                (2.0, depth + 1)
            });
        }
        // Deviation between the ends over the largest allowed, at the limit for the largest rate.
        let most = 1.0 / self.bounds.cap.max(1.0);
        let left_out = h_s * h_s * spread.bend / 8.0;
        let least = (BEND_MAX * spread.used.max(most)).max(LEFT_MAX * (most - spread.used));
        let bent = (left_out / least).max(course.excess / EXCESS_MAX);
        // The deviation falls at least with the square of the length.
        let is_bent = bent > 1.0 && depth < 2 * HALVINGS_MAX;
        is_bent.then(|| (bent.sqrt().ceil().min(PARTS_MAX), depth + 1))
    }
}
