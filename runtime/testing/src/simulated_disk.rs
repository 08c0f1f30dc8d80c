//! A simulated disk: a file system in memory that can lose, tear and reject written data.

#![allow(
    clippy::unwrap_used,
    clippy::missing_panics_doc,
    reason = "a simulated disk is smaller than the memory, and its names are UTF-8"
)]

mod file;
pub mod memory;
#[cfg(test)]
mod tests;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use parking_lot::{Mutex, MutexGuard};

use file::SimulatedFile;
use memory::DiskModel;
use tandem_store::disk::{Disk, DiskFile, DiskSpace, FileMetadata, FileSystem, OpenMode};

/// Root folder of a simulated disk.
pub const ROOT: &str = "/simulated";

/// A simulated disk. A clone refers to the same disk.
#[derive(Debug, Clone)]
pub struct SimulatedDisk(Arc<Mutex<DiskModel>>);

impl SimulatedDisk {
    /// Creates an empty disk; `now` is the time of day, and `seed` determines the results of faults.
    pub fn new(seed: u64, now: SystemTime) -> Self {
        Self(Arc::new(Mutex::new(DiskModel::new(seed, now))))
    }

    /// Gives access to the content and the faults of the disk.
    pub fn lock(&self) -> MutexGuard<'_, DiskModel> {
        self.0.lock()
    }

    /// Mounts the disk for a new process; the previous process can no longer use it.
    pub fn mount(&self) -> Disk {
        let mut disk = self.lock();
        disk.process += 1;
        disk.is_dead = false;
        Disk::new(Mount {
            disk: Arc::clone(&self.0),
            process: disk.process,
        })
    }

    /// Returns true if the process that has mounted the disk must end.
    pub fn is_dead(&self) -> bool {
        self.lock().is_dead
    }
}

/// A disk, as mounted by one process.
#[derive(Debug, Clone)]
struct Mount {
    disk: Arc<Mutex<DiskModel>>,
    process: u64,
}

impl Mount {
    fn with<T>(&self, work: impl FnOnce(&mut DiskModel) -> io::Result<T>) -> io::Result<T> {
        let mut disk = self.disk.lock();
        if disk.is_dead || disk.process != self.process {
            return Err(memory::ended());
        }
        work(&mut disk)
    }
}

impl FileSystem for Mount {
    fn open(&self, path: &Path, mode: OpenMode) -> io::Result<Box<dyn DiskFile>> {
        let ino = self.with(|disk| disk.open(path, mode))?;
        Ok(Box::new(SimulatedFile::new(self.clone(), ino, mode)))
    }

    fn metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        self.with(|disk| disk.metadata(path))
    }

    fn link_metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        self.metadata(path)
    }

    fn list_folder(&self, path: &Path) -> io::Result<Vec<PathBuf>> {
        let names = self.with(|disk| disk.names(path))?;
        Ok(names.into_iter().map(|name| path.join(name)).collect())
    }

    fn create_folder(&self, path: &Path, has_parents: bool) -> io::Result<()> {
        self.with(|disk| disk.make_folder(path, has_parents))
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.with(|disk| {
            let ino = disk.find(path)?;
            disk.sync(ino)
        })
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.with(|disk| disk.rename(from, to))
    }

    fn copy(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.with(|disk| disk.copy(from, to))
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        self.with(|disk| disk.remove(path))
    }

    fn set_mode(&self, _: &Path, _: u32) -> io::Result<()> {
        Ok(())
    }

    fn check_writable(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn space(&self, _: &Path) -> io::Result<DiskSpace> {
        let is_full = self.disk.lock().faults.refuses == Some(io::ErrorKind::StorageFull);
        Ok(DiskSpace {
            is_read_only: false,
            free_bytes: Some(if is_full { 0 } else { u64::MAX >> 32 }),
        })
    }
}
