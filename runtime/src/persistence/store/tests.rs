use std::collections::BTreeSet;
use std::sync::Arc;

use parking_lot::Mutex;

use super::super::image::Page;
use super::super::inspected_store::inspect_store;
use super::*;
use crate::disk::simulated::ROOT;
use crate::disk::simulated::memory::{Disk, Mount};

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

/// Opens a store as a start of the runtime does.
fn open(folder: &Path) -> (Store, InspectedStore, Option<PathBuf>) {
    let inspected = inspect_store(folder);
    let (store, aside) = Store::open(folder, &inspected, &generations(&inspected)).unwrap();
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
            (inspected.condition, inspected.image, aside),
            (StoreCondition::Whole, image(5), None)
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
        let inspected = inspect_store(folder.path());
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
        assert_eq!(aside.unwrap().exists(), damage != "gone");
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
        assert_eq!(inspect_store(folder.path()).image, image(2));
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
    let inspected = inspect_store(folder.path());
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
    let inspected = inspect_store(folder.path());
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
    let inspected = inspect_store(folder.path());
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
    ChecksumFile::create(&other, sealer, 9, of_programs).unwrap();
    let foreign = fs::read(&other).unwrap();
    for (bytes, fault) in [
        (foreign, "it contains lines of program_sums"),
        (b"rubbish\n".to_vec(), "lines are damaged"),
        (Vec::new(), "the file is missing or damaged"),
        (older, "the file is older than the store"),
    ] {
        fs::write(&sums, bytes).unwrap();
        let inspected = inspect_store(folder.path());
        assert_eq!(
            (&inspected.condition, &inspected.image),
            (&StoreCondition::Whole, &image(5))
        );
        assert_eq!(inspected.sums_fault.as_deref(), Some(fault));
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
    let (store, inspected, _) = open(folder.path());
    assert_eq!(inspected.condition, StoreCondition::WithoutSums);
    drop(store);
    let again = inspect_store(folder.path());
    assert_eq!(
        (again.condition, again.image.names()),
        (StoreCondition::Whole, vec!["p/3".into(), "tool/1".into()])
    );
    assert_eq!(again.image, inspected.image);
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
            let first = Store::open(&folder, &inspect_store(&folder), &Arc::default());
            let is_whole = first.is_ok();
            if power {
                disk.lock().cut_power();
            } else {
                disk.lock().kill();
            }
            drop(first);
            Mount::mount(&disk);
            crate::disk::make_folder(&folder).unwrap();
            let inspected = inspect_store(&folder);
            let is_right = matches!(inspected.condition, StoreCondition::New | StoreCondition::Whole);
            let is_lost =
                inspected.is_all_lost || !inspected.lost.is_empty() || inspected.sums_fault.is_some();
            assert!(
                is_right && !is_lost,
                "killed at operation {operation}: {inspected:?}"
            );
            let (mut store, _) = Store::open(&folder, &inspected, &generations(&inspected)).unwrap();
            store.commit(&image(1)).unwrap();
            drop(store);
            assert_eq!(inspect_store(&folder).image, image(1));
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
    let refused = Store::open(folder.path(), &inspect_store(folder.path()), &Arc::default()).unwrap_err();
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
    let inspected = inspect_store(folder.path());
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
