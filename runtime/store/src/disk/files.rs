//! Files and folders of the runtime. Other users cannot read them, and the runtime never writes through a
//! link. Opening never blocks, even if the path leads to a FIFO or a device.

use std::fs::TryLockError;
use std::io::{self, BufWriter, Read as _, Write};

use super::file_system::{DiskFile, FILE_MODE, FOLDER_MODE, FileKind, FileMetadata, OpenMode};
use super::path::DiskPath;

/// Suffix of a file that is being written; the next start removes such files left by a kill.
pub const UNFINISHED: &str = ".new";

/// Creates a folder and its missing parents. Their names are on disk when this function returns.
///
/// # Errors
/// Returns an error if the operating system rejects the operation.
pub fn make_folder(path: &DiskPath) -> io::Result<()> {
    path.files().create_folder(path.as_path(), true)?;
    // Also syncs folders that already exist: a start that was killed may have created them without a sync.
    let made = path.as_path().ancestors();
    for made in made.filter(|made| made.file_name().is_some()) {
        // The sync may fail, because the runtime may not be allowed to open a folder of another user.
        let _ = sync_folder(&path.at(made.to_owned()).parent());
    }
    Ok(())
}

/// Creates a folder in an existing folder. The name of the new folder is on disk when this function returns.
///
/// # Errors
/// Returns an error if the parent is missing, or the operating system rejects the operation.
pub fn make_folder_in(path: &DiskPath) -> io::Result<()> {
    match path.files().create_folder(path.as_path(), false) {
        // An earlier start may have created the folder and ended before the sync.
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
        _ => sync_folder(&path.parent()),
    }
}

/// Revokes the rights of other users to a file or folder. A file or folder of another user stays unchanged.
pub fn tighten(path: &DiskPath) {
    let Ok(metadata) = path.link_metadata() else {
        return;
    };
    let mode = if metadata.is_folder() {
        FOLDER_MODE
    } else {
        FILE_MODE
    };
    if metadata.kind != FileKind::Link
        && metadata.mode & 0o077 != 0
        && let Err(error) = path.files().set_mode(path.as_path(), mode)
    {
        tracing::warn!("other users can read {}: {error}", path.display());
    }
}

/// Opens a regular file, also through a link. Never blocks, even if the path leads to a FIFO or a device.
///
/// # Errors
/// Returns an error if the file does not exist or is not a regular file.
pub fn open_regular(path: &DiskPath, mode: OpenMode) -> io::Result<Box<dyn DiskFile>> {
    let file = path.files().open(path.as_path(), mode)?;
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    Err(io::Error::new(
        io::ErrorKind::InvalidInput,
        "it is not a regular file",
    ))
}

/// Reads at most `most` bytes of a regular file.
///
/// # Errors
/// Returns an error as [`open_regular`] does, or if the file is longer than `most`.
pub fn read_regular(path: &DiskPath, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let file = open_regular(path, OpenMode::Read)?;
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let text = format!("the file has more than {most} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

/// Maximum number of temporary names tried for a file; each start removes the temporary files of earlier
/// starts.
const UNFINISHED_MAX: u32 = 10_000;

/// Maximum bytes that one write operation adds to a file.
const PIECE_BYTES: usize = 64 << 10;

/// A file that is being written under a temporary name. If it is dropped before [`UnfinishedFile::finish`],
/// it is removed.
#[derive(Debug)]
pub struct UnfinishedFile {
    file: Box<dyn DiskFile>,
    /// Temporary path; `None` after the file has received its final name.
    path: Option<DiskPath>,
}

impl UnfinishedFile {
    /// Writes a file next to `path`; the file is on disk when this function returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the temporary file is then removed.
    pub fn write(path: &DiskPath, bytes: &[u8]) -> io::Result<Self> {
        Self::write_by(path, |out| out.write_all(bytes))
    }

    /// Writes the output of `write` to a file next to `path`, piece by piece.
    fn write_by(path: &DiskPath, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<Self> {
        let name = path.name();
        let mut number = 0;
        let mut unfinished = loop {
            let own = path.parent().join(format!("{name}.{number}{UNFINISHED}"));
            // Always creates a new file, so a file or link that another user has created there is not written
            // to.
            match open_regular(&own, OpenMode::CreateNew) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists && number < UNFINISHED_MAX => {
                    number += 1;
                }
                opened => {
                    break Self {
                        file: opened?,
                        path: Some(own),
                    };
                }
            }
        };
        let mut out = BufWriter::with_capacity(PIECE_BYTES, &mut unfinished.file);
        write(&mut out)?;
        out.flush()?;
        drop(out);
        unfinished.file.sync_all()?;
        Ok(unfinished)
    }

    /// Returns the properties of the file.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn metadata(&self) -> io::Result<FileMetadata> {
        self.file.metadata()
    }

    /// Renames the file to its final name; if a link has that name, the file replaces the link.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn finish(mut self, path: &DiskPath) -> io::Result<()> {
        if let Some(own) = &self.path {
            own.rename(path)?;
        }
        self.path = None;
        sync_folder(&path.parent())
    }
}

