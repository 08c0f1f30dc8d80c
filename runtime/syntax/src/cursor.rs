//! A position in the source text, at which the parser reads blanks, comments, names and numbers.

use tandem_model::Span;

use crate::grammar::Grammar;

/// Powers of ten that a 64-bit floating point number holds exactly.
const POWERS_OF_TEN: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// Every whole number up to this value is exact as a 64-bit floating point number.
const MANTISSA_EXACT_MAX: u64 = 1 << 53;

/// Maximum depth of nested comments for which the end of the outermost comment is searched.
const COMMENT_DEPTH_MAX: usize = 8;

/// Reason why the cursor could not read a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NumberError {
    /// The text at the cursor does not begin with a sign, a digit or a decimal point.
    Missing,
    /// The text has a sign or a decimal point, but no digit.
    Malformed,
    /// The number is too large for a 64-bit floating point number.
    TooLarge,
}

/// A number in the source text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Number {
    pub(crate) value: f64,
    /// True if the number has a decimal point.
    pub(crate) has_point: bool,
}

/// A position in the source text. The parser looks ahead with a copy of the cursor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cursor<'a> {
    source: &'a str,
    bytes: &'a [u8],
    at: usize,
    line: u32,
    comment_bytes: usize,
}

impl<'a> Cursor<'a> {
    /// Creates a cursor at the beginning of the text; skips a byte order mark.
    pub(crate) fn new(source: &'a str) -> Self {
        Self {
            source,
            bytes: source.as_bytes(),
            at: if source.starts_with('\u{feff}') { 3 } else { 0 },
            line: 1,
            comment_bytes: 0,
        }
    }

    pub(crate) fn at(&self) -> usize {
        self.at
    }

    pub(crate) fn line(&self) -> u32 {
        self.line
    }

    /// Returns the line of a byte that is before the cursor.
    pub(crate) fn line_of(&self, start: usize) -> u32 {
        self.line.saturating_sub(self.line_feeds(start))
    }

    /// Returns the number of line feeds from a byte to the cursor.
    fn line_feeds(&self, start: usize) -> u32 {
        let passed = self.bytes.get(start..self.at).unwrap_or_default();
        passed.iter().map(|byte| u32::from(*byte == b'\n')).sum()
    }

    /// Returns the number of bytes before the cursor, without the bytes of comments.
    pub(crate) fn text_bytes(&self) -> usize {
        self.at - self.comment_bytes
    }

    pub(crate) fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    pub(crate) fn peek_second(&self) -> Option<u8> {
        self.bytes.get(self.at + 1).copied()
    }

    /// Moves forward over bytes that the caller knows to be ASCII and not line feeds.
    pub(crate) fn advance(&mut self, bytes: usize) {
        self.at += bytes;
    }

    /// Skips the next byte if it equals `byte`. Returns true if it was skipped.
    pub(crate) fn skip_byte(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        if found {
            self.at += 1;
        }
        found
    }

    /// Skips one whole character, and increases the line number after a line feed. Returns the character.
    pub(crate) fn pass_character(&mut self) -> Option<char> {
        let character = self.source.get(self.at..)?.chars().next()?;
        self.at += character.len_utf8();
        self.line += u32::from(character == '\n');
        Some(character)
    }

    /// Moves to the end of the text.
    pub(crate) fn finish(&mut self) {
        let start = self.at;
        self.at = self.bytes.len();
        self.line += self.line_feeds(start);
    }

    /// Returns the range from a byte to the cursor.
    #[expect(clippy::cast_possible_truncation, reason = "a source is at most 64 MiB")]
    pub(crate) fn span_from(&self, start: usize) -> Span {
        Span::new(start as u32, self.at as u32)
    }

    /// Returns the text of a range; a text of more than 40 characters is shortened.
    pub(crate) fn excerpt(&self, span: Span) -> String {
        let text = self
            .source
            .get(span.start as usize..span.end as usize)
            .unwrap_or_default();
        match text.char_indices().nth(40) {
            Some((end, _)) => format!("{}...", &text[..end]),
            None => text.to_owned(),
        }
    }

    /// Skips blanks and comments, but no line feed outside of comments. Returns the start of a faulty comment
    /// as an error; see [`Self::comment`].
    #[inline]
    pub(crate) fn blanks(&mut self, grammar: &Grammar) -> Result<(), usize> {
        match self.peek() {
            Some(b'\n' | b'0'..=b'9' | b'A'..=b'Z' | b'a'..=b'z') => Ok(()),
            _ => self.pass_blanks(grammar),
        }
    }

