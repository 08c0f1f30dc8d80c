//! Planes of circles, and the sense of rotation in them.

use std::fmt;

use crate::axis::Axis;

/// Sense of rotation, seen against the direction of the plane's third axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// Clockwise: G02, M03.
    Clockwise,
    /// Counter-clockwise: G03, M04.
    CounterClockwise,
}

impl Turn {
    /// Returns the opposite sense.
    #[must_use]
    pub const fn reversed(self) -> Self {
        match self {
            Turn::Clockwise => Turn::CounterClockwise,
            Turn::CounterClockwise => Turn::Clockwise,
        }
    }
}

/// Plane of G17, G18 or G19.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Plane {
    /// G17: X, Y.
    #[default]
    Xy,
    /// G18: Z, X.
    Zx,
    /// G19: Y, Z.
    Yz,
}

impl Plane {
    /// Returns the first and second axis of the plane. A counter-clockwise rotation turns the first axis
    /// towards the second.
    pub const fn axes(self) -> [Axis; 2] {
        match self {
            Plane::Xy => [Axis::X, Axis::Y],
            Plane::Zx => [Axis::Z, Axis::X],
            Plane::Yz => [Axis::Y, Axis::Z],
        }
    }

    /// Returns the axis of X, Y and Z that is normal to the plane.
    pub const fn normal(self) -> Axis {
        match self {
            Plane::Xy => Axis::Z,
            Plane::Zx => Axis::Y,
            Plane::Yz => Axis::X,
        }
    }
}

impl fmt::Display for Plane {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Plane::Xy => "the XY plane",
            Plane::Zx => "the ZX plane",
            Plane::Yz => "the YZ plane",
        })
    }
}
