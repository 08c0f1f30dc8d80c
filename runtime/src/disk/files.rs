//! Files and folders of the runtime. Other users cannot read them, and the runtime never writes through a
//! link. Opening never blocks, even if the path leads to a FIFO or a device.

use std::io::{self, BufWriter, Read, Write};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use super::fs::{
    self, DirBuilder, DirBuilderExt as _, File, MetadataExt as _, OpenOptions, OpenOptionsExt as _,
    Permissions, TryLockError,
};

/// Mode of files that the runtime writes: only the user of the runtime has access.
const FILE_MODE: u32 = 0o600;

/// Mode of folders that the runtime creates: only the user of the runtime has access.
const FOLDER_MODE: u32 = 0o700;

/// Suffix of a file that is being written; the next start removes such files left by a kill.
pub(crate) const UNFINISHED: &str = ".new";

/// Creates a folder and its missing parents. Their names are on disk when this function returns.
///
/// # Errors
/// Returns an error if the operating system rejects the operation.
pub(crate) fn make_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(path)?;
    // Also syncs folders that already exist: a start that was killed may have created them without a sync.
    for made in path.ancestors().filter(|made| made.file_name().is_some()) {
        // The sync may fail, because the runtime may not be allowed to open a folder of another user.
        let _ = sync_folder(folder_of(made));
    }
    Ok(())
}

/// Creates a folder in an existing folder. The name of the new folder is on disk when this function returns.
///
/// # Errors
/// Returns an error if the parent is missing, or the operating system rejects the operation.
pub(crate) fn make_folder_in(path: &Path) -> io::Result<()> {
    match DirBuilder::new().mode(FOLDER_MODE).create(path) {
        // An earlier start may have created the folder and ended before the sync.
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
        _ => sync_folder(folder_of(path)),
    }
}

/// Revokes the rights of other users to a file or folder. A file or folder of another user stays unchanged.
pub(crate) fn tighten(path: &Path) {
    let Ok(metadata) = fs::symlink_metadata(path) else {
        return;
    };
    let mode = if metadata.is_dir() { FOLDER_MODE } else { FILE_MODE };
    if !metadata.is_symlink()
        && metadata.mode() & 0o077 != 0
        && let Err(error) = fs::set_permissions(path, Permissions::from_mode(mode))
    {
        tracing::warn!("other users can read {}: {error}", path.display());
    }
}

/// Opens a regular file, also through a link. Never blocks, even if the path leads to a FIFO or a device.
///
/// # Errors
/// Returns an error if the file does not exist or is not a regular file.
pub(crate) fn open_regular(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    let flags = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
    let file = options.mode(FILE_MODE).custom_flags(flags).open(path)?;
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
pub(crate) fn read_regular(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let file = open_regular(path, OpenOptions::new().read(true))?;
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
pub(crate) struct UnfinishedFile {
    file: File,
    /// Temporary path; `None` after the file has received its final name.
    path: Option<PathBuf>,
}

impl UnfinishedFile {
    /// Writes a file next to `path`; the file is on disk when this function returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the temporary file is then removed.
    pub fn write(path: &Path, bytes: &[u8]) -> io::Result<Self> {
        Self::write_by(path, |out| out.write_all(bytes))
    }

    /// Writes the output of `write` to a file next to `path`, piece by piece.
    fn write_by(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let mut number = 0;
        let mut unfinished = loop {
            let own = folder_of(path).join(format!("{name}.{number}{UNFINISHED}"));
            let options = &mut OpenOptions::new();
            // Always creates a new file, so a file or link that another user has created there is not written
            // to.
            match open_regular(&own, options.write(true).create_new(true)) {
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

    /// Returns the open file.
    pub fn as_file(&self) -> &File {
        &self.file
    }

    /// Renames the file to its final name; if a link has that name, the file replaces the link.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn finish(mut self, path: &Path) -> io::Result<()> {
        if let Some(own) = &self.path {
            fs::rename(own, path)?;
        }
        self.path = None;
        sync_folder(folder_of(path))
    }
}

impl Drop for UnfinishedFile {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // If the file cannot be removed now, the next start removes it.
            let _ = fs::remove_file(path);
        }
    }
}

/// Replaces a file as a whole: after a kill the path leads to the old or the new file.
///
/// # Errors
/// Returns an error if the disk operation fails; the old file then remains.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    UnfinishedFile::write(path, bytes)?.finish(path)
}

/// Replaces a file as a whole with the output of `write`, piece by piece.
///
/// # Errors
/// Returns an error as [`write_whole`] does.
pub(crate) fn write_whole_by(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    UnfinishedFile::write_by(path, write)?.finish(path)
}

/// Syncs a folder, so the names in it are on disk when this function returns.
///
/// # Errors
/// Returns an error if the disk operation fails.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().unwrap_or(Path::new("."));
    if folder.as_os_str().is_empty() {
        return Path::new(".");
    }
    folder
}

