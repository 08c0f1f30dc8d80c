//! Parses words (an address with a number or an indirection), and all other elements that begin with a
//! letter.

use tandem_model::Span;

use super::control::ForeignBraces;
use super::{LineKind, Parser, index};
use crate::address::Address;
use crate::cursor::{Number, NumberError};
use crate::diagnostics;
use crate::program_code::Keyword;
use crate::tree::{Form, Word};
use crate::variable::{Variable, VariableKind};

impl Parser<'_> {
    /// Reads an element that begins with a letter. Returns `true` if the line ends here, as after a branch or
    /// loop.
    pub(super) fn name_or_word(&mut self, line: u32) -> bool {
        let start = self.cursor.at();
        if let Some(b'0'..=b'9' | b'-' | b'.' | b'+') = self.cursor.peek_second() {
            let address = self.cursor.peek().and_then(Address::from_letter);
            match address.filter(|address| self.grammar.addresses.contains(*address)) {
                Some(address) => self.word(start, address, 1),
                None => self.unknown_word(start, 1),
            }
            return self.single && self.kind == LineKind::ProgramCodes;
        }
        let letters = self.cursor.letters();
        if self.grammar.program_codes
            && let Some(keyword) = Keyword::find(letters)
        {
            let ends = self.nesting.braces > 0 || (self.nesting.depth > 0 && ends_command(keyword));
            if self.kind == LineKind::Words && ends {
                self.end_words(line);
                return true;
            }
            self.control(keyword, line);
            return true;
        }
        match self.address_of(letters) {
            Some(address) => self.word(start, address, letters.len()),
            None => self.no_address(start, letters),
        }
        self.single && self.kind == LineKind::ProgramCodes
    }

    /// Returns the address with these letters, if the dialect has this address.
    fn address_of(&self, letters: &str) -> Option<Address> {
        let address = Address::find(letters);
        address.filter(|address| self.grammar.addresses.contains(*address))
    }

    /// Reports letters that are no address: an address without its value (`X` in `XY10`), or an unknown word.
    fn no_address(&mut self, start: usize, letters: &str) {
        let first = letters.get(..1).unwrap_or_default();
        let rest = letters.get(1..).unwrap_or_default();
        let two_words = self.address_of(first).is_some() && self.address_of(rest).is_some();
        if two_words && self.grammar.foreign(letters, "").is_none() {
            self.cursor.advance(1);
            let span = self.cursor.span_from(start);
            self.value_missing(span);
        } else {
            self.unknown_word(start, letters.len());
        }
    }

    fn unknown_word(&mut self, start: usize, letters: usize) {
        self.cursor.advance(letters);
        let name = self.cursor.excerpt(self.cursor.span_from(start));
        let mut ahead = self.cursor;
        if self.grammar.program_codes && ahead.blanks(self.grammar).is_ok() && ahead.peek() == Some(b'(') {
            self.foreign_statement(start, &name);
            return;
        }
        let mut ahead = self.cursor;
        if ahead.blanks(self.grammar).is_ok()
            && matches!(ahead.peek(), Some(b'0'..=b'9' | b'.' | b'-' | b'+' | b'['))
        {
            self.cursor = ahead;
        }
        let value_start = self.cursor.at();
        self.pass_value();
        let value = self.cursor.excerpt(self.cursor.span_from(value_start));
        let letter = self.grammar.program_form.number_letter.map(char::from);
        if letter.is_some_and(|letter| name.eq_ignore_ascii_case(letter.encode_utf8(&mut [0; 4]))) {
            self.report_from(
                start,
                &diagnostics::NOT_ALONE,
                "the program number is not alone on its line",
                "Write it on the line after the mark of the data.",
            );
            return;
        }
        let first = name.get(..1).and_then(|letter| self.address_of(letter));
        let zero_meant = first.is_some() && name.get(1..).is_some_and(|rest| rest.eq_ignore_ascii_case("O"));
        let help = self.grammar.foreign(&name, &value).unwrap_or_else(|| {
            let help = if zero_meant {
                "If a zero is meant, write the digit 0."
            } else {
                "Remove it, or correct its address."
            };
            help.to_owned()
        });
        self.report_from(
            start,
            &diagnostics::WORD_UNKNOWN,
            format!("`{name}` is not a word of this dialect"),
            help,
        );
        if name.len() > 1 && !zero_meant && !self.grammar.program_codes {
            self.skip_line(); // the line is text, or a statement of another control: no further finding
        }
    }

    /// Skips the value of a word that has already been reported.
    fn pass_value(&mut self) {
        while let Some(b'0'..=b'9' | b'.' | b'-' | b'+') = self.cursor.peek() {
            self.cursor.advance(1);
        }
        if self.cursor.peek() == Some(b'[') {
            self.pass_bracket();
        }
    }

    /// Skips from `[` to `]` or to the end of the line.
    fn pass_bracket(&mut self) {
        while let Some(byte) = self.cursor.peek() {
            if byte == b'\n' || self.cursor.pass_character() == Some(']') {
                break;
            }
        }
    }

    fn value_missing(&mut self, span: Span) {
        let name = self.cursor.excerpt(span);
        self.report(
            &diagnostics::VALUE_MISSING,
            span,
            format!("`{name}` has no value"),
            format!("Write a number after it, for example {name}1."),
        );
    }

    /// Reads a word whose address is known.
    #[inline]
    fn word(&mut self, start: usize, address: Address, letters: usize) {
        self.cursor.advance(letters);
        if matches!(self.cursor.peek(), Some(b' ' | b'\t')) {
            self.blanks();
        }
        if self.grammar.program_codes && self.cursor.peek() == Some(b'[') {
            self.indirect_word(start, address);
            return;
        }
        let value_start = self.cursor.at();
        let Number { value, has_point } = match self.cursor.number(true) {
            Ok(number) => number,
            Err(error) => return self.no_number(error, start, start + letters, value_start),
        };
        if matches!(self.cursor.peek(), Some(b'.' | b'-' | b'+')) || self.pass_exponent() {
            self.number_malformed(start, value_start);
        } else if matches!(address, Address::L | Address::P | Address::Q) && self.is_assignment() {
            self.assignment(start, address, value_start);
        } else {
            let form = if has_point { Form::Decimal } else { Form::Whole };
            self.push_word(start, address, value, form);
        }
    }

    /// Reports why no number follows the address that ends at `end`.
    #[cold]
    fn no_number(&mut self, error: NumberError, start: usize, end: usize, value_start: usize) {
        match error {
            NumberError::Missing => {
                // another finding reports a character that is not part of the language
                let missing = matches!(
                    self.cursor.peek(),
                    None | Some(b'\n' | b'\r' | b'/' | b'_' | b'A'..=b'Z' | b'a'..=b'z' | b'{' | b'}')
                );
                if missing {
                    self.value_missing(Span::new(index(start), index(end)));
                }
            }
            NumberError::Malformed => self.number_malformed(start, value_start),
            NumberError::TooLarge => self.report_from(
                start,
                &diagnostics::NUMBER_TOO_LARGE,
                "the number is too large",
                "Write a number within the range of the word.",
            ),
        }
    }

    /// Reports a number with invalid characters after it.
    #[cold]
    fn number_malformed(&mut self, start: usize, value_start: usize) {
        self.pass_value();
        let text = self.cursor.excerpt(self.cursor.span_from(value_start));
        self.report_from(
            start,
            &diagnostics::NUMBER_MALFORMED,
            format!("`{text}` is not a number"),
            "Write an optional sign, digits, and at most one decimal point.",
        );
    }

    /// Reports a statement of another language, such as `for (..)`, as one error; its braces are not
    /// reported.
    fn foreign_statement(&mut self, start: usize, name: &str) {
        let mut open = 0_u32;
        while let Some(byte) = self.cursor.peek() {
            match byte {
                b'\n' => break,
                b'(' => open += 1,
                b')' if open == 1 => {
                    self.cursor.advance(1);
                    break;
                }
                b')' => open -= 1,
                _ => {}
            }
            self.cursor.pass_character();
        }
        self.nesting.foreign = ForeignBraces::Begun;
        self.report_from(
            start,
            &diagnostics::WORD_UNKNOWN,
            format!("`{name}` is not a program code of this dialect"),
            "Write it with if, switch, while or do. Set a counter before the while, and change it at the end of its commands.",
        );
    }

    /// Skips the exponent of a number, which the language does not have. Returns true if the number has an
    /// exponent.
    #[inline]
    pub(super) fn pass_exponent(&mut self) -> bool {
        matches!(self.cursor.peek(), Some(b'e' | b'E')) && self.pass_its_digits()
    }

    #[cold]
    fn pass_its_digits(&mut self) -> bool {
        let mut ahead = self.cursor;
        ahead.advance(1);
        let _ = ahead.skip_byte(b'-') || ahead.skip_byte(b'+');
        let digits = ahead.digits().len();
        let is_one = digits > 0 && self.grammar.program_codes;
        if is_one {
            ahead.advance(digits);
            self.cursor = ahead;
        }
        is_one
    }

    /// Returns true if `=` follows the cursor, as after the target of an assignment.
    fn is_assignment(&self) -> bool {
        let mut ahead = self.cursor;
        self.grammar.program_codes && ahead.blanks(self.grammar).is_ok() && ahead.peek() == Some(b'=')
    }

    /// Reads the `[variable]` of an indirection (D04).
    #[inline(never)]
    fn indirect_word(&mut self, start: usize, address: Address) {
        let bracket = self.cursor.at();
        self.cursor.advance(1);
        self.blanks();
        let variable = self.variable();
        self.blanks();
        let closed = self.cursor.peek() == Some(b']');
        let Some(variable) = variable.filter(|_| closed) else {
            self.pass_bracket();
            let text = self.cursor.excerpt(self.cursor.span_from(bracket));
            self.report_from(
                start,
                &diagnostics::INDIRECTION_MALFORMED,
                format!("`{text}` is not one variable in brackets"),
                "Write the name of one variable, for example [L12], and calculate before the block.",
            );
            return;
        };
        self.cursor.advance(1);
        if matches!(address, Address::L | Address::P | Address::Q) && self.is_assignment() {
            self.report_from(
                start,
                &diagnostics::INDIRECTION_MALFORMED,
                "indirection cannot be used in a program code",
                "Assign to a variable by its number.",
            );
            self.skip_line();
            return;
        }
        let span = self.cursor.span_from(start);
        if self.variable_exists(variable, span) {
            let index = u16::try_from(variable.1).unwrap_or_default();
            self.push_word(start, address, f64::from(index), Form::Indirection(variable.0));
        }
    }

    /// Reads the name of a variable. Returns its array, and its index, which may be too large. The index of a
    /// captured position may be in parentheses, as in the manual's description of G31.
    pub(super) fn variable(&mut self) -> Option<(VariableKind, u64)> {
        let letters = self.cursor.letters();
        let kind = VariableKind::find(letters)?;
        let mut ahead = self.cursor;
        ahead.advance(letters.len());
        let in_parentheses = kind == VariableKind::CapturedPosition && ahead.skip_byte(b'(');
        let digits = ahead.digits();
        if digits.is_empty() {
            return None;
        }
        ahead.advance(digits.len());
        if in_parentheses && !ahead.skip_byte(b')') {
            return None;
        }
        self.cursor = ahead;
        Some((kind, digits.parse().unwrap_or(u64::MAX)))
    }

    /// Returns true if the array contains this index (manual 4-3); otherwise reports an error.
    pub(super) fn variable_exists(&mut self, (kind, number): (VariableKind, u64), span: Span) -> bool {
        let exists = number <= u64::from(kind.index_max());
        if !exists {
            let prefix = kind.prefix();
            self.report(
                &diagnostics::VARIABLE_UNKNOWN,
                span,
                format!("there is no variable {prefix}{number}"),
                format!("Use {prefix}0 to {prefix}{}.", kind.index_max()),
            );
        }
        exists
    }

    /// Returns the variable with this array and index if it exists; reports an error otherwise.
    pub(super) fn existing_variable(&mut self, name: (VariableKind, u64), span: Span) -> Option<Variable> {
        let index = u16::try_from(name.1).ok();
        self.variable_exists(name, span)
            .then_some(index)
            .flatten()
            .map(|index| Variable { kind: name.0, index })
    }

    #[inline]
    fn push_word(&mut self, start: usize, address: Address, value: f64, form: Form) {
        if self.too_long(start) {
            return;
        }
        if self.kind == LineKind::ProgramCodes {
            self.word_next_to_program_code(start);
            return;
        }
        if address != Address::N {
            self.kind = LineKind::Words;
        } else if !self.validate_block_number(start) {
            return;
        }
        let length = u16::try_from(self.cursor.at() - start).unwrap_or(u16::MAX);
        self.tree.words.push(Word {
            value,
            start: index(start),
            length,
            address,
            form,
        });
    }

    /// Returns true if a block number is at the right position. Reports a wrong position, and too many
    /// digits.
    #[inline(never)]
    fn validate_block_number(&mut self, start: usize) -> bool {
        if self.tree.words.len() > self.first_word {
            self.report_from(
                start,
                &diagnostics::BLOCK_NUMBER_PLACE,
                "the block number is not before the other words",
                "Write N at the beginning of the block, once.",
            );
            return false;
        }
        let max = self.grammar.program_form.number_digits_max;
        if self.cursor.at() - start > max {
            let text = self.cursor.excerpt(self.cursor.span_from(start));
            let digits = text.bytes().filter(u8::is_ascii_digit).count();
            if digits > max {
                self.report_from(
                    start,
                    &diagnostics::CODE_NUMBER,
                    format!("{text} has {digits} digits"),
                    format!("Write at most {max} digits."),
                );
            }
        }
        true
    }

    #[cold]
    fn word_next_to_program_code(&mut self, start: usize) {
        self.report_from(
            start,
            &diagnostics::ASSIGNMENT_PLACE,
            "a word is on the line of a program code",
            "Write words and program codes on lines of their own.",
        );
        self.skip_line();
        self.push_failed(start);
    }
}

/// Returns true for a keyword that may follow a command of a branch or repetition on the same line.
fn ends_command(keyword: Keyword) -> bool {
    matches!(
        keyword,
        Keyword::Else | Keyword::Case | Keyword::Default | Keyword::Break | Keyword::While
    )
}
