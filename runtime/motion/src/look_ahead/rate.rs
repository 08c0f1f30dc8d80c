//! The rate on the pieces of one block: its limits backwards, and the rate itself forward.
//!
//! A piece whose acceleration changes much along it wastes some of it at one end; where halves are faster, it is halved.

use std::collections::VecDeque;

use tandem_model::profile::SlewRoom;

use super::grid::{self, Piece, Shape};
use super::limits::{self, Bounds, HalfPlane};
use super::paced::{self, Step};
use super::way::{Motion, Way};

/// Smallest square of the rate: a millionth of the rate without look-ahead. Nothing is ever slower, so every block ends.
pub(super) const SQUARE_MIN: f64 = 1e-12;

/// A piece is halved when that gains more than this share of the square of the rate.
const GAIN: f64 = 1e-3;

/// With less change of the square of the rate a piece is not halved.
const CHANGE_MIN: f64 = 0.03;

/// A piece of another velocity at its ends is halved while the acceleration that an even rate would leave between them
/// is more than this share of the limit.
const SWAY_MAX: f64 = 0.3;

/// Rounding of a share of a limit; less than what is left of a maximum acceleration.
const WITHIN: f64 = 1e-8;

/// One block, with what its limits are made of.
pub(super) struct Limits<'a> {
    pub(super) way: Way<'a>,
    pub(super) bounds: Bounds<'a>,
    pub(super) planes: &'a mut Vec<HalfPlane>,
    /// Of the piece bent last: [`limits::sway`].
    pub(super) sway: f64,
}

impl Limits<'_> {
    /// The motion on a bent piece; its half planes stand ready then.
    fn bend(&mut self, piece: &Piece) -> Motion {
        let motion = self.way.motion(piece.from_s, piece.to_s);
        let bounds = Bounds {
            cap: piece.cap,
            ..self.bounds
        };
        limits::half_planes(&motion, bounds, piece.length_s(), self.planes);
        self.sway = limits::sway(&motion, self.bounds.inverse);
        motion
    }

    /// The largest square of the rate at the begin of a piece, `end` being the largest one behind it.
    pub(super) fn start(&mut self, piece: &Piece, end: f64) -> f64 {
        self.start_and_end(piece, end)[0]
    }

    /// That, and the square of the rate at the end that it leads to.
    fn start_and_end(&mut self, piece: &Piece, end: f64) -> [f64; 2] {
        let end = end.min(piece.cap);
        match piece.shape {
            Shape::Straight { change } => [(end + change * piece.length_s()).min(piece.cap), end],
            Shape::Whole { .. } | Shape::Bent { planned: Some(_) } if end >= piece.cap => [piece.cap, end],
            Shape::Whole { .. } | Shape::Bent { .. } => {
                self.bend(piece);
                limits::fastest_start(self.planes, piece.cap, end).map(|square| square.max(0.0))
            }
        }
    }

    /// Adds a piece with its new limit, in as many pieces as it takes, the last one first.
    pub(super) fn renew(&mut self, piece: &Piece, end: f64, renewed: &mut Vec<Piece>) -> f64 {
        if let Shape::Whole { .. } = piece.shape
            && end < piece.cap
        {
            return self.renew_finer(piece, end, renewed);
        }
        let [limit, after] = self.start_and_end(piece, end);
        if limit < piece.cap
            && let Shape::Bent { .. } = piece.shape
            && (changes(limit, after) || self.sways(limit.max(after)))
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

    /// A piece whose rate changes, in finer ones.
    fn renew_finer(&mut self, piece: &Piece, end: f64, renewed: &mut Vec<Piece>) -> f64 {
        let mut finer = VecDeque::new();
        grid::cut_finer(&self.way, self.bounds, piece, &mut finer);
        finer
            .iter()
            .rev()
            .fold(end, |end, piece| self.renew(piece, end, renewed))
    }

    /// Passes a piece from this square of the rate on, as fast as the limit behind it allows; gives the one at its end.
    pub(super) fn pass(&mut self, piece: &Piece, before: f64, limit: f64, steps: &mut Vec<Step>) -> f64 {
        let limit = limit.min(piece.cap);
        match piece.shape {
            Shape::Straight { change } => {
                let after = limit.min(before + change * piece.length_s()).max(SQUARE_MIN);
                straight(piece, change, [before, after], piece.cap, steps);
                after
            }
            Shape::Whole { room } | Shape::Bent { planned: Some(room) }
                if before >= piece.cap && limit >= piece.cap =>
            {
                let cap = piece.cap;
                paced::push(steps, step(piece, [cap; 2], room), piece.length_s());
                cap
            }
            Shape::Whole { .. } => {
                let mut finer = Vec::new();
                if self.renew_finer(piece, limit, &mut finer) < before {
                    // What is left for between the ends is not the same for parts, so they may allow less.
                    let whole = self.fastest(piece, before, limit);
                    paced::push(steps, whole, piece.length_s());
                    return whole.end;
                }
                let mut before = before;
                while let Some(piece) = finer.pop() {
                    let limit = finer.last().map_or(limit, |next| next.limit);
                    before = self.pass(&piece, before, limit, steps);
                }
                before
            }
            Shape::Bent { .. } => {
                let whole = self.fastest(piece, before, limit);
                if (self.could_change(piece, before, whole.end) || self.sways(before.max(whole.end)))
                    && let Some([first, second]) = piece.halves()
                {
                    let most = self.start(&second, limit);
                    let one = self.fastest(&first, before, most);
                    let two = self.fastest(&second, one.end, limit);
                    let gains = one.duration_s() + two.duration_s() < whole.duration_s() * (1.0 - GAIN)
                        || two.end > whole.end * (1.0 + GAIN);
                    // What is left for between the ends is not the same for halves, so they may allow less.
                    if gains && is_within(&one) && is_within(&two) {
                        let middle = self.pass(&first, before, most, steps);
                        return self.pass(&second, middle, limit, steps);
                    }
                }
                paced::push(steps, whole, piece.length_s());
                whole.end
            }
        }
    }

    /// True when halves of the piece bent last may be faster: its rate changes, or would without a limit behind it, so that
    /// it may rise and fall within the piece.
    fn could_change(&self, piece: &Piece, before: f64, after: f64) -> bool {
        let open = limits::fastest_end(self.planes, before, piece.cap);
        changes(before, after) || changes(before, open)
    }

    /// True when at this square of the rate the piece bent last is too long for its change of velocity.
    fn sways(&self, square: f64) -> bool {
        self.sway * square > SWAY_MAX
    }

    /// A bent piece in one step.
    fn fastest(&mut self, piece: &Piece, before: f64, limit: f64) -> Step {
        let motion = self.bend(piece);
        let after = limits::fastest_end(self.planes, before, limit).max(SQUARE_MIN);
        let room = limits::room(&motion, self.bounds.inverse, piece.length_s(), [before, after]);
        step(piece, [before, after], room)
    }
}

