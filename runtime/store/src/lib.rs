//! The stored data of a Tandem runtime: NC programs, values that survive the end of the runtime, runs, and the journal.
//!
//! All of them are in one data folder. The crate also contains the environment that this code uses (disk, threads and
//! clock, each a trait with the real implementation as default) and the tables of the values in use, because the store
//! restores them. It knows no configuration: [`data_folder::StoredMachine`] states what it needs to know of a machine.

pub mod clock;
pub mod data_folder;
pub mod disk;
pub mod environment;
pub mod journal;
pub mod order_key;
pub mod persistence;
pub mod program_store;
pub mod runs;
pub mod stored_data;
pub mod tables;
pub mod threads;

pub use clock::Clock;
