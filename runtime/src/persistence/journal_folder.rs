//! The journal's files: lines of JSON in files of bounded size.
//!
//! `journal.jsonl` is the newest file, `journal.1.jsonl` the one before it, and so on; the oldest is removed. If a kill
//! cut a line short, it is removed when the journal is opened again, so every line is complete. Lines are chained by
//! hashes (`chain`).

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read as _, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use plc_api::types::{BootId, Timestamp};
use serde_json::{Value, json};
use tokio::time::Instant;

use super::ahead::Rest;
use super::chain::{ChainMark, LINK_BYTES, journal_file_path, link, tidy_up};
use super::positions::RestPositions;
use super::resume::{ChainContinuation, Head, resume};
use crate::clock::time_of_day;
use crate::disk::fs::{self, File, OpenOptions};
use crate::disk::{
    Generations, Identity, LineContent, PartGenerations, SealedFileKind, StoredPart, make_folder_in, number,
    open_regular, read, read_regular, sync_folder, tighten,
};

/// The folder of the journal in `data_dir`.
pub(crate) const JOURNAL_FOLDER: &str = "journal";

/// Size at which a new file of the journal is begun, in bytes.
pub(super) const FILE_BYTES_MAX: u64 = 4 << 20;

/// Replaces the boot identifier in lines that a command has written.
pub(super) const COMMAND_LINE: &str = "command-line";

/// Maximum number of files of the journal, including the newest; the oldest is removed.
pub(super) const FILES_MAX: usize = 8;

/// Longest time between two anchors while lines are written continuously. Reason: an outdated copy of a file is
/// recognized by the anchor, and each anchor adds another wait for the disk.
const ANCHOR_EVERY: Duration = Duration::from_secs(10);

/// Maximum bytes read of a file of the journal: one write may exceed [`FILE_BYTES_MAX`].
const FILE_READ_MAX: u64 = 64 << 20;

/// The newest lines of a journal.
#[derive(Debug, Default)]
pub(crate) struct Newest {
    /// In the order of writing.
    pub lines: Vec<Value>,
    /// Number of damaged lines by file; they are omitted.
    pub damaged: BTreeMap<PathBuf, u64>,
    /// Files that cannot be read, with the reason.
    pub unreadable: BTreeMap<PathBuf, String>,
    /// Reason why a new chain begins at this start although a chain exists.
    pub why_anew: Option<String>,
    /// Rest positions of a coordinate system's axes at the end of the previous start of the runtime, by motor number.
    pub rests: RestPositions,
}

impl Newest {
    /// Returns warnings for a person.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let damaged = self.damaged.iter();
        let damaged = damaged.map(|(path, lines)| {
            let path = path.display();
            format!("{path}: {lines} damaged lines are skipped; the machine does not need them")
        });
        let unreadable = self.unreadable.iter();
        let unreadable =
            unreadable.map(|(path, why)| format!("{}: it cannot be read: {why}", path.display()));
        let anew = self.why_anew.iter();
        let anew = anew.map(|why| format!("a new chain of lines begins: {why}; run tandem journal verify"));
        damaged.chain(unreadable).chain(anew)
    }

    /// Returns those of `lines` that are missing here. A line older than all lines read is not reported as
    /// missing, because it may have been omitted.
    pub(super) fn missing(&self, mut lines: Vec<Value>) -> Vec<Value> {
        let there: BTreeSet<u64> = self.lines.iter().map(number).collect();
        let first = there.first().copied().unwrap_or(0);
        lines.retain(|line| number(line) >= first && !there.contains(&number(line)));
        lines
    }

    /// Returns the rest positions that are still valid: written during the last start of the runtime, with no later
    /// run.
    pub(super) fn hold(&self, rests: Vec<Rest>) -> RestPositions {
        let mut boots = self.lines.iter().rev().map(|line| &line["boot_id"]);
        let last = boots.find(|boot| **boot != COMMAND_LINE);
        let has_begun = |rest: &Rest| {
            let later = self
                .lines
                .iter()
                .rev()
                .take_while(|line| number(line) > rest.after);
            let mut of_cs = later.filter(|line| line["cs"] == rest.cs);
            of_cs.any(|line| line["event"] == "start")
        };
        let hold = rests
            .into_iter()
            .filter(|rest| last.is_some_and(|last| *last == rest.boot_id.0) && !has_begun(rest));
        hold.filter_map(|rest| Some((rest.cs, rest.positions?))).collect()
    }

    /// Returns the time of the newest line.
    pub fn time(&self) -> Option<Timestamp> {
        let ts = self.lines.iter().rev().find_map(|line| line["ts"].as_str())?;
        Some(Timestamp(ts.to_owned()))
    }
}

