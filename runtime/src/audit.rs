//! The journal of a machine as an audit trail. It can be verified and searched while the machine runs, or in a copy of
//! its folder.

use std::path::{Path, PathBuf};

pub use crate::journal::LineFilter;
pub use crate::persistence::chain::Hash;
use crate::persistence::journal_folder::JOURNAL_FOLDER;
pub use crate::persistence::journal_query::{LeftOut, search};
pub use crate::persistence::journal_verify::{Break, ChainVerification, verify};

/// Returns the folder of the journal in a data folder. If `folder` contains no journal folder, returns `folder` itself.
pub fn journal_folder(folder: &Path) -> PathBuf {
    let below = folder.join(JOURNAL_FOLDER);
    if below.is_dir() { below } else { folder.to_owned() }
}
