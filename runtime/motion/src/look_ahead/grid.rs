//! Division of a block's plan time into pieces on which the square of the rate is linear.

use std::collections::VecDeque;

use tandem_model::Axis;
use tandem_model::flow::Path;

use super::blended_block::{BlendedBlock, BlockPart, Phase, PieceEnd};
use super::course::Course;
use super::limits::{self, Bounds, Spread};
use super::piece::{Piece, Shape};
use super::straight::Straight;
use super::way::{SmoothedWay, Way};

/// Largest change of the velocity on one piece of a ramp, relative to the slower end.
const CHANGE_MAX: f64 = 0.25;

/// Largest deviation between the ends of a piece, as a share of a limit. With a larger deviation the piece is
/// divided.
const BEND_MAX: f64 = 0.04;

/// Largest deviation between the ends of a piece, as a share of the part of a limit that the motion at the
/// ends does not use.
const LEFT_MAX: f64 = 0.25;

/// Largest relative amount by which the square of the rate may exceed its values at the ends of a piece.
const EXCESS_MAX: f64 = 0.1;

/// Maximum number of halvings of a ramp.
const HALVINGS_MAX: u32 = 4;

/// Number of parts after [`HALVINGS_MAX`] halvings.
const PARTS_MAX: f64 = 16.0;

/// Largest turn of an arc on one piece, rad. It reserves 0.6 percent of the centripetal acceleration for the
/// deviation between the ends.
const TURN_MAX: f64 = 0.4;

/// Maximum number of parts of a piece that is halved for its rate.
const LEAST: f64 = 256.0;

/// Number of parts of a phase of a ramp from rest or to rest at an override below 100 percent.
const SLOW_PARTS: f64 = 8.0;

/// Maximum number of pieces of one phase.
const PIECES_MAX: f64 = 512.0;

/// Share of a block's plan time below which a ramp is only rounding.
const RAMP_MIN: f64 = 1e-14;

/// Share of a block's plan time below which the part between the ramps is only rounding.
const BETWEEN_MIN: f64 = 1e-8;

/// Adds the pieces of a block to `pieces`, and returns their number.
pub(super) fn cut(way: &Way<'_>, bounds: Bounds<'_>, pieces: &mut VecDeque<Piece>) -> usize {
    let before = pieces.len();
    let begin_s = way.begins_s();
    let ends_s = match way {
        Way::Blended(block) => cut_blended(block, way, bounds, pieces),
        Way::Smoothed(block) => cut_smoothed(*block, way, bounds, pieces),
    };
    if pieces.len() == before && way.plan_s() > begin_s {
        Cutter::new(way, bounds, [begin_s, way.plan_s()], pieces).whole(1.0, true);
    }
    // The last piece includes all parts that were omitted as rounding.
    if let Some(last) = pieces.back_mut().filter(|_| ends_s > begin_s) {
        last.to_s = way.plan_s();
    }
    pieces.len() - before
}

/// Adds the pieces of a block on a smoothed path. Returns the plan time at the end of the last piece, s.
fn cut_smoothed(
    block: SmoothedWay<'_>,
    way: &Way<'_>,
    bounds: Bounds<'_>,
    pieces: &mut VecDeque<Piece>,
) -> f64 {
    let mut at_s = way.begins_s();
    for (stretch, [_, to_s]) in block.stretches().filter(|(_, [_, to_s])| *to_s > way.begins_s()) {
        let range_s = [at_s, to_s];
        at_s = to_s;
        if stretch.is_straight() {
            let [velocity, _] = stretch.motion_at(stretch.from_s);
            let (straight, cap) = straight_along(|axis| velocity[axis].abs(), bounds);
            pieces.push_back(Piece::straight(straight, cap, range_s));
        } else {
            Cutter::new(way, bounds, range_s, pieces).whole(1.0, false);
        }
    }
    at_s
}

/// Adds the pieces of a block with ramps. Returns the plan time at the end of the last piece, s.
fn cut_blended(
    block: &BlendedBlock<'_>,
    way: &Way<'_>,
    bounds: Bounds<'_>,
    pieces: &mut VecDeque<Piece>,
) -> f64 {
    let mut at_s = way.begins_s();
    for phase in block.phases() {
        let least = match phase.part {
            BlockPart::Between => BETWEEN_MIN,
            BlockPart::Start | BlockPart::Stop => RAMP_MIN,
        };
        if phase.to_s - phase.from_s.max(at_s) <= least * way.plan_s() {
            continue;
        }
        let phase = Phase {
            from_s: at_s,
            ..phase
        };
        at_s = phase.to_s;
        let mut cutter = Cutter::new(way, bounds, [phase.from_s, phase.to_s], pieces);
        let range_s = [phase.from_s, phase.to_s];
        match (phase.part, &block.block.path) {
            (BlockPart::Between, path @ Path::Line { .. }) => {
                let (straight, cap) = straight_along(|axis| path.steepest(axis) * block.block.speed, bounds);
                cutter.pieces.push_back(Piece::straight(straight, cap, range_s));
            }
            (BlockPart::Between, Path::Arc(arc)) => {
                let swept =
                    arc.sweep().abs() * block.block.speed * (phase.to_s - phase.from_s) / arc.length();
                cutter.whole((swept / TURN_MAX).ceil().clamp(1.0, PIECES_MAX), false);
            }
            (BlockPart::Start | BlockPart::Stop, _) if bounds.cap < 1.0 && block.is_slow(&phase) => {
                cut_slow(block, way, bounds, &phase, pieces);
            }
            (BlockPart::Start | BlockPart::Stop, _) => cutter.whole(1.0, false),
        }
    }
    at_s
}

