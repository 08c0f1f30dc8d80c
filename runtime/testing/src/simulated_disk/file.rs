//! An open file on a disk in memory.

use std::fs::TryLockError;
use std::io::{self, Read, Seek, SeekFrom, Write};

use redb::{Builder, Database, DatabaseError, StorageBackend};
use tandem_store::disk::{DiskFile, FileMetadata, OpenMode};

use super::memory::FileChange;

use super::Mount;

/// An open file on a disk in memory.
#[derive(Debug)]
pub(super) struct SimulatedFile {
    mount: Mount,
    ino: u64,
    at: u64,
    is_appending: bool,
}

impl SimulatedFile {
    pub fn new(mount: Mount, ino: u64, mode: OpenMode) -> Self {
        Self {
            mount,
            ino,
            at: 0,
            is_appending: matches!(mode, OpenMode::Append | OpenMode::ReadAppend),
        }
    }
}

impl DiskFile for SimulatedFile {
    fn metadata(&self) -> io::Result<FileMetadata> {
        self.mount.with(|disk| disk.metadata_of(self.ino))
    }

    fn write_all_at(&self, bytes: &[u8], at: u64) -> io::Result<()> {
        self.mount.with(|disk| {
            if disk.faults.forgets_ahead && bytes.starts_with(b"{\"n\"") {
                return Ok(());
            }
            disk.alter(self.ino, FileChange::Write(at, bytes.to_vec()))
        })
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        self.mount
            .with(|disk| disk.alter(self.ino, FileChange::SetLen(length)))
    }

    fn sync_all(&self) -> io::Result<()> {
        self.mount.with(|disk| disk.sync(self.ino))
    }

    fn sync_data(&self) -> io::Result<()> {
        self.sync_all()
    }

    fn try_lock(&self) -> Result<(), TryLockError> {
        Ok(())
    }

    fn create_database(self: Box<Self>, builder: &Builder) -> Result<Database, DatabaseError> {
        builder.create_with_backend(*self)
    }
}

impl StorageBackend for SimulatedFile {
    fn len(&self) -> io::Result<u64> {
        Ok(self.metadata()?.length)
    }

    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        self.mount.with(|disk| {
            let at = usize::try_from(at).unwrap();
            let bytes = disk.file(self.ino)?.now.get(at..at + out.len());
            out.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
            Ok(())
        })
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        DiskFile::set_len(self, length)
    }

    fn sync_data(&self) -> io::Result<()> {
        self.sync_all()
    }

    fn write(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.write_all_at(bytes, at)
    }
}

impl Read for SimulatedFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let at = usize::try_from(self.at).unwrap();
        let read = self.mount.with(|disk| {
            let rest = disk.file(self.ino)?.now.get(at..).unwrap_or_default();
            let count = rest.len().min(buffer.len());
            buffer[..count].copy_from_slice(&rest[..count]);
            Ok(count)
        })?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Write for SimulatedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let at = if self.is_appending {
            self.metadata()?.length
        } else {
            self.at
        };
        self.mount
            .with(|disk| disk.alter(self.ino, FileChange::Write(at, bytes.to_vec())))?;
        self.at = at + bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for SimulatedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::End(by) => self.metadata()?.length.saturating_add_signed(by),
            SeekFrom::Current(by) => self.at.saturating_add_signed(by),
        };
        Ok(self.at)
    }
}
