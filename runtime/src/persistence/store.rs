//! The embedded store: one file, changed by whole transactions.

use std::fs::OpenOptions;
use std::io;
use std::path::{Path, PathBuf};

use redb::backends::FileBackend;
use redb::{Builder, Database, DatabaseError, ReadableDatabase, ReadableTable, TableDefinition};

use super::image::{Image, Page};
use crate::disk::{Identity, open_regular, tighten};

/// Pages of variables by area (0: P, else the coordinate system of Q) and place.
const VARIABLES: TableDefinition<'_, (u8, u16), &[u8]> = TableDefinition::new("variables");

/// Everything else, as JSON by name.
const VALUES: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("values");

/// Bytes of the store's cache. Reason: all that is kept fits.
const CACHE_BYTES: usize = 4 << 20;

/// An open store. No other process can open it as long as it lives.
#[derive(Debug)]
pub(crate) struct Store {
    database: Database,
    path: PathBuf,
    identity: Identity,
}

impl Store {
    /// Opens or makes the file; what a kill has left half-way is undone.
    ///
    /// # Errors
    /// Another process has it open, it is damaged, or the disk refuses.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = open_regular(
            path,
            OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false),
        )?;
        tighten(path);
        let identity = Identity::of(&file)?;
        let opened = FileBackend::new(file).and_then(|file| {
            let mut builder = Builder::new();
            builder.set_cache_size(CACHE_BYTES).create_with_backend(file)
        });
        let database = opened.map_err(|error| match error {
            DatabaseError::DatabaseAlreadyOpen => io::Error::new(
                io::ErrorKind::ResourceBusy,
                "another runtime runs with this folder; stop it, or set another data_dir",
            ),
            other => io::Error::other(format!("{}: {other}", path.display())),
        })?;
        Ok(Self {
            database,
            path: path.to_owned(),
            identity,
        })
    }

    /// Checks that the file is where it was opened.
    ///
    /// # Errors
    /// It was removed or replaced.
    pub fn check(&self) -> io::Result<()> {
        self.identity.check(&self.path)
    }

    /// Everything that is kept.
    ///
    /// # Errors
    /// The file is damaged, or the disk refuses.
    pub fn load(&self) -> io::Result<Image> {
        let mut image = Image::default();
        // the tables are made here, so that reading finds them
        let writing = self.database.begin_write().map_err(io::Error::other)?;
        writing.open_table(VARIABLES).map_err(io::Error::other)?;
        writing.open_table(VALUES).map_err(io::Error::other)?;
        writing.commit().map_err(io::Error::other)?;
        let reading = self.database.begin_read().map_err(io::Error::other)?;
        let pages = reading.open_table(VARIABLES).map_err(io::Error::other)?;
        for entry in pages.iter().map_err(io::Error::other)? {
            let (key, bytes) = entry.map_err(io::Error::other)?;
            image.pages.insert(key.value(), Page::from_bytes(bytes.value())?);
        }
        let values = reading.open_table(VALUES).map_err(io::Error::other)?;
        for entry in values.iter().map_err(io::Error::other)? {
            let (key, bytes) = entry.map_err(io::Error::other)?;
            image
                .values
                .insert(key.value().to_owned(), bytes.value().to_vec());
        }
        Ok(image)
    }

    /// Writes a change as a whole; it is on disk when this returns.
    ///
    /// # Errors
    /// The disk refuses; nothing of the change counts.
    pub fn commit(&self, change: &Image) -> io::Result<()> {
        self.check()?;
        let writing = self.database.begin_write().map_err(io::Error::other)?;
        {
            let mut pages = writing.open_table(VARIABLES).map_err(io::Error::other)?;
            for (key, page) in &change.pages {
                pages
                    .insert(key, page.to_bytes().as_slice())
                    .map_err(io::Error::other)?;
            }
            let mut values = writing.open_table(VALUES).map_err(io::Error::other)?;
            for (key, bytes) in &change.values {
                values
                    .insert(key.as_str(), bytes.as_slice())
                    .map_err(io::Error::other)?;
            }
        }
        writing.commit().map_err(io::Error::other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(number: u64) -> Image {
        Image {
            pages: [((0, 3), Page([number; 128])), ((2, 0), Page([number + 1; 128]))].into(),
            values: [("tools".to_owned(), number.to_string().into_bytes())].into(),
        }
    }

    #[test]
    fn what_was_committed_is_there_when_it_is_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.redb");
        let store = Store::open(&path).unwrap();
        assert_eq!(store.load().unwrap(), Image::default());
        store.commit(&image(1)).unwrap();
        store.commit(&image(5)).unwrap();
        drop(store);
        assert_eq!(Store::open(&path).unwrap().load().unwrap(), image(5));
    }

    #[test]
    fn a_store_that_is_open_is_not_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.redb");
        let _open = Store::open(&path).unwrap();
        let refused = Store::open(&path).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::ResourceBusy, "{refused}");
    }

    #[test]
    fn a_file_that_is_no_store_is_refused_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.redb");
        let text = "this is not a store ".repeat(500);
        std::fs::write(&path, &text).unwrap();
        assert!(Store::open(&path).is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn the_file_does_not_grow_with_the_number_of_changes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.redb");
        let store = Store::open(&path).unwrap();
        let bytes_after = |changes: u64| {
            for number in 0..changes {
                store.commit(&image(number)).unwrap();
            }
            std::fs::metadata(&path).unwrap().len()
        };
        let first = bytes_after(50);
        assert!(bytes_after(300) <= 2 * first);
    }
}
