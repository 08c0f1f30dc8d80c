//! The program tree: flat arrays whose elements refer to each other by index. A program of a million blocks
//! thus needs only a few times the size of its text.

use std::sync::Arc;

use tandem_model::{Origin, Span};

use crate::address::Address;
use crate::program_code::{CaseLabel, Expression, ExpressionId, ProgramCode};
use crate::variable::{Variable, VariableKind};

/// A parsed NC program. Every text gives a program; the diagnostics determine whether the program may run.
#[derive(Debug, Clone, Default)]
pub struct NcProgram {
    pub(crate) source: Arc<str>,
    pub(crate) number: Option<u32>,
    pub(crate) marked: bool,
    pub(crate) complete: bool,
    pub(crate) blocks: Vec<Block>,
    pub(crate) words: Vec<Word>,
    pub(crate) program_codes: Vec<ProgramCode>,
    pub(crate) expressions: Vec<Expression>,
    pub(crate) cases: Vec<CaseLabel>,
}

impl NcProgram {
    /// Returns the source text of the program.
    pub fn source(&self) -> &Arc<str> {
        &self.source
    }

    /// Returns the program number in the text; `None` in dialects without a program number in the text.
    pub fn number(&self) -> Option<u32> {
        self.number
    }

    /// Returns true if the text begins with the mark of the dialect.
    pub fn is_marked(&self) -> bool {
        self.marked
    }

    /// Returns false if the parser did not read the text to its end as blocks: the text was too large, had
    /// too many errors, or has a comment or bracket that is not closed.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Returns all blocks in the order of the text. Empty lines and comment lines have no blocks.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Returns the words of all blocks in the order of the text, including words of lines with errors.
    pub fn all_words(&self) -> &[Word] {
        &self.words
    }

    /// Returns true if the text contains a program code.
    pub fn has_program_codes(&self) -> bool {
        !self.program_codes.is_empty()
    }

    /// Returns the words of a block of this program; no words for a program code.
    #[inline]
    pub fn words(&self, block: &Block) -> &[Word] {
        match block.content {
            Content::Words { first, count } => {
                let first = first as usize;
                self.words
                    .get(first..first + usize::from(count))
                    .unwrap_or_default()
            }
            Content::ProgramCode(_) => &[],
        }
    }

    /// Returns the block number (N), if the block has a block number that is whole and not negative.
    pub fn block_number(&self, block: &Block) -> Option<u32> {
        let first = self.words(block).first()?;
        first.whole().filter(|_| first.address == Address::N)
    }

    /// Returns the program code of a block of this program; `None` for a block of words.
    #[inline]
    pub fn program_code(&self, block: &Block) -> Option<&ProgramCode> {
        match block.content {
            Content::Words { .. } => None,
            Content::ProgramCode(index) => self.program_codes.get(index as usize),
        }
    }

    /// Returns a node of an expression of this program.
    pub fn expression(&self, id: ExpressionId) -> Option<&Expression> {
        self.expressions.get(id.0 as usize)
    }

    /// Returns the index of the block with a label among `count` cases from index `first` on, if it exists.
    pub fn case(&self, first: u32, count: u32, label: i64) -> Option<u32> {
        let first = first as usize;
        let cases = self.cases.get(first..first.checked_add(count as usize)?)?;
        let at = cases.binary_search_by_key(&label, |case| case.label).ok()?;
        cases.get(at).map(|case| case.block)
    }

