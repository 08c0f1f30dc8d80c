use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use super::super::image::Page;
use super::super::inspected_store::inspect_store;
use super::*;

fn image(number: u64) -> Image {
    Image {
        pages: [((0, 3), Page([number; 128])), ((2, 0), Page([number + 1; 128]))].into(),
        values: [("tools".to_owned(), number.to_string().into_bytes())].into(),
    }
}

/// Returns the generations as they follow those that the inspection has read.
fn generations(inspected: &InspectedStore) -> Arc<Generations> {
    let generations = Generations::new("mill");
    generations.learn(&[(StoredPart::Store, inspected.generation())].into());
    Arc::new(generations)
}

fn inspect(folder: &Path) -> InspectedStore {
    inspect_store(&folder.into())
}

/// Opens a store as a start of the runtime does.
fn open(folder: &Path) -> (Store, InspectedStore, Option<DiskPath>) {
    let inspected = inspect(folder);
    let (store, aside) = Store::open(&folder.into(), &inspected, &generations(&inspected)).unwrap();
    (store, inspected, aside)
}

fn names(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

#[test]
fn what_was_committed_is_there_when_it_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let (mut store, inspected, _) = open(folder.path());
    assert_eq!(
        (inspected.condition, inspected.image),
        (StoreCondition::New, Image::default())
    );
    store.commit(&image(1)).unwrap();
    store.commit(&image(5)).unwrap();
    let last = store.last();
    drop(store);
    for round in 0..3 {
        let (store, inspected, aside) = open(folder.path());
        assert_eq!(
            (inspected.condition, inspected.image, aside.is_none()),
            (StoreCondition::Whole, image(5), true)
        );
        assert_eq!((inspected.last, store.last()), (last + round, last + round + 1));
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
        let inspected = inspect(folder.path());
        for (name, payload) in image(5).records() {
            let found = inspected
                .image
                .records()
                .find(|(found, _)| *found == name)
                .unwrap()
                .1;
            assert!(
                found == payload || inspected.lost.contains(&name),
                "{name} at bit {place}"
            );
        }
        assert!(inspected.lost.is_subset(&all));
        assert!(
            inspected.lost.len() <= 1,
            "{:?} at bit {place}: one bit is of one value",
            inspected.lost
        );
        (whole, lost) = (
            whole + usize::from(inspected.lost.is_empty()),
            lost + inspected.lost.len(),
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
        let (store, inspected, aside) = open(folder.path());
        assert!(
            matches!(inspected.condition, StoreCondition::Damaged(_)),
            "{damage}"
        );
        assert_eq!(inspected.lost, names(&["p/3", "q/2/0", "tools"]), "{damage}");
        assert_eq!(aside.unwrap().exists().unwrap(), damage != "gone");
        drop(store);
        // The value is lost until it is written again.
        let (mut store, inspected, _) = open(folder.path());
        assert_eq!(
            (inspected.condition, inspected.lost.len()),
            (StoreCondition::Whole, 0)
        );
        assert_eq!(inspected.image.values["tools"], b"lost");
        store.commit(&image(2)).unwrap();
        drop(store);
        assert_eq!(inspect(folder.path()).image, image(2));
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
    let inspected = inspect(folder.path());
    assert_eq!(inspected.lost, names(&["tools"]));
    assert_eq!(inspected.image.pages, image(1).pages);
}

#[test]
fn without_its_sums_a_sound_store_is_believed_and_a_damaged_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let (mut store, ..) = open(folder.path());
    store.commit(&image(1)).unwrap();
    drop(store);
    fs::remove_file(folder.path().join(SUMS_FILE)).unwrap();
    let inspected = inspect(folder.path());
    assert_eq!(
        (inspected.condition.clone(), inspected.image),
        (StoreCondition::Whole, image(1))
    );
    assert!(inspected.sums_fault.is_some());
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
    let inspected = inspect(folder.path());
    assert!(matches!(inspected.condition, StoreCondition::Damaged(_)));
    assert!(
        inspected.lost.is_superset(&names(&["p/3", "q/2/0"])),
        "{:?}",
        inspected.lost
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
        kind: SealedFileKind::ProgramSums,
        part: StoredPart::Programs,
        generations: Arc::default(),
    };
    let of_programs = [("1".to_owned(), "7".to_owned())].into();
    ChecksumFile::create(&other.as_path().into(), sealer, 9, of_programs).unwrap();
    let foreign = fs::read(&other).unwrap();
    for (bytes, fault) in [
        (foreign, "it contains lines of program_sums"),
        (b"rubbish\n".to_vec(), "lines are damaged"),
        (Vec::new(), "the file is missing or damaged"),
        (older, "the file is older than the store"),
    ] {
        fs::write(&sums, bytes).unwrap();
        let inspected = inspect(folder.path());
        assert_eq!(
            (&inspected.condition, &inspected.image),
            (&StoreCondition::Whole, &image(5))
        );
        assert_eq!(inspected.sums_fault.as_deref(), Some(fault));
    }
}

#[test]
fn a_store_without_records_is_damaged_and_kept_as_evidence() {
    const FOREIGN: redb::TableDefinition<'_, &str, &[u8]> = redb::TableDefinition::new("values");
    let folder = tempfile::tempdir().unwrap();
    let database = open_database(&folder.path().join(STORE_FILE).into()).unwrap();
    let writing = database.begin_write().unwrap();
    writing
        .open_table(FOREIGN)
        .unwrap()
        .insert("tool/1", b"7".as_slice())
        .unwrap();
    writing.commit().unwrap();
    drop(database);
    let (store, inspected, aside) = open(folder.path());
    assert!(matches!(&inspected.condition, StoreCondition::Damaged(how) if how.contains("no records")));
    assert!(inspected.is_all_lost && aside.unwrap().exists().unwrap());
    drop(store);
    assert_eq!(inspect(folder.path()).condition, StoreCondition::Whole);
}

#[test]
fn a_store_that_is_open_is_not_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let _open = open(folder.path());
    let refused = Store::open(&folder.path().into(), &inspect(folder.path()), &Arc::default()).unwrap_err();
    assert_eq!(refused.kind(), io::ErrorKind::ResourceBusy, "{refused}");
}

#[test]
fn change_refused_without_checksums_is_absent_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let (mut store, ..) = open(folder.path());
    store.commit(&image(1)).unwrap();
    let kept = fs::read(folder.path().join(SUMS_FILE)).unwrap();
    let sums = folder.path().join(SUMS_FILE);
    // This file rejects each further line.
    store.sums.file = open_regular(&sums.into(), OpenMode::Read).unwrap();
    store.commit(&image(5)).unwrap_err();
    drop(store);
    assert_eq!(fs::read(folder.path().join(SUMS_FILE)).unwrap(), kept);
    let inspected = inspect(folder.path());
    assert!(
        matches!(inspected.condition, StoreCondition::Whole),
        "{:?}",
        inspected.condition
    );
    assert_eq!(inspected.image, image(1));
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