/// True when halves may be faster.
fn changes(start: f64, end: f64) -> bool {
    (end - start).abs() > CHANGE_MIN * start.max(end)
}

/// True when no motor exceeds its limit.
fn is_within(step: &Step) -> bool {
    step.room.braking.max(step.room.driving) <= 1.0 + WITHIN
}

fn step(piece: &Piece, [start, end]: [f64; 2], room: SlewRoom) -> Step {
    Step {
        from_s: piece.from_s,
        to_s: piece.to_s,
        start,
        end,
        rate_change: (end - start) / (2.0 * piece.length_s()),
        room,
    }
}

/// A straight piece as fast as it goes: up to a peak, along at it, and down.
fn straight(piece: &Piece, change: f64, [before, after]: [f64; 2], cap: f64, steps: &mut Vec<Step>) {
    let h_s = piece.length_s();
    let peak = f64::midpoint(before + after, change * h_s)
        .min(cap)
        .max(before)
        .max(after);
    let up_s = piece.from_s + (peak - before) / change;
    let down_s = (piece.to_s - (peak - after) / change).max(up_s);
    let room = |braking: f64, driving: f64| SlewRoom {
        // At the rate w the velocity of the motor that limits is w times 2 a/change.
        slope: change / (2.0 * peak.sqrt()),
        braking,
        driving,
    };
    for (from_s, to_s, start, end, rate_change, room) in [
        (piece.from_s, up_s, before, peak, change / 2.0, room(0.0, 1.0)),
        (up_s, down_s, peak, peak, 0.0, room(0.0, 0.0)),
        (down_s, piece.to_s, peak, after, -change / 2.0, room(1.0, 0.0)),
    ] {
        let step = Step {
            from_s,
            to_s,
            start,
            end,
            rate_change,
            room,
        };
        paced::push(steps, step, h_s);
    }
}
