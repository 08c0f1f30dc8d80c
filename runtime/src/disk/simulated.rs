//! The names of [`std::fs`] for two kinds of disk. Paths below [`ROOT`] are on the disk in memory that is
//! mounted in this thread ([`memory`]); all other paths are on the disk of the operating system.

mod file;
pub(crate) mod memory;
#[cfg(test)]
mod tests;

use std::ffi::OsString;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Bound;
use std::os::unix::fs as unix;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use redb::{BackendError, DatabaseError, StorageBackend};
use rustix::fs::{Access, StatVfs};

pub(crate) use std::fs::{Permissions, TryLockError, create_dir, read, read_to_string, write};

use file::SimulatedFile;
use memory::{Mount, on};

/// Folder under which the disk in memory is mounted.
pub(crate) const ROOT: &str = "/simulated";

/// An open file on either disk.
#[derive(Debug)]
pub(crate) enum File {
    Real(std::fs::File),
    Simulated(SimulatedFile),
}

impl File {
    pub fn open(path: impl AsRef<Path>) -> io::Result<Self> {
        OpenOptions::new().read(true).open(path)
    }

    pub fn metadata(&self) -> io::Result<Metadata> {
        match self {
            Self::Real(file) => file.metadata().map(Metadata::Real),
            Self::Simulated(file) => file.metadata(),
        }
    }

    pub fn sync_all(&self) -> io::Result<()> {
        match self {
            Self::Real(file) => file.sync_all(),
            Self::Simulated(file) => file.sync(),
        }
    }

    pub fn sync_data(&self) -> io::Result<()> {
        self.sync_all()
    }

    pub fn set_len(&self, length: u64) -> io::Result<()> {
        match self {
            Self::Real(file) => file.set_len(length),
            Self::Simulated(file) => file.set_len(length),
        }
    }

    pub fn try_lock(&self) -> Result<(), TryLockError> {
        match self {
            Self::Real(file) => file.try_lock(),
            Self::Simulated(_) => Ok(()),
        }
    }
}

impl Read for File {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Real(file) => file.read(buffer),
            Self::Simulated(file) => file.read(buffer),
        }
    }
}

impl Write for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Real(file) => file.write(bytes),
            Self::Simulated(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for File {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self {
            Self::Real(file) => file.seek(to),
            Self::Simulated(file) => file.seek(to),
        }
    }
}

pub(crate) trait FileExt {
    fn write_all_at(&self, bytes: &[u8], at: u64) -> io::Result<()>;
}

impl FileExt for File {
    fn write_all_at(&self, bytes: &[u8], at: u64) -> io::Result<()> {
        match self {
            Self::Real(file) => unix::FileExt::write_all_at(file, bytes, at),
            Self::Simulated(file) => file.write_at(bytes, at),
        }
    }
}

/// Options for opening a file.
#[derive(Debug, Clone)]
pub(crate) struct OpenOptions {
    real: std::fs::OpenOptions,
    pub create: bool,
    pub create_new: bool,
    pub append: bool,
}

impl OpenOptions {
    pub fn new() -> Self {
        Self {
            real: std::fs::OpenOptions::new(),
            create: false,
            create_new: false,
            append: false,
        }
    }

    pub fn read(&mut self, yes: bool) -> &mut Self {
        self.real.read(yes);
        self
    }

    pub fn write(&mut self, yes: bool) -> &mut Self {
        self.real.write(yes);
        self
    }

    pub fn append(&mut self, yes: bool) -> &mut Self {
        self.real.append(yes);
        self.append = yes;
        self
    }

    /// Only accepts `false`, because the runtime opens no stored file with truncation.
    pub fn truncate(&mut self, yes: bool) -> &mut Self {
        assert!(!yes, "the disk in memory truncates no file that it opens");
        self.real.truncate(yes);
        self
    }

    pub fn create(&mut self, yes: bool) -> &mut Self {
        self.real.create(yes);
        self.create = yes;
        self
    }

    pub fn create_new(&mut self, yes: bool) -> &mut Self {
        self.real.create_new(yes);
        self.create_new = yes;
        self
    }

    pub fn open(&self, path: impl AsRef<Path>) -> io::Result<File> {
        let path = path.as_ref();
        match Mount::for_path(path) {
            None => self.real.open(path).map(File::Real),
            Some(mount) => SimulatedFile::open(mount, path, self).map(File::Simulated),
        }
    }
}

pub(crate) trait OpenOptionsExt {
    fn mode(&mut self, mode: u32) -> &mut Self;
    fn custom_flags(&mut self, flags: i32) -> &mut Self;
}

impl OpenOptionsExt for OpenOptions {
    fn mode(&mut self, mode: u32) -> &mut Self {
        unix::OpenOptionsExt::mode(&mut self.real, mode);
        self
    }

    fn custom_flags(&mut self, flags: i32) -> &mut Self {
        unix::OpenOptionsExt::custom_flags(&mut self.real, flags);
        self
    }
}

