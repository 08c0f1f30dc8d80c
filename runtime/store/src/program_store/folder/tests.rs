use std::fs;
use std::path::Path;
use std::process::Command;

use super::super::PROGRAMS_BYTES_MAX;
use super::*;

fn file(folder: &Path, name: &str, text: &str) {
    fs::write(folder.join(name), text).unwrap();
}

fn opening(dialect: &'static str, is_mixed: bool) -> Opening {
    Opening {
        dialect,
        is_mixed,
        bytes_max: PROGRAMS_BYTES_MAX,
        generations: Arc::default(),
        holds_back: false,
    }
}

fn found(folder: &Path) -> BTreeMap<u16, ProgramFileState> {
    scan_folder(&folder.into(), false, PROGRAMS_BYTES_MAX)
        .unwrap()
        .programs
}

/// Sets the modification time of file `of` to that of `as_file`.
fn same_time(of: &Path, as_file: &Path) {
    let set = Command::new("touch").arg("-r").arg(as_file).arg(of).status();
    assert!(set.unwrap().success());
}

#[test]
fn the_same_time_and_another_sum_is_damage_and_another_time_is_a_change() {
    let folder = tempfile::tempdir().unwrap();
    let (mut programs, _) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    programs.write(7, b"M30\n", "nj", None).unwrap();
    programs.write(8, b"M30\n", "nj", None).unwrap();
    let path = folder.path().join("7.nc");
    let copy = folder.path().join("copy");
    fs::copy(&path, &copy).unwrap();
    same_time(&copy, &path);
    assert_eq!(
        found(folder.path())[&7],
        ProgramFileState::Stored(b"M30\n".to_vec())
    );
    file(folder.path(), "7.nc", "M31\n");
    assert!(matches!(
        found(folder.path())[&7],
        ProgramFileState::FromOutside(..)
    ));
    same_time(&path, &copy);
    assert!(matches!(found(folder.path())[&7], ProgramFileState::Damaged(_)));
    assert_eq!(programs.changed().unwrap(), BTreeMap::new());
    // The program is still damaged after the folder is opened again, until it is written again.
    let (mut programs, look) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    assert!(matches!(look.programs[&7], ProgramFileState::Damaged(_)));
    assert!(matches!(found(folder.path())[&7], ProgramFileState::Damaged(_)));
    programs.write(7, b"M31\n", "nj", None).unwrap();
    assert_eq!(
        found(folder.path())[&7],
        ProgramFileState::Stored(b"M31\n".to_vec())
    );
    fs::remove_file(&path).unwrap();
    assert_eq!(
        (
            super::scan_folder(&folder.path().into(), false, PROGRAMS_BYTES_MAX)
                .unwrap()
                .gone,
            programs.changed().unwrap()
        ),
        (
            vec![(7, Some(crate::disk::checksum_hex(b"M31\n")))],
            [(7, None)].into()
        )
    );
}

#[test]
fn a_kill_between_sum_and_name_leaves_the_program_before_or_after() {
    let folder = tempfile::tempdir().unwrap();
    let (mut programs, _) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    programs.write(7, b"M30\n", "nj", None).unwrap();
    let before = programs.sums.get("7").unwrap().to_owned();
    programs
        .sums
        .add(
            0,
            [("7".to_owned(), Some(format!("{before}|1.000000000 77")))].into(),
        )
        .unwrap();
    assert_eq!(
        found(folder.path())[&7],
        ProgramFileState::Stored(b"M30\n".to_vec())
    );
    programs
        .sums
        .add(
            0,
            [("7".to_owned(), Some(format!("1.000000000 77|{before}")))].into(),
        )
        .unwrap();
    assert_eq!(
        found(folder.path())[&7],
        ProgramFileState::Stored(b"M30\n".to_vec())
    );
}

#[test]
fn a_program_has_one_name_and_others_are_renamed_once_or_named() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("O90.nc", "a"),
        ("0090.nc", "b"),
        ("o91.NC", "c"),
        ("91.nc", "d"),
        ("notes.nc", "e"),
    ] {
        file(folder.path(), name, text);
    }
    let (mut programs, look) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    let texts: Vec<_> = look.programs.iter().collect();
    assert_eq!(
        texts,
        [
            (&90, &ProgramFileState::Stored(b"b".to_vec())),
            (&91, &ProgramFileState::Stored(b"d".to_vec()))
        ]
    );
    assert_eq!(look.not_read.len(), 2, "{:?}", look.not_read);
    assert!(look.not_read[0].contains("O90.nc: rename it to 90.nc"));
    programs.delete(90).unwrap();
    let (_, look) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    let left: Vec<_> = look.programs.keys().collect();
    assert_eq!(left, [&91], "no other spelling takes its place");
}

#[test]
fn non_file_named_like_a_program_is_reported_without_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name| folder.path().join(name);
    fs::create_dir(path("71.nc")).unwrap();
    std::os::unix::fs::symlink("nowhere", path("72.nc")).unwrap();
    assert!(
        Command::new("mkfifo")
            .arg(path("73.nc"))
            .status()
            .unwrap()
            .success()
    );
    let _socket = std::os::unix::net::UnixListener::bind(path("74.nc")).unwrap();
    file(folder.path(), "75.nc", "M30\n");
    let (_, look) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    assert_eq!(look.programs.len(), 1);
    for number in 71..75 {
        let named = look.not_read.iter().any(|text| text.contains(&file_name(number)));
        assert!(named, "{number} in {:?}", look.not_read);
    }
}

#[test]
fn half_an_upload_is_removed_and_nothing_is_written_through_a_link() {
    let folder = tempfile::tempdir().unwrap();
    file(folder.path(), "90.nc.new", "half");
    let target = folder.path().join("theirs");
    file(folder.path(), "theirs", "theirs");
    std::os::unix::fs::symlink(&target, folder.path().join("96.nc.new")).unwrap();
    let (mut programs, _) = ProgramFolder::open(&folder.path().into(), &opening("nj", false)).unwrap();
    std::os::unix::fs::symlink(&target, folder.path().join("96.nc.new")).unwrap();
    programs.write(96, b"M30\n", "nj", None).unwrap();
    assert_eq!(fs::read_to_string(&target).unwrap(), "theirs");
    assert!(!folder.path().join("90.nc.new").exists());
}
