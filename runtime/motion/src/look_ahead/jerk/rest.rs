//! The first cell of a motion from rest, and the last cell of a motion to rest: both have a constant jerk along the path.
//!
//! From rest with the jerk j, the time t, the acceleration b and the square x of the speed after the distance h are
//! `h = j t^3/6`, `b = j t = 2/3 x/h` and `x = j^2 t^4/4`, so that `j = 2/9 x^(3/2)/h^2`. Within the cell the speed and
//! the acceleration are smaller than at its end. To rest the same holds backward.

use super::cell::Cell;
use super::cells::End;

/// Factor of the largest square of the speed for a stop with 0.3 times the largest jerk.
const SOFT: f64 = 0.44;

/// A cell from rest or to rest.
#[derive(Debug, Clone, Copy)]
pub(super) struct RestLaw {
    pub(super) length: f64,
    /// Largest square of the speed at the end of the cell that is not at rest.
    pub(super) square_max: f64,
}

impl RestLaw {
    /// Creates the law of the last cell of a window. If later blocks extend the window, it stops so softly that the motion can also go
    /// on within the limits: the acceleration then ends in this cell, with three times the jerk of the stop.
    pub(super) fn at_end(cell: &Cell, end: End) -> Self {
        let law = Self::new(cell);
        Self {
            square_max: law.square_max * if matches!(end, End::Open) { SOFT } else { 1.0 },
            ..law
        }
    }

    pub(super) fn new(cell: &Cell) -> Self {
        let h = cell.length;
        let slope = 2.0 / (3.0 * h);
        let jerk = 2.0 / (9.0 * h * h);
        let square_max = cell.rows.iter().fold(cell.cap, |square, row| {
            let acceleration = row.second.abs() + row.first.abs() * slope;
            let jerk =
                (row.jerk[0].abs() + row.jerk[1].abs() * slope + row.jerk[2].abs() * jerk) / cell.jerk_left;
            square.min(1.0 / acceleration).min(jerk.powf(-2.0 / 3.0))
        });
        Self {
            length: h,
            square_max,
        }
    }

    /// Returns the law with at least this largest square of the speed.
    pub(super) fn relaxed(self, square: f64) -> Self {
        Self {
            square_max: self.square_max.max(square),
            ..self
        }
    }

    /// Returns the acceleration at the end of the cell that is not at rest, per square of the speed there.
    pub(super) fn slope(&self) -> f64 {
        2.0 / (3.0 * self.length)
    }

    /// Returns the jerk along the path for a square of the speed.
    pub(super) fn jerk(&self, square: f64) -> f64 {
        2.0 / 9.0 * square * square.sqrt() / (self.length * self.length)
    }

    /// Returns the duration for a square of the speed, s.
    pub(super) fn duration_s(&self, square: f64) -> f64 {
        3.0 * self.length / square.sqrt()
    }
}
