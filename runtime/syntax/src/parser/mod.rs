//! Parses a text to the program tree.
//!
//! A line is either a block of words or program codes. After an error, the parser continues with the next
//! word, the end of the line, or the matching brace, so that one cause gives one error.

mod control;
mod expression;
mod frame;
mod program_code;
mod word;

use std::sync::Arc;

use tandem_model::limits::{BLOCK_BYTES_MAX, PROGRAM_BYTES_MAX};
use tandem_model::{Diagnostic, Span};

use self::control::OpenConstructs;
use crate::cursor::Cursor;
use crate::diagnostics::{self, DiagnosticEntry};
use crate::encoding::{WIDE, is_wide};
use crate::grammar::{Grammar, shared_variable};
use crate::tree::{Block, Content, NcProgram};

/// Maximum number of findings of one program; parsing ends at this number. The limit keeps time and memory
/// small for a text that consists of errors.
pub const DIAGNOSTICS_MAX: usize = 1000;

/// Maximum nesting depth of parentheses and signs in an expression, and of branches and repetitions.
pub const NESTING_MAX: usize = 64;

/// Parses a text. Always returns a program, and all findings in the order of the text.
///
/// A text is not read if it has more than [`PROGRAM_BYTES_MAX`] bytes, or another encoding than UTF-8. The
/// program is then empty, with one error.
pub fn parse(source: impl Into<Arc<str>>, grammar: &Grammar) -> (NcProgram, Vec<Diagnostic>) {
    let source: Arc<str> = source.into();
    let mut parser = Parser::new(&source, grammar);
    if source.len() > PROGRAM_BYTES_MAX {
        let message = format!(
            "the program has {} bytes, at most {PROGRAM_BYTES_MAX} are allowed",
            source.len()
        );
        parser.refuse(
            &diagnostics::SOURCE_TOO_LARGE,
            &message,
            "Split the program into subprograms.",
        );
    } else if is_wide(&source) {
        let (message, help) = WIDE;
        parser.refuse(&diagnostics::UNEXPECTED_CHARACTER, message, help);
    } else {
        parser.reserve(&source);
        parser.run();
    }
    (parser.tree, parser.diagnostics)
}

/// Kind of the line that is being parsed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LineKind {
    /// The line has no element yet, or only a block number.
    Open,
    /// The line is a block of words.
    Words,
    /// The line contains assignments, branches or repetitions.
    ProgramCodes,
}

struct Parser<'a> {
    cursor: Cursor<'a>,
    grammar: &'a Grammar,
    tree: NcProgram,
    nesting: OpenConstructs,
    /// Line of the last text read outside of comments.
    code_line: u32,
    diagnostics: Vec<Diagnostic>,
    // state of the line that is being read
    kind: LineKind,
    /// True if the line may contain only one command, because a branch or repetition without braces precedes
    /// the line.
    single: bool,
    flags: u32,
    /// Position after the block skips of the line.
    skips_end: usize,
    first_word: usize,
    line_start: usize,
    text_bytes_before: usize,
}

impl<'a> Parser<'a> {
    fn new(source: &'a Arc<str>, grammar: &'a Grammar) -> Self {
        Self {
            cursor: Cursor::new(source),
            grammar,
            tree: NcProgram {
                source: Arc::clone(source),
                complete: true,
                ..NcProgram::default()
            },
            nesting: OpenConstructs::default(),
            code_line: 0,
            diagnostics: Vec::new(),
            kind: LineKind::Open,
            single: false,
            flags: 0,
            skips_end: 0,
            first_word: 0,
            line_start: 0,
            text_bytes_before: 0,
        }
    }

    /// Reports one error for a text that is not read.
    fn refuse(&mut self, entry: &'static DiagnosticEntry, message: &str, help: &str) {
        self.tree.complete = false;
        // the text is not read, so a missing mark is not reported
        self.tree.marked = true;
        self.report(entry, Span::default(), message, help);
    }

