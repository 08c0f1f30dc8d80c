//! Stored data on a simulated disk: a start that ends at any disk operation, a power cut, a disk that refuses to write.

use std::io;

use tandem_interp::dialects::nj;
use tandem_model::settings::NcOptions;
use tandem_store::disk::{DiskPath, make_folder, make_folder_in, read_regular, write_whole};
use tandem_store::persistence::{Image, Store, StoreCondition};
use tandem_store::program_store::{HeldBack, ProgramStore, TextRules};
use tandem_store::stored_data::inspection::Inspection;
use tandem_testing::simulated_disk::{ROOT, SimulatedDisk};

fn rules() -> TextRules {
    TextRules {
        dialect: nj(),
        options: NcOptions::default(),
        arc_radius_tolerance_mm: 0.01,
    }
}

#[test]
fn a_folder_that_is_made_is_there_after_a_power_cut() {
    let disk = SimulatedDisk::new(7, std::time::SystemTime::UNIX_EPOCH);
    let folder = |disk: &SimulatedDisk| disk.mount().at(ROOT).join("data/of/a/machine");
    // Creates the folders as a start that is killed afterwards.
    let made = folder(&disk);
    made.files().create_folder(made.as_path(), true).unwrap();
    disk.lock().kill();
    let made = folder(&disk);
    make_folder(&made).unwrap();
    make_folder_in(&made.join("programs")).unwrap();
    write_whole(&made.join("programs/a"), b"kept").unwrap();
    disk.lock().cut_power();
    let kept = folder(&disk).join("programs/a");
    assert_eq!(read_regular(&kept, 10).unwrap(), b"kept");
}

#[test]
fn a_first_start_that_ends_anywhere_leaves_nothing_lost() {
    let tools = Image {
        values: [("tools".to_owned(), b"1".to_vec())].into(),
        ..Image::default()
    };
    let inspect = |folder: &DiskPath| Inspection::new(folder, "mill");
    for power in [false, true] {
        for operation in 0.. {
            let disk = SimulatedDisk::new(operation, std::time::SystemTime::UNIX_EPOCH);
            let folder = disk.mount().at(ROOT).join("data");
            make_folder(&folder).unwrap();
            let begin = disk.lock().operations;
            disk.lock().faults.dies_at = Some(begin + operation);
            let Inspection {
                inspected,
                generations,
                ..
            } = inspect(&folder);
            let first = Store::open(&folder, &inspected, &generations);
            let is_whole = first.is_ok();
            if power {
                disk.lock().cut_power();
            } else {
                disk.lock().kill();
            }
            drop(first);
            let folder = disk.mount().at(ROOT).join("data");
            make_folder(&folder).unwrap();
            let Inspection {
                inspected,
                generations,
                ..
            } = inspect(&folder);
            let is_right = matches!(inspected.condition, StoreCondition::New | StoreCondition::Whole);
            let is_lost =
                inspected.is_all_lost || !inspected.lost.is_empty() || inspected.sums_fault.is_some();
            assert!(
                is_right && !is_lost,
                "killed at operation {operation}: {inspected:?}"
            );
            let (mut store, _) = Store::open(&folder, &inspected, &generations).unwrap();
            store.commit(&tools).unwrap();
            drop(store);
            assert_eq!(inspect(&folder).inspected.image, tools);
            if is_whole {
                assert!(operation > 10, "{operation} operations");
                break;
            }
        }
    }
}

#[test]
fn a_disk_that_takes_nothing_at_a_start_hides_no_program() {
    let disk = SimulatedDisk::new(7, std::time::SystemTime::UNIX_EPOCH);
    let folder = disk.mount().at(ROOT).join("programs");
    make_folder(&folder).unwrap();
    let open = || {
        let mut store = ProgramStore::in_memory(rules());
        store.open_folder(&folder, &HeldBack::default()).1.unwrap();
        store
    };
    let store = open();
    store.write(7, "// Seven\nM30\n").unwrap();
    for refusal in [io::ErrorKind::StorageFull, io::ErrorKind::ReadOnlyFilesystem] {
        disk.lock().faults.refuses = Some(refusal);
        let mut store = ProgramStore::in_memory(rules());
        let (findings, opened) = store.open_folder(&folder, &HeldBack::default());
        assert_eq!(opened.unwrap_err().kind(), refusal);
        assert_eq!(store.get(7).unwrap().text(), "// Seven\nM30\n");
        assert!(
            findings.changed.is_empty() && findings.without_sum == 0,
            "{findings:?}"
        );
        assert!(store.write(8, "M30\n").is_err());
        disk.lock().faults.refuses = None;
        store.write(8, "M30\n").unwrap();
        assert_eq!(open().list().len(), 2);
        store.delete(8).unwrap();
    }
}
