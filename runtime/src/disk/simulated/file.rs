//! An open file on a disk in memory.

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

use super::memory::{FileChange, Mount};
use super::{Metadata, OpenOptions};

/// An open file on a disk in memory.
#[derive(Debug)]
pub(crate) struct SimulatedFile {
    mount: Mount,
    ino: u64,
    at: u64,
    is_appending: bool,
}

impl SimulatedFile {
    pub(super) fn open(mount: Mount, path: &Path, options: &OpenOptions) -> io::Result<Self> {
        Ok(Self {
            ino: mount.open(path, options)?,
            mount,
            at: 0,
            is_appending: options.append,
        })
    }

    pub(super) fn metadata(&self) -> io::Result<Metadata> {
        self.mount.with(|disk| disk.metadata_of(self.ino))
    }

    pub(super) fn sync(&self) -> io::Result<()> {
        self.mount.with(|disk| disk.sync(self.ino))
    }

    pub(super) fn set_len(&self, length: u64) -> io::Result<()> {
        self.mount
            .with(|disk| disk.alter(self.ino, FileChange::SetLen(length)))
    }

    pub(super) fn write_at(&self, bytes: &[u8], at: u64) -> io::Result<()> {
        self.mount.with(|disk| {
            if disk.faults.forgets_ahead && bytes.starts_with(b"{\"n\"") {
                return Ok(());
            }
            disk.alter(self.ino, FileChange::Write(at, bytes.to_vec()))
        })
    }

    pub(super) fn read_exact_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        self.mount.with(|disk| {
            let at = usize::try_from(at).unwrap();
            let bytes = disk.file(self.ino)?.now.get(at..at + out.len());
            out.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
            Ok(())
        })
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
            self.metadata()?.len()
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
            SeekFrom::End(by) => self.metadata()?.len().saturating_add_signed(by),
            SeekFrom::Current(by) => self.at.saturating_add_signed(by),
        };
        Ok(self.at)
    }
}
