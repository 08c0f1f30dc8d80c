//! The journal's files: lines of JSON in files of bounded size.
//!
//! `journal.jsonl` is the newest file, `journal.1.jsonl` the one before, and so on; rotation removes the
//! oldest. When the journal is opened, an incomplete last line left by a kill is removed, so every line is
//! complete. Hashes chain the lines (`chain`).

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read as _, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use plc_protocol::types::{BootId, Timestamp};
use serde_json::{Value, json};
use tokio::time::Instant;

use super::ahead::Rest;
use super::chain::{ChainMark, LINK_BYTES, journal_file_path, link, parse_line, tidy_up};
use super::positions::RestPositions;
use super::resume::{ChainContinuation, Head, resume};
use crate::clock::Clock;
use crate::disk::{
    DiskFile, DiskPath, Generations, Identity, OpenMode, PartGenerations, SealedFileKind, StoredPart,
    make_folder_in, number, open_regular, read_regular, sync_folder, tighten,
};

/// The folder of the journal in `data_dir`.
pub const JOURNAL_FOLDER: &str = "journal";

/// File size in bytes at which the journal begins a new file.
pub(super) const FILE_BYTES_MAX: u64 = 4 << 20;

/// Written instead of a boot identifier in lines from a command-line tool.
pub(super) const COMMAND_LINE: &str = "command-line";

/// Maximum number of journal files, including the newest; rotation removes the oldest.
pub(super) const FILES_MAX: usize = 8;

/// Longest time between two anchors while lines are written continuously. Reason: the anchor identifies an
/// outdated copy of a file, but writing it adds a wait for the disk.
const ANCHOR_EVERY: Duration = Duration::from_secs(10);

/// Maximum bytes read of one journal file. A file may exceed [`FILE_BYTES_MAX`], because one write may cross
/// that size.
const FILE_READ_MAX: u64 = 64 << 20;

/// The newest lines of a journal.
#[derive(Debug, Default)]
pub struct Newest {
    /// Lines in the order of writing.
    pub lines: Vec<Value>,
    /// Number of damaged lines in each file; these lines are omitted.
    pub damaged: BTreeMap<PathBuf, u64>,
    /// Number of lines of other machines in each file; a start of the runtime omits these lines.
    pub foreign: BTreeMap<PathBuf, u64>,
    /// Highest number of all lines read, also of lines of other machines.
    pub highest: u64,
    /// Files that cannot be read, with the reason.
    pub unreadable: BTreeMap<PathBuf, String>,
    /// Reason why a new chain began at this start although a chain existed; `None` if lines cannot be
    /// missing.
    pub why_anew: Option<String>,
    /// Rest positions of the axes at the end of the previous start of the runtime, by coordinate system and
    /// motor number.
    pub rests: RestPositions,
}

impl Newest {
    /// Returns warnings to show to a person.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let damaged = self.damaged.iter();
        let damaged = damaged.map(|(path, lines)| {
            let path = path.display();
            format!("{path}: {lines} damaged lines are skipped; the machine does not need them")
        });
        let foreign = self.foreign.iter();
        let foreign = foreign.map(|(path, lines)| {
            let path = path.display();
            format!(
                "{path}: {lines} lines belong to another machine, so this start does not use them; look for a copied \
                 journal, or for a changed name of this machine"
            )
        });
        let unreadable = self.unreadable.iter();
        let unreadable =
            unreadable.map(|(path, why)| format!("{}: it cannot be read: {why}", path.display()));
        let anew = self.why_anew.iter();
        let anew = anew.map(|why| format!("a new chain of lines begins: {why}; run tandem journal verify"));
        damaged.chain(foreign).chain(unreadable).chain(anew)
    }

    /// Returns those of `lines` that are not among the lines read. Lines older than all lines read are left
    /// out, because the journal may contain them.
    pub(super) fn missing(&self, mut lines: Vec<Value>) -> Vec<Value> {
        let there: BTreeSet<u64> = self.lines.iter().map(number).collect();
        let first = there.first().copied().unwrap_or(0);
        lines.retain(|line| number(line) >= first && !there.contains(&number(line)));
        lines
    }

    /// Returns the rest positions that are still valid: the last start of the runtime wrote them, and no run
    /// began later in that coordinate system.
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

    /// Returns the time of the newest line that has a time.
    pub fn time(&self) -> Option<Timestamp> {
        let ts = self.lines.iter().rev().find_map(|line| line["ts"].as_str())?;
        Some(Timestamp(ts.to_owned()))
    }
}

/// Reads the newest `count` lines of a journal, after skipping the `from` newest. Unreadable lines are
/// omitted.
pub fn newest(folder: &DiskPath, from: usize, count: usize) -> Newest {
    newest_where(folder, from, count, |_| true)
}