    /// Reserves memory for an estimated number of blocks and words, so that the arrays need not grow and
    /// move. In the estimate, a letter before a value begins a word, and a line is a block.
    fn reserve(&mut self, source: &str) {
        let bytes = source.as_bytes();
        let next = bytes.get(1..).unwrap_or_default();
        let (mut lines, mut words) = (1, 0);
        // counters of one byte, up to 255, let the processor handle many bytes at once
        for (bytes, next) in bytes.chunks(255).zip(next.chunks(255)) {
            let in_chunk = |count: u8, begins: bool| count + u8::from(begins);
            lines += usize::from(next.iter().map(|byte| *byte == b'\n').fold(0, in_chunk));
            let words_begin = bytes.iter().zip(next).map(|(byte, next)| {
                let value = next.is_ascii_digit() | matches!(next, b'-' | b'.' | b'[' | b'+');
                byte.is_ascii_alphabetic() & value
            });
            words += usize::from(words_begin.fold(0, in_chunk));
        }
        self.tree.blocks.reserve_exact(lines.min(words));
        self.tree.words.reserve_exact(words);
    }

    fn run(&mut self) {
        let form = self.grammar.program_form;
        self.head(form);
        loop {
            self.blank_lines();
            match self.cursor.peek() {
                None => break,
                byte if byte == form.mark => {
                    self.mark();
                    self.cursor.finish();
                    break;
                }
                Some(_) if self.is_program_number() => self.program_number(),
                Some(_) => self.line(false),
            }
            self.code_line = self.cursor.line();
        }
    }

    /// Reports an error, and marks the line as faulty.
    fn report(
        &mut self,
        entry: &'static DiagnosticEntry,
        span: Span,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.flags |= Block::HAS_ERRORS;
        self.record_finding(entry, span, message, help);
    }

    /// Reports an error in the text from `start` to the cursor.
    fn report_from(
        &mut self,
        start: usize,
        entry: &'static DiagnosticEntry,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.report(entry, self.cursor.span_from(start), message, help);
    }

    /// Adds a finding, unless the maximum number of findings is reached.
    fn record_finding(
        &mut self,
        entry: &'static DiagnosticEntry,
        span: Span,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        if self.diagnostics.len() > DIAGNOSTICS_MAX {
            return;
        }
        let help = self.grammar.cite(entry.code, help);
        self.diagnostics.push(entry.at(span, message, help));
        if self.diagnostics.len() == DIAGNOSTICS_MAX {
            self.diagnostics.push(diagnostics::TOO_MANY.at(
                span,
                format!("more than {DIAGNOSTICS_MAX} errors; the rest of the program was not read"),
                "Correct the errors above, then check again.",
            ));
            self.tree.complete = false;
            self.cursor.finish();
        }
    }

    fn blanks(&mut self) {
        if let Err(start) = self.cursor.blanks(self.grammar) {
            self.comment_fault(start);
        }
    }

    fn blank_lines(&mut self) {
        if let Err(start) = self.cursor.blank_lines(self.grammar) {
            self.comment_fault(start);
        }
    }

    /// Reports a comment that is not closed, or a comment that contains other comments and continues after
    /// them.
    fn comment_fault(&mut self, start: usize) {
        let (open, close) = self.grammar.block_comment.unwrap_or_default();
        let is_closed = self.tree.source[start..self.cursor.at()].ends_with(close);
        let (message, help) = if is_closed {
            (
                format!("the first {close} ends the comment, but more text follows"),
                format!("Write no {open} and {close} inside a comment."),
            )
        } else {
            self.tree.complete &= !self.grammar.comment_spans_lines;
            (
                format!("the comment that begins with {open} is not closed"),
                format!("Write {close} where the comment ends."),
            )
        };
        let span = Span::new(index(start), index(start + open.len()));
        self.report(&diagnostics::COMMENT_NOT_CLOSED, span, message, help);
    }

    /// Reads one line from its first token. With `single`, reads at most one command of the line.
    fn line(&mut self, single: bool) {
        self.single = single;
        self.kind = LineKind::Open;
        self.flags = 0;
        self.first_word = self.tree.words.len();
        self.line_start = self.cursor.at();
        self.text_bytes_before = self.cursor.text_bytes();
        let line = self.cursor.line();
        if self.grammar.block_skip_max > 0 && self.cursor.peek() == Some(b'/') && line != self.code_line {
            self.block_skips();
        }
        while let Some(byte) = self.cursor.peek() {
            match byte {
                b'A'..=b'Z' | b'a'..=b'z' | b'_' => {
                    if self.name_or_word(line) {
                        return;
                    }
                }
                b' ' | b'\t' | b'\r' => self.cursor.advance(1),
                b'\n' => break,
                _ if self.cursor.is_comment(self.grammar) => self.blanks(),
                b'/' if self.grammar.block_skip_max > 0 => self.misplaced_skip(),
                b'}' if self.nesting.braces > 0 => break,
                b'{' | b'}' => self.stray_brace(byte),
                b'(' => self.foreign_comment(),
                _ => self.unexpected_characters(),
            }
        }
        self.end_words(line);
    }

