//! What the text of a dialect looks like, as data.

use tandem_model::limits::OPTIONAL_SKIP_MAX;

use crate::address::{Address, AddressSet};

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
}

/// What is around the blocks of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramForm {
    /// Alone on the line before the program, and on one after it; what follows the second one is not read.
    pub mark: Option<u8>,
    /// The letter of the program number, which is alone on its line.
    pub number_letter: Option<u8>,
    /// Digits that block numbers and program numbers may have.
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
        number_digits_max: 10,
    },
};

static DGSHAPE: Grammar = Grammar {
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
};

impl Grammar {
    /// Dialect nj: the NJ/NY-series manual O031, chapters 1 and 4.
    pub fn nj() -> &'static Grammar {
        &NJ
    }

    /// Dialect dgshape: the NC code manual FA01232, 1-1 and 2-6.
    pub fn dgshape() -> &'static Grammar {
        &DGSHAPE
    }
}
