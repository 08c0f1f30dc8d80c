//! Parses assignments, and contains the parts that all program codes share.

use tandem_model::Span;

use super::{LineKind, Parser, index};
use crate::address::Address;
use crate::diagnostics;
use crate::program_code::Statement;
use crate::tree::{Block, Content};
use crate::variable::VariableKind;

impl Parser<'_> {
    /// Reads an assignment; the cursor is after the index of the target variable, at blanks or `=`.
    pub(super) fn assignment(&mut self, start: usize, address: Address, index_start: usize) {
        let target_span = self.cursor.span_from(start);
        let index_span = self.cursor.span_from(index_start);
        if self.kind == LineKind::Words {
            self.report_from(
                start,
                &diagnostics::ASSIGNMENT_PLACE,
                "an assignment is in a block of words",
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
        self.cursor.skip_byte(b'=');
        let value = self.expression(0);
        if let (Some(target), Some(value)) = (target, value) {
            self.push_program_code(start, Statement::Assignment(target), Some(value));
            self.too_long(start);
        } else {
            self.skip_line();
            self.push_failed(start);
        }
    }

    /// Records that the line contains program codes, and drops a block number before them.
    pub(super) fn begin_program_code(&mut self, start: usize) {
        if self.kind != LineKind::ProgramCodes {
            self.kind = LineKind::ProgramCodes;
            self.tree.words.truncate(self.first_word);
        }
        if self.flags & !Block::HAS_ERRORS != 0 {
            self.flags = 0;
            self.report(
                &diagnostics::SKIP_BEFORE_PROGRAM_CODE,
                Span::new(index(self.line_start), index(start)),
                "block skip is not allowed before a program code",
                "Remove it, or skip the blocks that use the value.",
            );
        }
    }

    /// Adds a block for a program code that could not be read.
    pub(super) fn push_failed(&mut self, start: usize) {
        let none = Content::Words {
            first: index(self.tree.words.len()),
            count: 0,
        };
        self.push_block(start, self.flags | Block::HAS_ERRORS, none);
    }

    pub(super) fn push_block(&mut self, start: usize, flags: u32, content: Content) {
        self.tree.blocks.push(Block {
            start: index(start),
            line: self.cursor.line_of(start),
            flags,
            content,
        });
    }
}
