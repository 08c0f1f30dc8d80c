//! The journal on disk: a line of JSON for each event, in files of bounded size, written by a thread of its own.
//!
//! `journal.jsonl` is the newest file, `journal.1.jsonl` the one before it, and so on; the oldest is removed. A line
//! that was cut short by a kill is removed when the journal is opened again, so every line is whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use plc_api::types::{BootId, Timestamp};
use serde_json::{Value, json};

use super::ahead::{Ahead, recover};
use super::replay::REPLAYED_LINES_MAX;
use crate::disk::{
    Health, Identity, Part, Read, make_folder_in, number, open_regular, read, read_regular, seal,
    sync_folder, tighten,
};
use crate::journal::{JournalWriter, Line, Message, WriteAhead};

/// Its folder in `data_dir`.
pub(crate) const JOURNAL_FOLDER: &str = "journal";

/// Bytes of one file of the journal; a new one is begun beyond.
const FILE_BYTES_MAX: u64 = 4 << 20;

/// Files of the journal, the newest included; the oldest is removed.
const FILES_MAX: usize = 8;

/// Bytes of a file of the journal that are read at the most: one write may go beyond [`FILE_BYTES_MAX`].
const FILE_READ_MAX: u64 = 64 << 20;

/// Time without lines after which the thread looks whether its file is there, and tries a disk that refused again.
const RETRY: Duration = Duration::from_secs(1);

/// Lines that wait for the disk; more are dropped and counted. Reason: some seconds of the busiest machine.
const WAITING_MAX: usize = 10_000;

/// Time to gather lines for one write, from the first of them on. Reason: half of the 20 ms that the journal may be
/// behind; the rest is the disk's.
const GATHER: Duration = Duration::from_millis(10);

/// The text of a line, with its end.
fn text(boot_id: &BootId, n: u64, line: &Line, time: SystemTime) -> String {
    let mut json = line.to_json();
    json["boot_id"] = json!(boot_id);
    json["n"] = json!(n);
    json["ts"] = json!(Timestamp::from_system_time(time));
    seal(&json.to_string())
}

/// The thread. Dropping it writes what waits and ends it.
#[derive(Debug)]
pub(crate) struct JournalThread {
    writer: JournalWriter,
    thread: Option<JoinHandle<()>>,
}

impl JournalThread {
    /// Opens the journal of a folder, which is made if it is missing, and gives its newest lines. A journal that cannot be
    /// read or written prevents nothing: it is tried again, and `health` says why meanwhile.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub fn start(folder: &Path, boot_id: BootId, health: Arc<Health>) -> io::Result<(Self, Newest)> {
        tighten(folder);
        let mut newest = newest(folder, 0, REPLAYED_LINES_MAX);
        let missing = newest.missing(recover(folder));
        let text: String = missing.iter().map(|line| seal(&line.to_string())).collect();
        newest.lines.extend(missing);
        newest.lines.sort_by_key(number);
        let opened = Files::open(folder, FILE_BYTES_MAX).and_then(|mut files| {
            files.append(&text)?;
            Ok((files, Ahead::begin(folder, boot_id.clone())?))
        });
        health.note(Part::Journal, &opened);
        let (files, ahead) = opened.ok().unzip();
        let (lines, inbox) = sync_channel(WAITING_MAX);
        let last = newest.lines.last().map_or(0, number);
        let writer = JournalWriter {
            lines,
            lost: Arc::default(),
            last: Arc::new(AtomicU64::new(last)),
            ahead: ahead.map(|ahead| Arc::new(ahead) as Arc<dyn WriteAhead>),
        };
        let work = Work {
            boot_id,
            started: Instant::now(),
            folder: folder.to_owned(),
            files,
            health,
            last: Arc::clone(&writer.last),
            lost: Arc::clone(&writer.lost),
        };
        let thread = std::thread::Builder::new()
            .name("journal".into())
            .spawn(move || work.run(&inbox))?;
        let thread = Some(thread);
        Ok((Self { writer, thread }, newest))
    }

    /// A handle for callers.
    pub fn writer(&self) -> JournalWriter {
        self.writer.clone()
    }
}

