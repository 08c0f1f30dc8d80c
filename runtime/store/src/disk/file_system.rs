//! The operations on files and folders that the runtime needs for its stored data, as traits, and their
//! implementation by the operating system.

use std::fmt::Debug;
use std::fs::{File, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use redb::backends::FileBackend;
use redb::{Builder, Database, DatabaseError};
use rustix::fs::{Access, StatVfsMountFlags};

/// Mode of files that the runtime creates: only the user of the runtime has access.
pub const FILE_MODE: u32 = 0o600;

/// Mode of folders that the runtime creates: only the user of the runtime has access.
pub const FOLDER_MODE: u32 = 0o700;

/// How a file is opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OpenMode {
    /// Reads an existing file.
    Read,
    /// Appends to an existing file.
    Append,
    /// Reads a file and appends to it; creates a missing file.
    ReadAppend,
    /// Reads and writes a file at any offset; creates a missing file.
    ReadWrite,
    /// Writes a new file; an existing file or link is an error.
    CreateNew,
}

/// Kind of the object at a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A regular file.
    File,
    /// A folder.
    Folder,
    /// A symbolic link.
    Link,
    /// A FIFO, a socket or a device.
    Special,
}

/// Properties of a file or folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileMetadata {
    /// Kind of the object.
    pub kind: FileKind,
    /// Length in bytes.
    pub length: u64,
    /// Access rights, as bits of the operating system.
    pub mode: u32,
    /// Time of the last modification: seconds since 1970, and nanoseconds after that second.
    pub modified: (i64, u32),
    /// Numbers of the device and of the object on the device. They identify the object independently of its name.
    pub identity: (u64, u64),
}

impl FileMetadata {
    /// Returns true for a regular file.
    pub fn is_file(&self) -> bool {
        self.kind == FileKind::File
    }

    /// Returns true for a folder.
    pub fn is_folder(&self) -> bool {
        self.kind == FileKind::Folder
    }

    /// Returns the time of the last modification.
    pub fn modified_at(&self) -> SystemTime {
        let (seconds, ns) = self.modified;
        let whole = Duration::from_secs(seconds.unsigned_abs());
        let second = if seconds < 0 {
            SystemTime::UNIX_EPOCH - whole
        } else {
            SystemTime::UNIX_EPOCH + whole
        };
        second + Duration::from_nanos(u64::from(ns))
    }
}

/// Free space of a disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DiskSpace {
    /// True if the disk accepts no changes.
    pub is_read_only: bool,
    /// Free bytes; `None` if the disk has no fixed size.
    pub free_bytes: Option<u64>,
}

/// An open file.
pub trait DiskFile: Debug + Read + Write + Seek + Send + Sync {
    /// Returns the properties of the file.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    fn metadata(&self) -> io::Result<FileMetadata>;

    /// Writes bytes at an offset.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; a part of the bytes may have been written.
    fn write_all_at(&self, bytes: &[u8], at: u64) -> io::Result<()>;

    /// Cuts the file to a length in bytes, or extends it with zeros.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    fn set_len(&self, length: u64) -> io::Result<()>;

    /// Waits until the content and the properties are on disk.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    fn sync_all(&self) -> io::Result<()>;

    /// Waits until the content is on disk.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    fn sync_data(&self) -> io::Result<()>;

    /// Locks the file until it is closed. Does not wait.
    ///
    /// # Errors
    /// Returns an error if another process has locked the file, or if the disk has no locks.
    fn try_lock(&self) -> Result<(), TryLockError>;

    /// Opens the database in this file; an empty file becomes an empty database. While the database is open, no
    /// other process can open it.
    ///
    /// # Errors
    /// Returns an error if the file contains no intact database, or if another process has it open.
    fn create_database(self: Box<Self>, builder: &Builder) -> Result<Database, DatabaseError>;
}

/// Files and folders by their paths.
pub trait FileSystem: Debug + Send + Sync {
    /// Opens a file, also through a link. Never waits, even if the path leads to a FIFO or a device.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn open(&self, path: &Path, mode: OpenMode) -> io::Result<Box<dyn DiskFile>>;

    /// Returns the properties of the object to which a path leads; follows links.
    ///
    /// # Errors
    /// Returns an error if the path leads to nothing, or if the operation fails.
    fn metadata(&self, path: &Path) -> io::Result<FileMetadata>;

    /// Returns the properties of the object at a path; does not follow links.
    ///
    /// # Errors
    /// Returns an error if nothing is at the path, or if the operation fails.
    fn link_metadata(&self, path: &Path) -> io::Result<FileMetadata>;

    /// Returns the paths of all entries of a folder, in any order.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn list_folder(&self, path: &Path) -> io::Result<Vec<PathBuf>>;

