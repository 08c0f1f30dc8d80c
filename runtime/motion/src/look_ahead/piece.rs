//! A piece of a block: an interval of plan time on which the square of the rate is linear.

use tandem_model::profile::SlewRoom;

use super::blended_block::Phase;
use super::straight::Straight;

/// A piece, in plan time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) shape: Shape,
    /// End of the piece that it was cut from, within its phase, s.
    pub(super) whole_to_s: f64,
    /// It is not halved below this length, s.
    pub(super) least_s: f64,
    /// Largest square of the rate in it.
    pub(super) cap: f64,
    /// Largest square of the rate at its start from which the motion can come to rest; NaN before it is known.
    pub(super) limit: f64,
}

/// Limits of the rate on a piece.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// At one speed: the limits are the same anywhere in the piece.
    Straight(Straight),
    /// No motor exceeds its limit at the largest rate; it is cut finer where the rate changes.
    Whole {
        /// Room that the motors leave at the largest rate.
        room: SlewRoom,
    },
    /// Limited by the half planes of its motors.
    Bent {
        /// Room that the motors leave at the largest rate, if none exceeds its limit at that rate.
        planned: Option<SlewRoom>,
    },
}

impl Piece {
    pub(super) fn length_s(&self) -> f64 {
        self.to_s - self.from_s
    }

    /// Returns true if both were cut from the same piece.
    pub(super) fn is_cut_with(&self, other: &Piece) -> bool {
        let is_bent = |piece: &Piece| matches!(piece.shape, Shape::Bent { .. });
        is_bent(self) && is_bent(other) && self.whole_to_s.to_bits() == other.whole_to_s.to_bits()
    }

    /// Returns true if the rate is the largest from begin to end; `limit` is the limit of the next piece.
    pub(super) fn is_even(&self, limit: f64) -> bool {
        self.room_at_cap().is_some() && self.limit >= self.cap && limit >= self.cap
    }

    /// Returns the room that the motors leave at the largest rate, if none exceeds its limit at that rate.
    pub(super) fn room_at_cap(&self) -> Option<SlewRoom> {
        match self.shape {
            Shape::Straight(straight) => Some(straight.room(self.cap, [0.0; 2])),
            Shape::Whole { room } => Some(room),
            Shape::Bent { planned } => planned,
        }
    }

    /// Returns a phase at one speed, which is not halved.
    pub(super) fn straight(straight: Straight, cap: f64, phase: Phase) -> Self {
        Self {
            from_s: phase.from_s,
            to_s: phase.to_s,
            whole_to_s: phase.to_s,
            shape: Shape::Straight(straight),
            least_s: f64::INFINITY,
            cap,
            limit: f64::NAN,
        }
    }

    /// Joins pieces cut from the same one.
    pub(super) fn joined(first: &Piece, others: &[Piece]) -> Piece {
        others.iter().fold(*first, |joined, piece| Piece {
            to_s: piece.to_s,
            shape: Shape::Bent { planned: None },
            cap: joined.cap.min(piece.cap),
            ..joined
        })
    }

    /// Returns both halves; `None` if the piece must not be cut.
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
