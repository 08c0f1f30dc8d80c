//! Inspects the stored values and decides which are trusted. The inspection does not change anything on disk.
//!
//! Each value in the store has a checksum, and the structure of the store has its own checksums. The separate
//! checksum file records the number of the last change and the checksum of each value. Three cases:
//! - The structure is intact and not older than the checksum file: all values are trusted. If the checksum
//!   file cannot be used, an intact structure is still trusted, and reported as not verified.
//! - The structure is damaged or older: a value is trusted if its checksum matches the recorded one, at any
//!   offset in the file, because it is then the last value written. All other values are lost.
//! - The structure is damaged and no checksums are recorded: the last value cannot be distinguished from an
//!   older one, so all values are lost.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};

use redb::{Builder, Database, ReadableDatabase, ReadableTable, StorageBackend, TableError};

use super::generation::{GENERATION_FILE, Generation};
use super::image::{Image, PRODUCTION_KEY, RUN_KEYS, RUN_LINES_KEY};
use super::record::{self, CACHE_BYTES, CHANGE, RECORDS, SEAL};
use crate::disk::{Checksums, DiskPath, Seal, SealedFileKind, read_regular};

/// Name of the store in the data folder, and of its checksum file.
pub const STORE_FILE: &str = "state.redb";
pub(super) const SUMS_FILE: &str = "state.sums";

/// Name of a file that exists if the machine has been started before.
pub const STARTED_FILE: &str = "started";

/// Maximum size of a store, bytes. Reason: a hundred times the size of all values.
const STORE_BYTES_MAX: u64 = 256 << 20;

/// Condition of the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StoreCondition {
    /// Nothing was ever stored in this folder.
    New,
    /// The store is unchanged since it was written.
    Whole,
    /// The store is damaged; contains the description.
    Damaged(String),
}

/// The result of inspecting a data folder.
#[derive(Debug, Clone)]
pub struct InspectedStore {
    /// Condition of the store file.
    pub condition: StoreCondition,
    /// Trusted values; the image also marks the lost values.
    pub image: Image,
    /// Names of the values lost because of the damage that this inspection found.
    pub lost: BTreeSet<String>,
    /// True if the names of the stored values are unknown; every possible value is then treated as lost.
    pub is_all_lost: bool,
    /// Number of the last change in the store or in the checksum file, whichever is higher.
    pub last: u64,
    /// Reason why the checksum file cannot be used.
    pub sums_fault: Option<String>,
    /// Seal of the newest record in the store.
    pub store_seal: Option<Seal>,
    /// Seal of the newest line of the checksum file.
    pub sums_seal: Option<Seal>,
}

/// Inspects the store of a folder.
pub fn inspect_store(folder: &DiskPath) -> InspectedStore {
    inspect_expected_store(folder, false)
}

/// Inspects the store of a folder. `is_known`: other files show that this folder must contain a store.
pub fn inspect_expected_store(folder: &DiskPath, is_known: bool) -> InspectedStore {
    let bytes = read_regular(&folder.join(STORE_FILE), STORE_BYTES_MAX);
    let content = (bytes.as_ref().ok())
        .filter(|bytes| !bytes.is_empty())
        .map(|bytes| read_database(bytes));
    let of_store = content.as_ref().and_then(|content| content.as_ref().ok());
    let of_store = of_store.and_then(|content| content.seal.as_ref());
    let sums = discard_foreign_checksums(
        Checksums::read(&folder.join(SUMS_FILE), SealedFileKind::StoreSums),
        of_store,
    );
    let was_started = is_known
        || [STARTED_FILE, GENERATION_FILE]
            .iter()
            .any(|name| folder.join(name).exists().unwrap_or(false));
    // These names only add lost values, so a last good generation of another machine or age makes no value trusted.
    let named = || {
        Generation::read_sealed(&folder.join(GENERATION_FILE), SealedFileKind::LastGood)
            .map(|generation| generation.image.names())
            .unwrap_or_default()
    };
    let mut inspected = match (bytes, content) {
        (Err(error), _) if error.kind() == io::ErrorKind::NotFound => {
            inspect_missing_store("the store is missing", &sums, was_started)
        }
        (Err(error), _) => damaged(&error.to_string(), &[], &sums),
        (Ok(_), None) => inspect_missing_store("the store is empty", &sums, was_started),
        (Ok(bytes), Some(Err(how))) => damaged(&how, &bytes, &sums),
        (Ok(bytes), Some(Ok(content))) => InspectedStore {
            store_seal: content.seal.clone(),
            ..inspect_content(content, &bytes, &sums, was_started)
        },
    };
    if matches!(inspected.condition, StoreCondition::Damaged(_)) && (!sums.is_there || sums.is_damaged) {
        // values may have been stored since the last good generation
        let is_all_lost = inspected.is_all_lost;
        inspected.lose(named());
        inspected.is_all_lost = is_all_lost;
    }
    if inspected.condition == StoreCondition::Whole {
        // A kill after the store and before its checksums are written leaves one change without recorded
        // checksums.
        let is_older = inspected.last > sums.last + 1;
        inspected.sums_fault = sums
            .fault()
            .or_else(|| is_older.then(|| "the file is older than the store".to_owned()));
    }
    inspected.last = inspected.last.max(sums.last);
    inspected.sums_seal = sums.seal.filter(|_| !sums.is_damaged);
    inspected
}

