//! User variables that outlive a program (manual 4-3): P, shared by all coordinate systems, and Q, of one.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// P0 to P32767.
pub const GLOBAL_VARIABLES: usize = 32_768;

/// Q0 to Q4095.
pub const COORDINATE_SYSTEM_VARIABLES: usize = 4096;

/// L0 to L255.
pub const LOCAL_VARIABLES: usize = 256;

/// An array of 64-bit floating point variables, initially zero. Each is atomic by itself, without any order among them; a
/// clone is another handle of the same array.
#[derive(Debug, Clone)]
pub struct VariableArray(Arc<[AtomicU64]>);

impl VariableArray {
    /// An array of `count` variables.
    pub fn new(count: usize) -> Self {
        Self((0..count).map(|_| AtomicU64::new(0)).collect())
    }

    /// The value of a variable; `None` beyond the array.
    pub fn get(&self, index: usize) -> Option<f64> {
        let cell = self.0.get(index)?;
        Some(f64::from_bits(cell.load(Ordering::Relaxed)))
    }

    /// Sets a variable. False beyond the array, where nothing changes.
    pub fn set(&self, index: usize, value: f64) -> bool {
        let Some(cell) = self.0.get(index) else {
            return false;
        };
        cell.store(value.to_bits(), Ordering::Relaxed);
        true
    }

    /// Number of variables.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// True for an array of no variables.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// The variables of the programs of one coordinate system, except for L.
#[derive(Debug, Clone)]
pub struct Variables {
    /// P: the same array for all coordinate systems.
    pub global: VariableArray,
    /// Q: of this coordinate system.
    pub coordinate_system: VariableArray,
}

impl Variables {
    /// The variables of a coordinate system together with the P variables of the controller.
    pub fn new(global: VariableArray) -> Self {
        Self {
            global,
            coordinate_system: VariableArray::new(COORDINATE_SYSTEM_VARIABLES),
        }
    }
}

impl Default for Variables {
    /// Variables of their own, all zero: for a machine of one coordinate system.
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
