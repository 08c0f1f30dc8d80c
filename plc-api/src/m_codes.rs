//! The M codes that a sequence program can serve.

use std::ops::{Range, RangeInclusive};

/// Highest M number.
pub const M_CODE_MAX: u16 = 191;

/// M codes that the runtime handles itself (D35); they never reach a handler.
pub const RUNTIME_M_CODES: [u16; 6] = [0, 1, 2, 30, 98, 99];

/// M codes that a handler serves: one, a range, or several.
pub trait MCodes {
    /// Ranges from first to last; a sequence program refuses an empty range.
    fn m_codes(self) -> Vec<RangeInclusive<u16>>;
}

impl MCodes for u16 {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        vec![self..=self]
    }
}

impl MCodes for RangeInclusive<u16> {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        vec![self]
    }
}

impl MCodes for Range<u16> {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        if self.is_empty() {
            return Vec::new();
        }
        vec![self.start..=self.end - 1]
    }
}

impl<const N: usize> MCodes for [u16; N] {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        self.map(|m| m..=m).to_vec()
    }
}
