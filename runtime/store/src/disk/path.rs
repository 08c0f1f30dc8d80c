//! A disk, and the paths on it.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::file_system::{DiskSpace, FileMetadata, FileSystem, OsFileSystem};

/// The disk with the stored data of a machine. A clone refers to the same disk. The default is the file system of the
/// operating system.
#[derive(Debug, Clone)]
pub struct Disk(Arc<dyn FileSystem>);

impl Default for Disk {
    fn default() -> Self {
        Self::new(OsFileSystem)
    }
}

impl Disk {
    /// Creates a disk from an implementation of its operations.
    pub fn new(files: impl FileSystem + 'static) -> Self {
        Self(Arc::new(files))
    }

    /// Returns a path on this disk.
    pub fn at(&self, path: impl Into<PathBuf>) -> DiskPath {
        DiskPath {
            disk: self.clone(),
            path: path.into(),
        }
    }
}

/// A path to a file or folder on a disk.
#[derive(Clone, Default)]
pub struct DiskPath {
    disk: Disk,
    path: PathBuf,
}

/// Shows only the path, because the disk is of no interest in a message.
impl fmt::Debug for DiskPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.fmt(f)
    }
}

/// Creates a path on the disk of the operating system.
impl From<PathBuf> for DiskPath {
    fn from(path: PathBuf) -> Self {
        Disk::default().at(path)
    }
}

/// Creates a path on the disk of the operating system.
impl From<&Path> for DiskPath {
    fn from(path: &Path) -> Self {
        Disk::default().at(path)
    }
}

impl DiskPath {
    /// Returns the path without its disk.
    pub fn as_path(&self) -> &Path {
        &self.path
    }

    /// Returns the path as text for a message.
    pub fn display(&self) -> std::path::Display<'_> {
        self.path.display()
    }

    /// Returns the path of an entry of this folder.
    #[must_use]
    pub fn join(&self, name: impl AsRef<Path>) -> Self {
        self.at(self.path.join(name))
    }

    /// Returns another path on this disk.
    pub(crate) fn at(&self, path: PathBuf) -> Self {
        let disk = self.disk.clone();
        Self { disk, path }
    }

    /// Returns the last part of the path; characters that are not UTF-8 are replaced.
    pub fn name(&self) -> String {
        let name = self.path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// Returns the folder that contains this file or folder.
    pub(crate) fn parent(&self) -> Self {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let is_relative_name = folder.as_os_str().is_empty();
        self.at(if is_relative_name { Path::new(".") } else { folder }.to_owned())
    }

    /// Returns the file system of the disk.
    pub fn files(&self) -> &dyn FileSystem {
        &*self.disk.0
    }

    /// Returns the properties of the object to which the path leads; follows links.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn metadata(&self) -> io::Result<FileMetadata> {
        self.files().metadata(&self.path)
    }

    /// Returns the properties of the object at the path; does not follow links.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn link_metadata(&self) -> io::Result<FileMetadata> {
        self.files().link_metadata(&self.path)
    }

    /// Returns true if the path leads to a file or folder.
    ///
    /// # Errors
    /// Returns an error if this is unknown.
    pub fn exists(&self) -> io::Result<bool> {
        match self.metadata() {
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Returns the entries of this folder, in any order.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn list_folder(&self) -> io::Result<Vec<Self>> {
        let paths = self.files().list_folder(&self.path)?;
        Ok(paths.into_iter().map(|path| self.at(path)).collect())
    }

    /// Renames this file or folder to a path on the same disk.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn rename(&self, to: &Self) -> io::Result<()> {
        self.files().rename(&self.path, &to.path)
    }

    /// Copies this file to a path on the same disk.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn copy(&self, to: &Self) -> io::Result<()> {
        self.files().copy(&self.path, &to.path)
    }

    /// Removes this file or link.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn remove_file(&self) -> io::Result<()> {
        self.files().remove_file(&self.path)
    }

    /// Checks that the runtime may create files in this folder.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn check_writable(&self) -> io::Result<()> {
        self.files().check_writable(&self.path)
    }

    /// Returns the free space of the disk.
    ///
    /// # Errors
    /// Returns an error if the operation of the file system fails.
    pub fn space(&self) -> io::Result<DiskSpace> {
        self.files().space(&self.path)
    }
}
