//! The journal of a machine as an audit trail. It can be verified and searched while the machine runs, or in a copy of
//! its folder.

pub use tandem_store::disk::DiskPath;
pub use tandem_store::journal::LineFilter;
pub use tandem_store::persistence::chain::Hash;
use tandem_store::persistence::journal_folder::JOURNAL_FOLDER;
pub use tandem_store::persistence::journal_query::{LeftOut, search};
pub use tandem_store::persistence::journal_verify::{Break, ChainVerification, verify};

/// Returns the folder of the journal in a data folder. If `folder` contains no journal folder, returns `folder` itself.
pub fn journal_folder(folder: &DiskPath) -> DiskPath {
    let below = folder.join(JOURNAL_FOLDER);
    let is_folder = below.metadata().is_ok_and(|metadata| metadata.is_folder());
    if is_folder { below } else { folder.clone() }
}