    /// Returns the constants that a program can compare with values: numbers in expressions, and labels of
    /// cases.
    pub fn compared_with(&self) -> impl Iterator<Item = f64> {
        let numbers = self.expressions.iter().filter_map(|expression| match expression {
            Expression::Number(number) => Some(*number),
            _ => None,
        });
        #[expect(
            clippy::cast_precision_loss,
            reason = "labels beyond 2^53 are equal to no value of a variable"
        )]
        let labels = self.cases.iter().map(|case| case.label as f64);
        numbers.chain(labels)
    }

    /// Returns the indices of the blocks of the cases of a `switch`.
    pub fn case_blocks(&self, first: u32, count: u32) -> impl Iterator<Item = u32> {
        let cases = self.cases.iter().skip(first as usize).take(count as usize);
        cases.map(|case| case.block)
    }

    /// Returns the block's range of bytes: from its first word (or block skip) to the end of its last word.
    #[inline]
    pub fn span(&self, block: &Block) -> Span {
        let end = match self.program_code(block) {
            Some(code) => code.span.end,
            None => self
                .words(block)
                .last()
                .map_or(block.start + 1, |word| word.span().end),
        };
        Span::new(block.start, end.max(block.start))
    }

    /// Returns the range of bytes of the block's first word with this address. If the block has no such word,
    /// returns the range of the block.
    pub fn span_of(&self, block: &Block, address: Address) -> Span {
        let mut words = self.words(block).iter();
        let word = words.find(|word| word.address == address);
        word.map_or_else(|| self.span(block), Word::span)
    }

    /// Returns the place of a block. `program` is the number of the program, or 0 if it has no number.
    pub fn origin(&self, block: &Block, program: u16) -> Origin {
        self.origin_within(block, block.start, program)
    }

    /// Returns the place of the first word whose address is one of these letters, in the block at place `at`.
    /// Returns `None` if the block has no such word.
    pub fn origin_of_word(&self, at: Origin, letters: &str) -> Option<Origin> {
        let mut of_line = self.blocks().iter().filter(|block| block.line == at.line);
        let block = of_line.find(|block| self.origin(block, at.program) == at)?;
        let word = self.first_word(block, letters)?;
        Some(self.origin_within(block, word.span().start, at.program))
    }

    /// Returns the range of bytes of the first word whose address is one of these letters, in the block that
    /// contains place `at`. If the block has no such word, returns the range of the block. Returns `None` if
    /// no block contains the place.
    pub fn span_at(&self, at: Origin, letters: &str) -> Option<Span> {
        let mut of_line = self.blocks().iter().filter(|block| block.line == at.line);
        let block = of_line.rfind(|block| self.origin(block, at.program).column <= at.column)?;
        let word = self.first_word(block, letters);
        Some(word.map_or_else(|| self.span(block), Word::span))
    }

    fn first_word(&self, block: &Block, letters: &str) -> Option<&Word> {
        self.words(block).iter().find(|word| {
            let mut text = word.address.text().chars();
            text.next().is_some_and(|letter| letters.contains(letter)) && text.next().is_none()
        })
    }

    /// Returns the place of a byte in the line of the block, like [`NcProgram::origin`].
    pub fn origin_within(&self, block: &Block, start: u32, program: u16) -> Origin {
        let before = self
            .source
            .get(..start.max(block.start) as usize)
            .unwrap_or_default();
        let line_feed = before.bytes().rposition(|byte| byte == b'\n');
        let line_start = line_feed.map_or(0, |at| at + 1);
        let mut prefix = &before[line_start..];
        if line_start == 0 {
            prefix = prefix.strip_prefix('\u{feff}').unwrap_or(prefix);
        }
        Origin {
            program,
            line: block.line,
            column: u32::try_from(prefix.chars().count()).map_or(u32::MAX, |count| count.saturating_add(1)),
        }
    }
}

/// A block: the words of one line, or one program code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Position of the first byte in the source: of the block skip if present, otherwise of the first word.
    pub start: u32,
    /// Line of the first byte, from 1.
    pub line: u32,
    pub(crate) flags: u32,
    /// Content of the block.
    pub content: Content,
}

impl Block {
    /// Bit of [`Block::flags`] that marks errors. Block skip numbers, at most 31, use the lower bits.
    pub(crate) const HAS_ERRORS: u32 = 1 << 31;

    /// Returns the block skip numbers written before the block: bit `n - 1` for number `n` of 1 to 31 (D13).
    pub fn skip_numbers(&self) -> u32 {
        self.flags & !Self::HAS_ERRORS
    }

    /// Returns true if the parser found an error in the block, so that words may be missing.
    pub fn has_errors(&self) -> bool {
        self.flags & Self::HAS_ERRORS != 0
    }
}

/// Content of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// The words of a block.
    Words {
        /// Index of the first word.
        first: u32,
        /// Number of words.
        count: u16,
    },
    /// Index of a program code (manual, chapter 4).
    ProgramCode(u32),
}

/// A word: an address and its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Word {
    pub(crate) value: f64,
    pub(crate) start: u32,
    pub(crate) length: u16,
    /// Address of the word.
    pub address: Address,
    pub(crate) form: Form,
}

/// Form in which the value of a word is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form {
    /// A number without a decimal point.
    Whole,
    /// A number with a decimal point.
    Decimal,
    /// A variable in brackets; the value of the word is the index of the variable.
    Indirection(VariableKind),
}

impl Word {
    /// Returns the value of the word: a number, or the variable that holds the value.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an indirection holds its index, which the parser bounds to 0..=32767"
    )]
    pub fn value(&self) -> Value {
        match self.form {
            Form::Whole | Form::Decimal => Value::Number(self.value),
            Form::Indirection(kind) => Value::Indirection(Variable {
                kind,
                index: self.value as u16,
            }),
        }
    }

    /// Returns the value if it is a number, and `None` if a variable holds the value.
    pub fn number(&self) -> Option<f64> {
        (!matches!(self.form, Form::Indirection(_))).then_some(self.value)
    }

    /// Returns the value if it is a whole number that is not negative and has at most 32 bits.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range is tested"
    )]
    pub fn whole(&self) -> Option<u32> {
        let number = self.number()?;
        let whole = number.fract().abs() <= 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number);
        whole.then_some(number as u32)
    }

    /// Returns true if the value is a number without a decimal point.
    pub fn is_whole(&self) -> bool {
        self.form == Form::Whole
    }

    /// Returns the range of bytes of the word: address and value.
    pub fn span(&self) -> Span {
        Span::new(self.start, self.start + u32::from(self.length))
    }
}

/// The value of a word (D04).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A number in the text.
    Number(f64),
    /// `X[L12]`: the variable that holds the value.
    Indirection(Variable),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_stays_small() {
        assert_eq!(size_of::<Word>(), 16);
        assert_eq!(size_of::<Block>(), 20);
    }
}
