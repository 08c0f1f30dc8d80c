//! The folder in which lists show each program, stored in one file next to the programs.
//!
//! The file contains one sealed line and a copy: if one of them is damaged, the other is read.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use plc_protocol::types::program::ProgramFolder;
use serde::Deserialize as _;
use serde_json::json;

use crate::disk::{
    DiskPath, Generations, Seal, SealedFileKind, StoredPart, Unusable, read_regular, read_sealed, seal,
    write_whole,
};

/// Name of the file in the folder of the programs.
pub const PLACES_FILE: &str = "folders.json";

/// Maximum size of the file, bytes. Reason: 2000 programs, each with a folder name of 120 characters of four
/// bytes, and the copy.
const BYTES_MAX: u64 = 4 << 20;

/// Folder of each program; a program without an entry is not in a folder.
pub type FolderByProgram = BTreeMap<u16, String>;

/// Content of the file.
#[derive(Debug, Default)]
pub struct FolderAssignmentsRead {
    /// Folder of each program that is in a folder.
    pub by_number: FolderByProgram,
    /// Seal of the line; `None` if the file does not exist or cannot be used.
    pub seal: Option<Seal>,
    /// Reason why the file cannot be used.
    pub fault: Option<String>,
}

impl FolderAssignmentsRead {
    /// Reads the file from the folder of programs.
    pub fn read(folder: &DiskPath) -> Self {
        let mut read = Self::default();
        let bytes = match read_regular(&folder.join(PLACES_FILE), BYTES_MAX) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return read,
            Err(error) => {
                read.fault = Some(format!("the file cannot be read: {error}"));
                return read;
            }
        };
        read.fault = Some("the file is damaged".to_owned());
        let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        for line in lines {
            match read_sealed(SealedFileKind::Folders, line) {
                Ok((line, seal)) => match by_number(&line["folders"]) {
                    Ok(by_number) => {
                        return Self {
                            by_number,
                            seal: Some(seal),
                            fault: None,
                        };
                    }
                    Err(error) => read.fault = Some(error.to_string()),
                },
                Err(Unusable::Foreign(how)) => read.fault = Some(how),
                Err(Unusable::Damaged) => {}
            }
        }
        read
    }
}

/// Folder of each program, and the file in which the folders are stored.
#[derive(Debug, Default)]
pub(super) struct FolderAssignments {
    path: Option<DiskPath>,
    generations: Arc<Generations>,
    by_number: FolderByProgram,
}

impl FolderAssignments {
    /// Reads the file from the folder of programs. With `holds_back`, or if the file cannot be used, no
    /// program is in a folder. Also returns the reason why the file cannot be used.
    pub fn open(
        folder: &DiskPath,
        generations: &Arc<Generations>,
        holds_back: bool,
    ) -> (Self, Option<String>) {
        let read = FolderAssignmentsRead::read(folder);
        let mut places = Self {
            path: Some(folder.join(PLACES_FILE)),
            generations: Arc::clone(generations),
            by_number: FolderByProgram::new(),
        };
        if !holds_back {
            places.by_number = read.by_number;
        }
        // The file is written again, so later starts do not find the same fault.
        if (holds_back || read.fault.is_some())
            && let Err(error) = places.write(&places.by_number)
        {
            tracing::warn!("{}: {error}", folder.join(PLACES_FILE).display());
        }
        (places, read.fault)
    }

    /// Returns the folder of a program; empty if the program is not in a folder.
    pub fn folder_of(&self, number: u16) -> &str {
        self.by_number.get(&number).map_or("", String::as_str)
    }

    /// Puts a program into a folder; an empty name removes it from its folder. The change is on disk when
    /// this function returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the program then stays in its previous folder.
    pub fn put(&mut self, number: u16, folder: &str) -> io::Result<()> {
        if self.folder_of(number) == folder {
            return Ok(());
        }
        let mut changed = self.by_number.clone();
        if folder.is_empty() {
            changed.remove(&number);
        } else {
            changed.insert(number, folder.to_owned());
        }
        self.write(&changed)?;
        self.by_number = changed;
        Ok(())
    }

    fn write(&self, by_number: &FolderByProgram) -> io::Result<()> {
        let Some(path) = &self.path else { return Ok(()) };
        let generation = self.generations.next();
        let mut line = json!({"n": 1, "folders": by_number});
        self.generations
            .seal(SealedFileKind::Folders, generation)
            .put(&mut line);
        let line = seal(&line.to_string());
        // The line is written twice: if one copy is damaged, the other remains.
        write_whole(path, format!("{line}\n").repeat(2).as_bytes())?;
        self.generations.note_on_disk(StoredPart::Folders, generation);
        Ok(())
    }
}

fn by_number(folders: &serde_json::Value) -> io::Result<FolderByProgram> {
    let named = FolderByProgram::deserialize(folders)?;
    let checked = named.into_iter().map(|(number, folder)| {
        let folder = ProgramFolder { folder }.checked().map_err(io::Error::other)?;
        Ok((number, folder.folder))
    });
    checked.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_flipped_bit_of_the_folders_changes_none_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let (mut places, fault) = FolderAssignments::open(&folder.path().into(), &Arc::default(), false);
        assert_eq!(fault, None);
        places.put(1, "moulds/gen2").unwrap();
        places.put(7, "ä").unwrap();
        let path = folder.path().join(PLACES_FILE);
        let bytes = std::fs::read(&path).unwrap();
        for place in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[place / 8] ^= 1 << (place % 8);
            std::fs::write(&path, flipped).unwrap();
            let read = FolderAssignmentsRead::read(&folder.path().into());
            assert_eq!((read.by_number, read.fault), (places.by_number.clone(), None));
        }
    }

    #[test]
    fn a_file_of_folders_that_cannot_be_used_is_named_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(PLACES_FILE);
        std::fs::write(&path, "{\"1\": \"gen2\"}").unwrap();
        let (places, fault) = FolderAssignments::open(&folder.path().into(), &Arc::default(), false);
        assert!(fault.is_some());
        assert_eq!(places.folder_of(1), "");
        assert_eq!(
            FolderAssignments::open(&folder.path().into(), &Arc::default(), false).1,
            None
        );
    }
}
