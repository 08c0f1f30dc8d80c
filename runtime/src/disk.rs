//! Common parts of the runtime's own files: access rights, names, lines and checksums that reveal damage, and the
//! health of files that cannot be written.

mod checksums;
mod files;
pub(crate) mod fs;
mod generations;
mod health;
mod line;
#[cfg(test)]
pub(crate) mod simulated;

pub(crate) use checksums::{ChecksumChange, ChecksumFile, ChecksumHasher, Checksums, Sealer, checksum_hex};
pub(crate) use files::{
    Identity, Lock, UNFINISHED, UnfinishedFile, in_use, make_folder, make_folder_in, open_regular,
    read_regular, sync_folder, tighten, write_whole, write_whole_by,
};
pub(crate) use generations::{Generations, PartGenerations, Seal, SealedFileKind, StoredPart};
pub(crate) use health::{DataFolderPart, Health};
pub(crate) use line::{LineContent, Unusable, number, read, read_sealed, seal, seal_in_place};
