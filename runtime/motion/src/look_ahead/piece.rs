//! A piece of a block: an interval of plan time on which the square of the rate is linear.

use tandem_model::profile::SlewRoom;

use super::straight::Straight;

/// A piece of a block, by plan time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) shape: Shape,
    /// End of the larger piece of the phase from which this piece was cut, s.
    pub(super) whole_to_s: f64,
    /// Length below which the piece is not halved, s.
    pub(super) least_s: f64,
    /// Largest square of the rate in the piece.
    pub(super) cap: f64,
    /// Largest square of the rate at the start of the piece from which the motion can come to rest; NaN
    /// before it is known.
    pub(super) limit: f64,
}

/// Limits of the rate on a piece.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// A piece at one programmed speed, on which the limits are constant.
    Straight(Straight),
    /// A piece on which no motor exceeds its limit at the largest rate. It is divided where the rate changes.
    Whole {
        /// Room that the motors leave at the largest rate.
        room: SlewRoom,
    },
    /// A piece whose rate is limited by half planes.
    Bent {
        /// Room that the motors leave at the largest rate, if none exceeds its limit at that rate.
        planned: Option<SlewRoom>,
    },
}

impl Piece {
    pub(super) fn length_s(&self) -> f64 {
        self.to_s - self.from_s
    }

    /// Returns true if both pieces were cut from the same larger piece.
    pub(super) fn is_cut_with(&self, other: &Piece) -> bool {
        let is_bent = |piece: &Piece| matches!(piece.shape, Shape::Bent { .. });
        is_bent(self) && is_bent(other) && self.whole_to_s.to_bits() == other.whole_to_s.to_bits()
    }

    /// Returns the room that the motors leave at the largest rate, if none exceeds its limit at that rate.
    pub(super) fn room_at_cap(&self) -> Option<SlewRoom> {
        match self.shape {
            Shape::Straight(straight) => Some(straight.room(self.cap, [0.0; 2])),
            Shape::Whole { room } => Some(room),
            Shape::Bent { planned } => planned,
        }
    }

    /// Returns a piece with constant limits between two plan times. The look-ahead never halves this piece.
    pub(super) fn straight(straight: Straight, cap: f64, [from_s, to_s]: [f64; 2]) -> Self {
        Self {
            from_s,
            to_s,
            whole_to_s: to_s,
            shape: Shape::Straight(straight),
            least_s: f64::INFINITY,
            cap,
            limit: f64::NAN,
        }
    }

    /// Joins pieces that were cut from the same larger piece.
    pub(super) fn joined(first: &Piece, others: &[Piece]) -> Piece {
        others.iter().fold(*first, |joined, piece| Piece {
            to_s: piece.to_s,
            shape: Shape::Bent { planned: None },
            cap: joined.cap.min(piece.cap),
            ..joined
        })
    }

    /// Returns both halves of the piece. Returns `None` if the piece must not be halved.
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
