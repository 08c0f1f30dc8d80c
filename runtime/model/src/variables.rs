//! User variables that keep their value after a program ends (manual 4-3): P is shared by all coordinate
//! systems, each coordinate system has its own Q.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

use crate::lost::LOST;

/// Number of P variables: P0 to P32767.
pub const GLOBAL_VARIABLES: usize = 32_768;

/// Number of Q variables: Q0 to Q4095.
pub const COORDINATE_SYSTEM_VARIABLES: usize = 4096;

/// Number of L variables: L0 to L255.
pub const LOCAL_VARIABLES: usize = 256;

/// Mark of a variable that a program has set.
const WRITTEN: u8 = 1;

/// Mark of a variable that a program has read before setting it.
const READ_FIRST: u8 = 2;

/// An array of 64-bit floating point variables, initially zero. Each variable is atomic; the order of
/// accesses to different variables is not defined. A clone refers to the same array.
#[derive(Debug, Clone)]
pub struct VariableArray {
    values: Arc<[AtomicU64]>,
    /// Marks of the variables, only in a copy made by [`VariableArray::watched_copy`].
    marks: Option<Arc<[AtomicU8]>>,
}

impl VariableArray {
    /// Creates an array of `count` variables.
    pub fn new(count: usize) -> Self {
        Self {
            values: (0..count).map(|_| AtomicU64::new(0)).collect(),
            marks: None,
        }
    }

    /// Returns a separate array with the same values. The copy records which variables are set or read from
    /// now on.
    #[must_use]
    pub fn watched_copy(&self) -> Self {
        let copy = |value: &AtomicU64| AtomicU64::new(value.load(Ordering::Relaxed));
        Self {
            values: self.values.iter().map(copy).collect(),
            marks: Some(self.values.iter().map(|_| AtomicU8::new(0)).collect()),
        }
    }

    /// Returns the index and value of each variable that was set since [`VariableArray::watched_copy`], in
    /// ascending order of the index.
    pub fn written(&self) -> impl Iterator<Item = (usize, f64)> {
        self.marked(WRITTEN)
            .filter_map(|index| Some((index, self.value(index)?)))
    }

    /// Returns the index of each variable that was read before it was set, since
    /// [`VariableArray::watched_copy`], in ascending order.
    pub fn read_first(&self) -> impl Iterator<Item = usize> {
        self.marked(READ_FIRST)
    }

    fn marked(&self, mark: u8) -> impl Iterator<Item = usize> {
        let marks = self.marks.iter().flat_map(|marks| marks.iter());
        let marks = marks.map(|mark| mark.load(Ordering::Relaxed)).enumerate();
        marks
            .filter(move |(_, marks)| marks & mark != 0)
            .map(|(index, _)| index)
    }

    /// Sets each variable that was not set since [`VariableArray::watched_copy`] to [`LOST`].
    pub fn lose_unwritten(&self) {
        let Some(marks) = &self.marks else { return };
        for (value, mark) in self.values.iter().zip(marks.iter()) {
            if mark.load(Ordering::Relaxed) & WRITTEN == 0 {
                value.store(LOST.to_bits(), Ordering::Relaxed);
            }
        }
    }

    /// Returns the value of a variable. Returns `None` for an index beyond the array.
    pub fn get(&self, index: usize) -> Option<f64> {
        if let Some(mark) = self.marks.as_ref().and_then(|marks| marks.get(index))
            && mark.load(Ordering::Relaxed) == 0
        {
            mark.store(READ_FIRST, Ordering::Relaxed);
        }
        self.value(index)
    }

    fn value(&self, index: usize) -> Option<f64> {
        let cell = self.values.get(index)?;
        Some(f64::from_bits(cell.load(Ordering::Relaxed)))
    }

    /// Sets a variable. Returns false, without any change, for an index beyond the array.
    pub fn set(&self, index: usize, value: f64) -> bool {
        let Some(cell) = self.values.get(index) else {
            return false;
        };
        cell.store(value.to_bits(), Ordering::Relaxed);
        if let Some(mark) = self.marks.as_ref().and_then(|marks| marks.get(index)) {
            mark.fetch_or(WRITTEN, Ordering::Relaxed);
        }
        true
    }

    /// Returns the number of variables.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Returns true if the array has no variables.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }
}

/// The P and Q variables that the programs of one coordinate system use.
#[derive(Debug, Clone)]
pub struct Variables {
    /// P, the same array for all coordinate systems.
    pub global: VariableArray,
    /// Q, an array of this coordinate system only.
    pub coordinate_system: VariableArray,
}

impl Variables {
    /// Creates the variables of a coordinate system, with the P variables that the whole controller shares.
    pub fn new(global: VariableArray) -> Self {
        Self {
            global,
            coordinate_system: VariableArray::new(COORDINATE_SYSTEM_VARIABLES),
        }
    }
}

impl Default for Variables {
    /// Creates variables that no other coordinate system shares, all zero.
    fn default() -> Self {
        Self::new(VariableArray::new(GLOBAL_VARIABLES))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clone_is_the_same_array() {
        let array = VariableArray::new(2);
        let other = array.clone();
        assert!(other.set(1, -0.5));
        assert_eq!(array.get(1), Some(-0.5));
        assert_eq!(array.get(0), Some(0.0));
    }

    #[test]
    fn a_watched_copy_knows_what_was_set_and_the_rest_can_be_lost() {
        let array = VariableArray::new(3);
        array.set(0, 1.0);
        array.set(1, 2.0);
        let copy = array.watched_copy();
        copy.set(1, 2.0);
        assert_eq!(copy.written().collect::<Vec<_>>(), [(1, 2.0)]);
        copy.lose_unwritten();
        assert_eq!(copy.get(1), Some(2.0));
        assert!(copy.get(0).is_some_and(crate::lost::is_lost));
        assert_eq!(array.get(0), Some(1.0), "the original array is unchanged");
        assert_eq!(array.written().count(), 0);
    }

    #[test]
    fn a_watched_copy_knows_what_was_read_before_it_was_set() {
        let copy = VariableArray::new(4).watched_copy();
        copy.set(0, 1.0);
        assert_eq!((copy.get(0), copy.get(2)), (Some(1.0), Some(0.0)));
        copy.set(2, 5.0);
        assert_eq!((copy.get(3), copy.get(9)), (Some(0.0), None));
        assert_eq!(copy.read_first().collect::<Vec<_>>(), [2, 3]);
        assert_eq!(copy.written().collect::<Vec<_>>(), [(0, 1.0), (2, 5.0)]);
        assert_eq!(copy.read_first().collect::<Vec<_>>(), [2, 3], "a list is no use");
    }

    #[test]
    fn nothing_is_beyond_the_array() {
        let array = VariableArray::new(2);
        assert_eq!(array.get(2), None);
        assert!(!array.set(2, 1.0));
    }

    #[test]
    fn p_is_shared_and_q_is_not() {
        let one = Variables::default();
        let two = Variables::new(one.global.clone());
        one.global.set(7, 3.0);
        one.coordinate_system.set(7, 4.0);
        assert_eq!(two.global.get(7), Some(3.0));
        assert_eq!(two.coordinate_system.get(7), Some(0.0));
    }
}