/// Metadata of a file or folder.
#[derive(Debug, Clone)]
pub(crate) enum Metadata {
    Real(std::fs::Metadata),
    Simulated {
        is_folder: bool,
        length: u64,
        modified: SystemTime,
        ino: u64,
    },
}

impl Metadata {
    pub fn is_dir(&self) -> bool {
        match self {
            Self::Real(real) => real.is_dir(),
            Self::Simulated { is_folder, .. } => *is_folder,
        }
    }

    pub fn is_file(&self) -> bool {
        match self {
            Self::Real(real) => real.is_file(),
            Self::Simulated { is_folder, .. } => !is_folder,
        }
    }

    pub fn is_symlink(&self) -> bool {
        matches!(self, Self::Real(real) if real.is_symlink())
    }

    pub fn len(&self) -> u64 {
        match self {
            Self::Real(real) => real.len(),
            Self::Simulated { length, .. } => *length,
        }
    }

    pub fn modified(&self) -> io::Result<SystemTime> {
        match self {
            Self::Real(real) => real.modified(),
            Self::Simulated { modified, .. } => Ok(*modified),
        }
    }
}

pub(crate) trait MetadataExt {
    fn mode(&self) -> u32;
    fn mtime(&self) -> i64;
    fn mtime_nsec(&self) -> i64;
    fn dev(&self) -> u64;
    fn ino(&self) -> u64;
}

fn since_epoch(time: SystemTime) -> std::time::Duration {
    time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}

impl MetadataExt for Metadata {
    fn mode(&self) -> u32 {
        match self {
            Self::Real(real) => unix::MetadataExt::mode(real),
            Self::Simulated { .. } => 0o600,
        }
    }

    fn mtime(&self) -> i64 {
        match self {
            Self::Real(real) => unix::MetadataExt::mtime(real),
            Self::Simulated { modified, .. } => since_epoch(*modified).as_secs().cast_signed(),
        }
    }

    fn mtime_nsec(&self) -> i64 {
        match self {
            Self::Real(real) => unix::MetadataExt::mtime_nsec(real),
            Self::Simulated { modified, .. } => i64::from(since_epoch(*modified).subsec_nanos()),
        }
    }

    fn dev(&self) -> u64 {
        match self {
            Self::Real(real) => unix::MetadataExt::dev(real),
            Self::Simulated { .. } => 0,
        }
    }

    fn ino(&self) -> u64 {
        match self {
            Self::Real(real) => unix::MetadataExt::ino(real),
            Self::Simulated { ino, .. } => *ino,
        }
    }
}

/// Options for creating a folder.
#[derive(Debug)]
pub(crate) struct DirBuilder {
    real: std::fs::DirBuilder,
    is_recursive: bool,
}

impl DirBuilder {
    pub fn new() -> Self {
        Self {
            real: std::fs::DirBuilder::new(),
            is_recursive: false,
        }
    }

    pub fn recursive(&mut self, yes: bool) -> &mut Self {
        self.real.recursive(yes);
        self.is_recursive = yes;
        self
    }

    pub fn create(&self, path: impl AsRef<Path>) -> io::Result<()> {
        let path = path.as_ref();
        let is_recursive = self.is_recursive;
        on(
            path,
            |path| self.real.create(path),
            |disk| disk.make_folder(path, is_recursive),
        )
    }
}

pub(crate) trait DirBuilderExt {
    fn mode(&mut self, mode: u32) -> &mut Self;
}

impl DirBuilderExt for DirBuilder {
    fn mode(&mut self, mode: u32) -> &mut Self {
        unix::DirBuilderExt::mode(&mut self.real, mode);
        self
    }
}

/// An entry of a folder.
#[derive(Debug)]
pub(crate) struct DirEntry(PathBuf);

impl DirEntry {
    pub fn path(&self) -> PathBuf {
        self.0.clone()
    }

    pub fn file_name(&self) -> OsString {
        self.0.file_name().unwrap_or_default().to_owned()
    }
}

pub(crate) type ReadDir = std::vec::IntoIter<io::Result<DirEntry>>;

pub(crate) fn read_dir(path: impl AsRef<Path>) -> io::Result<ReadDir> {
    let path = path.as_ref();
    let real = |path: &Path| {
        let entries = std::fs::read_dir(path)?;
        Ok(entries.map(|entry| Ok(entry?.path())).collect())
    };
    let paths: Vec<io::Result<PathBuf>> = on(path, real, |disk| {
        let names = disk.names(path)?;
        Ok(names.into_iter().map(|name| Ok(path.join(name))).collect())
    })?;
    let entries: Vec<_> = paths.into_iter().map(|path| path.map(DirEntry)).collect();
    Ok(entries.into_iter())
}

pub(crate) fn metadata(path: impl AsRef<Path>) -> io::Result<Metadata> {
    let path = path.as_ref();
    let real = |path: &Path| std::fs::metadata(path).map(Metadata::Real);
    on(path, real, |disk| disk.metadata(path))
}

