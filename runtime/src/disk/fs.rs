//! The file system of the data folder: that of the operating system; in tests also a disk in memory that
//! loses, tears and refuses written data (`simulated`), under the same names.

#[cfg(not(test))]
pub(crate) use redb::backends::FileBackend;
#[cfg(not(test))]
pub(crate) use rustix::fs::{access, statvfs};
#[cfg(not(test))]
pub(crate) use std::fs::*;
#[cfg(not(test))]
pub(crate) use std::os::unix::fs::{DirBuilderExt, FileExt, MetadataExt, OpenOptionsExt};

#[cfg(test)]
pub(crate) use super::simulated::*;