    /// Ends the block of words of this line, and adds it to the tree.
    fn end_words(&mut self, line: u32) {
        let count = self.tree.words.len() - self.first_word;
        let failed = self.flags & Block::HAS_ERRORS != 0;
        if self.flags != 0 && !failed && self.kind == LineKind::Open {
            self.skip_unused(self.line_start, self.skips_end, "no word follows the block skip");
        }
        if count > 0 || (failed && self.kind != LineKind::ProgramCodes) {
            self.tree.blocks.push(Block {
                start: index(self.line_start),
                line,
                flags: self.flags,
                content: Content::Words {
                    first: index(self.first_word),
                    count: u16::try_from(count).unwrap_or(u16::MAX),
                },
            });
        }
    }

    /// Returns the number of bytes from the start of the line to the cursor, without comments.
    fn line_bytes(&self) -> usize {
        self.cursor.text_bytes() - self.text_bytes_before
    }

    /// Returns true if the line is too long (D03); reports this, and skips the rest of the line.
    #[inline]
    fn too_long(&mut self, start: usize) -> bool {
        let too_long = self.line_bytes() > BLOCK_BYTES_MAX;
        if too_long {
            self.end_long_line(start);
        }
        too_long
    }

    #[cold]
    fn end_long_line(&mut self, start: usize) {
        self.report_from(
            start,
            &diagnostics::BLOCK_TOO_LONG,
            format!("the block is longer than {BLOCK_BYTES_MAX} bytes"),
            "Write the words in several blocks.",
        );
        self.skip_line();
    }

    /// Reads block skips such as `/`, `/1` or `/1/2` at the beginning of a line.
    fn block_skips(&mut self) {
        while self.cursor.peek() == Some(b'/') && !self.cursor.is_comment(self.grammar) {
            let start = self.cursor.at();
            if let Some(number) = self.skip_number() {
                if self.flags & (1 << (number - 1)) != 0 {
                    self.skip_unused(start, self.cursor.at(), "the block skip number appears twice");
                }
                self.flags |= 1 << (number - 1);
                self.skips_end = self.cursor.at();
            } else {
                let text = self.cursor.excerpt(self.cursor.span_from(start));
                let help = match self.grammar.block_skip_max {
                    ..=1 => "Write / without a number.".to_owned(),
                    max => format!("Write / or /1 to /{max}."),
                };
                let message = format!("`{text}` is not a block skip number");
                self.report_from(start, &diagnostics::SKIP_NUMBER, message, help);
            }
            self.blanks();
        }
    }

    fn skip_unused(&mut self, start: usize, end: usize, message: &str) {
        let span = Span::new(index(start), index(end));
        self.record_finding(
            &diagnostics::SKIP_UNUSED,
            span,
            message,
            "Remove it, or write words after it.",
        );
    }

    /// Skips `/` and the digits directly after it. Returns the block skip number if it is in range.
    fn skip_number(&mut self) -> Option<u8> {
        self.cursor.advance(1);
        let digits = self.cursor.digits();
        self.cursor.advance(digits.len());
        if digits.is_empty() {
            return Some(1);
        }
        let max = self.grammar.block_skip_max;
        let number = digits.parse().ok();
        number.filter(|number| max > 1 && (1..=max).contains(number))
    }

    fn misplaced_skip(&mut self) {
        let start = self.cursor.at();
        let _ = self.skip_number();
        let text = self.cursor.excerpt(self.cursor.span_from(start));
        self.report_from(
            start,
            &diagnostics::SKIP_PLACE,
            format!("`{text}` is not at the beginning of the line"),
            if self.grammar.program_codes {
                "Write the block skip before the block number and all words. For a division, assign to a variable on a line of its own."
            } else {
                "Write the block skip before the block number and all words."
            },
        );
    }