pub(crate) fn symlink_metadata(path: impl AsRef<Path>) -> io::Result<Metadata> {
    let path = path.as_ref();
    let real = |path: &Path| std::fs::symlink_metadata(path).map(Metadata::Real);
    on(path, real, |disk| disk.metadata(path))
}

pub(crate) fn exists(path: impl AsRef<Path>) -> io::Result<bool> {
    let path = path.as_ref();
    on(
        path,
        |path| std::fs::exists(path),
        |disk| Ok(disk.metadata(path).is_ok()),
    )
}

pub(crate) fn remove_file(path: impl AsRef<Path>) -> io::Result<()> {
    let path = path.as_ref();
    on(path, |path| std::fs::remove_file(path), |disk| disk.remove(path))
}

pub(crate) fn rename(from: impl AsRef<Path>, to: impl AsRef<Path>) -> io::Result<()> {
    let (from, to) = (from.as_ref(), to.as_ref());
    on(
        from,
        |from| std::fs::rename(from, to),
        |disk| disk.rename(from, to),
    )
}

pub(crate) fn copy(from: impl AsRef<Path>, to: impl AsRef<Path>) -> io::Result<u64> {
    let (from, to) = (from.as_ref(), to.as_ref());
    on(from, |from| std::fs::copy(from, to), |disk| disk.copy(from, to))
}

pub(crate) fn set_permissions(path: impl AsRef<Path>, permissions: Permissions) -> io::Result<()> {
    let path = path.as_ref();
    on(
        path,
        |path| std::fs::set_permissions(path, permissions),
        |_| Ok(()),
    )
}

pub(crate) fn access(path: &Path, access: Access) -> rustix::io::Result<()> {
    match Mount::for_path(path) {
        None => rustix::fs::access(path, access),
        Some(_) => Ok(()),
    }
}

pub(crate) fn statvfs(path: &Path) -> rustix::io::Result<StatVfs> {
    let real = || {
        rustix::fs::statvfs(if Mount::for_path(path).is_some() {
            Path::new("/")
        } else {
            path
        })
    };
    let mut said = real()?;
    if let Some(mount) = Mount::for_path(path) {
        said.f_bavail = if mount.is_full() { 0 } else { u64::MAX >> 32 };
        said.f_blocks = u64::MAX >> 32;
        said.f_frsize = 1;
    }
    Ok(said)
}

/// The file in which the database of the store is.
#[derive(Debug)]
pub(crate) enum FileBackend {
    Real(redb::backends::FileBackend),
    Simulated(SimulatedFile),
}

impl FileBackend {
    pub fn new(file: File) -> Result<Self, DatabaseError> {
        match file {
            File::Real(file) => redb::backends::FileBackend::new(file).map(Self::Real),
            File::Simulated(file) => Ok(Self::Simulated(file)),
        }
    }
}

impl StorageBackend for FileBackend {
    fn len(&self) -> io::Result<u64> {
        match self {
            Self::Real(file) => file.len(),
            Self::Simulated(file) => Ok(file.metadata()?.len()),
        }
    }

    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        match self {
            Self::Real(file) => file.read(at, out),
            Self::Simulated(file) => file.read_exact_at(at, out),
        }
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        match self {
            Self::Real(file) => file.set_len(length),
            Self::Simulated(file) => file.set_len(length),
        }
    }

    fn sync_data(&self) -> io::Result<()> {
        match self {
            Self::Real(file) => file.sync_data(),
            Self::Simulated(file) => file.sync(),
        }
    }

    fn write(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Real(file) => file.write(at, bytes),
            Self::Simulated(file) => file.write_at(bytes, at),
        }
    }

    fn close(&self) -> io::Result<()> {
        match self {
            Self::Real(file) => file.close(),
            Self::Simulated(_) => Ok(()),
        }
    }

    fn try_lock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<bool, BackendError> {
        match self {
            Self::Real(file) => file.try_lock_range(start, end),
            Self::Simulated(_) => Err(BackendError::Unsupported),
        }
    }

    fn try_lock_shared_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<bool, BackendError> {
        match self {
            Self::Real(file) => file.try_lock_shared_range(start, end),
            Self::Simulated(_) => Err(BackendError::Unsupported),
        }
    }

    fn lock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<(), BackendError> {
        match self {
            Self::Real(file) => file.lock_range(start, end),
            Self::Simulated(_) => Err(BackendError::Unsupported),
        }
    }

    fn lock_shared_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<(), BackendError> {
        match self {
            Self::Real(file) => file.lock_shared_range(start, end),
            Self::Simulated(_) => Err(BackendError::Unsupported),
        }
    }

    fn unlock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<(), BackendError> {
        match self {
            Self::Real(file) => file.unlock_range(start, end),
            Self::Simulated(_) => Err(BackendError::Unsupported),
        }
    }

    fn query_lock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<bool, BackendError> {
        match self {
            Self::Real(file) => file.query_lock_range(start, end),
            Self::Simulated(_) => Err(BackendError::Unsupported),
        }
    }
}
