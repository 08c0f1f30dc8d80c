//! Text form of a dialect, as data.

use crate::address::AddressSet;

/// The grammar of a dialect.
#[derive(Debug, PartialEq, Eq)]
pub struct Grammar {
    /// Name of the dialect.
    pub name: &'static str,
    /// The addresses that words may have.
    pub addresses: AddressSet,
    /// Text that begins a comment that ends with its line.
    pub line_comment: Option<&'static str>,
    /// Texts that begin and end a comment.
    pub block_comment: Option<(&'static str, &'static str)>,
    /// True if such a comment may contain line feeds; otherwise it ends on its line.
    pub comment_spans_lines: bool,
    /// The highest block skip number; `/` alone is `/1`. With 1, block skips have no number; with 0, the
    /// dialect has no block skips.
    pub block_skip_max: u8,
    /// True if assignments, branches and repetitions are part of the language.
    pub program_codes: bool,
    /// Text before and after the blocks of a program.
    pub program_form: ProgramForm,
    /// Sections of the dialect's manual that diagnostics refer to: code of the diagnostic, and section.
    pub sections: &'static [(&'static str, &'static str)],
    /// Text from programs for other controls, with its replacement; `{}` is the value after the text.
    pub foreign: &'static [(&'static str, &'static str)],
}

/// Text before and after the blocks of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramForm {
    /// Mark that is alone on the line before the program, and on a line after it. Text after the second mark
    /// is not read.
    pub mark: Option<u8>,
    /// The letter of the program number, which is alone on its line.
    pub number_letter: Option<u8>,
    /// Digits that block numbers and program numbers may have, leading zeros included.
    pub number_digits_max: usize,
}

impl Grammar {
    /// Returns the replacement for a word, a code without leading zeros, or a character of another control, with the
    /// value after it.
    pub fn foreign(&self, name: &str, value: &str) -> Option<String> {
        let mut all = self.foreign.iter();
        let (_, help) = all.find(|(known, _)| known.eq_ignore_ascii_case(name))?;
        Some(help.replace("{}", if value.is_empty() { "_" } else { value }))
    }

    /// Returns the replacement for a variable `#` with these digits.
    pub fn foreign_variable(&self, digits: &str) -> Option<String> {
        self.foreign("#", "")
            .or_else(|| self.program_codes.then(|| shared_variable(digits)))
    }

    /// Returns the help of a diagnostic, with the section of the manual if the dialect names one.
    pub fn cite(&self, code: &str, help: impl Into<String>) -> String {
        let mut help = help.into();
        if let Some((_, section)) = self.sections.iter().find(|(known, _)| *known == code) {
            help.push_str(" See ");
            help.push_str(section);
            help.push_str(" of the manual.");
        }
        help
    }
}

/// Returns the replacement for a variable `#n`, local or shared.
pub(crate) fn shared_variable(digits: &str) -> String {
    match digits.parse::<u32>() {
        Ok(1..=33) => format!("Write L{digits} for #{digits}, [L{digits}] as the value of a word."),
        Ok(100..=999) => {
            format!(
                "Write Q{digits} for #{digits}, [Q{digits}] as the value of a word, or P{digits} if other coordinate systems need it."
            )
        }
        Ok(1000..) => format!(
            "System variables do not exist: let the sequence program write the value of #{digits} into a Q variable."
        ),
        _ => {
            "Write L1, Q1 or P1, with the number of the variable, and [L1] as the value of a word.".to_owned()
        }
    }
}
