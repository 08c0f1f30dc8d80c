//! The folder of each program in lists: one file beside the programs.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use plc_api::types::program::ProgramFolder;

use crate::disk::{fs, write_whole};

/// File in the folder of the programs.
const PLACES_FILE: &str = "folders.json";

/// The folders by program; a program that is not named lies in none.
#[derive(Debug, Default)]
pub(super) struct Places {
    path: Option<PathBuf>,
    by_number: BTreeMap<u16, String>,
}

impl Places {
    /// What is kept beside the programs of this folder. A file that cannot be read is as none: the programs are then in no folder.
    pub fn read(folder: &Path) -> Self {
        let path = folder.join(PLACES_FILE);
        let by_number = match fs::read(&path) {
            Ok(bytes) => read(&bytes).unwrap_or_else(|error| {
                tracing::warn!("{}: {error}; programs are in no folder", path.display());
                BTreeMap::new()
            }),
            Err(_) => BTreeMap::new(),
        };
        Self {
            path: Some(path),
            by_number,
        }
    }

    /// The folder of a program; empty: none.
    pub fn of(&self, number: u16) -> &str {
        self.by_number.get(&number).map_or("", String::as_str)
    }

    /// Puts a program into a folder; empty: into none. On disk when it returns.
    ///
    /// # Errors
    /// The disk refuses; it is where it was then.
    pub fn put(&mut self, number: u16, folder: &str) -> io::Result<()> {
        if self.of(number) == folder {
            return Ok(());
        }
        let mut changed = self.by_number.clone();
        if folder.is_empty() {
            changed.remove(&number);
        } else {
            changed.insert(number, folder.to_owned());
        }
        if let Some(path) = &self.path {
            write_whole(path, &serde_json::to_vec_pretty(&changed)?)?;
        }
        self.by_number = changed;
        Ok(())
    }
}

fn read(bytes: &[u8]) -> io::Result<BTreeMap<u16, String>> {
    let named: BTreeMap<u16, String> = serde_json::from_slice(bytes)?;
    let checked = named.into_iter().map(|(number, folder)| {
        let folder = ProgramFolder { folder }.checked().map_err(io::Error::other)?;
        Ok((number, folder.folder))
    });
    checked.collect()
}
