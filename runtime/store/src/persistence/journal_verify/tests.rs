use std::fs;
use std::path::Path;
use std::sync::Arc;

use plc_protocol::types::BootId;
use serde_json::json;

use super::*;
use crate::clock::Clock;
use crate::disk::seal;
use crate::environment::Environment;
use crate::persistence::journal_file::JournalThread;
use crate::persistence::journal_folder::{Files, Newest, Object, Own};

/// Places that look random and are the same in every run.
struct Random(u32);

impl Random {
    fn index(&mut self, length: usize) -> usize {
        self.0 += 1;
        crc32fast::hash(&self.0.to_le_bytes()) as usize % length
    }
}

fn open(folder: &Path, bytes_max: u64) -> Files {
    let own = Own {
        boot_id: BootId("b1".to_owned()),
        started: tokio::time::Instant::now(),
        clock: Clock::real(),
        last: Arc::default(),
        generations: Arc::default(),
    };
    Files::open(&folder.into(), bytes_max, own).unwrap()
}

/// Writes a journal of `count` lines, in files of about `bytes_max` bytes, and ends it in an orderly way.
fn journal(folder: &Path, count: usize, bytes_max: u64) {
    let mut files = open(folder, bytes_max);
    for n in 0..count {
        files
            .append(&[Object::from_json(
                &json!({"event": "request", "n": n, "user": "anna", "ts": "2026-11-25T10:00:00Z"}),
            )])
            .unwrap();
    }
    files.anchor().unwrap();
}

fn lines(path: &Path) -> Vec<Vec<u8>> {
    let bytes = fs::read(path).unwrap();
    let mut lines: Vec<Vec<u8>> = bytes
        .split_inclusive(|byte| *byte == b'\n')
        .map(<[u8]>::to_vec)
        .collect();
    lines.retain(|line| !line.is_empty());
    lines
}

/// Verifies a journal on the disk of the operating system.
fn verify(folder: &Path, noted: Option<&str>) -> io::Result<ChainVerification> {
    super::verify(&folder.into(), noted)
}

fn journal_file_path(folder: &Path, age: usize) -> PathBuf {
    let path = crate::persistence::chain::journal_file_path(&folder.into(), age);
    path.as_path().to_owned()
}

fn breaks(folder: &Path) -> Vec<Break> {
    verify(folder, None).unwrap().breaks
}

/// Opens the journal in this folder as a start of the runtime does, and closes it.
fn start(folder: &Path) -> Newest {
    let started = JournalThread::start(
        &folder.into(),
        BootId("b2".to_owned()),
        Arc::default(),
        Arc::default(),
        &Environment::default(),
    );
    started.unwrap().1
}

#[test]
fn journal_verifies_over_starts_files_and_rotation() {
    let folder = tempfile::tempdir().unwrap();
    for round in 0..3 {
        journal(folder.path(), 40, 1500);
        start(folder.path());
        let found = verify(folder.path(), None).unwrap();
        assert!(found.is_whole(), "round {round}: {:#?}", found.breaks);
    }
    assert!(!lines(&journal_file_path(folder.path(), 7)).is_empty());
    let first = fs::read_to_string(journal_file_path(folder.path(), 7)).unwrap();
    assert!(!first.contains("\"file\":1,"), "{first}");
}

/// Number of ways in which the test changes a line.
const CHANGES: usize = 7;

fn change(random: &mut Random, kind: usize, lines: &mut Vec<Vec<u8>>, at: usize) {
    match kind {
        0 => {
            let line = &mut lines[at];
            let place = random.index(line.len() - 1);
            line[place] ^= 1 << random.index(8);
        }
        // Changes the line and recomputes its checksum.
        1 => {
            let text = String::from_utf8(lines[at].clone()).unwrap();
            let open = text.split(",\"crc\"").next().unwrap();
            let other = if open.contains("\"anna\"") {
                open.replace("\"anna\"", "\"otto\"")
            } else {
                open.replace("\"b1\"", "\"b9\"")
            };
            assert_ne!(open, other);
            lines[at] = seal(&(other + "}")).into_bytes();
        }
        2 => {
            lines.remove(at);
        }
        3 => lines.swap(at, at + 1),
        4 => {
            let copy = lines[random.index(at.max(1))].clone();
            lines.insert(at, copy);
        }
        5 => lines.insert(at, seal("{\"event\":\"request\",\"n\":7}").into_bytes()),
        _ => {
            let keep = 1 + random.index(lines[at].len() - 2);
            lines[at].truncate(keep);
            lines.truncate(at + 1);
        }
    }
}

