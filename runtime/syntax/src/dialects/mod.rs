//! The grammar of each dialect, one file each, with what programs for other controls write and what to write here.

mod dgshape;
mod fanuc;
mod nj;

use crate::grammar::Grammar;

/// What another control writes, and what to write here. `{}` in the help is the value behind it.
type Foreign = (&'static str, &'static str);

impl Grammar {
    /// Dialect nj: the NJ/NY-series manual O031, chapters 1 and 4.
    pub fn nj() -> &'static Grammar {
        &nj::NJ
    }

    /// Dialect dgshape: the NC code manual FA01232, 1-1 and 2-6.
    pub fn dgshape() -> &'static Grammar {
        &dgshape::DGSHAPE
    }

    /// The milling programs of FANUC controls, as far as they are read to be written in dialect nj: with its help.
    pub fn fanuc() -> &'static Grammar {
        &fanuc::FANUC
    }
}