/// Reads the newest `count` lines that the machine with this name wrote. Lines of other machines are omitted and
/// counted.
pub fn newest_own(folder: &DiskPath, count: usize, machine: &str) -> Newest {
    newest_where(folder, 0, count, |of_line| of_line == machine)
}

/// Reads the newest lines of the machines whose names `is_own` accepts.
fn newest_where(folder: &DiskPath, from: usize, count: usize, is_own: impl Fn(&str) -> bool) -> Newest {
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
                newest
                    .unreadable
                    .insert(path.as_path().to_owned(), error.to_string());
                continue;
            }
        };
        let mut lines = bytes.split(|byte| *byte == b'\n').rev();
        // The last line is omitted, because a runtime may still be writing it.
        lines.next();
        for line in lines {
            if newest.lines.len() >= wanted {
                break;
            }
            let line = parse_line(line);
            newest.highest = newest
                .highest
                .max(line.as_ref().map_or(0, |line| number(&line.value)));
            match line {
                Some(line) if is_own(&line.machine) => newest.lines.push(line.value),
                Some(_) => *newest.foreign.entry(path.as_path().to_owned()).or_default() += 1,
                None => *newest.damaged.entry(path.as_path().to_owned()).or_default() += 1,
            }
        }
    }
    newest.lines.drain(..from.min(newest.lines.len()));
    newest.lines.reverse();
    newest
}

/// A line that is not yet linked into the chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Object {
    n: u64,
    text: String,
}

impl Object {
    /// Creates the line from a JSON object that contains the line number.
    pub fn from_json(line: &Value) -> Self {
        Self {
            n: number(line),
            text: line.to_string(),
        }
    }
}

/// Creates the journal's own lines with the next line numbers.
#[derive(Debug, Clone)]
pub(super) struct Own {
    pub boot_id: BootId,
    /// Start time of the writer; `t_s` in its lines is the time since then.
    pub started: Instant,
    /// Clock that gives the time of day of lines.
    pub clock: Clock,
    /// Number of the newest line.
    pub last: Arc<AtomicU64>,
    pub generations: Arc<Generations>,
}

impl Own {
    /// Creates a line from an event: adds the next number and the current time.
    pub fn line(&self, mut event: Value) -> Object {
        event["boot_id"] = json!(self.boot_id);
        event["cs"] = json!(0);
        event["n"] = json!(self.last.fetch_add(1, Ordering::Relaxed) + 1);
        event["t_s"] = json!(self.started.elapsed().as_secs_f64());
        event["ts"] = json!(Timestamp::from_system_time(self.clock.time_of_day()));
        Object::from_json(&event)
    }
}

/// The open files of a journal.
#[derive(Debug)]
pub(super) struct Files {
    folder: DiskPath,
    newest: Box<dyn DiskFile>,
    bytes: u64,
    bytes_max: u64,
    head: Head,
    /// The state that the anchor contains.
    anchored: Head,
    /// The newest generation on disk of each other part when the anchor was written.
    anchored_known: PartGenerations,
    anchored_at: Instant,
    own: Own,
    /// Reason why a new chain began although a chain existed; `None` if no line can be missing.
    pub why_anew: Option<String>,
}

impl Files {
    /// Opens the files. Creates a missing folder, but not its parents: if a person removed them, an error is
    /// more useful than new folders. If the chain cannot continue, begins a new chain with a line that states
    /// the reason.
    pub(super) fn open(folder: &DiskPath, bytes_max: u64, own: Own) -> io::Result<Self> {
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
            folder: folder.clone(),
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
        // The anchor is written first, also before a mark: it shows that the lines of the new chain are
        // newer.
        let begun = files.anchor().and_then(|()| match &mark {
            Some(mark) => files.write_mark(mark),
            None => Ok(()),
        });
        begun.map_err(|error| name_file_in_error(&path, &error))?;
        files.why_anew = mark.filter(|_| may_lack_lines).and_then(|mark| mark.why);
        Ok(files)
    }

    /// Writes the line that begins a file or a chain.
    fn write_mark(&mut self, mark: &ChainMark) -> io::Result<()> {
        let line = self.own.line(mark.to_json());
        self.write(&[line])
    }

    /// Writes lines; the lines are on disk when this function returns.
    pub(super) fn append(&mut self, lines: &[Object]) -> io::Result<()> {
        let path = journal_file_path(&self.folder, 0);
        let appended = self.append_to(&path, lines);
        appended.map_err(|error| name_file_in_error(&path, &error))
    }

