//! A block's plan time cut into pieces on which the square of the rate is linear.

use std::collections::VecDeque;

use tandem_model::Axis;
use tandem_model::flow::Path;
use tandem_model::profile::SlewRoom;

use super::limits::{self, Bounds};
use super::way::{Motion, Phase, Way};

/// The largest change of a velocity on one piece of a ramp, as a share of it.
const CHANGE_MAX: f64 = 0.25;

/// The largest share of a limit left for what lies between the ends of a piece before it is halved for its rate.
const BEND_MAX: f64 = 0.04;

/// A ramp is halved so often at most.
const HALVINGS_MAX: u32 = 4;

/// As many parts as that.
const PARTS_MAX: f64 = 16.0;

/// The largest turn of an arc on one piece, rad: 0.6 percent of the centripetal acceleration is left for what lies
/// between the ends.
const TURN_MAX: f64 = 0.4;

/// A piece is cut into so many at most where the rate needs it.
const LEAST: f64 = 64.0;

/// Pieces of one phase at most.
const PIECES_MAX: f64 = 512.0;

/// A ramp shorter than this share of its block's plan time is rounding.
const RAMP_MIN: f64 = 1e-14;

/// A way between ramps shorter than this share of its block's plan time is rounding.
const BETWEEN_MIN: f64 = 1e-8;

/// A piece, in plan time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) shape: Shape,
    /// It is not halved below this, s.
    pub(super) least_s: f64,
    /// Largest square of the rate in it.
    pub(super) cap: f64,
    /// Largest square of the rate at its begin from which the motion can end in rest; not a number before it is known.
    pub(super) limit: f64,
}

/// What a piece is like.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// Straight at one speed: the square of the rate changes by at most this per second of plan time, anywhere in it.
    Straight { change: f64 },
    Bent {
        /// What is left at the largest rate, when nothing exceeds its limit at that.
        planned: Option<SlewRoom>,
    },
}

impl Piece {
    pub(super) fn length_s(&self) -> f64 {
        self.to_s - self.from_s
    }

    /// Both halves, if it may be cut.
    pub(super) fn halves(&self) -> Option<[Piece; 2]> {
        if self.length_s() < 2.0 * self.least_s {
            return None;
        }
        let middle_s = f64::midpoint(self.from_s, self.to_s);
        let first = Piece {
            to_s: middle_s,
            ..*self
        };
        let second = Piece {
            from_s: middle_s,
            ..*self
        };
        Some([first, second])
    }
}

/// Adds the pieces of a way, and gives how many.
pub(super) fn cut(way: &Way<'_>, bounds: Bounds<'_>, pieces: &mut VecDeque<Piece>) -> usize {
    let before = pieces.len();
    let begin_s = way.passage.from_s;
    let mut at_s = begin_s;
    for phase in way.phases() {
        let least = if phase.is_ramp { RAMP_MIN } else { BETWEEN_MIN };
        if phase.to_s - phase.from_s.max(at_s) <= least * way.plan_s {
            continue;
        }
        let phase = Phase {
            from_s: at_s,
            ..phase
        };
        at_s = phase.to_s;
        match (phase.is_ramp, way.path) {
            (false, Path::Line { .. }) => pieces.push_back(straight(way, bounds, phase)),
            (false, Path::Arc(arc)) => {
                let swept = arc.swept() * way.speed * (phase.to_s - phase.from_s) / arc.length();
                let n = (swept / TURN_MAX).ceil().clamp(1.0, PIECES_MAX);
                even(way, bounds, phase, n, 0, pieces);
            }
            (true, _) => parts(way, bounds, phase, 0, pieces),
        }
    }
    if pieces.len() == before && way.plan_s > begin_s {
        add(
            bounds,
            &way.motion(begin_s, way.plan_s),
            [begin_s, way.plan_s],
            pieces,
        );
    }
    // What was left out as rounding belongs to the last piece.
    if let Some(last) = pieces.back_mut().filter(|_| at_s > begin_s) {
        last.to_s = way.plan_s;
    }
    pieces.len() - before
}

