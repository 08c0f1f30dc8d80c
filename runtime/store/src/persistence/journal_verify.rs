//! Verifies the chain of a journal, and names each location where a line was changed, removed, inserted or moved.

use std::io;
use std::path::PathBuf;

use serde_json::Value;

use super::chain::{Anchor, AnchorRead, ChainMark, Ending, Hash, LinkedLine, parse_line};
use super::journal_reader::{LineLocation, OpenedJournalFile, TRIES_MAX, open, read_lines};
use crate::disk::DiskPath;

/// Maximum number of breaks that are listed; further breaks are only counted.
const BREAKS_MAX: usize = 100;

/// Advice for lines that differ from those written.
const COMPARE: &str = "compare with a copy of the journal, and find out who could write here";

/// Result of verifying the chain of a journal.
#[derive(Debug, Default)]
pub struct ChainVerification {
    /// Number of chained lines.
    pub chained: u64,
    /// Time of the first line.
    pub first: Option<String>,
    /// Time of the last line.
    pub last: Option<String>,
    /// Locations where the chain is broken.
    pub breaks: Vec<Break>,
    /// Number of breaks that are not listed.
    pub more: u64,
    /// Notes that do not describe a break.
    pub notes: Vec<String>,
    /// Hash of the newest line, which covers all lines.
    pub head: Option<Hash>,
}

/// A location where a chain is broken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Break {
    /// The file, or the folder if no single file is concerned.
    pub path: PathBuf,
    /// Line number, from 1; `None` if the break concerns the file as a whole.
    pub line: Option<u64>,
    /// Description of the fault.
    pub what: String,
    /// Advice for the user.
    pub advice: &'static str,
}

/// Verifies the chain of the journal in a folder. `noted` is the hash of a line that must be in the journal,
/// or at least the first 16 digits of that hash.
///
/// # Errors
/// Returns an error if the folder does not exist.
pub fn verify(folder: &DiskPath, noted: Option<&str>) -> io::Result<ChainVerification> {
    let Snapshot { anchor, first, files } = Snapshot::from_folder(folder)?;
    let mut walk = Walk {
        anchor: anchor.there().cloned(),
        first,
        noted: noted.map(str::to_ascii_lowercase),
        before: Predecessor::Nothing,
        file: None,
        at: LineLocation {
            path: folder.as_path().to_owned(),
            line: 0,
        },
        has_anchored: false,
        has_noted: false,
        found: ChainVerification::default(),
    };
    let unreadable = read_lines(files, &mut |place, ending, line| walk.line(place, ending, line));
    for (path, error) in unreadable {
        walk.found.add(Break {
            path,
            line: None,
            what: format!("the file cannot be read: {error}"),
            advice: "check its access rights and the disk",
        });
    }
    walk.check_end(folder, &anchor);
    Ok(walk.found)
}

/// The opened files of a journal and its anchor; a runtime may be writing the files.
struct Snapshot {
    /// Anchor, read before the files were opened: the files must contain the anchor's line.
    anchor: AnchorRead,
    /// Number of the oldest file that must exist. It is read after the files were opened, because rotation
    /// may have removed files in the meantime.
    first: Option<u64>,
    files: Vec<OpenedJournalFile>,
}

impl Snapshot {
    fn from_folder(folder: &DiskPath) -> io::Result<Self> {
        let mut tries = 0;
        loop {
            let (anchor, files, after) = (Anchor::read(folder), open(folder)?, Anchor::read(folder));
            tries += 1;
            let file = |read: &AnchorRead| read.there().map(|anchor| anchor.file);
            let has_rotated = file(&anchor) != file(&after);
            if !has_rotated || tries >= TRIES_MAX {
                let first = after.there().map(|anchor| anchor.first);
                return Ok(Self { anchor, first, files });
            }
        }
    }
}

impl ChainVerification {
    /// Returns true if the journal has a chain without breaks.
    pub fn is_whole(&self) -> bool {
        self.breaks.is_empty() && self.chained > 0
    }

    fn add(&mut self, found: Break) {
        if self.breaks.len() < BREAKS_MAX {
            self.breaks.push(found);
        } else {
            self.more += 1;
        }
    }
}

/// The expected predecessor of the next line in the chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Predecessor {
    /// No chained line was read yet.
    Nothing,
    Line(Hash),
    /// The predecessor is a damaged line, so its hash is unknown.
    Unknown,
}

/// State of the pass over all lines.
struct Walk {
    anchor: Option<Anchor>,
    /// Number of the oldest file that must exist.
    first: Option<u64>,
    noted: Option<String>,
    before: Predecessor,
    /// Number of the file that is being read.
    file: Option<u64>,
    at: LineLocation,
    has_anchored: bool,
    has_noted: bool,
    found: ChainVerification,
}

