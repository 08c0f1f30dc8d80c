//! The journal's files: lines of JSON in files of bounded size.
//!
//! `journal.jsonl` is the newest file, `journal.1.jsonl` the one before it, and so on; the oldest is removed. A line
//! that was cut short by a kill is removed when the journal is opened again, so every line is whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::disk::{
    Identity, Read, make_folder_in, number, open_regular, read, read_regular, sync_folder, tighten,
};

/// The folder of the journal in `data_dir`.
pub(crate) const JOURNAL_FOLDER: &str = "journal";

/// Bytes of one file of the journal; a new one is begun beyond.
pub(super) const FILE_BYTES_MAX: u64 = 4 << 20;

/// Files of the journal, the newest included; the oldest is removed.
const FILES_MAX: usize = 8;

/// Bytes of a file of the journal that are read at the most: one write may go beyond [`FILE_BYTES_MAX`].
const FILE_READ_MAX: u64 = 64 << 20;

/// The newest lines of a journal.
#[derive(Debug, Default)]
pub(crate) struct Newest {
    /// In the order in which they were written.
    pub lines: Vec<Value>,
    /// Lines that are damaged, by their file; they are left out.
    pub damaged: BTreeMap<PathBuf, u64>,
    /// Files that cannot be read, and why.
    pub unreadable: BTreeMap<PathBuf, String>,
}

impl Newest {
    /// What a person should know of it.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let damaged = self.damaged.iter();
        let damaged = damaged.map(|(path, lines)| {
            let path = path.display();
            format!("{path}: {lines} damaged lines are left out; the machine does not need them")
        });
        let unreadable = self.unreadable.iter();
        damaged.chain(unreadable.map(|(path, why)| format!("{}: it cannot be read: {why}", path.display())))
    }

    /// Those of these lines that it lacks.
    pub(super) fn missing(&self, mut lines: Vec<Value>) -> Vec<Value> {
        let there: BTreeSet<u64> = self.lines.iter().map(number).collect();
        lines.retain(|line| !there.contains(&number(line)));
        lines
    }
}

/// The newest `count` lines of the journal of a folder but for the `from` newest. What cannot be read is left out.
pub(crate) fn newest(folder: &Path, from: usize, count: usize) -> Newest {
    let (mut newest, wanted) = (Newest::default(), from.saturating_add(count));
    for age in 0..FILES_MAX {
        if newest.lines.len() >= wanted {
            break;
        }
        let path = place(folder, age);
        let bytes = match read_regular(&path, FILE_READ_MAX) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => {
                newest.unreadable.insert(path, error.to_string());
                continue;
            }
        };
        let mut lines = bytes.split(|byte| *byte == b'\n').rev();
        // The last line may not be written in full yet.
        lines.next();
        for line in lines {
            if newest.lines.len() >= wanted {
                break;
            }
            match read(line) {
                Read::Whole(line) => newest.lines.push(line),
                Read::Damaged => *newest.damaged.entry(path.clone()).or_default() += 1,
            }
        }
    }
    newest.lines.drain(..from.min(newest.lines.len()));
    newest.lines.reverse();
    newest
}

/// The files of a journal.
#[derive(Debug)]
pub(super) struct Files {
    folder: PathBuf,
    newest: File,
    bytes: u64,
    bytes_max: u64,
}

impl Files {
    /// The folder is made if it is missing, but not those above it: who removes these wants an answer, not new ones.
    pub(super) fn open(folder: &Path, bytes_max: u64) -> io::Result<Self> {
        make_folder_in(folder).map_err(|error| of(folder, &error))?;
        for age in 0..FILES_MAX {
            tighten(&place(folder, age));
        }
        let path = place(folder, 0);
        let (newest, bytes) = open_whole(&path).map_err(|error| of(&path, &error))?;
        Ok(Self {
            folder: folder.to_owned(),
            newest,
            bytes,
            bytes_max,
        })
    }

    /// Writes lines; they are on disk when this returns.
    pub(super) fn append(&mut self, lines: &str) -> io::Result<()> {
        let path = place(&self.folder, 0);
        let appended = self.append_to(&path, lines);
        appended.map_err(|error| of(&path, &error))
    }

