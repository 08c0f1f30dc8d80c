//! Axis letters, sets of axes, and one value for each axis.

use std::ops::{Index, IndexMut};

/// Maximum number of axes of one coordinate system.
///
/// Reason: the controller has the axis letters X Y Z A B C; two more letters leave room for dialects. A
/// configuration with more axes is rejected when the runtime reads it.
pub const AXES_MAX: usize = 8;

/// An axis letter of a coordinate system. Motors perform the motion; the configuration assigns a motor to each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Axis {
    /// Linear axis X, mm.
    X,
    /// Linear axis Y, mm.
    Y,
    /// Linear axis Z, mm.
    Z,
    /// Rotary axis A, degrees.
    A,
    /// Rotary axis B, degrees.
    B,
    /// Rotary axis C, degrees.
    C,
    /// Further axis U.
    U,
    /// Further axis V.
    V,
}

impl Axis {
    /// All axes in the order of their index.
    pub const ALL: [Axis; AXES_MAX] = [
        Axis::X,
        Axis::Y,
        Axis::Z,
        Axis::A,
        Axis::B,
        Axis::C,
        Axis::U,
        Axis::V,
    ];

    /// The axes whose common vector has the speed F (manual: the feedrate is that of X, Y, Z).
    pub const ORTHOGONAL: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

    /// Returns the index of the axis in an [`AxisVector`], 0 to 7.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Returns the upper-case letter of the axis.
    pub const fn letter(self) -> char {
        ['X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V'][self as usize]
    }

    /// Returns the axis of a letter; upper and lower case are equal.
    pub fn from_letter(letter: char) -> Option<Axis> {
        Axis::ALL
            .into_iter()
            .find(|axis| axis.letter() == letter.to_ascii_uppercase())
    }

    /// Returns true for X, Y and Z.
    pub const fn is_orthogonal(self) -> bool {
        matches!(self, Axis::X | Axis::Y | Axis::Z)
    }
}

/// A set of axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct AxisSet(u8);

impl AxisSet {
    /// The empty set.
    pub const EMPTY: AxisSet = AxisSet(0);

    /// Adds an axis.
    pub fn insert(&mut self, axis: Axis) {
        self.0 |= 1 << axis.index();
    }

    /// Returns the set as a number: bit 0 is X, bit 7 is V.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Returns the set of a number from [`AxisSet::bits`].
    pub const fn from_bits(bits: u8) -> Self {
        AxisSet(bits)
    }

    /// Returns true if the axis is in the set.
    pub const fn contains(self, axis: Axis) -> bool {
        self.0 & (1 << axis.index()) != 0
    }

    /// Returns true if no axis is in the set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the axes of the set in the order of their index.
    pub fn iter(self) -> impl Iterator<Item = Axis> {
        let mut bits = self.0;
        std::iter::from_fn(move || {
            let lowest = bits.trailing_zeros() as usize;
            bits &= bits.wrapping_sub(1);
            Axis::ALL.get(lowest).copied()
        })
    }
}

impl FromIterator<Axis> for AxisSet {
    fn from_iter<I: IntoIterator<Item = Axis>>(axes: I) -> Self {
        let mut set = AxisSet::EMPTY;
        for axis in axes {
            set.insert(axis);
        }
        set
    }
}

/// One value for each axis: mm for linear, degrees for rotary axes (per second for velocities).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisVector(pub [f64; AXES_MAX]);

impl AxisVector {
    /// All values zero.
    pub const ZERO: AxisVector = AxisVector([0.0; AXES_MAX]);

    /// Applies a function to each pair of values.
    #[inline]
    #[must_use]
    pub fn zip(self, other: AxisVector, f: impl Fn(f64, f64) -> f64) -> AxisVector {
        AxisVector(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }

    /// Returns this vector with the values of `by` on the given axes.
    #[inline]
    #[must_use]
    pub fn replaced(self, axes: AxisSet, by: AxisVector) -> AxisVector {
        AxisVector(std::array::from_fn(|i| {
            let is_replaced = axes.0 & (1 << i) != 0;
            if is_replaced { by.0[i] } else { self.0[i] }
        }))
    }

    /// Returns the sum, value by value.
    #[inline]
    #[must_use]
    pub fn plus(self, other: AxisVector) -> AxisVector {
        self.zip(other, |a, b| a + b)
    }

    /// Returns the difference, value by value.
    #[inline]
    #[must_use]
    pub fn minus(self, other: AxisVector) -> AxisVector {
        self.zip(other, |a, b| a - b)
    }

    /// Returns every value multiplied by a factor.
    #[inline]
    #[must_use]
    pub fn scaled(self, factor: f64) -> AxisVector {
        AxisVector(self.0.map(|value| value * factor))
    }

    /// Returns the vector length over X, Y and Z, mm.
    pub fn orthogonal_length(self) -> f64 {
        let [x, y, z, ..] = self.0;
        (x * x + y * y + z * z).sqrt()
    }

    /// Returns the vector length over all axes except X, Y and Z, degrees.
    pub fn rotary_length(self) -> f64 {
        self.0[3..].iter().map(|value| value * value).sum::<f64>().sqrt()
    }

    /// Returns true if every value is a finite number.
    pub fn is_finite(self) -> bool {
        self.0.iter().all(|value| value.is_finite())
    }
}

impl Index<Axis> for AxisVector {
    type Output = f64;
    #[inline]
    fn index(&self, axis: Axis) -> &f64 {
        &self.0[axis.index()]
    }
}

impl IndexMut<Axis> for AxisVector {
    #[inline]
    fn index_mut(&mut self, axis: Axis) -> &mut f64 {
        &mut self.0[axis.index()]
    }
}

/// A position in machine coordinates: mm or degrees from the zero point of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MachinePosition(pub AxisVector);

/// A position in the current work coordinates, which the HMI shows next to the machine position.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WorkPosition(pub AxisVector);
