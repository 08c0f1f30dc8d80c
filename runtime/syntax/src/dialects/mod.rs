//! The grammar of each dialect, one file each, with the replacements for text of other controls.

mod dgshape;
mod fanuc;
mod nj;

use crate::grammar::Grammar;

/// Text of another control, and its replacement. `{}` in the help is the value after it.
type ForeignWord = (&'static str, &'static str);

impl Grammar {
    /// Returns the grammar of dialect nj: the NJ/NY-series manual O031, chapters 1 and 4.
    pub fn nj() -> &'static Grammar {
        &nj::NJ
    }

    /// Returns the grammar of dialect dgshape: the NC code manual FA01232, 1-1 and 2-6.
    pub fn dgshape() -> &'static Grammar {
        &dgshape::DGSHAPE
    }

    /// Returns the grammar of milling programs of FANUC controls, for the conversion to dialect nj only: its
    /// help texts name replacements of nj.
    pub fn fanuc() -> &'static Grammar {
        &fanuc::FANUC
    }
}