impl Drop for UnfinishedFile {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // If the file cannot be removed now, the next start removes it.
            let _ = path.remove_file();
        }
    }
}

/// Replaces a file as a whole: after a kill the path leads to the old or the new file.
///
/// # Errors
/// Returns an error if the disk operation fails; the old file then remains.
pub fn write_whole(path: &DiskPath, bytes: &[u8]) -> io::Result<()> {
    UnfinishedFile::write(path, bytes)?.finish(path)
}

/// Replaces a file as a whole with the output of `write`, piece by piece.
///
/// # Errors
/// Returns an error as [`write_whole`] does.
pub fn write_whole_by(
    path: &DiskPath,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    UnfinishedFile::write_by(path, write)?.finish(path)
}

/// Syncs a folder, so the names in it are on disk when this function returns.
///
/// # Errors
/// Returns an error if the disk operation fails.
pub fn sync_folder(folder: &DiskPath) -> io::Result<()> {
    folder.files().sync_folder(folder.as_path())
}

/// Lock of a folder that only one process uses. Dropping this value or ending the process releases the lock.
#[derive(Debug)]
pub struct Lock {
    /// Lock file; it holds the lock while it is open.
    _file: Box<dyn DiskFile>,
}

impl Lock {
    /// Locks a folder. Returns `None` if the lock file cannot be opened or the file system does not support
    /// locks.
    ///
    /// # Errors
    /// Returns an error if another process has locked the folder.
    pub fn acquire(folder: &DiskPath) -> io::Result<Option<Self>> {
        let opened = open_regular(&folder.join("lock"), OpenMode::ReadWrite);
        let Ok(file) = opened else { return Ok(None) };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(in_use()),
            // Some file systems do not support locks.
            Err(TryLockError::Error(_)) => Ok(None),
            Ok(()) => Ok(Some(Self { _file: file })),
        }
    }
}

/// Creates the error for a folder that another process uses.
pub fn in_use() -> io::Error {
    io::Error::new(
        io::ErrorKind::ResourceBusy,
        "another runtime uses this folder; stop that runtime, or set another data_dir",
    )
}

/// Identifies a file or folder independently of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Identity(u64, u64);

impl Identity {
    /// Returns the identity of the file or folder at a path.
    ///
    /// # Errors
    /// Returns an error if the path does not exist.
    pub fn at(path: &DiskPath) -> io::Result<Self> {
        let (device, number) = path.metadata()?.identity;
        Ok(Self(device, number))
    }

    /// Returns the identity of an open file.
    ///
    /// # Errors
    /// Returns an error if the operating system rejects the operation.
    pub fn from_file(file: &dyn DiskFile) -> io::Result<Self> {
        let (device, number) = file.metadata()?.identity;
        Ok(Self(device, number))
    }

    /// Checks that the file or folder is still at this path.
    ///
    /// # Errors
    /// Returns an error if the file or folder was removed or replaced.
    pub fn check(self, path: &DiskPath) -> io::Result<()> {
        match Self::at(path) {
            Ok(now) if now == self => Ok(()),
            Ok(_) => Err(io::Error::other("it was replaced while the runtime was using it")),
            Err(error) => Err(io::Error::new(
                error.kind(),
                format!("it does not exist any more ({error})"),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt as _;
    use std::path::Path;

    use super::*;

    #[test]
    fn a_file_is_written_whole_for_its_user_only_and_never_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("other"));
        fs::write(&other, "theirs").unwrap();
        std::os::unix::fs::symlink(&other, &path).unwrap();
        write_whole(&path.as_path().into(), b"ours").unwrap();
        assert_eq!(fs::read_to_string(&other).unwrap(), "theirs");
        assert_eq!(fs::read_to_string(&path).unwrap(), "ours");
        assert_eq!(
            fs::metadata(&path).unwrap().permissions().mode() & 0o777,
            FILE_MODE
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_is_not_finished_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        drop(UnfinishedFile::write(&folder.path().join("a").into(), b"half").unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn folder_fifo_socket_and_dead_link_fail_without_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name| folder.path().join(name);
        fs::create_dir(path("folder")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(path("fifo")).status();
        assert!(made.unwrap().success());
        std::os::unix::fs::symlink(path("nothing"), path("dead")).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(path("socket")).unwrap();
        for name in ["folder", "fifo", "dead", "socket", "nothing"] {
            assert!(read_regular(&path(name).into(), 10).is_err(), "{name}");
        }
    }

    #[test]
    fn rights_of_others_are_taken_away() {
        let folder = tempfile::tempdir().unwrap();
        let (sub, file) = (folder.path().join("sub"), folder.path().join("file"));
        fs::create_dir(&sub).unwrap();
        fs::write(&file, "").unwrap();
        for (path, mode) in [(&sub, 0o755), (&file, 0o644)] {
            fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
            tighten(&path.as_path().into());
        }
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&sub), mode(&file)), (FOLDER_MODE, FILE_MODE));
    }
}
