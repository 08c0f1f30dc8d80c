//! Table that finds a code by its number.

use super::Code;

/// Names of codes, and NC blocks that show these codes.
pub type Example = (&'static [&'static str], &'static str);

/// One more than ten times the highest code number that a table can hold (999.9).
const TENTHS: usize = 10_000;

/// Codes of one letter (G or M) in a dialect.
#[derive(Debug, Clone)]
pub struct CodeTable {
    /// The codes of the table.
    pub codes: &'static [&'static Code],
    /// Example programs for codes of the dialect.
    pub examples: &'static [Example],
    index: [u8; TENTHS],
}

impl CodeTable {
    /// Creates a table; in a `static`, the compiler builds its index. A table holds at most 254 codes.
    ///
    /// # Panics
    /// Panics if two codes have the same number, or if there are too many codes; in a `static`, the compiler
    /// reports an error.
    pub const fn new(codes: &'static [&'static Code]) -> Self {
        assert!(codes.len() < u8::MAX as usize);
        let mut index = [0; TENTHS];
        let mut entry: u8 = 0;
        while (entry as usize) < codes.len() {
            let at = &mut index[codes[entry as usize].tenths() as usize];
            assert!(*at == 0, "two codes have one number");
            entry += 1;
            *at = entry;
        }
        Self {
            codes,
            examples: &[],
            index,
        }
    }

    /// Returns the table with example programs for codes of the dialect.
    #[must_use]
    pub const fn shown_by(mut self, examples: &'static [Example]) -> Self {
        self.examples = examples;
        self
    }

    /// Returns the code for which ten times the number is `tenths`.
    pub fn find(&self, tenths: u16) -> Option<&'static Code> {
        let entry = usize::from(*self.index.get(usize::from(tenths))?);
        self.codes.get(entry.checked_sub(1)?).copied()
    }
}

/// Returns ten times the number of a code; `None` for a value that is not a code number.
pub(crate) fn tenths(value: f64) -> Option<u16> {
    let tenths = (value * 10.0).round();
    // the quotient is the double nearest to the decimal in the text, and therefore equals the parsed value
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
