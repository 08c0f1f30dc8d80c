//! The embedded store: one file, changed by whole transactions, and a separate checksum file.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use redb::{Builder, Database, DatabaseError};

use super::image::Image;
use super::judge::{Condition, Judged, STORE_FILE, SUMS_FILE};
use super::record::{self, CACHE_BYTES, CHANGE, OLD_VALUES, OLD_VARIABLES, RECORDS, SEAL};
use crate::disk::fs::{self, FileBackend, OpenOptions};
use crate::disk::{
    Generations, Identity, Kind, Sealer, StoredPart, SumChange, SumFile, UNFINISHED, in_use, open_regular,
    sync_folder, tighten,
};

/// Maximum number of damaged stores kept as evidence; the oldest are removed.
const EVIDENCE_MAX: usize = 8;

/// An open store. No other process can open it in the meantime.
#[derive(Debug)]
pub(crate) struct Store {
    database: Database,
    path: PathBuf,
    identity: Identity,
    sums: SumFile,
    /// Number of the last change.
    last: u64,
    generations: Arc<Generations>,
}

/// Number of a change, and the seal of its record.
struct Change<'a> {
    number: u64,
    generation: u64,
    generations: &'a Generations,
}

impl<'a> Change<'a> {
    fn new(number: u64, generations: &'a Generations) -> Self {
        Self {
            number,
            generation: generations.next(),
            generations,
        }
    }

    fn records(&self) -> io::Result<[(String, Vec<u8>); 2]> {
        let seal = self.generations.seal(Kind::Store, self.generation);
        Ok([
            (CHANGE.to_owned(), self.number.to_string().into_bytes()),
            (SEAL.to_owned(), serde_json::to_vec(&seal)?),
        ])
    }
}

impl Store {
    /// Opens the store of an inspected folder (result in `judged`). A new store receives its name when it is
    /// complete, so a kill during its creation leaves no store. A damaged store is moved aside and replaced
    /// by a new one with the remaining values. Also returns the path of the damaged store.
    ///
    /// # Errors
    /// Returns an error if another process has it open, or the disk operation fails; in both cases nothing more is
    /// lost.
    pub fn open(
        folder: &Path,
        judged: &Judged,
        generations: &Arc<Generations>,
    ) -> io::Result<(Self, Option<PathBuf>)> {
        let path = folder.join(STORE_FILE);
        let mut last = judged.last;
        if judged.condition != Condition::Whole {
            last += 1;
        }
        let change = || Change::new(last, generations);
        let mut aside = None;
        match judged.condition {
            Condition::Damaged(_) => aside = Some(replace(folder, &path, &judged.image, &change())?),
            Condition::New => {
                fs::rename(unfinished(folder, &judged.image, &change())?, &path)?;
                sync_folder(folder)?;
            }
            Condition::Whole | Condition::WithoutSums => {}
        }
        let database = open_database(&path)?;
        let identity = Identity::at(&path)?;
        if judged.condition == Condition::WithoutSums {
            write_all(&database, &judged.image, &change())?;
        }
        let sealer = Sealer {
            kind: Kind::StoreSums,
            part: StoredPart::Store,
            generations: Arc::clone(generations),
        };
        // generation of the change in the store: the data on disk are not newer yet
        let (sums_path, generation) = (folder.join(SUMS_FILE), judged.generation());
        let sums = SumFile::begin_at(&sums_path, sealer, last, generation, sums_of(&judged.image))?;
        let mut store = Self {
            database,
            path,
            identity,
            sums,
            last,
            generations: Arc::clone(generations),
        };
        // From here on both files have the same number.
        store.commit(&Image::default())?;
        Ok((store, aside))
    }

    /// Checks that the file is still the one that was opened.
    ///
    /// # Errors
    /// Returns an error if it was removed or replaced.
    pub fn check(&self) -> io::Result<()> {
        self.identity.check(&self.path)?;
        self.sums.check()
    }