/// Adds the pieces of a ramp from rest or to rest at an override below 100 percent. The rate is up to 1 while the
/// speed is below F times the override, so that the override does not lengthen the ramp.
fn cut_slow(
    block: &BlendedBlock<'_>,
    way: &Way<'_>,
    bounds: Bounds<'_>,
    phase: &Phase,
    pieces: &mut VecDeque<Piece>,
) {
    let at_s = |k: f64| phase.from_s + (phase.to_s - phase.from_s) * k / SLOW_PARTS;
    let mut k = 0.0;
    while k < SLOW_PARTS {
        let range_s = [at_s(k), at_s(k + 1.0)];
        let share = range_s.map(|t_s| block.share_of_speed(t_s, phase));
        let share = share[0].max(share[1]);
        let bounds = Bounds {
            cap: (bounds.cap / (share * share)).clamp(bounds.cap, 1.0),
            ..bounds
        };
        Cutter::new(way, bounds, range_s, pieces).whole(1.0, false);
        k += 1.0;
    }
}

/// Divides a piece that was planned as a whole. The rate changes on the piece.
pub(super) fn cut_finer(way: &Way<'_>, bounds: Bounds<'_>, piece: &Piece, pieces: &mut VecDeque<Piece>) {
    let bounds = Bounds {
        cap: piece.cap,
        ..bounds
    };
    Cutter::new(way, bounds, [piece.from_s, piece.to_s], pieces).whole(1.0, true);
}

/// Returns the limits of the rate where each axis moves at one speed, and the largest square of the rate.
/// `speed` returns the speed of an axis at the rate 1.
fn straight_along(speed: impl Fn(Axis) -> f64, bounds: Bounds<'_>) -> (Straight, f64) {
    let most = Axis::ALL.into_iter().fold(0.0, |most: f64, axis| {
        most.max(speed(axis) * bounds.motors.inverse[axis.index()])
    });
    let straight = Straight {
        change: (2.0 / most).min(bounds.change),
    };
    (straight, bounds.cap_at(speed))
}

/// Division of an interval within one phase.
struct Cutter<'a> {
    way: &'a Way<'a>,
    bounds: Bounds<'a>,
    from_s: f64,
    to_s: f64,
    pieces: &'a mut VecDeque<Piece>,
}

impl<'a> Cutter<'a> {
    fn new(
        way: &'a Way<'a>,
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

    /// Divides the whole interval into n parts. `finer` is true if the rate changes on the interval.
    fn whole(&mut self, n: f64, finer: bool) {
        let (from, to) = (self.piece_end(self.from_s), self.piece_end(self.to_s));
        self.even([&from, &to], n, 0, finer);
    }

    /// Divides into n parts of equal length, and divides each part further if necessary.
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

    /// Adds a piece, or divides it until an arc bends little on it. A piece stays whole if no motor exceeds
    /// its limit on it at the block's largest rate. Any other piece is also divided until its velocity
    /// changes little relative to the slower end: into equal parts if its direction stays, otherwise into
    /// halves.
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

    /// Returns the number of parts into which a piece must be divided, and the depth of these parts. Returns
    /// `None` if the piece stays whole.
    fn parts(&self, course: &Course, depth: u32, finer: bool) -> Option<(f64, u32)> {
        if !finer && !self.way.bends() {
            return None;
        }
        let (motion, h_s) = (&course.motion, course.length_s);
        let spread = Spread::new(motion, &self.bounds.motors.inverse);
        // Change of the velocity between the ends relative to the slower end, divided by the largest
        // permitted change.
        let uneven = spread.change_s.max(h_s / 4.0) / (CHANGE_MAX * spread.slower_s);
        if finer && uneven > 1.0 && depth < HALVINGS_MAX {
            let keeps_direction = spread.change_s < spread.slower_s;
            return Some(if keeps_direction {
                (uneven.min(PARTS_MAX).ceil(), HALVINGS_MAX)
            } else {
                (2.0, depth + 1)
            });
        }
        // Deviation between the ends, divided by the largest permitted deviation, at the limit for the
        // largest rate.
        let most = 1.0 / self.bounds.cap.max(1.0);
        let left_out = h_s * h_s * spread.bend / 8.0;
        let least = (BEND_MAX * spread.used.max(most)).max(LEFT_MAX * (most - spread.used));
        let bent = (left_out / least).max(course.excess / EXCESS_MAX);
        // The deviation falls at least with the square of the length.
        let is_bent = bent > 1.0 && depth < 2 * HALVINGS_MAX;
        is_bent.then(|| (bent.sqrt().ceil().min(PARTS_MAX), depth + 1))
    }
}
