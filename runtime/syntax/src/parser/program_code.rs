//! Program codes: assignments, and branches and repetitions, which are recognised as a whole.

use tandem_model::Span;

use super::word::keyword;
use super::{LineKind, Parser, index};
use crate::address::Address;
use crate::diagnostics;
use crate::program_code::{Keyword, ProgramCode};
use crate::tree::{Block, Content, VariableKind};

impl Parser<'_> {
    /// Reads an assignment; the cursor stands behind the target's index, at blanks or `=`.
    pub(super) fn assignment(&mut self, start: usize, address: Address, index_start: usize) {
        let line = self.cursor.line();
        let target_span = self.cursor.span_from(start);
        let index_span = self.cursor.span_from(index_start);
        if self.kind == LineKind::Words {
            self.report(
                &diagnostics::ASSIGNMENT_PLACE,
                target_span,
                "an assignment stands in a block of words",
                "Write the assignment on a line of its own, before the block.",
            );
            self.skip_line();
            return;
        }
        self.begin_program_code(start);
        let kind = match address {
            Address::L => VariableKind::Local,
            Address::Q => VariableKind::CoordinateSystem,
            _ => VariableKind::Global,
        };
        let digits = self.cursor.excerpt(index_span);
        let number = if digits.bytes().all(|byte| byte.is_ascii_digit()) {
            digits.parse().unwrap_or(u64::MAX)
        } else {
            u64::MAX
        };
        let target = self.existing_variable((kind, number), target_span);
        self.blanks();
        self.cursor.take(b'=');
        let value = self.expression();
        let span = self.cursor.span_from(start);
        if let (Some(target), Some(value)) = (target, value) {
            self.push_program_code(start, line, ProgramCode::Assignment { target, value, span });
            self.too_long(start);
        } else {
            self.skip_line();
            self.push_failed(start, line);
        }
    }

    /// Notes that the line holds program codes; a block number before them is let go (its number is the line's).
    fn begin_program_code(&mut self, start: usize) {
        if self.kind != LineKind::ProgramCodes {
            self.kind = LineKind::ProgramCodes;
            self.words.truncate(self.first_word);
        }
        if self.flags & !Block::HAS_ERRORS != 0 {
            let span = Span::new(index(self.line_start), index(start));
            self.flags = 0;
            self.report(
                &diagnostics::SKIP_BEFORE_PROGRAM_CODE,
                span,
                "block skip cannot stand before a program code",
                "Remove it, or skip the blocks that use the value.",
            );
        }
    }

    fn push_program_code(&mut self, start: usize, line: u32, code: ProgramCode) {
        let content = Content::ProgramCode(index(self.program_codes.len()));
        self.program_codes.push(code);
        self.blocks.push(Block {
            start: index(start),
            line,
            flags: self.flags,
            content,
        });
    }

    /// A block in the place of a program code that could not be read.
    fn push_failed(&mut self, start: usize, line: u32) {
        self.blocks.push(Block {
            start: index(start),
            line,
            flags: self.flags | Block::HAS_ERRORS,
            content: Content::Words {
                first: index(self.words.len()),
                count: 0,
            },
        });
    }

    /// Passes a branch or repetition with all that belongs to it.
    pub(super) fn control(&mut self, keyword: Keyword, line: u32) {
        let start = self.cursor.at();
        let keyword_span = Span::new(index(start), index(start + keyword.text().len()));
        if self.kind == LineKind::Words {
            self.report(
                &diagnostics::ASSIGNMENT_PLACE,
                keyword_span,
                format!("`{}` stands in a block of words", keyword.text()),
                "Write the program code on a line of its own.",
            );
            self.end_words(line);
        }
        self.begin_program_code(start);
        self.cursor.advance(keyword.text().len());
        match keyword {
            Keyword::If | Keyword::While | Keyword::Switch => self.condition_and_body(keyword),
            Keyword::Do => {
                self.body();
                self.closing_while();
            }
            Keyword::Else | Keyword::Case | Keyword::Default | Keyword::Break => {
                self.report(
                    &diagnostics::KEYWORD_PLACE,
                    keyword_span,
                    format!("`{}` stands alone", keyword.text()),
                    "Write it inside the if, switch, while or do that it belongs to.",
                );
                self.body();
            }
        }
        let span = self.cursor.span_from(start);
        self.push_program_code(start, line, ProgramCode::Control { keyword, span });
        self.blank_lines();
    }

    fn condition_and_body(&mut self, keyword: Keyword) {
        self.blank_lines();
        if self.cursor.peek() == Some(b'(') {
            self.group(b'(', b')');
        }
        self.body();
        while keyword == Keyword::If && self.next_keyword() == Some(Keyword::Else) {
            self.blank_lines();
            self.cursor.advance(Keyword::Else.text().len());
            self.body();
        }
    }

    fn closing_while(&mut self) {
        if self.next_keyword() == Some(Keyword::While) {
            self.blank_lines();
            self.cursor.advance(Keyword::While.text().len());
            self.blank_lines();
            if self.cursor.peek() == Some(b'(') {
                self.group(b'(', b')');
            }
        }
    }

    /// The keyword that comes next, across blank lines, without passing anything.
    fn next_keyword(&self) -> Option<Keyword> {
        let mut ahead = self.cursor;
        ahead.blank_lines(self.grammar).ok()?;
        keyword(ahead.letters())
    }

    /// Passes braces with what they hold, or the rest of the line.
    fn body(&mut self) {
        self.blank_lines();
        if self.cursor.peek() == Some(b'{') {
            self.group(b'{', b'}');
            return;
        }
        loop {
            self.blanks();
            match self.cursor.peek() {
                None | Some(b'\n') => break,
                Some(b'{') => self.group(b'{', b'}'),
                Some(b'(') => self.group(b'(', b')'),
                Some(_) => {
                    self.cursor.pass_character();
                }
            }
        }
    }

    /// Passes from an opening bracket to its partner.
    fn group(&mut self, open: u8, close: u8) {
        let start = self.cursor.at();
        let mut depth = 0_usize;
        loop {
            self.blank_lines();
            let Some(byte) = self.cursor.peek() else {
                let start = index(start);
                self.complete = false;
                self.report(
                    &diagnostics::BRACE_UNMATCHED,
                    Span::new(start, start + 1),
                    format!("`{}` is not closed", char::from(open)),
                    format!("Write `{}` where it ends.", char::from(close)),
                );
                return;
            };
            self.cursor.pass_character();
            if byte == open {
                depth += 1;
            } else if byte == close {
                depth -= 1;
                if depth == 0 {
                    return;
                }
            }
        }
    }
}