impl Walk {
    fn line(&mut self, place: &LineLocation, ending: Ending, line: &[u8]) {
        self.at.clone_from(place);
        match (ending, parse_line(line)) {
            (Ending::Cut, _) => {
                self.broken(
                    "the last line is cut short",
                    "a power failure or a person has cut the line; the next start removes it",
                );
                self.before = Predecessor::Unknown;
            }
            (Ending::TooLong, _) | (_, None) => {
                self.broken("the line is damaged", COMPARE);
                self.before = Predecessor::Unknown;
            }
            (_, Some(line)) => self.linked(&line),
        }
    }

    fn linked(&mut self, line: &LinkedLine<'_>) {
        let LinkedLine {
            value, open, hash, ..
        } = line;
        let hash = *hash;
        self.found.chained += 1;
        self.time(value);
        match ChainMark::from_line(value) {
            Some(mark) => {
                if mark.base().then(open) != hash {
                    self.broken("the line was changed", COMPARE);
                }
                self.mark(&mark);
                self.file = Some(mark.file);
            }
            None => match self.before {
                Predecessor::Nothing => self.broken("lines before this one are missing", COMPARE),
                Predecessor::Line(before) if before.then(open) != hash => self.broken(
                    "the line does not follow the one before it: one of them was changed, or lines were removed, inserted or moved",
                    COMPARE,
                ),
                Predecessor::Line(_) | Predecessor::Unknown => {}
            },
        }
        self.before = Predecessor::Line(hash);
        self.found.head = Some(hash);
        self.has_anchored |= self.anchor.as_ref().is_some_and(|anchor| anchor.hash == hash);
        let is_noted = |noted: &String| hash.to_string().starts_with(noted.as_str());
        self.has_noted |= self.noted.as_ref().is_some_and(is_noted);
    }

    /// Processes a line that marks the beginning of a file or of the chain.
    fn mark(&mut self, mark: &ChainMark) {
        let why = mark.why.as_deref().unwrap_or("there was no journal");
        let is_first = self.before == Predecessor::Nothing;
        match mark.before {
            None if is_first && mark.file == 1 => {
                if mark.why.is_some() {
                    let note = format!(
                        "{}:{}: the chain begins: {why}",
                        self.at.path.display(),
                        self.at.line
                    );
                    self.found.notes.push(note);
                }
            }
            None => {
                let what = format!("a new chain begins: {why}");
                self.broken(
                    &what,
                    "earlier lines cannot be verified; compare with a copy of the journal",
                );
            }
            Some(_) if is_first => {
                let missing = self.first.filter(|first| *first < mark.file);
                if let Some(first) = missing {
                    let what = format!(
                        "files {first} to {} of the journal are missing, and rotation did not remove them",
                        mark.file - 1
                    );
                    self.broken(&what, COMPARE);
                }
            }
            Some(before) => {
                let is_next = self.file.is_none_or(|file| file + 1 == mark.file);
                if !is_next {
                    let what = format!(
                        "file {} follows file {}: files between them are missing or were moved",
                        mark.file,
                        self.file.unwrap_or_default()
                    );
                    self.broken(&what, COMPARE);
                } else if matches!(self.before, Predecessor::Line(last) if last != before) {
                    self.broken(
                        "lines at the end of the file before this one are missing or were changed",
                        COMPARE,
                    );
                }
            }
        }
    }

    fn time(&mut self, value: &Value) {
        let ts = value["ts"].as_str().map(ToOwned::to_owned);
        self.found.first = self.found.first.take().or_else(|| ts.clone());
        self.found.last = ts.or_else(|| self.found.last.take());
    }

    fn broken(&mut self, what: &str, advice: &'static str) {
        self.found.add(Break {
            path: self.at.path.clone(),
            line: (self.at.line > 0).then_some(self.at.line),
            what: what.to_owned(),
            advice,
        });
    }

    fn check_end(&mut self, folder: &DiskPath, read: &AnchorRead) {
        let has_chain = self.found.chained > 0;
        match read {
            AnchorRead::There(anchor) if anchor.hash != Hash::ORIGIN && !self.has_anchored => {
                let what = format!(
                    "lines after this one are missing: the newest known line was number {}, with hash {}",
                    anchor.n, anchor.hash
                );
                self.broken(
                    &what,
                    "the lines were removed, or the folder was copied while the machine wrote; compare with \
                     a copy",
                );
            }
            AnchorRead::There(_) => {}
            AnchorRead::Missing if !has_chain => {}
            AnchorRead::Missing | AnchorRead::Damaged => {
                let how = match read {
                    AnchorRead::Missing => "missing",
                    _ => "damaged",
                };
                self.found.add(Break {
                    path: folder.join("anchor").as_path().to_owned(),
                    line: None,
                    what: format!(
                        "the anchor is {how}, so it is unknown whether newer lines or older files existed"
                    ),
                    advice: "the next start writes a new anchor; compare with a copy of the journal",
                });
            }
        }
        if let Some(noted) = self.noted.clone().filter(|_| !self.has_noted) {
            let what = format!("no line has the hash {noted}");
            self.broken(
                &what,
                "lines up to this hash were changed or removed, or rotation has removed them: check the \
                 time of the first line",
            );
        }
    }
}

#[cfg(test)]
mod tests;
