//! File system of the data folder, with the names of [`std::fs`]: that of the operating system. In tests a
//! disk in memory (`simulated`) is added, which can lose, tear and reject written data.

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
