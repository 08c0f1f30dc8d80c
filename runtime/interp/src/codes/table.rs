//! From a code's number to the code.

use super::{Code, ModalGroup};

/// One past ten times the highest number that a table can hold (999.9).
const TENTHS: usize = 10_000;

/// Entries of the index from here on are codes that are not supported.
const NOT_SUPPORTED_FROM: u8 = 128;

/// The codes of one letter in a dialect.
#[derive(Debug)]
pub struct CodeTable {
    /// The codes that run.
    pub codes: &'static [&'static Code],
    /// The codes that the language has and this version does not run.
    pub not_supported: &'static [NotSupported],
    index: [u8; TENTHS],
}

/// A code that the language has and this version does not run.
#[derive(Debug, PartialEq, Eq)]
pub struct NotSupported {
    /// As the manual writes it.
    pub code: &'static str,
    /// Ten times the number.
    pub tenths: u16,
    /// The manual's name of it.
    pub name: &'static str,
    /// The modal group.
    pub group: ModalGroup,
}

/// What a number stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Known {
    /// A code that runs.
    Code(&'static Code),
    /// One that does not.
    NotSupported(&'static NotSupported),
}

impl CodeTable {
    /// Builds the index when the program is compiled. A table holds at most 126 codes of either kind.
    ///
    /// # Panics
    /// When two codes have one number or there are too many; in a `static` that is an error of the compiler.
    pub const fn new(codes: &'static [&'static Code], not_supported: &'static [NotSupported]) -> Self {
        assert!(
            codes.len() < NOT_SUPPORTED_FROM as usize - 1
                && not_supported.len() < NOT_SUPPORTED_FROM as usize - 1
        );
        let mut index = [0; TENTHS];
        let mut entry = 0;
        while entry < NOT_SUPPORTED_FROM - 1 {
            if (entry as usize) < codes.len() {
                let at = &mut index[codes[entry as usize].tenths as usize];
                assert!(*at == 0, "two codes have one number");
                *at = entry + 1;
            }
            if (entry as usize) < not_supported.len() {
                let at = &mut index[not_supported[entry as usize].tenths as usize];
                assert!(*at == 0, "two codes have one number");
                *at = entry + NOT_SUPPORTED_FROM;
            }
            entry += 1;
        }
        Self {
            codes,
            not_supported,
            index,
        }
    }

    /// What ten times a number stands for.
    pub fn find(&self, tenths: u16) -> Option<Known> {
        let entry = usize::from(*self.index.get(usize::from(tenths))?);
        if let Some(at) = entry.checked_sub(usize::from(NOT_SUPPORTED_FROM)) {
            return self.not_supported.get(at).map(Known::NotSupported);
        }
        self.codes.get(entry.checked_sub(1)?).copied().map(Known::Code)
    }
}

/// Ten times a code's number; `None` for a value that is no code number.
pub(crate) fn tenths(value: f64) -> Option<u16> {
    let tenths = (value * 10.0).round();
    // the quotient is the nearest number to what is written, so it is the parsed value itself
    #[expect(clippy::float_cmp, reason = "both are the nearest number to the same decimal")]
    let is_tenth = tenths / 10.0 == value;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range is tested"
    )]
    (is_tenth && (0.0..=65_535.0).contains(&tenths)).then_some(tenths as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn d01_decimal_codes_are_their_own() {
        assert_eq!(tenths(50.1), Some(501));
        assert_eq!(tenths(51.1), Some(511));
        assert_eq!(tenths(501.0), Some(5010));
        assert_eq!(tenths(50.01), None);
        assert_eq!(tenths(-1.0), None);
        assert_eq!(tenths(1e9), None);
    }
}