impl Drop for JournalThread {
    fn drop(&mut self) {
        // A thread that has ended is joined all the same.
        let _ = self.writer.lines.send(Message::Close);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread works with.
struct Work {
    boot_id: BootId,
    /// When it was started: `t_s` of its own lines counts from then.
    started: Instant,
    folder: PathBuf,
    /// `None` after a failure, until it opens again.
    files: Option<Files>,
    health: Arc<Health>,
    last: Arc<AtomicU64>,
    lost: Arc<AtomicU64>,
}

impl Work {
    fn run(mut self, inbox: &Receiver<Message>) {
        loop {
            // without a line, too: the disk may have refused, and the folder may be gone
            let first = inbox.recv_timeout(RETRY);
            let (batch, count, open) = match first {
                Ok(first) => gather(&self.boot_id, first, inbox),
                Err(RecvTimeoutError::Timeout) => (String::new(), 0, true),
                Err(RecvTimeoutError::Disconnected) => return,
            };
            let written = self.write(batch);
            if written.is_err() {
                self.files = None;
                self.lost.fetch_add(count, Ordering::Relaxed);
            }
            self.health.note(Part::Journal, &written);
            if !open {
                return;
            }
        }
    }

    /// Lines that could not be written before are counted in a line of their own.
    fn write(&mut self, mut batch: String) -> io::Result<()> {
        let files = match &mut self.files {
            Some(files) => files,
            none => none.insert(Files::open(&self.folder, FILE_BYTES_MAX)?),
        };
        let lost = self.lost.load(Ordering::Relaxed);
        if lost > 0 {
            let n = self.last.fetch_add(1, Ordering::Relaxed) + 1;
            let line = json!({
                "boot_id": self.boot_id, "cs": 0, "event": "lost", "lines": lost, "n": n,
                "t_s": self.started.elapsed().as_secs_f64(), "ts": Timestamp::from_system_time(SystemTime::now()),
            });
            batch += &seal(&line.to_string());
        }
        files.append(&batch)?;
        self.lost.fetch_sub(lost, Ordering::Relaxed);
        Ok(())
    }
}

/// How long to gather on, when the oldest line that waits was handed over this long ago. One that came while the lines
/// before it were written has waited for that already: with writes of up to [`GATHER`] a line is on disk within twice
/// as long.
fn rest(age: Duration) -> Duration {
    GATHER.saturating_sub(age)
}

/// Takes what has come [`GATHER`] after the first line: their text and their number. False: the journal is to be closed.
///
/// It sleeps in between instead of waiting for the next line: then no line but the first has to wake this thread.
fn gather(boot_id: &BootId, first: Message, inbox: &Receiver<Message>) -> (String, u64, bool) {
    if let Message::Line { handed_over, .. } = &first {
        std::thread::sleep(rest(handed_over.elapsed()));
    }
    let mut next = Some(first);
    let (mut batch, mut taken) = (String::new(), 0);
    while let Some(message) = next {
        match message {
            Message::Line { n, line, time, .. } => batch += &text(boot_id, n, &line, time),
            Message::Close => return (batch, taken, false),
        }
        taken += 1;
        next = (taken < WAITING_MAX as u64)
            .then(|| inbox.try_recv().ok())
            .flatten();
    }
    (batch, taken, true)
}

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
    fn missing(&self, mut lines: Vec<Value>) -> Vec<Value> {
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
struct Files {
    folder: PathBuf,
    newest: File,
    bytes: u64,
    bytes_max: u64,
}

impl Files {
    /// The folder is made if it is missing, but not those above it: who removes these wants an answer, not new ones.
    fn open(folder: &Path, bytes_max: u64) -> io::Result<Self> {
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
    fn append(&mut self, lines: &str) -> io::Result<()> {
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
    use super::*;
    use crate::journal::Event;

    fn content(folder: &Path, age: usize) -> String {
        fs::read_to_string(place(folder, age)).unwrap_or_default()
    }

    /// Line number n, said at the start of 1970.
    fn line(n: usize) -> Line {
        Line {
            t_s: 0.5,
            cs: 1,
            event: Event::Question {
                seq: n as u64,
                text: String::new(),
                choices: Vec::new(),
            },
        }
    }

    /// Its text, as the first line after `before` others.
    fn line_text(before: usize, n: usize) -> String {
        let (ts, number) = ("1970-01-01T00:00:00.000000Z", before + 1);
        seal(&format!(
            "{{\"boot_id\":\"b1\",\"choices\":[],\"cs\":1,\"event\":\"question\",\"n\":{number},\"seq\":{n},\"t_s\":0.5,\"text\":\"\",\"ts\":\"{ts}\"}}"
        ))
    }

    fn start(folder: &Path) -> (JournalThread, Newest) {
        JournalThread::start(folder, BootId("b1".to_owned()), Arc::default()).unwrap()
    }

    fn work(folder: &Path) -> Work {
        Work {
            boot_id: BootId("b1".to_owned()),
            started: Instant::now(),
            folder: folder.to_owned(),
            files: None,
            health: Arc::default(),
            last: Arc::default(),
            lost: Arc::default(),
        }
    }

    /// A line of another file, which the thread does not write.
    fn sealed(n: usize) -> String {
        seal(&json!({"n": n, "text": "0123456789"}).to_string())
    }

    fn write(writer: &JournalWriter, n: usize) {
        writer.write(line(n), SystemTime::UNIX_EPOCH);
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
    fn what_was_handed_over_stands_there_line_by_line_when_the_journal_is_closed() {
        let folder = tempfile::tempdir().unwrap();
        for round in 0..2 {
            let (thread, before) = start(folder.path());
            assert_eq!(before.lines.len(), 100 * round);
            for n in 0..100 {
                write(&thread.writer(), 100 * round + n);
            }
        }
        let expected: Vec<String> = (0..200).map(|n| line_text(n, n)).collect();
        assert_eq!(content(folder.path(), 0), expected.concat());
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

    #[test]
    fn lines_are_gathered_and_lost_ones_are_counted() {
        let (sender, inbox) = sync_channel(4);
        let writer = JournalWriter {
            lines: sender,
            lost: Arc::default(),
            last: Arc::default(),
            ahead: None,
        };
        for n in 0..6 {
            write(&writer, n);
        }
        let boot_id = BootId("b1".to_owned());
        let (batch, taken, open) = gather(&boot_id, inbox.recv().unwrap(), &inbox);
        assert_eq!(
            (batch, taken, open),
            ((0..4).map(|n| line_text(n, n)).collect(), 4, true)
        );
        let folder = tempfile::tempdir().unwrap();
        let mut work = Work {
            last: Arc::clone(&writer.last),
            lost: Arc::clone(&writer.lost),
            ..work(folder.path())
        };
        work.write(String::new()).unwrap();
        let lost = newest(folder.path(), 0, 9).lines;
        let told = (&lost[0]["event"], &lost[0]["lines"], number(&lost[0]));
        assert_eq!(told, (&json!("lost"), &json!(2), 7));
        assert_eq!(writer.lost.load(Ordering::Relaxed), 0);
        write(&writer, 6);
        writer.lines.send(Message::Close).unwrap();
        let last = gather(&boot_id, inbox.recv().unwrap(), &inbox);
        assert_eq!(last, (line_text(7, 6), 1, false));
    }

    #[test]
    fn a_journal_that_is_damaged_or_cannot_be_opened_never_keeps_a_machine_from_starting() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(
            path("journal.jsonl"),
            b"{\"n\":1,\"even\x80\n\n{\"event\":\"boot\"}\n",
        )
        .unwrap();
        fs::create_dir(path("journal.1.jsonl")).unwrap();
        let (thread, newest) = start(folder.path());
        assert_eq!(newest.lines, [json!({"event": "boot"})]);
        let warnings: Vec<String> = newest.warnings().collect();
        assert!(
            warnings[0].contains("journal.jsonl: 2 damaged lines"),
            "{warnings:?}"
        );
        assert!(
            warnings[1].contains("journal.1.jsonl: it cannot be read"),
            "{warnings:?}"
        );
        drop(thread);

        let no_folder = path("journal.jsonl");
        let health = Arc::<Health>::default();
        let boot_id = BootId("b1".to_owned());
        let (thread, newest) = JournalThread::start(&no_folder, boot_id, Arc::clone(&health)).unwrap();
        assert_eq!(newest.lines, Vec::<Value>::new());
        assert!(health.fault(Part::Journal).is_some());
        write(&thread.writer(), 1);
    }

    #[test]
    fn what_was_written_ahead_and_not_gathered_is_in_the_journal_of_the_next_start() {
        let folder = tempfile::tempdir().unwrap();
        let (thread, _) = start(folder.path());
        let started = |n: u64| Line {
            event: Event::Start {
                program: 60,
                run_id: format!("1-{n}"),
            },
            ..line(0)
        };
        thread.writer().write(started(1), SystemTime::UNIX_EPOCH);
        drop(thread);
        // as a kill leaves it
        let ahead = Ahead::begin(folder.path(), BootId("b1".to_owned())).unwrap();
        for n in 1..4 {
            ahead.write(n, &started(n), SystemTime::UNIX_EPOCH).unwrap();
        }
        let (thread, newest) = start(folder.path());
        let runs = |lines: &[Value]| -> Vec<(u64, String)> {
            let run = |line: &Value| (number(line), line["run_id"].as_str().unwrap().to_owned());
            lines.iter().map(run).collect()
        };
        let expected = [1, 2, 3].map(|n| (n, format!("1-{n}")));
        assert_eq!(runs(&newest.lines), expected);
        drop(thread);
        let (thread, newest) = start(folder.path());
        assert_eq!(runs(&newest.lines), expected);
        assert_eq!(thread.writer().last.load(Ordering::Relaxed), 3);
    }

    #[test]
    fn a_journal_whose_file_was_removed_is_written_again_and_says_how_many_lines_it_lacks() {
        let folder = tempfile::tempdir().unwrap();
        let mut work = work(&folder.path().join("journal"));
        work.write("{}\n".to_owned()).unwrap();
        fs::remove_dir_all(&work.folder).unwrap();
        assert!(work.write("{}\n".to_owned()).is_err());
        work.files = None;
        work.lost.store(1, Ordering::Relaxed);
        work.write(String::new()).unwrap();
        assert!(content(&work.folder, 0).contains("\"lines\":1"));
        fs::remove_dir_all(folder.path()).unwrap();
        work.files = None;
        assert!(
            work.write(String::new()).is_err(),
            "the folder above is not made anew"
        );
    }

    #[test]
    fn with_writes_of_up_to_10_ms_a_line_is_on_disk_20_ms_after_it_was_said() {
        let ms = Duration::from_millis;
        let (mut now, mut said, mut longest) = (ms(0), std::collections::VecDeque::new(), ms(0));
        for line in 0..2000_u64 {
            said.push_back(ms(line * 7 / 3));
        }
        for round in 0.. {
            let Some(&first) = said.front() else { break };
            now = now.max(first);
            now += rest(now.checked_sub(first).unwrap());
            let taken: Vec<_> = std::iter::from_fn(|| said.pop_front_if(|line| *line <= now)).collect();
            now += ms(round * 3 % 11);
            longest = taken
                .iter()
                .map(|line| now.checked_sub(*line).unwrap())
                .fold(longest, Duration::max);
        }
        assert!(longest > ms(18), "{longest:?}");
        assert!(longest <= ms(20), "{longest:?}");
    }
}
