//! Everything that outlives the runtime: variables, tools, work offsets, the tool in the spindle, the state of the last
//! run, and the journal.
//!
//! All but the journal is in one file of an embedded store (`store`), changed by whole transactions, so that a kill or
//! a power cut at any moment leaves the state before or after one of them. Each value has a checksum
//! (`record`), and a file next to the store has the checksums of all (`sums`). A value is trusted if both
//! agree, or if the store as a whole is intact (module `inspected_store`). All other values are lost and treated as
//! missing until a person writes them again. A separate thread (`state_writer`) looks for changes and writes
//! them: neither motion nor the handshake waits for a disk. The journal consists of lines in files of bounded
//! size (`journal_folder`), written by another thread (`journal_file`). NC programs are files of their own,
//! see `program_store`.

mod ahead;
pub(crate) mod chain;
mod cut_short;
mod generation;
mod image;
mod inspected_store;
pub(crate) mod journal_file;
pub(crate) mod journal_folder;
pub(crate) mod journal_query;
pub(crate) mod journal_reader;
pub(crate) mod journal_verify;
pub(crate) mod positions;
mod record;
mod replay;
mod restore;
mod resume;
mod state_writer;
mod store;

pub(crate) use chain::anchor_seal;
pub(crate) use cut_short::{cut_short, cut_short_between_parts};
pub(crate) use generation::Generation;
pub(crate) use image::{Image, LastRuns, PAGE_VARIABLES, page_name, pages};
pub(crate) use inspected_store::{
    InspectedStore, STARTED_FILE, STORE_FILE, StoreCondition, inspect_expected_store, inspect_store,
};
pub(crate) use replay::replay_last_runs;
pub(crate) use restore::{RestoredState, forget_outputs, restore, restore_outputs};
pub(crate) use state_writer::{Source, StateWriter, StateWriterThread};
pub(crate) use store::Store;