/// Reads the newest `count` lines of the journal of a folder, except for the `from` newest. Unreadable lines are
/// omitted.
pub(crate) fn newest(folder: &Path, from: usize, count: usize) -> Newest {
    let (mut newest, wanted) = (Newest::default(), from.saturating_add(count));
    for age in 0..FILES_MAX {
        if newest.lines.len() >= wanted {
            break;
        }
        let path = journal_file_path(folder, age);
        let bytes = match read_regular(&path, FILE_READ_MAX) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => {
                newest.unreadable.insert(path, error.to_string());
                continue;
            }
        };
        let mut lines = bytes.split(|byte| *byte == b'\n').rev();
        // The last line may still be incomplete.
        lines.next();
        for line in lines {
            if newest.lines.len() >= wanted {
                break;
            }
            match read(SealedFileKind::Journal, line) {
                LineContent::Whole(line) => newest.lines.push(line),
                LineContent::Damaged => *newest.damaged.entry(path.clone()).or_default() += 1,
            }
        }
    }
    newest.lines.drain(..from.min(newest.lines.len()));
    newest.lines.reverse();
    newest
}

/// A line before it is linked into the chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Object {
    n: u64,
    text: String,
}

impl Object {
    /// Creates the line from a JSON object with its number.
    pub fn from_json(line: &Value) -> Self {
        Self {
            n: number(line),
            text: line.to_string(),
        }
    }
}

/// Writer of the journal's own lines, which have the next numbers.
#[derive(Debug, Clone)]
pub(super) struct Own {
    pub boot_id: BootId,
    /// Start time of the writer, from which `t_s` of its lines counts.
    pub started: Instant,
    /// Number of the last line.
    pub last: Arc<AtomicU64>,
    pub generations: Arc<Generations>,
}

impl Own {
    /// Creates a line with the current time, as a JSON object.
    pub fn line(&self, mut event: Value) -> Object {
        event["boot_id"] = json!(self.boot_id);
        event["cs"] = json!(0);
        event["n"] = json!(self.last.fetch_add(1, Ordering::Relaxed) + 1);
        event["t_s"] = json!(self.started.elapsed().as_secs_f64());
        event["ts"] = json!(Timestamp::from_system_time(time_of_day()));
        Object::from_json(&event)
    }
}

/// The files of a journal.
#[derive(Debug)]
pub(super) struct Files {
    folder: PathBuf,
    newest: File,
    bytes: u64,
    bytes_max: u64,
    head: Head,
    /// Content of the anchor.
    anchored: Head,
    /// Generations of other parts on disk when the anchor was written.
    anchored_known: PartGenerations,
    anchored_at: Instant,
    own: Own,
    /// Reason why a new chain begins although a chain exists; `None` if the chain continues.
    pub why_anew: Option<String>,
}

impl Files {
    /// Opens the files. A missing folder is created, but not its parents: if they were removed, an error is more useful
    /// than new ones. If the chain cannot continue, a new one begins with a line that states the reason.
    pub(super) fn open(folder: &Path, bytes_max: u64, own: Own) -> io::Result<Self> {
        make_folder_in(folder).map_err(|error| name_file_in_error(folder, &error))?;
        for age in 0..FILES_MAX {
            tighten(&journal_file_path(folder, age));
        }
        tidy_up(folder).map_err(|error| name_file_in_error(folder, &error))?;
        let path = journal_file_path(folder, 0);
        let (newest, bytes, is_cut) = open_whole(&path).map_err(|error| name_file_in_error(&path, &error))?;
        let ChainContinuation {
            head,
            mark,
            may_lack_lines,
        } = resume(folder, is_cut).map_err(|error| name_file_in_error(&path, &error))?;
        let mut files = Self {
            folder: folder.to_owned(),
            newest,
            bytes,
            bytes_max,
            anchored: head.clone(),
            anchored_known: PartGenerations::new(),
            anchored_at: Instant::now(),
            head,
            own,
            why_anew: None,
        };
        // also with a mark: lines found later were then written after the anchor
        let begun = files.anchor().and_then(|()| match &mark {
            Some(mark) => files.write_mark(mark),
            None => Ok(()),
        });
        begun.map_err(|error| name_file_in_error(&path, &error))?;
        files.why_anew = mark.filter(|_| may_lack_lines).and_then(|mark| mark.why);
        Ok(files)
    }