    fn stray_brace(&mut self, byte: u8) {
        let start = self.cursor.at();
        self.cursor.advance(1);
        if self.nesting.foreign.passes(byte) {
            return;
        }
        self.report_from(
            start,
            &diagnostics::BRACE_UNMATCHED,
            format!("`{}` belongs to no program code", char::from(byte)),
            if self.grammar.program_codes {
                "Remove it, or write the if, else, switch, while or do that it belongs to."
            } else {
                "Remove it, or make it a comment: the dialect has no branches and repetitions."
            },
        );
    }

    /// Reports text in parentheses, which is a comment in other dialects.
    fn foreign_comment(&mut self) {
        let start = self.cursor.at();
        while let Some(byte) = self.cursor.peek() {
            if byte == b'\n' || self.cursor.pass_character() == Some(')') {
                break;
            }
        }
        self.report_from(
            start,
            &diagnostics::UNEXPECTED_CHARACTER,
            "`(` is not part of a block",
            self.comment_help(),
        );
    }

    /// Returns a help text on how to write comments.
    fn comment_help(&self) -> String {
        let (open, close) = self.grammar.block_comment.unwrap_or_default();
        let block = format!("{open} {close}");
        let line = self.grammar.line_comment;
        let forms = line.map_or(block.clone(), |line| format!("{line} or {block}"));
        format!("Write comments as {forms}.")
    }

    /// Reports characters that cannot begin an element, with the characters joined to them, as one error.
    fn unexpected_characters(&mut self) {
        let start = self.cursor.at();
        let first = self.cursor.pass_character().unwrap_or_default();
        while let Some(byte) = self.cursor.peek() {
            if byte.is_ascii_alphabetic() || b" \t\r\n/{}(_".contains(&byte) {
                break;
            }
            self.cursor.pass_character();
        }
        if first == '=' {
            self.skip_line();
        }
        let (message, help) = if first.is_ascii_digit() || matches!(first, '.' | '+' | '-') {
            let text = self.cursor.excerpt(self.cursor.span_from(start));
            (
                format!("`{text}` has no address"),
                "Write the letter of the word before the number.".to_owned(),
            )
        } else {
            let shown = if first.is_control() {
                first.escape_default().to_string()
            } else {
                first.to_string()
            };
            let help = match first {
                '#' if self.grammar.foreign("#", "").is_none() => {
                    let text = self.cursor.excerpt(self.cursor.span_from(start + 1));
                    let digits = text.split(|c: char| !c.is_ascii_digit()).next();
                    shared_variable(digits.unwrap_or_default())
                }
                _ => self.plain_help(first),
            };
            (format!("`{shown}` is not part of the language"), help)
        };
        self.report_from(start, &diagnostics::UNEXPECTED_CHARACTER, message, help);
        // the rest of the line is a comment or a statement of another control, and gives no separate finding
        let is_text = first == ';' || !(first.is_ascii_digit() || matches!(first, '.' | '+' | '-'));
        if is_text && (first == ';' || !self.grammar.program_codes) {
            self.skip_line();
        }
    }

    /// Returns the help for a character that cannot begin an element.
    fn plain_help(&self, first: char) -> String {
        let foreign = self.grammar.foreign(first.encode_utf8(&mut [0; 4]), "");
        foreign.unwrap_or_else(|| {
            let help = match first {
                ',' => "The decimal sign is a point.",
                '=' => "Only variables L, Q and P can be assigned to.",
                _ if first.is_ascii() => "Remove it, or make it a comment.",
                _ => "Characters that are not ASCII are allowed only in comments.",
            };
            help.to_owned()
        })
    }

    /// Moves to the end of the line; also skips comments that contain line feeds.
    fn skip_line(&mut self) {
        loop {
            self.blanks();
            match self.cursor.peek() {
                None | Some(b'\n') => break,
                Some(b'}') if self.nesting.braces > 0 => break,
                Some(_) => {
                    self.cursor.pass_character();
                }
            }
        }
    }
}

/// Converts an index or a position to 32 bits. They suffice, because the source has at most 64 MiB, and each
/// entry takes at least one byte of the source.
#[expect(clippy::cast_possible_truncation, reason = "bounded by PROGRAM_BYTES_MAX")]
fn index(value: usize) -> u32 {
    value as u32
}