    fn append_to(&mut self, path: &DiskPath, lines: &[Object]) -> io::Result<()> {
        Identity::from_file(&*self.newest)?.check(path)?;
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

    /// Returns the seal as text, for use as the first field of a line.
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
            // Truncates the file, so the next line does not follow a fragment of this one.
            self.newest.set_len(self.bytes)?;
            return Err(error);
        }
        self.bytes += text.len() as u64;
        self.head = head;
        self.newest.sync_data()
    }

    /// Writes the anchor with the newest line. The anchor is on disk when this function returns.
    pub(super) fn anchor(&mut self) -> io::Result<()> {
        let known = self.own.generations.on_disk();
        self.head.anchor().write(&self.folder, &self.own.generations)?;
        self.anchored = self.head.clone();
        self.anchored_known = known;
        self.anchored_at = Instant::now();
        Ok(())
    }

    /// Returns true if the last anchor was written [`ANCHOR_EVERY`] ago or earlier.
    pub(super) fn is_anchor_overdue(&self) -> bool {
        self.anchored_at.elapsed() >= ANCHOR_EVERY
    }

    /// Returns true if the anchor does not contain the newest line, or the newest generation of another part.
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
        // The anchor is written before the oldest file is removed. After a kill, it then shows that rotation
        // removed the file.
        self.head.file = mark.file;
        let kept = FILES_MAX as u64 - 1;
        self.head.first = self.head.first.max(mark.file.saturating_sub(kept));
        self.anchor()?;
        for age in (0..FILES_MAX - 1).rev() {
            let older = journal_file_path(&self.folder, age + 1);
            match journal_file_path(&self.folder, age).rename(&older) {
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

/// Adds the path of the file to an error.
fn name_file_in_error(path: &DiskPath, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Opens a file for appending, and removes an incomplete line that a kill has left at the end. Returns the
/// file, its length in bytes, and true if such a line existed.
fn open_whole(path: &DiskPath) -> io::Result<(Box<dyn DiskFile>, u64, bool)> {
    let mut file = open_regular(path, OpenMode::ReadAppend)?;
    let length = file.metadata()?.length;
    // Lines are far shorter than 1 MiB; longer text is not a line.
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
    use std::fs;
    use std::path::Path;

    use super::*;

    fn open(folder: &Path, bytes_max: u64) -> Files {
        open_as("", folder, bytes_max)
    }

    fn open_as(machine: &str, folder: &Path, bytes_max: u64) -> Files {
        let own = Own {
            boot_id: BootId("b1".to_owned()),
            started: Instant::now(),
            clock: Clock::real(),
            last: Arc::default(),
            generations: Arc::new(Generations::new(machine)),
        };
        Files::open(&folder.into(), bytes_max, own).unwrap()
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
    fn lines_of_another_machine_are_counted_and_not_replayed() {
        let folder = tempfile::tempdir().unwrap();
        for (machine, lines) in [("mill", [line(1), line(2)]), ("lathe", [line(3), line(4)])] {
            open_as(machine, folder.path(), 10_000).append(&lines).unwrap();
        }
        let path = folder.path().into();
        let own = newest_own(&path, 10, "mill");
        assert_eq!(numbers(&own.lines), [1, 2]);
        assert_eq!(own.highest, 4, "numbers of lines continue after all lines");
        let warnings: Vec<_> = own.warnings().collect();
        assert!(
            warnings[0].contains("2 lines belong to another machine"),
            "{warnings:?}"
        );
        assert_eq!(
            numbers(&newest(&path, 0, 10).lines),
            [1, 2, 3, 4],
            "all lines can be read"
        );
    }

    #[test]
    fn the_newest_lines_are_read_across_files_in_the_order_of_time() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(newest(&folder.path().into(), 0, 10).lines, Vec::<Value>::new());
        let mut files = open(folder.path(), 10_000);
        for n in 0..30 {
            files.bytes_max = if n == 15 { 1 } else { 10_000 };
            files.append(&[line(n)]).unwrap();
        }
        files.newest.write_all(b"{\"n\":").unwrap();
        let read = |from, count| numbers(&newest(&folder.path().into(), from, count).lines);
        assert_eq!(read(0, 3), [27, 28, 29]);
        assert_eq!(read(2, 4), [24, 25, 26, 27]);
        // Between the lines read is the mark that begins the second file.
        assert_eq!(read(13, 4), [14, 15, 16]);
        assert_eq!(read(29, 100), [0, 1]);
        assert_eq!(read(40, 1), Vec::<u64>::new());
    }

    #[test]
    fn a_line_that_was_cut_short_is_taken_away() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = open(folder.path(), 1000);
        files.append(&[line(1), line(2)]).unwrap();
        files.newest.write_all(b"{\"n\"").unwrap();
        open(folder.path(), 1000).append(&[line(3)]).unwrap();
        assert_eq!(numbers(&newest(&folder.path().into(), 0, 9).lines), [1, 2, 3]);
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
        let kept = numbers(&newest(&folder.path().into(), 0, 1000).lines);
        let last: Vec<u64> = (100 - kept.len() as u64..100).collect();
        assert_eq!(kept, last);
    }
}