    /// Begins a file or a chain.
    fn write_mark(&mut self, mark: &ChainMark) -> io::Result<()> {
        let line = self.own.line(mark.to_json());
        self.write(&[line])
    }

    /// Writes lines; they are on disk when this returns.
    pub(super) fn append(&mut self, lines: &[Object]) -> io::Result<()> {
        let path = journal_file_path(&self.folder, 0);
        let appended = self.append_to(&path, lines);
        appended.map_err(|error| name_file_in_error(&path, &error))
    }

    fn append_to(&mut self, path: &Path, lines: &[Object]) -> io::Result<()> {
        Identity::from_file(&self.newest)?.check(path)?;
        if lines.is_empty() {
            return Ok(());
        }
        let with_seal = LINK_BYTES + self.seal()?.len() as u64;
        let bytes: u64 = lines.iter().map(|line| line.text.len() as u64 + with_seal).sum();
        if self.bytes > 0 && self.bytes + bytes > self.bytes_max {
            self.begin_file()?;
        }
        self.write(lines)
    }

    /// Returns the seal of a line, as its first field.
    fn seal(&self) -> io::Result<String> {
        let seal = self.own.generations.plain_seal(SealedFileKind::Journal);
        Ok(format!("\"seal\":{},", serde_json::to_string(&seal)?))
    }

    fn write(&mut self, lines: &[Object]) -> io::Result<()> {
        let (mut text, mut head) = (String::new(), self.head.clone());
        let seal = self.seal()?;
        for line in lines {
            let object = line.text.strip_prefix('{').unwrap_or_default();
            let (linked, hash) = link(head.hash, &format!("{{{seal}{object}"));
            text += &linked;
            (head.hash, head.n) = (hash, line.n);
        }
        if let Err(error) = self.newest.write_all(text.as_bytes()) {
            // The next line must not follow a fragment of this one.
            self.newest.set_len(self.bytes)?;
            return Err(error);
        }
        self.bytes += text.len() as u64;
        self.head = head;
        self.newest.sync_data()
    }

    /// Writes the newest line to the anchor. It is on disk when this returns.
    pub(super) fn anchor(&mut self) -> io::Result<()> {
        let known = self.own.generations.on_disk();
        self.head.anchor().write(&self.folder, &self.own.generations)?;
        self.anchored = self.head.clone();
        self.anchored_known = known;
        self.anchored_at = Instant::now();
        Ok(())
    }

    /// Returns true if the anchor must be written although lines are still being written.
    pub(super) fn is_anchor_overdue(&self) -> bool {
        self.anchored_at.elapsed() >= ANCHOR_EVERY
    }

    /// Returns true if the anchor lacks the newest line, or the newest generation of another part.
    pub(super) fn is_ahead_of_anchor(&self) -> bool {
        let mut known = self.own.generations.on_disk();
        let mut anchored = self.anchored_known.clone();
        known.remove(&StoredPart::Journal);
        anchored.remove(&StoredPart::Journal);
        self.anchored != self.head || anchored != known
    }