    /// Returns the number of the last change.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Writes a change as a whole; it is on disk when this returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the change then has no effect, now and after a restart.
    pub fn commit(&mut self, change: &Image) -> io::Result<()> {
        self.check()?;
        let (number, generations) = (self.last + 1, Arc::clone(&self.generations));
        let of_change = Change::new(number, &generations);
        let before = write_all(&self.database, change, &of_change)?;
        let sums: SumChange = sums_of(change)
            .into_iter()
            .map(|(name, sum)| (name, Some(sum)))
            .collect();
        if let Err(error) = self.sums.add_at(number, of_change.generation, sums) {
            // undone before the failure is reported: if the process is killed before that, the outcome is unknown
            put_back(&self.database, &before).map_err(|also| {
                let text = format!("{error}; and the written data could not be undone: {also}");
                io::Error::new(error.kind(), text)
            })?;
            return Err(error);
        }
        self.last = number;
        Ok(())
    }
}

/// Records before a change, by name.
type Before = Vec<(String, Option<Vec<u8>>)>;

/// Returns the checksum of each record of an image.
fn sums_of(image: &Image) -> BTreeMap<String, String> {
    let records = image.records();
    records
        .map(|(name, payload)| {
            let sum = record::sum_of_record(&name, &payload);
            (name, sum)
        })
        .collect()
}

/// Writes an image as one change, and returns the previous content of its names; `None` for a name that did
/// not exist.
fn write_all(database: &Database, image: &Image, of_change: &Change<'_>) -> io::Result<Before> {
    let mut before = Before::new();
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
    writing.delete_table(OLD_VARIABLES).map_err(io::Error::other)?;
    writing.delete_table(OLD_VALUES).map_err(io::Error::other)?;
    writing.commit().map_err(io::Error::other)?;
    Ok(before)
}

/// Undoes a change.
fn put_back(database: &Database, before: &Before) -> io::Result<()> {
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

fn open_database(path: &Path) -> io::Result<Database> {
    let file = open_regular(
        path,
        OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false),
    )?;
    tighten(path);
    let opened = FileBackend::new(file).and_then(|file| {
        let mut builder = Builder::new();
        builder.set_cache_size(CACHE_BYTES).create_with_backend(file)
    });
    opened.map_err(|error| match error {
        DatabaseError::DatabaseAlreadyOpen => in_use(),
        other => io::Error::other(format!("{}: {other}", path.display())),
    })
}

/// Creates a store of an image under a temporary name.
fn unfinished(folder: &Path, image: &Image, of_change: &Change<'_>) -> io::Result<PathBuf> {
    let new = folder.join(format!("{STORE_FILE}{UNFINISHED}"));
    match fs::remove_file(&new) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    write_all(&open_database(&new)?, image, of_change)?;
    Ok(new)
}

/// Replaces a damaged store by a new one with the remaining values, and keeps the damaged one aside.
fn replace(folder: &Path, path: &Path, image: &Image, of_change: &Change<'_>) -> io::Result<PathBuf> {
    let new = unfinished(folder, image, of_change)?;
    let aside = evidence(folder);
    let is_file = fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file());
    if is_file {
        fs::copy(path, &aside)?;
        tighten(&aside);
        OpenOptions::new().read(true).open(&aside)?.sync_all()?;
    } else if fs::symlink_metadata(path).is_ok() {
        // a folder, a link or a FIFO
        fs::rename(path, &aside)?;
    }
    fs::rename(&new, path)?;
    sync_folder(folder)?;
    remove_old_evidence(folder);
    Ok(aside)
}

/// Returns an unused path for a damaged store that is kept as evidence.
fn evidence(folder: &Path) -> PathBuf {
    let named = |number: u32| folder.join(format!("{STORE_FILE}.damaged-{number}"));
    let number = (1..u32::MAX).find(|number| !fs::exists(named(*number)).unwrap_or(true));
    named(number.unwrap_or(u32::MAX))
}

