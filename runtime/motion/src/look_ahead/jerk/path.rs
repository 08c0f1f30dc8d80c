//! The path of a chain as pieces on which each axis is a polynomial of third degree.
//!
//! On a smoothed path the pieces are its stretches, by distance. On the programmed path they are the phases of its ramps and
//! the parts between them, by plan time; arcs are divided.

use tandem_model::flow::Path;
use tandem_model::{AXES_MAX, Axis, AxisVector};

use super::joint::Step;
use crate::look_ahead::blended_block::{BlendedBlock, BlockPart, Phase};
use crate::look_ahead::held_block::HeldBlock;
use crate::look_ahead::limits::Motors;
use crate::look_ahead::way::{SmoothedWay, Way};
use crate::smooth_block::Stretch;

/// Largest turn of an arc on one piece, rad. The third derivative deviates by at most half of it, relative to its size.
const TURN_MAX: f64 = 0.02;

/// Largest number of pieces of a phase.
const PIECES_MAX: f64 = 2000.0;

/// Number of pieces of a phase of a ramp from rest or to rest at an override below 100 percent, and of a ramp along an arc,
/// whose centripetal acceleration follows the square of the speed.
const RAMP_PIECES: f64 = 8.0;

/// Share of a block's plan time below which a phase is only rounding.
const PHASE_MIN: f64 = 1e-9;

/// A stretch of the path on which each axis is a polynomial of third degree in the distance along the chain.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathPiece {
    pub(super) from: f64,
    pub(super) to: f64,
    /// Step of the second derivative at `from`.
    pub(super) step: Step,
    /// First to third derivative of the position with respect to distance, at `from`.
    pub(super) derivatives: [AxisVector; 3],
    /// Square of the largest speed along the path.
    pub(super) speed_square: f64,
    /// Largest acceleration along the path; infinite if only the motors limit it.
    pub(super) acceleration: f64,
}

impl PathPiece {
    pub(super) fn derivatives_at(&self, at: f64) -> [AxisVector; 3] {
        let t = at - self.from;
        let [first, second, third] = self.derivatives;
        [
            first.plus(second.scaled(t)).plus(third.scaled(t * t / 2.0)),
            second.plus(third.scaled(t)),
            third,
        ]
    }

    /// Returns the largest square of the speed at a distance, by the velocities.
    pub(super) fn cap_at(&self, first: AxisVector, motors: &Motors) -> f64 {
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

    pub(super) fn is_straight(&self) -> bool {
        let [_, second, third] = self.derivatives;
        second == AxisVector::ZERO && third == AxisVector::ZERO
    }

    /// Returns the largest speed of each motor at the start of the piece.
    pub(super) fn speeds(&self) -> [f64; AXES_MAX] {
        let [first, ..] = self.derivatives;
        first.0.map(|slope| slope.abs() * self.speed_square.sqrt())
    }

    /// Returns the second derivative at the end.
    pub(super) fn second_at_end(&self) -> AxisVector {
        let [_, second, third] = self.derivatives;
        second.plus(third.scaled(self.to - self.from))
    }
}

/// Returns the distance per plan time of a block.
pub(super) fn speed(way: &Way<'_>) -> f64 {
    match way {
        Way::Blended(_) => 1.0,
        Way::Smoothed(way) => way.block.speed,
    }
}

/// Returns the plan times at which a profile of a block must end, s.
pub(super) fn ends_s(way: &Way<'_>) -> Vec<f64> {
    match way {
        Way::Blended(way) => vec![way.block.plan_s],
        Way::Smoothed(way) => {
            let begins_s = Way::Smoothed(*way).begins_s();
            let ends_s = way.stretches().map(|(_, [_, to_s])| to_s);
            ends_s.filter(|to_s| *to_s > begins_s).collect()
        }
    }
}

/// Adds the path of a block. Returns the distance along the chain at its end.
pub(super) fn add_pieces(held: &HeldBlock, from: f64, motors: &Motors, pieces: &mut Vec<PathPiece>) -> f64 {
    match Way::new(&held.block.motion, held.passage) {
        Way::Blended(way) => add_blended(&way, held, from, pieces),
        Way::Smoothed(way) => add_smoothed(&way, held, from, motors, pieces),
    }
}

fn add_smoothed(
    way: &SmoothedWay<'_>,
    held: &HeldBlock,
    from: f64,
    motors: &Motors,
    pieces: &mut Vec<PathPiece>,
) -> f64 {
    let speed = way.block.speed;
    let bounds = Way::Smoothed(*way).bounds(motors, held.cap);
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
            step: Step::NONE,
            derivatives: derivatives_at(way, stretch, from_s.max(begins_s), speed),
            speed_square: held.cap * speed * speed,
            acceleration: bounds.change / 2.0 * speed,
        });
        at = to;
    }
    at
}

