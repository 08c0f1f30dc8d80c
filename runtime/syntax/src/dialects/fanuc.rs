//! The milling programs of FANUC controls, as far as they are read to be written in dialect nj: with its help.

use super::{dgshape, nj};
use crate::grammar::Grammar;

pub(super) static FANUC: Grammar = Grammar {
    name: "fanuc",
    block_skip_max: 9,
    sections: &[],
    foreign: nj::FOREIGN,
    ..dgshape::GRAMMAR
};
