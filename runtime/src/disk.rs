//! What the runtime's own files have in common: their rights and names, lines and sums that show damage, and which of them
//! cannot be written now.

mod files;
pub(crate) mod fs;
mod health;
mod line;
#[cfg(test)]
pub(crate) mod simulated;
mod sums;

pub(crate) use files::{
    Identity, Lock, UNFINISHED, Unfinished, in_use, make_folder, make_folder_in, open_regular, read_regular,
    sync_folder, tighten, write_whole,
};
pub(crate) use health::{Health, Part};
pub(crate) use line::{Read, number, read, seal, seal_in_place};
pub(crate) use sums::{SumChange, SumFile, Sums, sum_of};
