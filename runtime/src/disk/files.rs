//! Files and folders that the runtime keeps: nobody else may read them, none is written through a link, and what is no
//! regular file is never waited for.

use std::io::{self, BufWriter, Read, Write};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use super::fs::{
    self, DirBuilder, DirBuilderExt as _, File, MetadataExt as _, OpenOptions, OpenOptionsExt as _,
    Permissions, TryLockError,
};

/// Mode of what the runtime writes: its user only.
const FILE_MODE: u32 = 0o600;

/// Mode of its folders.
const FOLDER_MODE: u32 = 0o700;

/// End of the name of a file that is being written; what a kill leaves of it is removed at the next start.
pub(crate) const UNFINISHED: &str = ".new";

/// Makes a folder, and those above it. Their names are on disk when this returns.
///
/// # Errors
/// The operating system refuses.
pub(crate) fn make_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(path)?;
    // also of those that were there: a start that was killed may have made them
    for made in path.ancestors().filter(|made| made.file_name().is_some()) {
        // a folder of somebody else may not be open to us
        let _ = sync_folder(folder_of(made));
    }
    Ok(())
}

/// Makes a folder in one that is there. Its name is on disk when this returns.
///
/// # Errors
/// The one above it is missing, or the operating system refuses.
pub(crate) fn make_folder_in(path: &Path) -> io::Result<()> {
    match DirBuilder::new().mode(FOLDER_MODE).create(path) {
        // one that is there may have been made by a start that ended here
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
        _ => sync_folder(folder_of(path)),
    }
}

/// Takes the rights of others to a file or folder away. One that belongs to somebody else stays as it is.
pub(crate) fn tighten(path: &Path) {
    let Ok(metadata) = fs::symlink_metadata(path) else {
        return;
    };
    let mode = if metadata.is_dir() { FOLDER_MODE } else { FILE_MODE };
    if !metadata.is_symlink()
        && metadata.mode() & 0o077 != 0
        && let Err(error) = fs::set_permissions(path, Permissions::from_mode(mode))
    {
        tracing::warn!("{} can be read by others: {error}", path.display());
    }
}

/// Opens a regular file, also through a link. A FIFO or a device is not waited for.
///
/// # Errors
/// There is none, or what is there is no regular file.
pub(crate) fn open_regular(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    let flags = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
    let file = options.mode(FILE_MODE).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    Err(io::Error::new(
        io::ErrorKind::InvalidInput,
        "it is no regular file",
    ))
}

/// At most `most` bytes of a regular file.
///
/// # Errors
/// As those of [`open_regular`], or it has more.
pub(crate) fn read_regular(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let file = open_regular(path, OpenOptions::new().read(true))?;
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let text = format!("it has more than {most} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

/// Names that are tried for a file that is being written; a start removes what earlier ones have left.
const UNFINISHED_MAX: u32 = 10_000;

/// Bytes of a file that are written at once.
const PIECE_BYTES: usize = 64 << 10;

/// A file that is being written under a name of its own; dropped before [`Unfinished::finish`], it is removed.
#[derive(Debug)]
pub(crate) struct Unfinished {
    file: File,
    /// `None` once it has its name.
    path: Option<PathBuf>,
}

impl Unfinished {
    /// Writes a file beside `path`; it is on disk when this returns.
    ///
    /// # Errors
    /// The disk refuses; nothing is left then.
    pub fn write(path: &Path, bytes: &[u8]) -> io::Result<Self> {
        Self::write_by(path, |out| out.write_all(bytes))
    }

    /// The same with what `write` writes, piece by piece.
    fn write_by(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let mut number = 0;
        let mut unfinished = loop {
            let own = folder_of(path).join(format!("{name}.{number}{UNFINISHED}"));
            let options = &mut OpenOptions::new();
            // made anew: what somebody has put there, such as a link, is not written to
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

    /// The file, open.
    pub fn as_file(&self) -> &File {
        &self.file
    }

    /// Gives it its name; a link of that name is replaced.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn finish(mut self, path: &Path) -> io::Result<()> {
        if let Some(own) = &self.path {
            fs::rename(own, path)?;
        }
        self.path = None;
        sync_folder(folder_of(path))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // what cannot be removed is removed at the next start
            let _ = fs::remove_file(path);
        }
    }
}

/// Writes a file as a whole: before or after a kill it is the old one or the new one.
///
/// # Errors
/// The disk refuses; the old one is there then.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    Unfinished::write(path, bytes)?.finish(path)
}

/// The same with what `write` writes, piece by piece.
///
/// # Errors
/// As those of [`write_whole`].
pub(crate) fn write_whole_by(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    Unfinished::write_by(path, write)?.finish(path)
}

/// Brings the names in a folder to disk.
///
/// # Errors
/// The disk refuses.
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

/// A folder that one process works with. It is free again when this is dropped, or the process ends.
#[derive(Debug)]
pub(crate) struct Lock {
    /// It holds the lock as long as it is open.
    _file: File,
}

impl Lock {
    /// Takes a folder; `None` where the disk takes no file.
    ///
    /// # Errors
    /// Another process has it.
    pub fn take(folder: &Path) -> io::Result<Option<Self>> {
        let options = &mut OpenOptions::new();
        let opened = open_regular(&folder.join("lock"), options.write(true).create(true));
        let Ok(file) = opened else { return Ok(None) };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(in_use()),
            // not every file system knows locks
            Err(TryLockError::Error(_)) => Ok(None),
            Ok(()) => Ok(Some(Self { _file: file })),
        }
    }
}

/// The refusal of a folder that another process works with.
pub(crate) fn in_use() -> io::Error {
    io::Error::new(
        io::ErrorKind::ResourceBusy,
        "another runtime runs with this folder; stop it, or set another data_dir",
    )
}

/// Which file or folder a path leads to, whatever its name is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Identity(u64, u64);

impl Identity {
    /// What is at a path now.
    ///
    /// # Errors
    /// Nothing is.
    pub fn at(path: &Path) -> io::Result<Self> {
        let metadata = fs::metadata(path)?;
        Ok(Self(metadata.dev(), metadata.ino()))
    }

    /// That of an open file.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn of(file: &File) -> io::Result<Self> {
        let metadata = file.metadata()?;
        Ok(Self(metadata.dev(), metadata.ino()))
    }

    /// Checks that it is still at its path.
    ///
    /// # Errors
    /// It was removed or replaced.
    pub fn check(self, path: &Path) -> io::Result<()> {
        match Self::at(path) {
            Ok(now) if now == self => Ok(()),
            Ok(_) => Err(io::Error::other("it was replaced while the runtime had it open")),
            Err(error) => Err(io::Error::new(error.kind(), format!("it is gone ({error})"))),
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
        drop(Unfinished::write(&folder.path().join("a"), b"half").unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_a_fifo_and_a_dead_link_are_no_regular_files_and_nobody_waits_for_them() {
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
        // a start that is killed after it has made them
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
