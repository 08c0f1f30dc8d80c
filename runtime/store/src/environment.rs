//! The environment of a runtime: the disk, the threads and the clock that it uses. Each is a trait with the real
//! implementation as default, so that a simulated world runs the code that a machine runs.

pub use crate::clock::{Clock, TimeSource};
pub use crate::disk::{Disk, DiskFile, DiskPath, DiskSpace, FileKind, FileMetadata, FileSystem, OpenMode};
pub use crate::threads::{StartedThread, SupervisedWork, ThreadStarter, Threads};

/// Disk, threads and clock of a runtime. The default is the disk, the threads and the time of the operating system.
#[derive(Debug, Clone, Default)]
pub struct Environment {
    /// Disk with the data folder.
    pub disk: Disk,
    /// Threads for work that waits for the disk.
    pub threads: Threads,
    /// Clock, which starts when the runtime starts.
    pub clock: Clock,
}
