//! Reads a whole journal line by line, oldest line first, also while a runtime writes the journal.

use std::io::{self, BufReader};
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use super::chain::{Ending, journal_file_path, next_line, parse_line};
use super::journal_folder::{FILES_MAX, Newest};
use crate::disk::{DiskFile, DiskPath, Identity, OpenMode, open_regular};

/// Maximum number of attempts to open all files while a runtime may be renaming them.
pub(super) const TRIES_MAX: usize = 10;

/// Time between two attempts; a runtime renames all files in less time.
const BETWEEN_TRIES: Duration = Duration::from_millis(5);

/// Time to wait for the rest of a line that a runtime is still writing.
const REST_OF_LINE: Duration = Duration::from_millis(50);

/// Path of a journal file, and the open file or the reason why it cannot be opened.
pub(super) type OpenedJournalFile = (DiskPath, io::Result<Box<dyn DiskFile>>);

/// Location of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct LineLocation {
    pub path: PathBuf,
    /// Line number, from 1.
    pub line: u64,
}

/// Passes each line of a journal's files to `each`. Returns the files that cannot be read, with the reasons.
pub(super) fn read_lines(
    files: Vec<OpenedJournalFile>,
    each: &mut dyn FnMut(&LineLocation, Ending, &[u8]),
) -> Vec<(PathBuf, io::Error)> {
    let mut unreadable = Vec::new();
    for (path, file) in files {
        let read = file.and_then(|file| {
            let mut place = LineLocation {
                path: path.as_path().to_owned(),
                line: 0,
            };
            read_file(file, &mut place, each)
        });
        if let Err(error) = read {
            unreadable.push((path.as_path().to_owned(), error));
        }
    }
    unreadable
}

fn read_file(
    file: Box<dyn DiskFile>,
    place: &mut LineLocation,
    each: &mut dyn FnMut(&LineLocation, Ending, &[u8]),
) -> io::Result<()> {
    let (mut reader, mut line, mut rest) = (BufReader::new(file), Vec::new(), Vec::new());
    while let Some(mut ending) = next_line(&mut reader, &mut line)? {
        if ending == Ending::Cut {
            sleep(REST_OF_LINE);
            if let Some(of_rest) = next_line(&mut reader, &mut rest)? {
                line.append(&mut rest);
                ending = of_rest;
            }
        }
        place.line += 1;
        each(place, ending, &line);
    }
    Ok(())
}

/// Returns the damaged lines and unreadable files of a journal, without keeping lines in memory.
pub fn damage(folder: &DiskPath) -> Newest {
    let mut found = Newest::default();
    let Ok(files) = open(folder) else { return found };
    let mut each = |place: &LineLocation, ending: Ending, line: &[u8]| {
        // A runtime may still be writing the last line.
        let is_damaged = match ending {
            Ending::Whole => parse_line(line).is_none(),
            Ending::TooLong => true,
            Ending::Cut => false,
        };
        if is_damaged {
            *found.damaged.entry(place.path.clone()).or_default() += 1;
        }
    };
    let unreadable = read_lines(files, &mut each);
    let unreadable = unreadable.into_iter().map(|(path, why)| (path, why.to_string()));
    found.unreadable = unreadable.collect();
    found
}

/// Returns the ages of the existing journal files; age 0 is the newest file.
fn ages(folder: &DiskPath) -> Vec<usize> {
    let is_there = |age: &usize| journal_file_path(folder, *age).link_metadata().is_ok();
    (0..FILES_MAX).filter(is_there).collect()
}

/// Opens all files of a journal, oldest first, as they are at one moment. A runtime may rename files
/// meanwhile; then all files are opened again.
///
/// # Errors
/// Returns an error if the folder does not exist.
pub(super) fn open(folder: &DiskPath) -> io::Result<Vec<OpenedJournalFile>> {
    folder.list_folder()?;
    let mut opened = Vec::new();
    for _ in 0..TRIES_MAX {
        let there = ages(folder);
        opened = (0..FILES_MAX)
            .rev()
            .filter(|age| there.contains(age))
            .map(|age| journal_file_path(folder, age))
            .map(|path| {
                let file = open_regular(&path, OpenMode::Read);
                (path, file)
            })
            .collect();
        let has_its_name = |(path, file): &OpenedJournalFile| match file {
            Ok(file) => Identity::from_file(&**file).is_ok_and(|opened| opened.check(path).is_ok()),
            Err(error) => error.kind() != io::ErrorKind::NotFound,
        };
        let is_without_gap = there.iter().copied().eq(0..there.len());
        if is_without_gap && there == ages(folder) && opened.iter().all(has_its_name) {
            break;
        }
        sleep(BETWEEN_TRIES);
    }
    Ok(opened)
}
