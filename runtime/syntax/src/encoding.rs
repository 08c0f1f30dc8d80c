//! Detects texts in an encoding other than UTF-8, which some editors and controls write.

/// Number of characters that are examined at the beginning of a text.
const LOOKED_AT: usize = 64;

/// Returns true for a text in UTF-16 or UTF-32 that was read as UTF-8: zero bytes are at least a third of the
/// characters at its beginning.
pub fn is_wide(text: &str) -> bool {
    let head = || text.chars().take(LOOKED_AT);
    let zeros = head().filter(|character| *character == '\0').count();
    3 * zeros >= head().count() && zeros > 0
}

/// Message and help of the finding for a text in UTF-16 or UTF-32.
pub(crate) const WIDE: (&str, &str) = (
    "the text is in UTF-16, but a program must be in UTF-8",
    "Save the text as UTF-8, or as ASCII, in the editor or program that wrote it.",
);

#[cfg(test)]
mod tests {
    use super::*;

    fn wide(text: &str, to_bytes: fn(u16) -> [u8; 2], mark: bool) -> String {
        let mark = mark.then_some(0xFEFF).into_iter();
        let bytes: Vec<u8> = mark.chain(text.encode_utf16()).flat_map(to_bytes).collect();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    #[test]
    fn utf_16_is_told_from_utf_8_with_a_mark_and_without() {
        for text in ["G90 G01 X10 F100\r\nM30\r\n", "%\n", "// größe\nM30\n"] {
            for mark in [true, false] {
                assert!(is_wide(&wide(text, u16::to_le_bytes, mark)), "{text}");
                assert!(is_wide(&wide(text, u16::to_be_bytes, mark)), "{text}");
            }
            assert!(!is_wide(text), "{text}");
        }
        for plain in [
            "",
            "\u{FEFF}M30",
            "\0\0\0\0G90 G01 X10 F100 // a leader",
            "// \u{FFFD}",
        ] {
            assert!(!is_wide(plain), "{plain:?}");
        }
    }
}