    fn begin_file(&mut self) -> io::Result<()> {
        let mark = ChainMark {
            file: self.head.file + 1,
            before: Some(self.head.hash),
            why: None,
        };
        // before the oldest file is removed: files missing after a kill were then removed by rotation
        self.head.file = mark.file;
        let kept = FILES_MAX as u64 - 1;
        self.head.first = self.head.first.max(mark.file.saturating_sub(kept));
        self.anchor()?;
        for age in (0..FILES_MAX - 1).rev() {
            match fs::rename(
                journal_file_path(&self.folder, age),
                journal_file_path(&self.folder, age + 1),
            ) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        (self.newest, self.bytes, _) = open_whole(&journal_file_path(&self.folder, 0))?;
        sync_folder(&self.folder)?;
        let line = self.own.line(mark.to_json());
        self.write(&[line])
    }
}

/// Creates an error that names its file.
fn name_file_in_error(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Opens a file for appending and removes an incomplete line that a kill has left at its end. The result is true if
/// such a line existed.
fn open_whole(path: &Path) -> io::Result<(File, u64, bool)> {
    let mut file = open_regular(path, OpenOptions::new().create(true).read(true).append(true))?;
    let length = file.metadata()?.len();
    // lines are far shorter than this; longer text is not a line
    let tail = length.min(1 << 20);
    file.seek(SeekFrom::Start(length - tail))?;
    let mut text = Vec::new();
    file.read_to_end(&mut text)?;
    let end = text.iter().rposition(|byte| *byte == b'\n');
    let whole = end.map_or(0, |end| end + 1);
    let whole = length - tail + whole as u64;
    file.set_len(whole)?;
    Ok((file, whole, whole < length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disk::seal;

    fn open(folder: &Path, bytes_max: u64) -> Files {
        let own = Own {
            boot_id: BootId("b1".to_owned()),
            started: Instant::now(),
            last: Arc::default(),
            generations: Arc::default(),
        };
        Files::open(folder, bytes_max, own).unwrap()
    }

    fn line(n: usize) -> Object {
        Object::from_json(&json!({"n": n, "text": "0123456789"}))
    }

    /// Returns the numbers of the lines, except for those of the chain itself.
    fn numbers(lines: &[Value]) -> Vec<u64> {
        let others = lines.iter().filter(|line| line["event"] != "chain");
        others.map(number).collect()
    }

    #[test]
    fn where_axes_rested_holds_for_the_last_start_and_until_a_run_began() {
        let line = |n: u64, boot: &str, cs: u8, event: &str| json!({"n": n, "boot_id": boot, "cs": cs, "event": event});
        let rest = |boot: &str, after| Rest {
            cs: 1,
            boot_id: BootId(boot.to_owned()),
            after,
            positions: Some([(7, 1.5)].into()),
        };
        let holds = |lines: &[Value], rest: Rest| {
            let newest = Newest {
                lines: lines.to_vec(),
                ..Newest::default()
            };
            newest.hold(vec![rest]).contains_key(&1)
        };
        let mut lines = vec![
            line(1, "b1", 1, "boot"),
            line(2, "b1", 1, "start"),
            line(3, "b1", 1, "end"),
        ];
        assert!(holds(&lines, rest("b1", 2)));
        assert!(!holds(&lines, rest("b1", 1)), "a run began since");
        assert!(!holds(&lines, rest("b0", 2)), "of an earlier start");
        lines.push(line(4, COMMAND_LINE, 0, "request"));
        lines.push(line(5, "b1", 2, "start"));
        assert!(holds(&lines, rest("b1", 2)), "of another coordinate system");
        lines.push(line(6, "b2", 1, "boot"));
        assert!(!holds(&lines, rest("b1", 2)), "another start came since");
    }

    #[test]
    fn the_newest_lines_are_read_across_files_in_the_order_of_time() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(newest(folder.path(), 0, 10).lines, Vec::<Value>::new());
        let mut files = open(folder.path(), 10_000);
        for n in 0..30 {
            files.bytes_max = if n == 15 { 1 } else { 10_000 };
            files.append(&[line(n)]).unwrap();
        }
        files.newest.write_all(b"{\"n\":").unwrap();
        let read = |from, count| numbers(&newest(folder.path(), from, count).lines);
        assert_eq!(read(0, 3), [27, 28, 29]);
        assert_eq!(read(2, 4), [24, 25, 26, 27]);
        // the first line of the second file lies between both
        assert_eq!(read(13, 4), [14, 15, 16]);
        assert_eq!(read(29, 100), [0, 1]);
        assert_eq!(read(40, 1), Vec::<u64>::new());
    }

    #[test]
    fn a_line_that_was_cut_short_is_taken_away() {
        let folder = tempfile::tempdir().unwrap();
        let old = seal("{\"n\":1}") + &seal("{\"n\":2}");
        fs::write(journal_file_path(folder.path(), 0), format!("{old}{{\"n\"")).unwrap();
        open(folder.path(), 1000).append(&[line(3)]).unwrap();
        assert_eq!(numbers(&newest(folder.path(), 0, 9).lines), [1, 2, 3]);
    }

    #[test]
    fn the_journal_keeps_eight_files_of_a_bounded_size() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = open(folder.path(), 1000);
        for n in 0..100 {
            files.append(&[line(n)]).unwrap();
        }
        let paths = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().path());
        let journals: Vec<_> = paths
            .filter(|path| path.extension().is_some_and(|ending| ending == "jsonl"))
            .collect();
        assert_eq!(journals.len(), FILES_MAX);
        for path in journals {
            let bytes = fs::metadata(&path).unwrap().len();
            assert!((500..=1000).contains(&bytes), "{}: {bytes}", path.display());
        }
        let kept = numbers(&newest(folder.path(), 0, 1000).lines);
        let last: Vec<u64> = (100 - kept.len() as u64..100).collect();
        assert_eq!(kept, last);
    }
}