fn straight(way: &Way<'_>, bounds: Bounds<'_>, phase: Phase) -> Piece {
    let steepest = Axis::ALL.into_iter().fold(0.0, |steepest: f64, axis| {
        steepest.max(way.path.steepest(axis) * bounds.inverse[axis.index()])
    });
    Piece {
        from_s: phase.from_s,
        to_s: phase.to_s,
        shape: Shape::Straight {
            change: 2.0 / (steepest * way.speed),
        },
        least_s: f64::INFINITY,
        cap: bounds.cap_at(|axis| way.path.steepest(axis) * way.speed),
        limit: f64::NAN,
    }
}

/// Cuts a phase into n parts of one length, and each as [`parts`] does.
fn even(way: &Way<'_>, bounds: Bounds<'_>, phase: Phase, n: f64, depth: u32, pieces: &mut VecDeque<Piece>) {
    let mut from_s = phase.from_s;
    let mut k = 0.0;
    while k < n {
        k += 1.0;
        let to_s = if k < n {
            phase.from_s + (phase.to_s - phase.from_s) * k / n
        } else {
            phase.to_s
        };
        let part = Phase {
            from_s,
            to_s,
            ..phase
        };
        parts(way, bounds, part, depth, pieces);
        from_s = to_s;
    }
}

/// Cuts a phase until on each piece the velocity changes little against the slower end, and an arc bends little: evenly
/// where its speed does not change much, else in halves.
fn parts(way: &Way<'_>, bounds: Bounds<'_>, phase: Phase, depth: u32, pieces: &mut VecDeque<Piece>) {
    let Phase { from_s, to_s, .. } = phase;
    let motion = way.motion(from_s, to_s);
    let h_s = to_s - from_s;
    let (mut change, mut bend, mut most) = (0.0_f64, 0.0_f64, 1.0 / bounds.cap.max(1.0));
    let mut speeds = [0.0_f64; 2];
    for axis in Axis::ALL {
        let inverse = bounds.inverse[axis.index()];
        let ends = [motion.velocity[0][axis], motion.velocity[1][axis]].map(|v| v * inverse);
        change = change.max((ends[1] - ends[0]).abs());
        for (speed, end) in speeds.iter_mut().zip(ends) {
            *speed = speed.max(end.abs());
        }
        bend = bend.max(motion.fourth[axis] * inverse);
        for end in motion.acceleration {
            most = most.max(end[axis].abs() * inverse);
        }
    }
    let slower = speeds[0].min(speeds[1]);
    let uneven = change.max(h_s / 4.0) / (CHANGE_MAX * slower);
    // Little of the limit is left for what lies between the ends of an arc, at the rate that the limit allows.
    let bent = h_s * h_s * bend > 8.0 * BEND_MAX * most;
    let (parts, depth) = if uneven > 1.0 && depth < HALVINGS_MAX {
        if change < slower {
            (uneven.min(PARTS_MAX).ceil(), HALVINGS_MAX)
        } else {
            (2.0, depth + 1)
        }
    } else if bent && depth < 2 * HALVINGS_MAX {
        (2.0, depth + 1)
    } else {
        return add(bounds, &motion, [from_s, to_s], pieces);
    };
    even(way, bounds, phase, parts, depth, pieces);
}

fn add(bounds: Bounds<'_>, motion: &Motion, [from_s, to_s]: [f64; 2], pieces: &mut VecDeque<Piece>) {
    let h_s = to_s - from_s;
    let cap = bounds.cap_at(|axis| {
        let [begin, end] = motion.velocity.map(|velocity| velocity[axis].abs());
        begin.max(end) + motion.third[axis] * h_s * h_s / 8.0
    });
    let room = limits::room(motion, bounds.inverse, h_s, [cap; 2]);
    let within = room.braking.max(room.driving) <= 1.0;
    pieces.push_back(Piece {
        from_s,
        to_s,
        shape: Shape::Bent {
            planned: within.then_some(room),
        },
        least_s: h_s / LEAST,
        cap,
        limit: f64::NAN,
    });
}
