//! Common parts of the runtime's own files: the disk as a parameter, access rights, names, lines and checksums that
//! reveal damage, and the health of files that cannot be written.

mod checksums;
mod file_system;
mod files;
mod generations;
mod health;
mod line;
mod path;

pub use checksums::{ChecksumChange, ChecksumFile, ChecksumHasher, Checksums, Sealer, checksum_hex};
pub use file_system::{DiskFile, DiskSpace, FileKind, FileMetadata, FileSystem, OpenMode};
pub use files::{
    Identity, Lock, UNFINISHED, UnfinishedFile, in_use, make_folder, make_folder_in, open_regular,
    read_regular, sync_folder, tighten, write_whole, write_whole_by,
};
pub use generations::{Generations, PartGenerations, Seal, SealMismatch, SealedFileKind, StoredPart};
pub use health::{DataFolderPart, Health};
pub use line::{Unusable, number, read_sealed, seal, seal_in_place};
pub use path::{Disk, DiskPath};
