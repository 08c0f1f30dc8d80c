//! The rate on the pieces of one block: a backward pass finds its limits, a forward pass the rate itself.
//!
//! If the acceleration changes much along a piece, a part of it stays unused at one end. The piece is halved
//! where this is faster.

use std::collections::VecDeque;

use tandem_model::profile::SlewRoom;

use super::course::Course;
use super::grid;
use super::limits::{self, Bounds, HalfPlane, SQUARE_MIN, Spread};
use super::piece::{Piece, Shape};
use super::step::{self, RateStep};
use super::straight::Straight;
use super::way::Way;

/// Smallest relative gain in the square of the rate for which a piece is halved.
const GAIN: f64 = 7e-4;

/// Relative change of the square of the rate below which a piece is not halved.
const CHANGE_MIN: f64 = 0.02;

/// Largest acceleration between the ends of a piece that a constant rate causes if the velocities at the ends
/// differ, as a share of the limit. With more, the piece is halved.
const SWAY_MAX: f64 = 0.1;

/// Number of pieces cut from the same larger piece, from which on they are passed in one step where this is
/// as fast. Reason: the backward pass divides finely enough for the fastest possible motion, and the actual
/// motion may be much slower.
const JOINED_FROM: usize = 16;

/// Tolerance for rounding of a share of a limit, below the reserve of the acceleration.
const WITHIN: f64 = 1e-8;

/// Limits and working memory for the pieces of one block.
pub(super) struct Limits<'a> {
    pub(super) way: Way<'a>,
    pub(super) bounds: Bounds<'a>,
    pub(super) planes: &'a mut Vec<HalfPlane>,
    pub(super) bent: BentPiece,
}

/// Values of the bent piece whose half planes are in `planes`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BentPiece {
    /// [`Spread::sway`].
    sway: f64,
    /// [`Course::scale`].
    scale: f64,
    /// Largest square of the rate at the ends of the piece.
    cap: f64,
}

