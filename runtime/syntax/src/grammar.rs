//! What the text of a dialect looks like, as data.

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
    /// Begins and ends a comment that may hold line feeds.
    pub block_comment: Option<(&'static str, &'static str)>,
    /// True when `/`, `/1` to `/31` at the beginning of a line are block skips.
    pub block_skip: bool,
    /// True when assignments, branches and repetitions are part of the language.
    pub program_codes: bool,
    /// What is around the blocks of a program.
    pub program_form: ProgramForm,
}

/// What is around the blocks of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramForm {
    /// Begins a line before the program and one after it; what follows the second one is not read.
    pub mark: Option<u8>,
    /// The letter of the program number, on a line of its own before the first block.
    pub number_letter: Option<u8>,
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
    block_skip: true,
    program_codes: true,
    program_form: ProgramForm {
        mark: None,
        number_letter: None,
    },
};

impl Grammar {
    /// Dialect nj: the NJ/NY-series manual O031, chapters 1 and 4.
    pub fn nj() -> &'static Grammar {
        &NJ
    }
}