/// Removes old evidence; files that cannot be removed stay.
fn remove_old_evidence(folder: &Path) {
    let prefix = format!("{STORE_FILE}.damaged-");
    let number = |entry: fs::DirEntry| -> Option<(u32, PathBuf)> {
        let name = entry.file_name().into_string().ok()?;
        Some((name.strip_prefix(&prefix)?.parse().ok()?, entry.path()))
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut all: Vec<_> = entries.filter_map(number).collect();
    all.sort();
    let surplus = all.len().saturating_sub(EVIDENCE_MAX);
    for (_, path) in &all[..surplus] {
        let _ = fs::remove_file(path);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::sync::Arc;

    use parking_lot::Mutex;

    use super::super::image::Page;
    use super::super::judge::judge;
    use super::*;
    use crate::disk::simulated::ROOT;
    use crate::disk::simulated::memory::{Disk, Mount};

    fn image(number: u64) -> Image {
        Image {
            pages: [((0, 3), Page([number; 128])), ((2, 0), Page([number + 1; 128]))].into(),
            values: [("tools".to_owned(), number.to_string().into_bytes())].into(),
        }
    }

    /// Returns generations after those that were read.
    fn generations(judged: &Judged) -> Arc<Generations> {
        let generations = Generations::new("mill");
        generations.learn(&[(StoredPart::Store, judged.generation())].into());
        Arc::new(generations)
    }

    /// Opens a store as a start does.
    fn open(folder: &Path) -> (Store, Judged, Option<PathBuf>) {
        let judged = judge(folder);
        let (store, aside) = Store::open(folder, &judged, &generations(&judged)).unwrap();
        (store, judged, aside)
    }

    fn names(names: &[&str]) -> BTreeSet<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn what_was_committed_is_there_when_it_is_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, judged, _) = open(folder.path());
        assert_eq!(
            (judged.condition, judged.image),
            (Condition::New, Image::default())
        );
        store.commit(&image(1)).unwrap();
        store.commit(&image(5)).unwrap();
        let last = store.last();
        drop(store);
        for round in 0..3 {
            let (store, judged, aside) = open(folder.path());
            assert_eq!(
                (judged.condition, judged.image, aside),
                (Condition::Whole, image(5), None)
            );
            assert_eq!((judged.last, store.last()), (last + round, last + round + 1));
        }
    }

    #[test]
    fn with_any_bit_flipped_a_value_is_the_kept_one_or_lost() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, ..) = open(folder.path());
        store.commit(&image(1)).unwrap();
        store.commit(&image(5)).unwrap();
        drop(store);
        let path = folder.path().join(STORE_FILE);
        let good = fs::read(&path).unwrap();
        let all = names(&["p/3", "q/2/0", "tools"]);
        let (mut whole, mut lost) = (0, 0);
        for place in (0..good.len() * 8).step_by(1009) {
            let mut flipped = good.clone();
            flipped[place / 8] ^= 1 << (place % 8);
            fs::write(&path, &flipped).unwrap();
            let judged = judge(folder.path());
            for (name, payload) in image(5).records() {
                let found = judged
                    .image
                    .records()
                    .find(|(found, _)| *found == name)
                    .unwrap()
                    .1;
                assert!(
                    found == payload || judged.lost.contains(&name),
                    "{name} at bit {place}"
                );
            }
            assert!(judged.lost.is_subset(&all));
            assert!(
                judged.lost.len() <= 1,
                "{:?} at bit {place}: one bit is of one value",
                judged.lost
            );
            (whole, lost) = (
                whole + usize::from(judged.lost.is_empty()),
                lost + judged.lost.len(),
            );
        }
        assert!(whole > 10 * lost, "{whole} {lost}");
    }

    #[test]
    fn missing_or_invalid_store_is_set_aside_and_its_values_lost_by_name() {
        for damage in ["gone", "empty", "none", "folder"] {
            let folder = tempfile::tempdir().unwrap();
            let (mut store, ..) = open(folder.path());
            store.commit(&image(1)).unwrap();
            drop(store);
            let path = folder.path().join(STORE_FILE);
            fs::remove_file(&path).unwrap();
            match damage {
                "gone" => {}
                "empty" => fs::write(&path, "").unwrap(),
                "none" => fs::write(&path, "this is not a store ".repeat(500)).unwrap(),
                _ => fs::create_dir(&path).unwrap(),
            }
            let (store, judged, aside) = open(folder.path());
            assert!(matches!(judged.condition, Condition::Damaged(_)), "{damage}");
            assert_eq!(judged.lost, names(&["p/3", "q/2/0", "tools"]), "{damage}");
            assert_eq!(aside.unwrap().exists(), damage != "gone");
            drop(store);
            // lost until it is written again
            let (mut store, judged, _) = open(folder.path());
            assert_eq!((judged.condition, judged.lost.len()), (Condition::Whole, 0));
            assert_eq!(judged.image.values["tools"], b"lost");
            store.commit(&image(2)).unwrap();
            drop(store);
            assert_eq!(judge(folder.path()).image, image(2));
        }
    }

    #[test]
    fn an_older_store_is_not_believed_but_for_what_has_not_changed_since() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(STORE_FILE);
        let (mut store, ..) = open(folder.path());
        store.commit(&image(1)).unwrap();
        drop(store);
        let older = fs::read(&path).unwrap();
        let (mut store, ..) = open(folder.path());
        let mut change = Image::default();
        change.values.insert("tools".to_owned(), b"2".to_vec());
        store.commit(&change).unwrap();
        drop(store);
        fs::write(&path, older).unwrap();
        let judged = judge(folder.path());
        assert_eq!(judged.lost, names(&["tools"]));
        assert_eq!(judged.image.pages, image(1).pages);
    }

    #[test]
    fn without_its_sums_a_sound_store_is_believed_and_a_damaged_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, ..) = open(folder.path());
        store.commit(&image(1)).unwrap();
        drop(store);
        fs::remove_file(folder.path().join(SUMS_FILE)).unwrap();
        let judged = judge(folder.path());
        assert_eq!(
            (judged.condition.clone(), judged.image),
            (Condition::Whole, image(1))
        );
        assert!(judged.sums_fault.is_some());
        let path = folder.path().join(STORE_FILE);
        let mut bytes = fs::read(&path).unwrap();
        let record = record::write("tools", b"1");
        let place = bytes
            .windows(record.len())
            .position(|window| window == record)
            .unwrap();
        bytes[place + record.len() - 1] ^= 1;
        fs::write(&path, bytes).unwrap();
        fs::write(folder.path().join("started"), "").unwrap();
        let judged = judge(folder.path());
        assert!(matches!(judged.condition, Condition::Damaged(_)));
        assert!(
            judged.lost.is_superset(&names(&["p/3", "q/2/0"])),
            "{:?}",
            judged.lost
        );
    }

    #[test]
    fn a_sound_store_is_believed_whatever_is_in_the_place_of_its_sums() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, ..) = open(folder.path());
        store.commit(&image(1)).unwrap();
        let sums = folder.path().join(SUMS_FILE);
        let older = fs::read(&sums).unwrap();
        store.commit(&image(3)).unwrap();
        store.commit(&image(5)).unwrap();
        drop(store);
        let other = folder.path().join("other");
        let sealer = Sealer {
            kind: Kind::ProgramSums,
            part: StoredPart::Programs,
            generations: Arc::default(),
        };
        let of_programs = [("1".to_owned(), "7".to_owned())].into();
        SumFile::begin(&other, sealer, 9, of_programs).unwrap();
        let foreign = fs::read(&other).unwrap();
        for (bytes, fault) in [
            (foreign, "it contains lines of program_sums"),
            (b"rubbish\n".to_vec(), "lines are damaged"),
            (Vec::new(), "the file is missing or damaged"),
            (older, "the file is older than the store"),
        ] {
            fs::write(&sums, bytes).unwrap();
            let judged = judge(folder.path());
            assert_eq!((&judged.condition, &judged.image), (&Condition::Whole, &image(5)));
            assert_eq!(judged.sums_fault.as_deref(), Some(fault));
        }
    }

    #[test]
    fn a_store_of_a_version_without_sums_is_taken_over_once() {
        let folder = tempfile::tempdir().unwrap();
        let database = open_database(&folder.path().join(STORE_FILE)).unwrap();
        let writing = database.begin_write().unwrap();
        let page = Page([7; 128]).to_bytes();
        writing
            .open_table(OLD_VARIABLES)
            .unwrap()
            .insert((0, 3), page.as_slice())
            .unwrap();
        writing
            .open_table(OLD_VALUES)
            .unwrap()
            .insert("tool/1", b"7".as_slice())
            .unwrap();
        writing.commit().unwrap();
        drop(database);
        fs::write(folder.path().join("started"), "").unwrap();
        let (store, judged, _) = open(folder.path());
        assert_eq!(judged.condition, Condition::WithoutSums);
        drop(store);
        let again = judge(folder.path());
        assert_eq!(
            (again.condition, again.image.names()),
            (Condition::Whole, vec!["p/3".into(), "tool/1".into()])
        );
        assert_eq!(again.image, judged.image);
    }

    #[test]
    fn a_first_start_that_ends_anywhere_leaves_nothing_lost() {
        for power in [false, true] {
            for operation in 0.. {
                let disk = Disk::new(operation, std::time::SystemTime::UNIX_EPOCH);
                let disk = Arc::new(Mutex::new(disk));
                let folder = Path::new(ROOT).join("data");
                Mount::mount(&disk);
                crate::disk::make_folder(&folder).unwrap();
                let begin = disk.lock().operations;
                disk.lock().faults.dies_at = Some(begin + operation);
                let first = Store::open(&folder, &judge(&folder), &Arc::default());
                let is_whole = first.is_ok();
                if power {
                    disk.lock().cut_power();
                } else {
                    disk.lock().kill();
                }
                drop(first);
                Mount::mount(&disk);
                crate::disk::make_folder(&folder).unwrap();
                let judged = judge(&folder);
                let is_right = matches!(judged.condition, Condition::New | Condition::Whole);
                let is_lost = judged.is_all_lost || !judged.lost.is_empty() || judged.sums_fault.is_some();
                assert!(
                    is_right && !is_lost,
                    "killed at operation {operation}: {judged:?}"
                );
                let (mut store, _) = Store::open(&folder, &judged, &generations(&judged)).unwrap();
                store.commit(&image(1)).unwrap();
                drop(store);
                assert_eq!(judge(&folder).image, image(1));
                if is_whole {
                    assert!(operation > 10, "{operation} operations");
                    break;
                }
            }
        }
        Mount::unmount();
    }

    #[test]
    fn a_store_that_is_open_is_not_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let _open = open(folder.path());
        let refused = Store::open(folder.path(), &judge(folder.path()), &Arc::default()).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::ResourceBusy, "{refused}");
    }

    #[test]
    fn change_refused_without_checksums_is_absent_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, ..) = open(folder.path());
        store.commit(&image(1)).unwrap();
        let kept = fs::read(folder.path().join(SUMS_FILE)).unwrap();
        store.sums.refuse_all();
        store.commit(&image(5)).unwrap_err();
        drop(store);
        assert_eq!(fs::read(folder.path().join(SUMS_FILE)).unwrap(), kept);
        let judged = judge(folder.path());
        assert!(
            matches!(judged.condition, Condition::Whole),
            "{:?}",
            judged.condition
        );
        assert_eq!(judged.image, image(1));
    }

    #[test]
    fn the_file_does_not_grow_with_the_number_of_changes() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, ..) = open(folder.path());
        let path = folder.path().join(STORE_FILE);
        let mut bytes_after = |changes: u64| {
            for number in 0..changes {
                store.commit(&image(number)).unwrap();
            }
            fs::metadata(&path).unwrap().len()
        };
        let first = bytes_after(50);
        assert!(bytes_after(300) <= 2 * first);
    }

    #[test]
    fn at_most_eight_damaged_stores_are_kept_as_evidence() {
        let folder = tempfile::tempdir().unwrap();
        for _ in 0..EVIDENCE_MAX + 3 {
            drop(open(folder.path()));
            fs::write(folder.path().join(STORE_FILE), "none").unwrap();
            fs::write(folder.path().join("started"), "").unwrap();
        }
        let entries = fs::read_dir(folder.path()).unwrap().flatten();
        let evidence = entries.filter(|entry| entry.file_name().to_string_lossy().contains("damaged-"));
        assert_eq!(evidence.count(), EVIDENCE_MAX);
    }
}