    fn append_to(&mut self, path: &Path, lines: &str) -> io::Result<()> {
        Identity::of(&self.newest)?.check(path)?;
        if lines.is_empty() {
            return Ok(());
        }
        if self.bytes > 0 && self.bytes + lines.len() as u64 > self.bytes_max {
            self.begin_anew()?;
        }
        if let Err(error) = self.newest.write_all(lines.as_bytes()) {
            // The next line must not follow a part of this one.
            self.newest.set_len(self.bytes)?;
            return Err(error);
        }
        self.bytes += lines.len() as u64;
        self.newest.sync_data()
    }

    fn begin_anew(&mut self) -> io::Result<()> {
        for age in (0..FILES_MAX - 1).rev() {
            match fs::rename(place(&self.folder, age), place(&self.folder, age + 1)) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        (self.newest, self.bytes) = open_whole(&place(&self.folder, 0))?;
        sync_folder(&self.folder)
    }
}

/// An error that names its file.
fn of(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

fn place(folder: &Path, age: usize) -> PathBuf {
    folder.join(match age {
        0 => "journal.jsonl".to_owned(),
        age => format!("journal.{age}.jsonl"),
    })
}

/// Opens a file to append to, without the part of a line that a kill has left at its end.
fn open_whole(path: &Path) -> io::Result<(File, u64)> {
    let mut file = open_regular(path, OpenOptions::new().create(true).read(true).append(true))?;
    let length = file.metadata()?.len();
    // lines are far shorter than this; what is longer is none
    let tail = length.min(1 << 20);
    file.seek(SeekFrom::Start(length - tail))?;
    let mut text = Vec::new();
    file.read_to_end(&mut text)?;
    let end = text.iter().rposition(|byte| *byte == b'\n');
    let whole = end.map_or(0, |end| end + 1);
    let length = length - tail + whole as u64;
    file.set_len(length)?;
    Ok((file, length))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::disk::seal;

    fn content(folder: &Path, age: usize) -> String {
        fs::read_to_string(place(folder, age)).unwrap_or_default()
    }

    /// A whole line.
    fn sealed(n: usize) -> String {
        seal(&json!({"n": n, "text": "0123456789"}).to_string())
    }

    #[test]
    fn the_newest_lines_are_read_across_files_in_the_order_of_time() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = Files::open(folder.path(), 100).unwrap();
        assert_eq!(newest(folder.path(), 0, 10).lines, Vec::<Value>::new());
        for n in 0..10 {
            files.append(&sealed(n)).unwrap();
        }
        files.newest.write_all(b"{\"n\":").unwrap();
        let numbers = |from, count| -> Vec<u64> {
            let lines = newest(folder.path(), from, count).lines;
            lines.iter().map(|line| line["n"].as_u64().unwrap()).collect()
        };
        assert_eq!(numbers(0, 3), [7, 8, 9]);
        assert_eq!(numbers(2, 4), [4, 5, 6, 7]);
        assert_eq!(numbers(8, 100), [0, 1]);
        assert_eq!(numbers(20, 1), Vec::<u64>::new());
    }

    #[test]
    fn a_line_that_was_cut_short_is_taken_away() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(place(folder.path(), 0), "{\"n\":1}\n{\"n\":2}\n{\"n\"").unwrap();
        let mut files = Files::open(folder.path(), 1000).unwrap();
        files.append("{\"n\":3}\n").unwrap();
        assert_eq!(content(folder.path(), 0), "{\"n\":1}\n{\"n\":2}\n{\"n\":3}\n");
    }

    #[test]
    fn the_journal_keeps_eight_files_of_a_bounded_size() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = Files::open(folder.path(), 100).unwrap();
        let line = |n: usize| format!("{n:0>29}\n");
        for n in 0..100 {
            files.append(&line(n)).unwrap();
        }
        // three lines of 30 bytes in each file: 97 to 99 are in the last one but for the one that begins anew
        assert_eq!(content(folder.path(), 0), line(99));
        assert_eq!(content(folder.path(), 1), line(96) + &line(97) + &line(98));
        assert_eq!(content(folder.path(), 7), line(78) + &line(79) + &line(80));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), FILES_MAX);
    }
}