impl InspectedStore {
    /// Returns the generation of the newest change in the store; 0 if the generation is unknown.
    pub fn generation(&self) -> u64 {
        self.store_seal.as_ref().map_or(0, |seal| seal.generation)
    }

    /// Returns the seal that dates the trusted values; `None` if no seal exists.
    pub fn seal(&self) -> Option<&Seal> {
        match self.condition {
            // In a damaged store, only values with recorded checksums are trusted.
            StoreCondition::Damaged(_) => self.sums_seal.as_ref().or(self.store_seal.as_ref()),
            _ => self.store_seal.as_ref(),
        }
    }

    /// Marks further values as lost: all except the history of runs and the counters, because an error in
    /// them could remain unnoticed.
    pub fn hold_back(&mut self, how: String) {
        let statistics = |name: &String| {
            name.starts_with(RUN_KEYS)
                || name.starts_with("open_run/")
                || [PRODUCTION_KEY, RUN_LINES_KEY].contains(&name.as_str())
        };
        let mut names = self.image.names();
        names.retain(|name| !statistics(name));
        for name in names {
            self.image.lose(&name);
            self.lost.insert(name);
        }
        self.condition = StoreCondition::Damaged(how);
        self.sums_fault = None;
    }

    /// Marks those of the named values as lost that the image does not contain; they may have been stored.
    pub fn lose(&mut self, names: impl IntoIterator<Item = String>) {
        for name in names {
            if !self.image.has(&name) {
                self.image.lose(&name);
                self.lost.insert(name);
                self.is_all_lost = false;
            }
        }
    }
}

fn trusted_store(condition: StoreCondition, image: Image, last: u64) -> InspectedStore {
    InspectedStore {
        condition,
        image,
        lost: BTreeSet::new(),
        is_all_lost: false,
        last,
        sums_fault: None,
        store_seal: None,
        sums_seal: None,
    }
}

fn inspect_missing_store(how: &str, sums: &Checksums, was_started: bool) -> InspectedStore {
    if sums.is_there || sums.is_damaged || was_started {
        return damaged(how, &[], sums);
    }
    trusted_store(StoreCondition::New, Image::default(), 0)
}

/// Discards the checksums if they belong to another machine than an intact store does.
fn discard_foreign_checksums(sums: Checksums, of_store: Option<&Seal>) -> Checksums {
    match (&sums.seal, of_store) {
        (Some(of_sums), Some(of_store)) if of_sums.machine != of_store.machine => Checksums {
            is_there: true,
            is_damaged: true,
            foreign: Some(format!("the file belongs to machine {}", of_sums.machine)),
            ..Checksums::default()
        },
        _ => sums,
    }
}

fn inspect_content(
    content: DatabaseContent,
    bytes: &[u8],
    sums: &Checksums,
    was_started: bool,
) -> InspectedStore {
    let is_missing = |name: &&String| !content.image.has(name);
    // The first change creates the store. If the first start was cut short before the checksums were written,
    // nothing was stored.
    if content.last <= 1 && !sums.is_there && !was_started {
        return trusted_store(StoreCondition::New, Image::default(), 0);
    }
    if content.last == 0 || content.last < sums.last {
        let how = format!(
            "the last change in the store is number {}, but the checksums name change {} as the last",
            content.last, sums.last
        );
        return damaged(&how, bytes, sums);
    }
    if let Some(name) = sums.by_name.keys().find(is_missing) {
        return damaged(&format!("{name} is missing"), bytes, sums);
    }
    if !content.is_clean {
        let how = "the structure was damaged".to_owned();
        return trusted_store(StoreCondition::Damaged(how), content.image, content.last);
    }
    trusted_store(StoreCondition::Whole, content.image, content.last)
}

