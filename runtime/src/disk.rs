//! Common parts of the runtime's own files: rights and names, lines and checksums that reveal damage, and the health of
//! files that cannot be written.

mod files;
pub(crate) mod fs;
mod generations;
mod health;
mod line;
#[cfg(test)]
pub(crate) mod simulated;
mod sums;

pub(crate) use files::{
    Identity, Lock, UNFINISHED, Unfinished, in_use, make_folder, make_folder_in, open_regular, read_regular,
    sync_folder, tighten, write_whole, write_whole_by,
};
pub(crate) use generations::{Generations, Kind, PartGenerations, Seal, StoredPart};
pub(crate) use health::{Health, Part};
pub(crate) use line::{Read, Unusable, number, read, read_sealed, seal, seal_in_place};
pub(crate) use sums::{Sealer, SumChange, SumFile, SumOfParts, Sums, sum_of};