/// Returns the derivatives of the position by distance in the direction of the motion, at a plan time of the motion.
fn derivatives_at(way: &SmoothedWay<'_>, stretch: &Stretch, t_s: f64, speed: f64) -> [AxisVector; 3] {
    let [velocity, acceleration] = stretch.motion_at(way.forward_s(t_s));
    let [.., third] = stretch.derivatives;
    let sign = if way.is_backward() { -1.0 } else { 1.0 };
    [
        velocity.scaled(sign / speed),
        acceleration.scaled(1.0 / (speed * speed)),
        third.scaled(sign / (speed * speed * speed)),
    ]
}

fn add_blended(way: &BlendedBlock<'_>, held: &HeldBlock, from: f64, pieces: &mut Vec<PathPiece>) -> f64 {
    let whole_s = way.block.plan_s;
    let begins_s = held.passage.from_s;
    let mut at_s = begins_s;
    for phase in way.phases() {
        if phase.to_s - phase.from_s.max(at_s) <= PHASE_MIN * whole_s {
            continue;
        }
        let is_slow = held.cap < 1.0 && way.is_slow(&phase);
        let is_uneven = is_slow || phase.part != BlockPart::Between && way.bends();
        let least = if is_uneven { RAMP_PIECES } else { 1.0 };
        let parts = (turn(way, &phase) / TURN_MAX).ceil().clamp(least, PIECES_MAX);
        let begin_s = at_s;
        let mut k = 1.0;
        while k <= parts {
            let to_s = if k < parts {
                begin_s + (phase.to_s - begin_s) * k / parts
            } else {
                phase.to_s
            };
            let mut piece = piece(way, [at_s, to_s], from - begins_s, held.cap);
            if is_slow {
                let shares = [at_s, to_s].map(|t_s| way.share_of_speed(t_s, &phase));
                let share = shares[0].max(shares[1]);
                piece.speed_square = (held.cap / (share * share)).clamp(held.cap, 1.0);
            }
            pieces.push(piece);
            at_s = to_s;
            k += 1.0;
        }
    }
    from + whole_s - begins_s
}

/// Returns a piece between two plan times of a phase. `offset` is the distance along the chain at the plan time 0.
fn piece(way: &BlendedBlock<'_>, [from_s, to_s]: [f64; 2], offset: f64, cap: f64) -> PathPiece {
    let within_s = f64::midpoint(from_s, to_s);
    let [begin, end] = [from_s, to_s].map(|t_s| way.piece_end(t_s, within_s));
    let change = end.acceleration.minus(begin.acceleration);
    PathPiece {
        from: offset + from_s,
        to: offset + to_s,
        step: Step::NONE,
        derivatives: [
            begin.velocity,
            begin.acceleration,
            change.scaled(1.0 / (to_s - from_s)),
        ],
        speed_square: cap,
        acceleration: f64::INFINITY,
    }
}

/// Returns the turn of the arcs along which the motion passes in a phase, rad.
fn turn(way: &BlendedBlock<'_>, phase: &Phase) -> f64 {
    let next = way.block.next.as_ref().map(|next| (&next.path, next.speed));
    let paths = [Some((&way.block.path, way.block.speed)), next];
    paths
        .into_iter()
        .flatten()
        .fold(0.0, |turn, (path, speed)| match path {
            Path::Arc(arc) => {
                let length = speed * (phase.to_s - phase.from_s);
                turn.max(arc.sweep().abs() * (length / arc.length()).min(1.0))
            }
            Path::Line { .. } => turn,
        })
}
