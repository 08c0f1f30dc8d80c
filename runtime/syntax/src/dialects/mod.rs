//! Grammars of the dialects, one file for each dialect, with help texts for the words of other controls.

mod dgshape;
mod fanuc;
mod nj;

use crate::grammar::Grammar;

/// Word of another control, and the help that names its replacement. `{}` in the help stands for the value of
/// the word.
type ForeignWord = (&'static str, &'static str);

impl Grammar {
    /// Returns the grammar of dialect nj, by the NJ/NY-series manual O031, chapters 1 and 4.
    pub fn nj() -> &'static Grammar {
        &nj::NJ
    }

    /// Returns the grammar of dialect dgshape, by the NC code manual FA01232, 1-1 and 2-6.
    pub fn dgshape() -> &'static Grammar {
        &dgshape::DGSHAPE
    }

    /// Returns the grammar of milling programs for FANUC controls, used only for the conversion to dialect
    /// nj: its help texts name replacements of nj.
    pub fn fanuc() -> &'static Grammar {
        &fanuc::FANUC
    }
}