#[test]
fn changed_removed_inserted_or_moved_line_found_and_chain_continues() {
    let mut random = Random(11);
    for round in 0..70 {
        let folder = tempfile::tempdir().unwrap();
        journal(folder.path(), 30, 1500);
        let files = (0..8)
            .filter(|age| journal_file_path(folder.path(), *age).exists())
            .count();
        let age = random.index(files);
        let path = journal_file_path(folder.path(), age);
        let mut lines = lines(&path);
        let kind = round % CHANGES;
        let at = 1 + random.index(lines.len().saturating_sub(2).max(1));
        let at = at.min(lines.len() - 1);
        if kind == 3 && at + 1 >= lines.len() {
            continue;
        }
        let last = at + 1 >= lines.len();
        change(&mut random, kind, &mut lines, at);
        fs::write(&path, lines.concat()).unwrap();
        let found = breaks(folder.path());
        let context = format!("round {round}, kind {kind}, {}:{}", path.display(), at + 1);
        let first = found
            .first()
            .unwrap_or_else(|| panic!("{context}: nothing is found"));
        if last && matches!(kind, 2) {
            // A missing line is reported in the next file, or at the end of the journal.
            assert!(found.len() == 1, "{context}: {found:#?}");
        } else {
            assert_eq!(
                (&first.path, first.line),
                (&path, Some(at as u64 + 1)),
                "{context}: {found:#?}"
            );
        }
        start(folder.path());
        let after = verify(folder.path(), None).unwrap();
        assert!(!after.is_whole(), "{context}: forgotten by the next start");
        // Lines written after the break are chained again.
        let again = verify(folder.path(), None).unwrap();
        start(folder.path());
        let later = verify(folder.path(), None).unwrap();
        assert_eq!(again.breaks.len(), later.breaks.len(), "{context}");
    }
}

#[test]
fn files_that_somebody_removed_are_told_from_those_that_rotation_removed() {
    for age in 0..8 {
        let folder = tempfile::tempdir().unwrap();
        journal(folder.path(), 60, 1500);
        assert_eq!(breaks(folder.path()), []);
        fs::remove_file(journal_file_path(folder.path(), age)).unwrap();
        let found = breaks(folder.path());
        assert_eq!(found.len(), 1, "{age}: {found:#?}");
        assert!(found[0].what.contains("missing"), "{found:#?}");
        start(folder.path());
        assert!(!breaks(folder.path()).is_empty(), "{age}");
    }
    let folder = tempfile::tempdir().unwrap();
    journal(folder.path(), 60, 1500);
    for age in 0..8 {
        fs::remove_file(journal_file_path(folder.path(), age)).unwrap();
    }
    let found = breaks(folder.path());
    assert!(
        found[0].what.contains("the newest known line was number 59"),
        "{found:#?}"
    );
    start(folder.path());
    let found = breaks(folder.path());
    assert!(found[0].what.contains("a new chain begins"), "{found:#?}");
}

#[test]
fn missing_newest_lines_found_by_anchor_and_by_recorded_head() {
    let folder = tempfile::tempdir().unwrap();
    journal(folder.path(), 20, 100_000);
    let head = verify(folder.path(), None).unwrap().head.unwrap().to_string();
    for noted in [head.clone(), head[..16].to_owned(), head.to_uppercase()] {
        assert!(verify(folder.path(), Some(&noted)).unwrap().is_whole());
    }
    let path = journal_file_path(folder.path(), 0);
    let kept = lines(&path)[..15].concat();
    fs::write(&path, &kept).unwrap();
    let found = breaks(folder.path());
    assert!(
        found[0].what.contains("the newest known line was number 19"),
        "{found:#?}"
    );
    assert_eq!(found[0].line, Some(15));
    // The second break is found without the anchor, too.
    fs::remove_file(folder.path().join("anchor")).unwrap();
    assert!(breaks(folder.path())[0].what.contains("anchor is missing"));
    // Only the noted head reveals that a complete new journal has replaced the previous one.
    let other = tempfile::tempdir().unwrap();
    journal(other.path(), 15, 100_000);
    assert_eq!(breaks(other.path()), []);
    let found = verify(other.path(), Some(&head)).unwrap();
    assert!(!found.is_whole() && found.breaks[0].what.contains(&head));
}

#[test]
fn lines_without_a_chain_are_damaged_and_begin_a_new_chain_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let foreign = seal("{\"event\":\"boot\",\"n\":1}") + "{\"event\":\"boot\"}\n";
    fs::write(journal_file_path(folder.path(), 0), foreign).unwrap();
    let found = verify(folder.path(), None).unwrap();
    assert_eq!(
        (found.chained, found.breaks.len(), found.is_whole()),
        (0, 2, false)
    );
    let warnings: Vec<String> = start(folder.path()).warnings().collect();
    assert!(
        warnings[0].contains("2 damaged lines") && warnings[1].contains("a new chain of lines begins"),
        "{warnings:?}"
    );
    let found = verify(folder.path(), None).unwrap();
    assert_eq!((found.chained, found.is_whole()), (1, false));
}

#[test]
fn a_journal_is_whole_while_it_is_written_and_rotated() {
    let folder = tempfile::tempdir().unwrap();
    journal(folder.path(), 1, 1500);
    let path = folder.path().to_owned();
    let writer = std::thread::spawn(move || journal(&path, 600, 4000));
    while !writer.is_finished() {
        let found = verify(folder.path(), None).unwrap();
        assert!(found.is_whole(), "{:#?}", found.breaks);
    }
    writer.join().unwrap();
}
