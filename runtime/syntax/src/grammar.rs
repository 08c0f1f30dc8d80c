//! Grammar of a dialect, as data.

use crate::address::AddressSet;

/// The grammar of a dialect: the form of its program texts.
#[derive(Debug, PartialEq, Eq)]
pub struct Grammar {
    /// Name of the dialect.
    pub name: &'static str,
    /// The addresses that words may have.
    pub addresses: AddressSet,
    /// Text that begins a comment which ends with its line.
    pub line_comment: Option<&'static str>,
    /// Texts that begin and end a block comment.
    pub block_comment: Option<(&'static str, &'static str)>,
    /// True if a block comment may contain line feeds; otherwise the comment ends on its line.
    pub comment_spans_lines: bool,
    /// The highest block skip number; `/` alone is `/1`. With 1, block skips have no number; with 0, the
    /// dialect has no block skips.
    pub block_skip_max: u8,
    /// True if assignments, branches and repetitions are part of the language.
    pub program_codes: bool,
    /// Marks and program number before and after the blocks of a program.
    pub program_form: ProgramForm,
    /// Codes of diagnostics, each with the section of the dialect's manual that contains the rule.
    pub sections: &'static [(&'static str, &'static str)],
    /// Words of other controls, each with its help; `{}` in the help stands for the value of the word.
    pub foreign: &'static [(&'static str, &'static str)],
}

/// Marks and program number before and after the blocks of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramForm {
    /// Mark that is alone on the line before the program, and on a line after the program. The parser does
    /// not read the text after the second mark.
    pub mark: Option<u8>,
    /// Letter of the program number; the program number is alone on its line.
    pub number_letter: Option<u8>,
    /// Maximum number of digits of block numbers and program numbers, including leading zeros.
    pub number_digits_max: usize,
}

impl Grammar {
    /// Returns the help for a word, a code without leading zeros, or a character of another control. `value`
    /// is the text of the value after the word.
    pub fn foreign(&self, name: &str, value: &str) -> Option<String> {
        let mut all = self.foreign.iter();
        let (_, help) = all.find(|(known, _)| known.eq_ignore_ascii_case(name))?;
        Some(help.replace("{}", if value.is_empty() { "_" } else { value }))
    }

    /// Returns the help for a variable `#` with these digits.
    pub fn foreign_variable(&self, digits: &str) -> Option<String> {
        self.foreign("#", "")
            .or_else(|| self.program_codes.then(|| shared_variable(digits)))
    }

    /// Returns the help of a diagnostic; adds the section of the manual if the dialect names a section for
    /// this code.
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

/// Returns the help for a variable `#n`, which names a local or shared variable.
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
