use std::fs;

use plc_protocol::types::program::DiagnosticSeverity;
use plc_protocol::types::upload::Hashes;
use tandem_interp::dialects::nj;
use tandem_model::limits::PROGRAM_BYTES_MAX;
use tandem_model::settings::NcOptions;

use super::*;

pub(super) fn rules() -> TextRules {
    TextRules {
        dialect: nj(),
        options: NcOptions::default(),
        arc_radius_tolerance_mm: 0.01,
    }
}

#[test]
fn a_written_program_is_there_after_the_store_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = ProgramStore::open(folder.path(), rules()).unwrap();
    assert!(store.write(7, "// Seven\nG90\nM30\n").unwrap().created);
    assert!(!store.write(7, "// Seven again\nG90\nM30\n").unwrap().created);
    let again = ProgramStore::open(folder.path(), rules()).unwrap();
    assert_eq!(again.list()[0].title, "Seven again");
    assert!(again.delete(7).unwrap());
    assert!(
        ProgramStore::open(folder.path(), rules())
            .unwrap()
            .list()
            .is_empty()
    );
}

#[test]
fn a_program_with_errors_is_stored_and_says_them() {
    let store = ProgramStore::in_memory(rules());
    let check = store.write(1, "G01 X\nM30\n").unwrap();
    assert!(
        check
            .diagnostics
            .iter()
            .any(|found| found.severity == DiagnosticSeverity::Error)
    );
    assert!(store.get(1).unwrap().has_errors());
}

#[test]
fn an_upload_of_what_is_there_changes_nothing_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let store = ProgramStore::open(folder.path(), rules()).unwrap();
    let first = store.write(7, "M30\n").unwrap();
    let written = store.written_at(7);
    assert_eq!(first.hash, crate::disk::checksum_hex(b"M30\n"));
    let again = store.write(7, "M30\n").unwrap();
    assert!(again.unchanged && !again.created && again.hash == first.hash);
    assert_eq!(store.written_at(7), written);
    assert!(!store.write(7, "G90\nM30\n").unwrap().unchanged);
}

#[test]
fn of_many_who_change_one_program_under_the_same_condition_one_does() {
    let folder = tempfile::tempdir().unwrap();
    let store = ProgramStore::open(folder.path(), rules()).unwrap();
    let hash = store.write(7, "M30\n").unwrap().hash;
    let condition = ProgramCondition {
        if_match: Some(Hashes::OneOf(vec![hash])),
        if_none_match: None,
    };
    let won = std::thread::scope(|threads| {
        let writers: Vec<_> = (0..8)
            .map(|n| {
                let (store, condition) = (&store, &condition);
                threads.spawn(move || {
                    let program = StoredProgram::new(7, &format!("G00 X{n}\nM30\n"), rules());
                    store.store(program, condition).unwrap().is_ok()
                })
            })
            .collect();
        let won = writers.into_iter().map(|writer| writer.join().unwrap());
        won.filter(|won| *won).count()
    });
    assert_eq!(won, 1);
}

#[test]
fn condition_is_compared_with_the_file_before_a_change_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let store = ProgramStore::open(folder.path(), rules()).unwrap();
    let hash = store.write(7, "M30\n").unwrap().hash;
    std::fs::write(folder.path().join("7.nc"), "G00 X1\nM30\n").unwrap();
    let is = |hash: &str| ProgramCondition {
        if_match: Some(Hashes::OneOf(vec![hash.to_owned()])),
        if_none_match: None,
    };
    let program = || StoredProgram::new(7, "G00 X2\nM30\n", rules());
    let refusal = store.store(program(), &is(&hash)).unwrap().unwrap_err();
    assert_eq!(refusal.code, RefusalCode::PreconditionFailed);
    assert!(store.remove(7, &is(&hash)).unwrap().is_err());
    let outside = crate::disk::checksum_hex(b"G00 X1\nM30\n");
    assert!(store.store(program(), &is(&outside)).unwrap().is_ok());
    let new = ProgramCondition {
        if_none_match: Some(Hashes::Any),
        if_match: None,
    };
    assert!(store.store(program(), &new).unwrap().is_err());
    assert!(store.remove(7, &ProgramCondition::default()).unwrap().is_ok());
    assert!(store.store(program(), &new).unwrap().is_ok());
}

