//! The embedded store: one file, changed only by whole transactions, and a separate checksum file.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use redb::{Builder, Database, DatabaseError};

use super::image::Image;
use super::inspected_store::{InspectedStore, STORE_FILE, SUMS_FILE, StoreCondition};
use super::record::{self, CACHE_BYTES, CHANGE, RECORDS, SEAL};
use crate::disk::{
    ChecksumChange, ChecksumFile, DiskPath, FileMetadata, Generations, Identity, OpenMode, SealedFileKind,
    Sealer, StoredPart, UNFINISHED, in_use, open_regular, sync_folder, tighten,
};

/// Maximum number of damaged stores kept as evidence; the oldest are removed.
const EVIDENCE_MAX: usize = 8;

/// An open store. While it is open, no other process can open the file.
#[derive(Debug)]
pub struct Store {
    database: Database,
    path: DiskPath,
    identity: Identity,
    sums: ChecksumFile,
    /// Number of the last change.
    last: u64,
    generations: Arc<Generations>,
}

/// Number of a change, and the seal for its record.
struct ChangeRecord<'a> {
    number: u64,
    generation: u64,
    generations: &'a Generations,
}

impl<'a> ChangeRecord<'a> {
    fn new(number: u64, generations: &'a Generations) -> Self {
        Self {
            number,
            generation: generations.next(),
            generations,
        }
    }

    fn records(&self) -> io::Result<[(String, Vec<u8>); 2]> {
        let seal = self.generations.seal(SealedFileKind::Store, self.generation);
        Ok([
            (CHANGE.to_owned(), self.number.to_string().into_bytes()),
            (SEAL.to_owned(), serde_json::to_vec(&seal)?),
        ])
    }
}

impl Store {
    /// Opens the store of a folder that was inspected (result in `inspected`). A new store gets its final
    /// name only when it is complete, so a kill during its creation leaves no store. A damaged store is moved
    /// aside, and a new store with the trusted values replaces it. Also returns the path of the damaged
    /// store.
    ///
    /// # Errors
    /// Returns an error if another process has the store open, or the disk operation fails. In both cases no
    /// further value is lost.
    pub fn open(
        folder: &DiskPath,
        inspected: &InspectedStore,
        generations: &Arc<Generations>,
    ) -> io::Result<(Self, Option<DiskPath>)> {
        let path = folder.join(STORE_FILE);
        let mut last = inspected.last;
        if inspected.condition != StoreCondition::Whole {
            last += 1;
        }
        let change = || ChangeRecord::new(last, generations);
        let mut aside = None;
        match inspected.condition {
            StoreCondition::Damaged(_) => aside = Some(replace(folder, &path, &inspected.image, &change())?),
            StoreCondition::New => {
                unfinished(folder, &inspected.image, &change())?.rename(&path)?;
                sync_folder(folder)?;
            }
            StoreCondition::Whole => {}
        }
        let database = open_database(&path)?;
        let identity = Identity::at(&path)?;
        let sealer = Sealer {
            kind: SealedFileKind::StoreSums,
            part: StoredPart::Store,
            generations: Arc::clone(generations),
        };
        // The generation of the last change is used again, because the data on disk have not changed since.
        let (sums_path, generation) = (folder.join(SUMS_FILE), inspected.generation());
        let sums = ChecksumFile::create_at(
            &sums_path,
            sealer,
            last,
            generation,
            record_checksums(&inspected.image),
        )?;
        let mut store = Self {
            database,
            path,
            identity,
            sums,
            last,
            generations: Arc::clone(generations),
        };
        // From here on the store and the checksum file have the same number.
        store.commit(&Image::default())?;
        Ok((store, aside))
    }

    /// Checks that the path still leads to the file that was opened.
    ///
    /// # Errors
    /// Returns an error if the file was removed or replaced.
    pub fn check(&self) -> io::Result<()> {
        self.identity.check(&self.path)?;
        self.sums.check()
    }

    /// Returns the number of the last change.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Writes a change as one transaction; the change is on disk when this function returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the change then has no effect, now and after a restart.
    pub fn commit(&mut self, change: &Image) -> io::Result<()> {
        self.check()?;
        let (number, generations) = (self.last + 1, Arc::clone(&self.generations));
        let of_change = ChangeRecord::new(number, &generations);
        let before = write_all(&self.database, change, &of_change)?;
        let sums: ChecksumChange = record_checksums(change)
            .into_iter()
            .map(|(name, sum)| (name, Some(sum)))
            .collect();
        if let Err(error) = self.sums.add_at(number, of_change.generation, sums) {
            // The change is undone before the failure is reported. If the process is killed in between, the
            // outcome is unknown.
            put_back(&self.database, &before).map_err(|also| {
                let text = format!("{error}; and the written data could not be undone: {also}");
                io::Error::new(error.kind(), text)
            })?;
            return Err(error);
        }
        self.last = number;
        debug_assert!(
            self.has_checksums_of(change),
            "change {number} has records without a checksum"
        );
        Ok(())
    }

