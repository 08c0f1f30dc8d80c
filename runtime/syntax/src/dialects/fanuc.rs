//! Grammar of milling programs for FANUC controls, used only for the conversion to dialect nj: its help texts
//! name replacements of nj.

use super::{dgshape, nj};
use crate::grammar::Grammar;

pub(super) static FANUC: Grammar = Grammar {
    name: "fanuc",
    block_skip_max: 9,
    sections: &[],
    foreign: nj::FOREIGN,
    ..dgshape::GRAMMAR
};