#[test]
fn program_numbers_outside_1_to_9999_are_refused() {
    let store = ProgramStore::in_memory(rules());
    assert!(store.write(0, "M30").is_err());
    assert!(store.write(10_000, "M30").is_err());
}

#[test]
fn a_file_that_is_larger_than_a_program_may_be_is_not_read_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("7.nc");
    std::fs::File::create(&path)
        .unwrap()
        .set_len(PROGRAM_BYTES_MAX as u64 + 1)
        .unwrap();
    assert_eq!(read_text(&path).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    assert!(
        ProgramStore::open(folder.path(), rules())
            .unwrap()
            .list()
            .is_empty()
    );
}

#[test]
fn program_folder_survives_write_and_restart_but_not_deletion() {
    let folder = tempfile::tempdir().unwrap();
    let store = ProgramStore::open(folder.path(), rules()).unwrap();
    store.write(7, "G90\nM30\n").unwrap();
    assert!(store.put_in_folder(7, "parts/left").unwrap());
    assert!(!store.put_in_folder(8, "parts/left").unwrap(), "there is no 8");
    store.write(7, "G91\nM30\n").unwrap();
    let again = ProgramStore::open(folder.path(), rules()).unwrap();
    assert_eq!(again.list()[0].folder, "parts/left");
    again.delete(7).unwrap();
    again.write(7, "G90\nM30\n").unwrap();
    assert_eq!(again.list()[0].folder, "");
}

#[test]
fn a_damaged_file_of_folders_takes_no_program_away() {
    let folder = tempfile::tempdir().unwrap();
    let store = ProgramStore::open(folder.path(), rules()).unwrap();
    store.write(7, "G90\nM30\n").unwrap();
    store.put_in_folder(7, "parts").unwrap();
    for damaged in ["", "{\"7\": 1}", "{\"7\": \"a/../b\"}"] {
        std::fs::write(folder.path().join("folders.json"), damaged).unwrap();
        let again = ProgramStore::open(folder.path(), rules()).unwrap();
        assert_eq!(again.list()[0].folder, "", "{damaged}");
    }
}

#[test]
fn all_texts_together_have_a_limit_and_what_is_beyond_it_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let open = |bytes_max| {
        let mut store = ProgramStore::in_memory(rules()).with_room(bytes_max);
        let (findings, opened) = store.open_folder(&folder.path().into(), &HeldBack::default());
        opened.unwrap();
        (store, findings)
    };
    let text = |n: u32| format!("G00 X{n}\nM30\n");
    let (store, _) = open(22);
    store.write(1, &text(1)).unwrap();
    store.write(2, &text(2)).unwrap();
    let refused = store.write(3, &text(3)).unwrap_err();
    assert_eq!(refused.kind(), io::ErrorKind::QuotaExceeded);
    assert!(refused.to_string().contains("total_max_mib"), "{refused}");
    // A program that replaces another one may use the space of that one.
    store.write(2, &text(4)).unwrap();
    store.write(1, &text(10)).unwrap_err();
    store.delete(1).unwrap();
    store.write(3, &text(3)).unwrap();

    // A file that a person puts into the folder: it is not read, and the other programs are.
    fs::write(folder.path().join("4.nc"), text(5)).unwrap();
    let (store, findings) = open(22);
    assert_eq!(store.list().len(), 2);
    assert_eq!(findings.not_read.len(), 1);
    assert!(findings.not_read[0].contains("4.nc"), "{findings:?}");
    fs::write(folder.path().join("3.nc"), text(100)).unwrap();
    assert!(store.look_again().unwrap().is_empty(), "it may be written yet");
    let said = store.look_again().unwrap();
    assert!(
        said.iter()
            .any(|(text, _)| text.contains("program 3: its file was written, and is not read")),
        "{said:?}"
    );
    assert!(store.get(3).is_none() && store.get(2).is_some());
    assert_eq!(open(1 << 20).0.list().len(), 3);
}
