//! Data that survive the end of the runtime: variables, tools, work offsets, the tool in the spindle, the
//! state of the last run, and the journal.
//!
//! All data except the journal are in one file of an embedded store (`store`). Only whole transactions change
//! the file, so after a kill or a power cut it contains the state before or after a transaction. Each value
//! has a checksum (`record`), and the file `sums` next to the store contains the checksums of all values. A
//! value is trusted if both checksums agree, or if the store as a whole is intact (module `inspected_store`).
//! All other values are lost: the runtime treats them as missing until a person writes them again. A separate
//! thread (`state_writer`) finds changes and writes them, so neither motion nor the handshake waits for a
//! disk. Another thread (`journal_file`) writes the lines of the journal into files of bounded size
//! (`journal_folder`). NC programs are separate files, see `program_store`.

mod ahead;
pub mod chain;
mod cut_short;
mod generation;
pub mod image;
mod inspected_store;
pub mod journal_file;
pub mod journal_folder;
pub mod journal_query;
pub mod journal_reader;
pub mod journal_verify;
pub mod positions;
mod record;
mod replay;
mod restore;
mod resume;
mod store;

pub use chain::anchor_seal;
pub use cut_short::{cut_short, cut_short_between_parts};
pub use generation::{GENERATION_FILE, Generation};
pub use image::{Image, LastRuns, PAGE_VARIABLES, page_name, pages};
pub use inspected_store::{
    InspectedStore, STARTED_FILE, STORE_FILE, StoreCondition, inspect_expected_store, inspect_store,
};
pub use replay::replay_last_runs;
pub use restore::{RestoredState, forget_outputs, restore, restore_outputs};
pub use store::Store;