    fn pass_blanks(&mut self, grammar: &Grammar) -> Result<(), usize> {
        while let Some(byte) = self.peek() {
            match byte {
                b' ' | b'\t' | b'\r' => self.at += 1,
                b'\n' | b'0'..=b'9' | b'A'..=b'Z' | b'a'..=b'z' => break,
                _ if self.is_comment(grammar) => self.comment(grammar)?,
                _ => break,
            }
        }
        Ok(())
    }

    /// Skips blanks, comments and line feeds.
    pub(crate) fn blank_lines(&mut self, grammar: &Grammar) -> Result<(), usize> {
        loop {
            self.blanks(grammar)?;
            if !self.skip_byte(b'\n') {
                return Ok(());
            }
            self.line += 1;
        }
    }

    /// Returns true if a comment begins at the cursor.
    pub(crate) fn is_comment(&self, grammar: &Grammar) -> bool {
        grammar.line_comment.is_some_and(|begin| self.begins_with(begin))
            || grammar
                .block_comment
                .is_some_and(|(open, _)| self.begins_with(open))
    }

    /// Returns true if this text begins at the cursor.
    pub(crate) fn begins_with(&self, text: &str) -> bool {
        self.bytes[self.at..].starts_with(text.as_bytes())
    }

    /// Skips the comment that begins at the cursor, up to its own end. Returns the start of the comment as an
    /// error in two cases: the comment is not closed before the end of the text or line, or it contains other
    /// comments and continues after them.
    pub(crate) fn comment(&mut self, grammar: &Grammar) -> Result<(), usize> {
        let start = self.at;
        if grammar.line_comment.is_some_and(|begin| self.begins_with(begin)) {
            let rest = &self.bytes[start..];
            self.at += rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
        } else if let Some((open, close)) = grammar.block_comment {
            let inside = self.source.get(start + open.len()..).unwrap_or_default();
            let lines = grammar.comment_spans_lines;
            let line_end = inside.find('\n').filter(|_| !lines);
            let end = line_end.unwrap_or(inside.len());
            let Some(length) = inside[..end].find(close) else {
                self.at += open.len() + end;
                self.line += self.line_feeds(start);
                return Err(start);
            };
            let nested = (!lines && inside[..length].contains(open))
                .then(|| end_of_nested(&inside[..end], open, close))
                .flatten();
            self.at += open.len() + nested.unwrap_or(length + close.len());
            self.line += self.line_feeds(start);
            if nested.is_some() {
                return Err(start);
            }
        }
        self.comment_bytes += self.at - start;
        Ok(())
    }

    /// Returns the letters, digits and underscores at the cursor, without moving the cursor.
    pub(crate) fn name(&self) -> &'a str {
        self.run(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    }

    /// Returns the letters and underscores at the cursor, without moving the cursor.
    pub(crate) fn letters(&self) -> &'a str {
        self.run(|byte| byte.is_ascii_alphabetic() || byte == b'_')
    }

    /// Returns the digits at the cursor, without moving the cursor.
    pub(crate) fn digits(&self) -> &'a str {
        self.run(|byte| byte.is_ascii_digit())
    }

    fn run(&self, belongs: impl Fn(u8) -> bool) -> &'a str {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let length = rest.iter().position(|byte| !belongs(*byte)).unwrap_or(rest.len());
        self.source.get(self.at..self.at + length).unwrap_or_default()
    }

    /// Reads a number: an optional sign if `signed`, digits, and at most one decimal point.
    #[expect(
        clippy::inline_always,
        reason = "each word has one: a call takes 6 percent longer to parse"
    )]
    #[inline(always)]
    pub(crate) fn number(&mut self, signed: bool) -> Result<Number, NumberError> {
        let start = self.at;
        let mut negative = false;
        let mut begin = start;
        if signed && let Some(sign @ (b'-' | b'+')) = self.peek() {
            negative = sign == b'-';
            begin += 1;
        }
        let (mut end, mut mantissa) = digits(self.bytes, begin, 0);
        let whole = end - begin;
        let mut decimals = 0;
        let has_point = self.bytes.get(end) == Some(&b'.');
        if has_point {
            let point = end;
            (end, mantissa) = digits(self.bytes, point + 1, mantissa);
            decimals = end - point - 1;
        }
        self.at = end;
        let digits = whole + decimals;
        if digits == 0 {
            return Err(if self.at == start {
                NumberError::Missing
            } else {
                NumberError::Malformed
            });
        }
        let value = if digits <= 19 && mantissa <= MANTISSA_EXACT_MAX {
            // both operands are exact, so the quotient is the double nearest to the number in the text
            let value = mantissa as f64 / POWERS_OF_TEN[decimals];
            if negative { -value } else { value }
        } else {
            self.source[start..self.at].parse().unwrap_or(f64::INFINITY)
        };
        if value.is_finite() {
            Ok(Number { value, has_point })
        } else {
            Err(NumberError::TooLarge)
        }
    }
}