/// Returns the values of a damaged store that are still trusted.
fn damaged(how: &str, bytes: &[u8], sums: &Checksums) -> InspectedStore {
    let mut found: BTreeMap<&str, Vec<&[u8]>> = BTreeMap::new();
    for (name, payload) in record::scan(bytes) {
        found.entry(name).or_default().push(payload);
    }
    let change = |payload: &&[u8]| std::str::from_utf8(payload).ok()?.parse::<u64>().ok();
    let changes = found.remove(CHANGE).unwrap_or_default();
    found.remove(SEAL);
    let last = changes.iter().filter_map(change).max().unwrap_or(0);
    // Checksums are recorded after each change, so at most the last change has no recorded checksums.
    let is_noted = sums.is_there && last <= sums.last + 1;
    let names: BTreeSet<&str> = found
        .keys()
        .copied()
        .chain(sums.by_name.keys().map(String::as_str))
        .collect();
    let mut inspected = trusted_store(StoreCondition::Damaged(how.to_owned()), Image::default(), last);
    inspected.is_all_lost = names.is_empty();
    for name in names {
        let noted = sums.by_name.get(name);
        if sums.is_there && !sums.is_damaged && noted.is_none() {
            // The value was removed from the store, or its change was never acknowledged.
            continue;
        }
        let noted = noted.and_then(Option::as_deref).filter(|_| is_noted);
        let candidates = found.get(name).into_iter().flatten();
        let vouched = noted.and_then(|sum| {
            candidates
                .copied()
                .find(|payload| record::record_checksum_hex(name, payload) == sum)
        });
        if !vouched.is_some_and(|payload| inspected.image.take_record(name, payload)) {
            inspected.image.lose(name);
            inspected.lost.insert(name.to_owned());
        }
    }
    inspected
}

/// Content of the database.
#[derive(Debug, Default)]
struct DatabaseContent {
    image: Image,
    last: u64,
    seal: Option<Seal>,
    /// The structure needed no repair, except the repair after a kill.
    is_clean: bool,
}

/// Reads a copy of the database in memory, so the library cannot repair the file before the inspection.
fn read_database(bytes: &[u8]) -> Result<DatabaseContent, String> {
    // The checks of the library detect nearly all damage. Damage that they do not detect may cause a panic; a
    // panic is treated as damage.
    let read = catch_unwind(AssertUnwindSafe(|| {
        let memory = Memory::from_bytes(bytes).map_err(|error| error.to_string())?;
        let mut builder = Builder::new();
        let opened = builder.set_cache_size(CACHE_BYTES).create_with_backend(memory);
        let mut database = opened.map_err(|error| error.to_string())?;
        let is_clean = database.check_integrity().map_err(|error| error.to_string())?;
        let content = read_tables(&database)?;
        Ok(DatabaseContent { is_clean, ..content })
    }));
    read.unwrap_or_else(|_| Err("the structure is inconsistent".to_owned()))
}

fn read_tables(database: &Database) -> Result<DatabaseContent, String> {
    let text = |error: &dyn std::error::Error| error.to_string();
    let reading = database.begin_read().map_err(|error| text(&error))?;
    let mut content = DatabaseContent::default();
    let records = match reading.open_table(RECORDS) {
        Ok(records) => records,
        Err(TableError::TableDoesNotExist(_)) => {
            return Err("the file has no records, so no runtime wrote it".to_owned());
        }
        Err(error) => return Err(text(&error)),
    };
    for entry in records.iter().map_err(|error| text(&error))? {
        let (name, bytes) = entry.map_err(|error| text(&error))?;
        let name = name.value();
        let payload = record::read(name, bytes.value()).ok_or_else(|| format!("{name} is damaged"))?;
        if name == CHANGE {
            let last = std::str::from_utf8(payload)
                .ok()
                .and_then(|text| text.parse().ok());
            content.last = last.ok_or("the last change has no number")?;
        } else if name == SEAL {
            let seal: Seal = serde_json::from_slice(payload).map_err(|error| text(&error))?;
            if seal.kind != SealedFileKind::Store {
                return Err("the seal is of another kind".to_owned());
            }
            content.seal = Some(seal);
        } else if !content.image.take_record(name, payload) {
            return Err(format!("{name} has an unknown format"));
        }
    }
    Ok(content)
}

/// A file in memory with bounded size: a damaged structure may request any size.
#[derive(Debug)]
struct Memory(redb::backends::InMemoryBackend);

impl Memory {
    fn from_bytes(bytes: &[u8]) -> io::Result<Self> {
        let memory = redb::backends::InMemoryBackend::new();
        memory.set_len(bytes.len() as u64)?;
        memory.write(0, bytes)?;
        Ok(Self(memory))
    }
}

impl StorageBackend for Memory {
    fn len(&self) -> Result<u64, io::Error> {
        self.0.len()
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> Result<(), io::Error> {
        self.0.read(offset, out)
    }

    fn set_len(&self, len: u64) -> Result<(), io::Error> {
        if len > STORE_BYTES_MAX {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        self.0.set_len(len)
    }

    fn sync_data(&self) -> Result<(), io::Error> {
        self.0.sync_data()
    }

    fn write(&self, offset: u64, data: &[u8]) -> Result<(), io::Error> {
        self.0.write(offset, data)
    }
}