    /// Returns true if the checksum file contains the checksum of each record of an image.
    fn has_checksums_of(&self, image: &Image) -> bool {
        let mut checksums = record_checksums(image).into_iter();
        checksums.all(|(name, checksum)| self.sums.get(&name) == Some(&*checksum))
    }
}

/// Content of records before a change, by name; `None` for a record that did not exist.
type PreviousRecords = Vec<(String, Option<Vec<u8>>)>;

/// Returns the checksum of each record of an image.
fn record_checksums(image: &Image) -> BTreeMap<String, String> {
    let records = image.records();
    records
        .map(|(name, payload)| {
            let sum = record::record_checksum_hex(&name, &payload);
            (name, sum)
        })
        .collect()
}

/// Writes an image as one change. Returns the previous content of each written name, or `None` for a new
/// name.
fn write_all(
    database: &Database,
    image: &Image,
    of_change: &ChangeRecord<'_>,
) -> io::Result<PreviousRecords> {
    let mut before = PreviousRecords::new();
    let writing = database.begin_write().map_err(io::Error::other)?;
    {
        let mut records = writing.open_table(RECORDS).map_err(io::Error::other)?;
        for (name, payload) in image.records().chain(of_change.records()?) {
            let bytes = record::write(&name, &payload);
            let old = records
                .insert(name.as_str(), bytes.as_slice())
                .map_err(io::Error::other)?
                .map(|old| old.value().to_vec());
            before.push((name, old));
        }
    }
    writing.commit().map_err(io::Error::other)?;
    Ok(before)
}

/// Restores the records to their content before a change.
fn put_back(database: &Database, before: &PreviousRecords) -> io::Result<()> {
    let writing = database.begin_write().map_err(io::Error::other)?;
    {
        let mut records = writing.open_table(RECORDS).map_err(io::Error::other)?;
        for (name, old) in before {
            let put = match old {
                Some(old) => records.insert(name.as_str(), old.as_slice()),
                None => records.remove(name.as_str()),
            };
            drop(put.map_err(io::Error::other)?);
        }
    }
    writing.commit().map_err(io::Error::other)
}

fn open_database(path: &DiskPath) -> io::Result<Database> {
    let file = open_regular(path, OpenMode::ReadWrite)?;
    tighten(path);
    let opened = file.create_database(Builder::new().set_cache_size(CACHE_BYTES));
    opened.map_err(|error| match error {
        DatabaseError::DatabaseAlreadyOpen => in_use(),
        other => io::Error::other(format!("{}: {other}", path.display())),
    })
}

/// Creates a store with the values of an image under a temporary name.
fn unfinished(folder: &DiskPath, image: &Image, of_change: &ChangeRecord<'_>) -> io::Result<DiskPath> {
    let new = folder.join(format!("{STORE_FILE}{UNFINISHED}"));
    match new.remove_file() {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    write_all(&open_database(&new)?, image, of_change)?;
    Ok(new)
}

/// Replaces a damaged store by a new one with the trusted values, and keeps the damaged store as evidence.
fn replace(
    folder: &DiskPath,
    path: &DiskPath,
    image: &Image,
    of_change: &ChangeRecord<'_>,
) -> io::Result<DiskPath> {
    let new = unfinished(folder, image, of_change)?;
    let aside = evidence(folder);
    let found = path.link_metadata();
    if found.as_ref().is_ok_and(FileMetadata::is_file) {
        path.copy(&aside)?;
        tighten(&aside);
        open_regular(&aside, OpenMode::Read)?.sync_all()?;
    } else if found.is_ok() {
        // The path is a folder, a link or a FIFO, not a regular file.
        path.rename(&aside)?;
    }
    new.rename(path)?;
    sync_folder(folder)?;
    remove_old_evidence(folder);
    Ok(aside)
}

/// Returns an unused path to which a damaged store is moved as evidence.
fn evidence(folder: &DiskPath) -> DiskPath {
    let named = |number: u32| folder.join(format!("{STORE_FILE}.damaged-{number}"));
    let number = (1..u32::MAX).find(|number| !named(*number).exists().unwrap_or(true));
    named(number.unwrap_or(u32::MAX))
}

/// Removes the oldest evidence above [`EVIDENCE_MAX`]; files that cannot be removed stay.
fn remove_old_evidence(folder: &DiskPath) {
    let prefix = format!("{STORE_FILE}.damaged-");
    let number = |path: DiskPath| -> Option<(u32, DiskPath)> {
        let number = path.name().strip_prefix(&prefix)?.parse().ok()?;
        Some((number, path))
    };
    let entries = folder.list_folder().unwrap_or_default().into_iter();
    let mut all: Vec<_> = entries.filter_map(number).collect();
    all.sort_by_key(|(number, _)| *number);
    let surplus = all.len().saturating_sub(EVIDENCE_MAX);
    for (_, path) in &all[..surplus] {
        let _ = path.remove_file();
    }
}

#[cfg(test)]
mod tests;