impl Limits<'_> {
    fn load_piece(&mut self, course: &Course, piece: &Piece) {
        let bounds = Bounds {
            cap: piece.cap,
            ..self.bounds
        };
        limits::half_planes(course, bounds, self.planes);
        self.bent = BentPiece {
            sway: Spread::new(&course.motion, &self.bounds.motors.inverse).sway(),
            scale: course.scale,
            cap: piece.cap / (1.0 + course.excess),
        };
    }

    /// Returns the largest square of the rate at the start of a piece. `end` is the largest square after the
    /// piece.
    pub(super) fn start(&mut self, piece: &Piece, end: f64) -> f64 {
        self.start_and_end(piece, end)[0]
    }

    /// Returns the largest square of the rate at the start, and the resulting square of the rate at the end.
    fn start_and_end(&mut self, piece: &Piece, end: f64) -> [f64; 2] {
        let end = end.min(piece.cap);
        match piece.shape {
            Shape::Straight(Straight { change }) => [(end + change * piece.length_s()).min(piece.cap), end],
            Shape::Whole { .. } | Shape::Bent { planned: Some(_) } if end >= piece.cap => [piece.cap, end],
            Shape::Whole { .. } | Shape::Bent { .. } => {
                self.better(piece, |limits| limits.bent_start(end)[0]);
                self.bent_start(end)
            }
        }
    }

    /// Returns the course of a bent piece by plan time or by distance, whichever has the larger `value`. Both
    /// respect the limits. The half planes of the result are in `planes`.
    fn better(&mut self, piece: &Piece, value: impl Fn(&Self) -> f64) -> Course {
        let by_plan_time = self.way.by_plan_time(piece.from_s, piece.to_s);
        self.load_piece(&by_plan_time, piece);
        let Some(by_distance) = self.way.by_distance(piece.from_s, piece.to_s) else {
            return by_plan_time;
        };
        let least = value(self);
        self.load_piece(&by_distance, piece);
        if value(self) >= least {
            return by_distance;
        }
        self.load_piece(&by_plan_time, piece);
        by_plan_time
    }

    /// Returns the largest square of the rate at the start of the piece in `planes`, and the resulting square
    /// at its end.
    fn bent_start(&self, end: f64) -> [f64; 2] {
        let cap = self.bent.cap;
        limits::fastest_start(self.planes, cap, end.min(cap)).map(|square| square.max(0.0))
    }

    /// Returns the largest square of the rate at the end of the piece in `planes`.
    fn bent_end(&self, before: f64, limit: f64) -> f64 {
        limits::fastest_end(self.planes, before, limit.min(self.bent.cap)).max(SQUARE_MIN)
    }

    /// Adds a piece with its new limit, divided into as many pieces as necessary, in reverse order. Returns
    /// the limit at its start.
    pub(super) fn renew(&mut self, piece: &Piece, end: f64, renewed: &mut Vec<Piece>) -> f64 {
        if let Shape::Whole { .. } = piece.shape
            && end < piece.cap
        {
            return self.renew_finer(piece, end, renewed);
        }
        let [limit, after] = self.start_and_end(piece, end);
        if limit < piece.cap
            && let Shape::Bent { .. } = piece.shape
            && self.is_uneven(limit, after)
            && let Some([first, second]) = piece.halves()
        {
            let middle = self.start(&second, end);
            if self.start(&first, middle) > limit * (1.0 + GAIN) {
                let middle = self.renew(&second, end, renewed);
                return self.renew(&first, middle, renewed);
            }
        }
        renewed.push(Piece { limit, ..*piece });
        limit
    }

    /// Divides a piece on which the rate changes into finer pieces, and adds these.
    fn renew_finer(&mut self, piece: &Piece, end: f64, renewed: &mut Vec<Piece>) -> f64 {
        let mut finer = VecDeque::new();
        grid::cut_finer(&self.way, self.bounds, piece, &mut finer);
        finer
            .iter()
            .rev()
            .fold(end, |end, piece| self.renew(piece, end, renewed))
    }

    /// Passes pieces that were cut from the same larger piece. Many pieces are passed in one step where this
    /// is as fast.
    pub(super) fn pass_cut(
        &mut self,
        pieces: &[Piece],
        before: f64,
        limit: f64,
        steps: &mut Vec<RateStep>,
    ) -> f64 {
        let [first, others @ ..] = pieces else {
            return before;
        };
        if pieces.len() < JOINED_FROM {
            return self.pass_each(pieces, before, limit, steps);
        }
        let whole = Piece::joined(first, others);
        let step = self.fastest(&whole, before, limit);
        if before <= self.bent.cap && is_within(&step) {
            let mut each = Vec::new();
            let end = self.pass_each(pieces, before, limit, &mut each);
            let least_s: f64 = each.iter().map(RateStep::duration_s).sum();
            if step.end * (1.0 + GAIN) >= end && step.duration_s() <= least_s * (1.0 + GAIN) {
                step::push(steps, step, whole.length_s());
                return step.end;
            }
        }
        let (first, second) = pieces.split_at(pieces.len() / 2);
        let most = second.first().map_or(limit, |piece| piece.limit);
        let middle = self.pass_cut(first, before, most, steps);
        self.pass_cut(second, middle, limit, steps)
    }

    fn pass_each(&mut self, pieces: &[Piece], before: f64, limit: f64, steps: &mut Vec<RateStep>) -> f64 {
        let limits = pieces.iter().skip(1).map(|next| next.limit).chain([limit]);
        let mut at = before;
        for (piece, limit) in pieces.iter().zip(limits) {
            at = self.pass(piece, at, limit, steps);
        }
        at
    }

    /// Returns true if two halves are faster than the step `whole` over both. `most` is the limit after the
    /// first half, `limit` that after the second.
    fn gains(&mut self, whole: &RateStep, [first, second]: [&Piece; 2], most: f64, limit: f64) -> bool {
        let one = self.fastest(first, whole.start, most);
        let two = self.fastest(second, one.end, limit);
        let is_faster = one.duration_s() + two.duration_s() < whole.duration_s() * (1.0 - GAIN)
            || two.end > whole.end * (1.0 + GAIN);
        // The bound of the deviation differs for halves, so that halves may allow a lower rate.
        is_faster && is_within(&one) && is_within(&two)
    }

    /// Passes a piece from the square `before` of the rate, as fast as `limit` after the piece allows.
    /// Returns the square at its end.
    pub(super) fn pass(&mut self, piece: &Piece, before: f64, limit: f64, steps: &mut Vec<RateStep>) -> f64 {
        let limit = limit.min(piece.cap);
        if before >= piece.cap
            && limit >= piece.cap
            && let Some(room) = piece.room_at_cap()
        {
            step::push(steps, at_cap(piece, room), piece.length_s());
            return piece.cap;
        }
        match piece.shape {
            Shape::Straight(straight) => {
                let after = limit
                    .min(before + straight.change * piece.length_s())
                    .max(SQUARE_MIN);
                let span_s = [piece.from_s, piece.to_s];
                straight.pass(span_s, piece.cap, [before, after], steps);
                after
            }
            Shape::Whole { .. } => {
                let mut finer = Vec::new();
                if self.renew_finer(piece, limit, &mut finer) < before {
                    // The bound of the deviation differs for parts, so that parts may allow a lower rate.
                    let whole = self.fastest(piece, before, limit);
                    step::push(steps, whole, piece.length_s());
                    return whole.end;
                }
                finer.reverse();
                self.pass_cut(&finer, before, limit, steps)
            }
            Shape::Bent { .. } => {
                let whole = self.fastest(piece, before, limit);
                if (self.is_uneven(before, whole.end) || self.could_rise(before))
                    && let Some([first, second]) = piece.halves()
                {
                    let most = self.start(&second, limit);
                    if self.gains(&whole, [&first, &second], most, limit) {
                        let middle = self.pass(&first, before, most, steps);
                        return self.pass(&second, middle, limit, steps);
                    }
                }
                step::push(steps, whole, piece.length_s());
                whole.end
            }
        }
    }

    /// Returns true if halves of the piece in `planes` may be faster, because its rate changes or, at a
    /// constant rate, its velocity would change.
    fn is_uneven(&self, before: f64, after: f64) -> bool {
        let after = after * self.bent.scale;
        changes(before, after) || self.bent.sway * before.max(after) > SWAY_MAX
    }

    /// Returns true if the rate would change without a limit after the piece in `planes`. The rate may then
    /// rise and fall within the piece.
    fn could_rise(&self, before: f64) -> bool {
        let open = limits::fastest_end(self.planes, before, self.bent.cap);
        changes(before, open * self.bent.scale)
    }

    /// Returns the fastest passage of a bent piece in a single step.
    fn fastest(&mut self, piece: &Piece, before: f64, limit: f64) -> RateStep {
        let course = self.better(piece, |limits| {
            let may_begin = limits.bent_start(limit)[0] >= before;
            if may_begin {
                limits.bent_end(before, limit)
            } else {
                0.0
            }
        });
        let after = self.bent_end(before, limit);
        let room = limits::room(&course, &self.bounds.motors.inverse, [before, after]);
        RateStep {
            from_s: piece.from_s,
            to_s: piece.to_s,
            start: before,
            end: after,
            growth: course.growth,
            rate_change: (after * course.scale - before) / (2.0 * course.length_s),
            room,
            ..RateStep::default()
        }
    }
}

/// Returns true if the square of the rate changes by more than [`CHANGE_MIN`], so that halves may be faster.
fn changes(start: f64, end: f64) -> bool {
    (end - start).abs() > CHANGE_MIN * start.max(end)
}

/// Returns true if no motor exceeds its limit in this step.
fn is_within(step: &RateStep) -> bool {
    step.room.braking.max(step.room.driving) <= 1.0 + WITHIN
}

/// Returns the step that passes a piece at its largest rate.
fn at_cap(piece: &Piece, room: SlewRoom) -> RateStep {
    RateStep {
        from_s: piece.from_s,
        to_s: piece.to_s,
        start: piece.cap,
        end: piece.cap,
        room,
        ..RateStep::default()
    }
}
