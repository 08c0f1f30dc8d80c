//! Determines where the chain of a journal continues when the runtime opens the journal, or why a new chain
//! begins. Any result allows the machine to start.

use std::io::{self, BufReader};

use super::chain::{Anchor, AnchorRead, ChainMark, Ending, Hash, journal_file_path, next_line, parse_line};
use crate::disk::{DiskPath, OpenMode, number, open_regular};

/// The state of the chain at the end of a journal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Head {
    /// Hash of the newest line.
    pub hash: Hash,
    /// Number of the newest line.
    pub n: u64,
    /// Number of the newest file.
    pub file: u64,
    /// Number of the oldest file that must exist.
    pub first: u64,
}

impl Head {
    /// Returns the anchor to record outside of the files.
    pub fn anchor(&self) -> Anchor {
        Anchor {
            hash: self.hash,
            n: self.n,
            file: self.file,
            first: self.first,
        }
    }
}

/// Continuation of the chain.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ChainContinuation {
    pub head: Head,
    /// The line that begins the file or the chain; `None` if the file continues.
    pub mark: Option<ChainMark>,
    /// True if lines that were written earlier may be missing.
    pub may_lack_lines: bool,
}

/// The last line of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Last {
    None,
    Linked(Hash, u64),
    Damaged,
}

/// Data of the chain in one file.
struct Scan {
    last: Last,
    /// Number of the journal file.
    file: Option<u64>,
    /// True if the file contains the line that the caller searches for.
    has_sought: bool,
}

impl Scan {
    fn from_file(path: &DiskPath, sought: Option<Hash>) -> io::Result<Self> {
        let mut scan = Self {
            last: Last::None,
            file: None,
            has_sought: false,
        };
        let file = match open_regular(path, OpenMode::Read) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(scan),
            Err(error) => return Err(error),
        };
        let (mut reader, mut line) = (BufReader::new(file), Vec::new());
        while let Some(ending) = next_line(&mut reader, &mut line)? {
            scan.last = match (ending, parse_line(&line)) {
                (Ending::Whole, Some(line)) => {
                    scan.file = ChainMark::from_line(&line.value)
                        .map(|mark| mark.file)
                        .or(scan.file);
                    scan.has_sought |= Some(line.hash) == sought;
                    Last::Linked(line.hash, number(&line.value))
                }
                _ => Last::Damaged,
            };
        }
        Ok(scan)
    }
}

/// Finds the end of the chain in a folder. `is_cut`: the last line was incomplete and has been removed.
///
/// # Errors
/// Returns an error if the newest file cannot be read.
pub(super) fn resume(folder: &DiskPath, is_cut: bool) -> io::Result<ChainContinuation> {
    let read = Anchor::read(folder);
    let anchor = read.there();
    let sought = anchor.map(|anchor| anchor.hash);
    let newest = Scan::from_file(&journal_file_path(folder, 0), sought)?;
    // If an older file cannot be read, it is treated as damaged.
    let older = Scan::from_file(&journal_file_path(folder, 1), sought).unwrap_or(Scan {
        last: Last::Damaged,
        file: None,
        has_sought: false,
    });
    let is_new = newest.last == Last::None;
    let last = if is_new { older.last } else { newest.last };
    let has_sought = sought == Some(Hash::ORIGIN) || newest.has_sought || older.has_sought;
    let known = anchor.map(|anchor| anchor.file);
    let after_older = older.file.filter(|_| is_new).map(|file| file + 1);
    let file = newest.file.or(after_older).or(known).unwrap_or(1);
    let begins = |why: Option<String>| ChainMark {
        file,
        before: None,
        why,
    };
    let mark = match (last, &read) {
        _ if is_cut => Some(begins(Some("the last line was cut short".to_owned()))),
        (Last::Damaged, _) => Some(begins(Some("the last line is damaged".to_owned()))),
        (Last::None, AnchorRead::Missing) => Some(begins(None)),
        (_, AnchorRead::Missing | AnchorRead::Damaged) => Some(begins(Some(
            "the anchor is missing or damaged, so it is unknown whether there were newer lines".to_owned(),
        ))),
        (_, AnchorRead::There(anchor)) if !has_sought => Some(begins(Some(format!(
            "newer lines existed: number {} was the newest known line",
            anchor.n
        )))),
        (Last::None, AnchorRead::There(_)) => Some(begins(None)),
        (Last::Linked(hash, _), AnchorRead::There(_)) => is_new.then_some(ChainMark {
            file,
            before: Some(hash),
            why: None,
        }),
    };
    // If a kill cut the last line short, no complete line is missing.
    let may_lack_lines = !is_cut && mark.as_ref().is_some_and(|mark| mark.why.is_some());
    let (hash, n) = match (&mark, last) {
        (None | Some(ChainMark { before: Some(_), .. }), Last::Linked(hash, n)) => (hash, n),
        _ => (Hash::ORIGIN, 0),
    };
    let first = anchor.map_or(file, |anchor| anchor.first.min(file));
    Ok(ChainContinuation {
        head: Head { hash, n, file, first },
        mark,
        may_lack_lines,
    })
}