    /// Creates a folder. With `has_parents`, also creates missing parents, and accepts an existing folder.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn create_folder(&self, path: &Path, has_parents: bool) -> io::Result<()>;

    /// Waits until the names in a folder are on disk.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn sync_folder(&self, path: &Path) -> io::Result<()>;

    /// Renames a file or folder; replaces a file that has the new name.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Copies the content of a file.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn copy(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file or link.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn remove_file(&self, path: &Path) -> io::Result<()>;

    /// Sets the access rights of a file or folder.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn set_mode(&self, path: &Path, mode: u32) -> io::Result<()>;

    /// Checks that the runtime may create files in a folder.
    ///
    /// # Errors
    /// Returns an error if the runtime may not.
    fn check_writable(&self, path: &Path) -> io::Result<()>;

    /// Returns the free space of the disk on which a path is.
    ///
    /// # Errors
    /// Returns an error if the operation fails.
    fn space(&self, path: &Path) -> io::Result<DiskSpace>;
}

/// The file system of the operating system.
#[derive(Debug, Clone, Copy)]
pub(super) struct OsFileSystem;

impl From<&std::fs::Metadata> for FileMetadata {
    fn from(metadata: &std::fs::Metadata) -> Self {
        let file_type = metadata.file_type();
        let kind = if file_type.is_dir() {
            FileKind::Folder
        } else if file_type.is_symlink() {
            FileKind::Link
        } else if file_type.is_file() {
            FileKind::File
        } else {
            FileKind::Special
        };
        Self {
            kind,
            length: metadata.len(),
            mode: metadata.mode(),
            // The operating system gives 0 to 999,999,999 ns.
            modified: (
                metadata.mtime(),
                u32::try_from(metadata.mtime_nsec()).unwrap_or(0),
            ),
            identity: (metadata.dev(), metadata.ino()),
        }
    }
}

impl DiskFile for File {
    fn metadata(&self) -> io::Result<FileMetadata> {
        Ok(FileMetadata::from(&File::metadata(self)?))
    }

    fn write_all_at(&self, bytes: &[u8], at: u64) -> io::Result<()> {
        std::os::unix::fs::FileExt::write_all_at(self, bytes, at)
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        File::set_len(self, length)
    }

    fn sync_all(&self) -> io::Result<()> {
        File::sync_all(self)
    }

    fn sync_data(&self) -> io::Result<()> {
        File::sync_data(self)
    }

    fn try_lock(&self) -> Result<(), TryLockError> {
        File::try_lock(self)
    }

    fn create_database(self: Box<Self>, builder: &Builder) -> Result<Database, DatabaseError> {
        builder.create_with_backend(FileBackend::new(*self)?)
    }
}

impl FileSystem for OsFileSystem {
    fn open(&self, path: &Path, mode: OpenMode) -> io::Result<Box<dyn DiskFile>> {
        let mut options = std::fs::OpenOptions::new();
        match mode {
            OpenMode::Read => options.read(true),
            OpenMode::Append => options.append(true),
            OpenMode::ReadAppend => options.create(true).read(true).append(true),
            OpenMode::ReadWrite => options.create(true).read(true).write(true).truncate(false),
            OpenMode::CreateNew => options.create_new(true).write(true),
        };
        let flags = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
        let file = options.mode(FILE_MODE).custom_flags(flags).open(path)?;
        Ok(Box::new(file))
    }

    fn metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        Ok(FileMetadata::from(&std::fs::metadata(path)?))
    }

    fn link_metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        Ok(FileMetadata::from(&std::fs::symlink_metadata(path)?))
    }

    fn list_folder(&self, path: &Path) -> io::Result<Vec<PathBuf>> {
        std::fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect()
    }

    fn create_folder(&self, path: &Path, has_parents: bool) -> io::Result<()> {
        let mut builder = std::fs::DirBuilder::new();
        builder.recursive(has_parents).mode(FOLDER_MODE).create(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        std::fs::rename(from, to)
    }

    fn copy(&self, from: &Path, to: &Path) -> io::Result<()> {
        std::fs::copy(from, to).map(drop)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        std::fs::remove_file(path)
    }

    fn set_mode(&self, path: &Path, mode: u32) -> io::Result<()> {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))
    }

    fn check_writable(&self, path: &Path) -> io::Result<()> {
        Ok(rustix::fs::access(path, Access::WRITE_OK | Access::EXEC_OK)?)
    }

    fn space(&self, path: &Path) -> io::Result<DiskSpace> {
        let disk = rustix::fs::statvfs(path)?;
        let free_bytes = disk.f_bavail.saturating_mul(disk.f_frsize);
        Ok(DiskSpace {
            is_read_only: disk.f_flag.contains(StatVfsMountFlags::RDONLY),
            free_bytes: (disk.f_blocks > 0).then_some(free_bytes),
        })
    }
}