/// Appends the digits from a position on to a number. Returns the position after the digits, and the number
/// modulo 2^64.
#[inline]
fn digits(bytes: &[u8], mut at: usize, mut number: u64) -> (usize, u64) {
    let digit = |byte: &u8| Some(byte.wrapping_sub(b'0')).filter(|digit| *digit <= 9);
    while let Some(digit) = bytes.get(at).and_then(digit) {
        number = number.wrapping_mul(10).wrapping_add(u64::from(digit));
        at += 1;
    }
    (at, number)
}

/// Returns the length in bytes of a comment that contains other comments, with its closing text; `None` if
/// the comment is not closed.
fn end_of_nested(text: &str, open: &str, close: &str) -> Option<usize> {
    let (mut depth, mut at) = (1, 0);
    while (1..=COMMENT_DEPTH_MAX).contains(&depth) {
        let end = at + text[at..].find(close)?;
        depth += text[at..end].matches(open).count();
        depth -= 1;
        at = end + close.len();
    }
    (depth == 0).then_some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> Result<f64, NumberError> {
        Cursor::new(text).number(true).map(|number| number.value)
    }

    #[test]
    fn numbers_are_the_nearest_floating_point_number() {
        for text in [
            "0",
            "-0.5",
            ".5",
            "5.",
            "+7",
            "0.1",
            "12.345",
            "123456789012345678901234567890.125",
            "-.000001",
        ] {
            assert_eq!(
                number(text).map(f64::to_bits),
                Ok(text.parse::<f64>().unwrap().to_bits()),
                "{text}"
            );
        }
    }

    #[test]
    fn what_is_no_number_is_told_apart() {
        assert_eq!(number(""), Err(NumberError::Missing));
        assert_eq!(number("X"), Err(NumberError::Missing));
        assert_eq!(number("-"), Err(NumberError::Malformed));
        assert_eq!(number("."), Err(NumberError::Malformed));
        assert_eq!(number(&"9".repeat(400)), Err(NumberError::TooLarge));
    }

    #[test]
    fn comments_are_blanks_and_their_lines_count() {
        let mut cursor = Cursor::new(" /* a\nb */\t// c\nX");
        assert_eq!(cursor.blanks(Grammar::nj()), Ok(()));
        assert_eq!((cursor.peek(), cursor.line()), (Some(b'\n'), 2));
        assert_eq!(cursor.blank_lines(Grammar::nj()), Ok(()));
        assert_eq!((cursor.peek(), cursor.line()), (Some(b'X'), 3));
    }

    #[test]
    fn comments_within_a_comment_are_passed_with_it() {
        for (text, rest) in [
            ("(a (b) c)X1", Some(b'X')),
            ("(a (b) to (c) d) X1", Some(b' ')),
            // the outer comment is not closed: it ends with the inner comment
            ("(a (b) X1", None),
        ] {
            let mut cursor = Cursor::new(text);
            let passed = cursor.comment(Grammar::dgshape());
            match rest {
                Some(byte) => assert_eq!((passed, cursor.peek()), (Err(0), Some(byte)), "{text}"),
                None => assert_eq!((passed, cursor.at()), (Ok(()), "(a (b)".len()), "{text}"),
            }
        }
    }

    #[test]
    fn a_comment_that_is_not_closed_ends_the_text() {
        let mut cursor = Cursor::new("/* a\nX1");
        assert_eq!(cursor.blank_lines(Grammar::nj()), Err(0));
        assert_eq!(cursor.peek(), None);
    }
}