/// Lock of a folder that only one process uses. Dropping this value or ending the process releases the lock.
#[derive(Debug)]
pub(crate) struct Lock {
    /// Lock file; it holds the lock while it is open.
    _file: File,
}

impl Lock {
    /// Locks a folder. Returns `None` if the lock file cannot be opened or the file system does not support
    /// locks.
    ///
    /// # Errors
    /// Returns an error if another process has locked the folder.
    pub fn acquire(folder: &Path) -> io::Result<Option<Self>> {
        let options = &mut OpenOptions::new();
        let opened = open_regular(&folder.join("lock"), options.write(true).create(true));
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
pub(crate) fn in_use() -> io::Error {
    io::Error::new(
        io::ErrorKind::ResourceBusy,
        "another runtime uses this folder; stop that runtime, or set another data_dir",
    )
}

/// Identifies a file or folder independently of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Identity(u64, u64);

impl Identity {
    /// Returns the identity of the file or folder at a path.
    ///
    /// # Errors
    /// Returns an error if the path does not exist.
    pub fn at(path: &Path) -> io::Result<Self> {
        let metadata = fs::metadata(path)?;
        Ok(Self(metadata.dev(), metadata.ino()))
    }

    /// Returns the identity of an open file.
    ///
    /// # Errors
    /// Returns an error if the operating system rejects the operation.
    pub fn from_file(file: &File) -> io::Result<Self> {
        let metadata = file.metadata()?;
        Ok(Self(metadata.dev(), metadata.ino()))
    }

    /// Checks that the file or folder is still at this path.
    ///
    /// # Errors
    /// Returns an error if the file or folder was removed or replaced.
    pub fn check(self, path: &Path) -> io::Result<()> {
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
    use super::*;

    #[test]
    fn a_file_is_written_whole_for_its_user_only_and_never_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("other"));
        fs::write(&other, "theirs").unwrap();
        std::os::unix::fs::symlink(&other, &path).unwrap();
        write_whole(&path, b"ours").unwrap();
        assert_eq!(fs::read_to_string(&other).unwrap(), "theirs");
        assert_eq!(fs::read_to_string(&path).unwrap(), "ours");
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, FILE_MODE);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_is_not_finished_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        drop(UnfinishedFile::write(&folder.path().join("a"), b"half").unwrap());
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
            assert!(read_regular(&path(name), 10).is_err(), "{name}");
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
            tighten(path);
        }
        let mode = |path: &Path| fs::metadata(path).unwrap().mode() & 0o777;
        assert_eq!((mode(&sub), mode(&file)), (FOLDER_MODE, FILE_MODE));
    }

    #[test]
    fn a_folder_that_is_made_is_there_after_a_power_cut() {
        use crate::disk::simulated::ROOT;
        use crate::disk::simulated::memory::{Disk, Mount};

        let disk = Disk::new(7, std::time::SystemTime::UNIX_EPOCH);
        let disk = std::sync::Arc::new(parking_lot::Mutex::new(disk));
        Mount::mount(&disk);
        let folder = Path::new(ROOT).join("data/of/a/machine");
        // Creates the folders as a start that is killed afterwards.
        let made = DirBuilder::new().recursive(true).create(&folder);
        made.unwrap();
        disk.lock().kill();
        Mount::mount(&disk);
        make_folder(&folder).unwrap();
        make_folder_in(&folder.join("programs")).unwrap();
        write_whole(&folder.join("programs/a"), b"kept").unwrap();
        disk.lock().cut_power();
        Mount::mount(&disk);
        assert_eq!(read_regular(&folder.join("programs/a"), 10).unwrap(), b"kept");
        Mount::unmount();
    }
}
