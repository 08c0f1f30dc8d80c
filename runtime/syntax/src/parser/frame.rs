//! Parses the text before and after the blocks of a program: the marks, and the program number.

use super::Parser;
use crate::diagnostics;
use crate::grammar::ProgramForm;

impl Parser<'_> {
    /// Reads the mark before the first block, if the dialect has marks.
    pub(super) fn head(&mut self, form: ProgramForm) {
        self.blank_lines();
        if form.mark.is_some() && self.cursor.peek() == form.mark {
            self.tree.marked = true;
            self.mark();
        }
    }

    /// Reads a mark, which must be alone on its line.
    pub(super) fn mark(&mut self) {
        self.cursor.advance(1);
        self.nothing_else("the mark of the data");
    }

    /// Returns true if the line begins with the letter of the program number.
    pub(super) fn is_program_number(&self) -> bool {
        let letter = self.cursor.peek().map(|byte| byte.to_ascii_uppercase());
        letter.is_some() && letter == self.grammar.program_form.number_letter
    }

    /// Reads the program number, which must be alone on its line and may occur once in a program.
    pub(super) fn program_number(&mut self) {
        let start = self.cursor.at();
        self.cursor.advance(1);
        let digits = self.cursor.digits();
        self.cursor.advance(digits.len());
        let max = self.grammar.program_form.number_digits_max;
        let number = digits.parse().ok().filter(|_| digits.len() <= max);
        let malformed = number.is_none() || self.cursor.peek() == Some(b'.');
        if malformed || self.tree.number.is_some() {
            let message = if malformed {
                "this is not a program number"
            } else {
                "this is the second program number"
            };
            let help = format!("Write one number of 1 to {max} digits, before the first block.");
            self.report_from(start, &diagnostics::PROGRAM_NUMBER, message, help);
            self.skip_line();
            self.push_failed(start);
            return;
        }
        self.tree.number = number;
        let follows = !self.tree.blocks.is_empty();
        let span = self.cursor.span_from(start);
        if self.nothing_else("the program number") && follows {
            let message = "the program number follows a block";
            let help = "Write it on the line after the mark of the data.";
            self.record_finding(&diagnostics::PROGRAM_NUMBER_LATE, span, message, help);
        }
    }

    /// Returns true if the rest of the line contains only comments; otherwise reports an error.
    fn nothing_else(&mut self, what: &str) -> bool {
        self.blanks();
        if matches!(self.cursor.peek(), None | Some(b'\n')) {
            return true;
        }
        let start = self.cursor.at();
        self.skip_line();
        let message = format!("{what} is not alone on its line");
        self.report_from(
            start,
            &diagnostics::NOT_ALONE,
            message,
            "Write the words on the next line.",
        );
        self.push_failed(start);
        false
    }
}
