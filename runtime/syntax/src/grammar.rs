//! What the text of a dialect looks like, as data.

use tandem_model::limits::OPTIONAL_SKIP_MAX;

use crate::address::{Address, AddressSet};
use crate::foreign;

/// The grammar of a dialect.
#[derive(Debug, PartialEq, Eq)]
pub struct Grammar {
    /// Name of the dialect.
    pub name: &'static str,
    /// The addresses that words may have.
    pub addresses: AddressSet,
    /// Begins a comment that ends with its line.
    pub line_comment: Option<&'static str>,
    /// Begins and ends a comment.
    pub block_comment: Option<(&'static str, &'static str)>,
    /// True when such a comment may hold line feeds; otherwise it ends on its line.
    pub comment_spans_lines: bool,
    /// The highest block skip number; `/` alone is `/1`. With 1 there are no numbers, with 0 no block skips.
    pub block_skip_max: u8,
    /// True when assignments, branches and repetitions are part of the language.
    pub program_codes: bool,
    /// What is around the blocks of a program.
    pub program_form: ProgramForm,
    /// Sections of the dialect's manual that diagnostics name: code and section; empty: they name none.
    pub sections: &'static [(&'static str, &'static str)],
    /// What programs for other controls write, and what to write here; `{}` is the value behind it.
    pub foreign: &'static [(&'static str, &'static str)],
}

/// What is around the blocks of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramForm {
    /// Alone on the line before the program, and on one after it; what follows the second one is not read.
    pub mark: Option<u8>,
    /// The letter of the program number, which is alone on its line.
    pub number_letter: Option<u8>,
    /// Digits that block numbers and program numbers may have, leading zeros included.
    pub number_digits_max: usize,
}

static NJ: Grammar = Grammar {
    name: "nj",
    addresses: AddressSet::of(&[
        Address::A,
        Address::B,
        Address::C,
        Address::F,
        Address::G,
        Address::I,
        Address::J,
        Address::K,
        Address::L,
        Address::M,
        Address::N,
        Address::P,
        Address::Q,
        Address::R,
        Address::S,
        Address::X,
        Address::Y,
        Address::Z,
        Address::Ta,
        Address::Td,
        Address::Ts,
        Address::Va,
        Address::Vb,
        Address::Vc,
        Address::Vd,
        Address::Ve,
        Address::Vf,
        Address::Vg,
        Address::Vh,
    ]),
    line_comment: Some("//"),
    block_comment: Some(("/*", "*/")),
    comment_spans_lines: true,
    block_skip_max: OPTIONAL_SKIP_MAX,
    program_codes: true,
    program_form: ProgramForm {
        mark: None,
        number_letter: None,
        number_digits_max: usize::MAX,
    },
    sections: &[],
    foreign: foreign::OF_NJ,
};

const OF_DGSHAPE: Grammar = Grammar {
    name: "dgshape",
    addresses: AddressSet::of(&[
        Address::A,
        Address::D,
        Address::F,
        Address::G,
        Address::H,
        Address::I,
        Address::J,
        Address::K,
        Address::L,
        Address::M,
        Address::N,
        Address::P,
        Address::Q,
        Address::R,
        Address::S,
        Address::T,
        Address::X,
        Address::Y,
        Address::Z,
    ]),
    line_comment: None,
    block_comment: Some(("(", ")")),
    comment_spans_lines: false,
    block_skip_max: 1,
    program_codes: false,
    program_form: ProgramForm {
        mark: Some(b'%'),
        number_letter: Some(b'O'),
        number_digits_max: 8,
    },
    sections: &[
        ("E0003", "1-1"),
        ("E0004", "2-6, Comment"),
        ("E0005", "1-1"),
        ("E0006", "1-5"),
        ("E0007", "2-7"),
        ("E0008", "2-6, Optional Block Skip"),
        ("E0009", "2-6, Optional Block Skip"),
        ("E0010", "2-6, Sequence Number"),
        ("E0024", "2-6, Data Start"),
        ("E0025", "2-6"),
        ("E0026", "2-6, Program Number"),
        ("E0101", "2-7"),
        ("E0103", "2-7"),
        ("E0104", "2-7"),
        ("E0105", "1-1"),
        ("E0107", "1-3, Miscellaneous Functions, and 2-3, M06"),
        ("E0108", "2-2 and 2-3"),
        ("E0109", "2-1"),
        ("E0110", "2-1"),
        ("E0111", "2-2 and 2-3"),
        ("E0113", "2-2, G04"),
        ("E0115", "2-3, M02"),
        ("E0118", "2-2"),
        ("E0119", "2-2, G39 to G42"),
        ("E0120", "2-2, G53"),
        ("E0121", "2-2, G80 to G89"),
        ("E0122", "2-2, G02 and G03"),
        ("E0123", "2-3"),
        ("E0124", "2-2, G20 and G21"),
        ("E0125", "2-2, G53"),
        ("E0126", "2-2, G01"),
        ("W0002", "2-3, M02"),
        ("W0004", "2-5"),
        ("W0006", "2-6, Optional Block Skip"),
        ("W0007", "2-6, Program Number"),
        ("W0008", "2-2, G40 to G42"),
        ("W0017", "2-2, G02 and G03"),
        ("W0018", "2-2, G01"),
    ],
    foreign: foreign::OF_DGSHAPE,
};

static DGSHAPE: Grammar = OF_DGSHAPE;

static FANUC: Grammar = Grammar {
    name: "fanuc",
    block_skip_max: 9,
    sections: &[],
    foreign: foreign::OF_NJ,
    ..OF_DGSHAPE
};

impl Grammar {
    /// Dialect nj: the NJ/NY-series manual O031, chapters 1 and 4.
    pub fn nj() -> &'static Grammar {
        &NJ
    }

    /// What to write here for a word, a code without leading zeros, or a character of another control, with the value
    /// behind it.
    pub fn foreign(&self, name: &str, value: &str) -> Option<String> {
        foreign::help(self.foreign, name, value)
    }

    /// What to write for a variable `#` with these digits.
    pub fn foreign_variable(&self, digits: &str) -> Option<String> {
        self.foreign("#", "")
            .or_else(|| self.program_codes.then(|| foreign::variable(digits)))
    }

    /// Help of a diagnostic with the section of the manual, where the dialect names it.
    pub fn cite(&self, code: &str, help: impl Into<String>) -> String {
        let mut help = help.into();
        if let Some((_, section)) = self.sections.iter().find(|(known, _)| *known == code) {
            help.push_str(" See ");
            help.push_str(section);
            help.push_str(" of the manual.");
        }
        help
    }

    /// The milling programs of FANUC controls, as far as they are read to be written in dialect nj: with its help.
    pub fn fanuc() -> &'static Grammar {
        &FANUC
    }

    /// Dialect dgshape: the NC code manual FA01232, 1-1 and 2-6.
    pub fn dgshape() -> &'static Grammar {
        &DGSHAPE
    }
}
