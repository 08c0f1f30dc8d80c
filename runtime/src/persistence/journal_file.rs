//! The journal on disk: a line of JSON for each event, in files of bounded size, written by a thread of its own.
//!
//! `journal.jsonl` is the newest file, `journal.1.jsonl` the one before it, and so on; the oldest is removed. A line
//! that was cut short by a kill is removed when the journal is opened again, so every line is whole.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use plc_api::types::Timestamp;
use serde_json::{Value, json};

use crate::journal::{JournalWriter, Line, Message};

/// Its folder in `data_dir`.
pub(crate) const JOURNAL_FOLDER: &str = "journal";

/// Bytes of one file of the journal; a new one is begun beyond.
const FILE_BYTES_MAX: u64 = 4 << 20;

/// Files of the journal, the newest included; the oldest is removed.
const FILES_MAX: usize = 8;

/// Lines that wait for the disk; more are dropped and counted. Reason: some seconds of the busiest machine.
const WAITING_MAX: usize = 10_000;

/// Time to gather lines for one write, from the first of them on. Reason: half of the 20 ms that the journal may be
/// behind; the rest is the disk's.
const GATHER: Duration = Duration::from_millis(10);

/// The text of a line, with its end.
fn text(line: &Line, time: SystemTime) -> String {
    let mut json = line.to_json();
    json["ts"] = json!(Timestamp::from_system_time(time));
    format!("{json}\n")
}

/// The thread. Dropping it writes what waits and ends it.
#[derive(Debug)]
pub(crate) struct JournalThread {
    writer: JournalWriter,
    thread: Option<JoinHandle<()>>,
}

impl JournalThread {
    /// Opens the journal of a folder, which is made if it is missing.
    ///
    /// # Errors
    /// The disk refuses, or the operating system gives no thread.
    pub fn start(folder: &Path) -> io::Result<Self> {
        let mut files = Files::open(folder, FILE_BYTES_MAX)?;
        let (lines, inbox) = sync_channel(WAITING_MAX);
        let lost = Arc::new(AtomicU64::new(0));
        let writer = JournalWriter {
            lines,
            lost: Arc::clone(&lost),
        };
        let thread = std::thread::Builder::new()
            .name("journal".into())
            .spawn(move || run(&inbox, &lost, &mut files))?;
        Ok(Self {
            writer,
            thread: Some(thread),
        })
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

fn run(inbox: &Receiver<Message>, lost: &AtomicU64, files: &mut Files) {
    let mut failing = false;
    while let Some((batch, open)) = gather(inbox, lost) {
        let written = files.append(&batch);
        if let Err(error) = &written
            && !failing
        {
            tracing::error!("the journal cannot be written: {error}");
        }
        failing = written.is_err();
        if !open {
            return;
        }
    }
}

/// How long to gather on, when the oldest line that waits was handed over this long ago. One that came while the lines
/// before it were written has waited for that already: with writes of up to [`GATHER`] a line is on disk within twice
/// as long.
fn rest(age: Duration) -> Duration {
    GATHER.saturating_sub(age)
}

/// Waits for a line, and takes what has come [`GATHER`] after it. False: the journal is to be closed.
///
/// It sleeps in between instead of waiting for the next line: then no line but the first has to wake this thread.
fn gather(inbox: &Receiver<Message>, lost: &AtomicU64) -> Option<(String, bool)> {
    let first = inbox.recv().ok()?;
    if let Message::Line(_, _, handed_over) = &first {
        std::thread::sleep(rest(handed_over.elapsed()));
    }
    let mut next = Some(first);
    let (mut batch, mut taken) = (String::new(), 0);
    while let Some(message) = next {
        match message {
            Message::Line(line, time, _) => batch += &text(&line, time),
            Message::Close => return Some((batch, false)),
        }
        taken += 1;
        next = (taken < WAITING_MAX).then(|| inbox.try_recv().ok()).flatten();
    }
    let lost = lost.swap(0, Ordering::Relaxed);
    if lost > 0 {
        let line = format!("{{\"event\":\"lost\",\"lines\":{lost}}}\n");
        batch += &line;
    }
    Some((batch, true))
}

/// The newest `count` lines of the journal of a folder but for the `from` newest, in the order of time.
///
/// # Errors
/// A file cannot be read.
pub(crate) fn newest(folder: &Path, from: usize, count: usize) -> io::Result<Vec<Value>> {
    let (mut found, wanted) = (Vec::new(), from.saturating_add(count));
    for age in 0..FILES_MAX {
        if found.len() == wanted {
            break;
        }
        let text = match fs::read_to_string(place(folder, age)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => break,
            text => text?,
        };
        // The last line may not be written in full yet.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let lines = whole.lines().rev();
        let lines = lines.filter_map(|line| serde_json::from_str(line).ok());
        found.extend(lines.take(wanted - found.len()));
    }
    found.drain(..from.min(found.len()));
    found.reverse();
    Ok(found)
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
    fn open(folder: &Path, bytes_max: u64) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let (newest, bytes) = open_whole(&place(folder, 0))?;
        Ok(Self {
            folder: folder.to_owned(),
            newest,
            bytes,
            bytes_max,
        })
    }

    /// Writes lines; they are on disk when this returns.
    fn append(&mut self, lines: &str) -> io::Result<()> {
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
        File::open(&self.folder)?.sync_all()
    }
}

fn place(folder: &Path, age: usize) -> PathBuf {
    folder.join(match age {
        0 => "journal.jsonl".to_owned(),
        age => format!("journal.{age}.jsonl"),
    })
}

/// Opens a file to append to, without the part of a line that a kill has left at its end.
fn open_whole(path: &Path) -> io::Result<(File, u64)> {
    let mut file = OpenOptions::new()
        .create(true)
        .read(true)
        .append(true)
        .open(path)?;
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

    fn line_text(n: usize) -> String {
        let ts = "1970-01-01T00:00:00.000000Z";
        format!(
            "{{\"choices\":[],\"cs\":1,\"event\":\"question\",\"seq\":{n},\"t_s\":0.5,\"text\":\"\",\"ts\":\"{ts}\"}}\n"
        )
    }

    fn write(writer: &JournalWriter, n: usize) {
        writer.write(line(n), SystemTime::UNIX_EPOCH);
    }

    #[test]
    fn the_newest_lines_are_read_across_files_in_the_order_of_time() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = Files::open(folder.path(), 100).unwrap();
        assert_eq!(newest(folder.path(), 0, 10).unwrap(), Vec::<Value>::new());
        for n in 0..10 {
            files
                .append(&format!("{{\"n\":{n},\"text\":\"0123456789\"}}\n"))
                .unwrap();
        }
        files.newest.write_all(b"{\"n\":").unwrap();
        let numbers = |from, count| -> Vec<u64> {
            let lines = newest(folder.path(), from, count).unwrap();
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
            let thread = JournalThread::start(folder.path()).unwrap();
            for n in 0..100 {
                write(&thread.writer(), 100 * round + n);
            }
        }
        let expected: Vec<String> = (0..200).map(line_text).collect();
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
        };
        for n in 0..6 {
            write(&writer, n);
        }
        let (batch, open) = gather(&inbox, &writer.lost).unwrap();
        let lines: String = (0..4).map(line_text).collect();
        assert_eq!(batch, lines + "{\"event\":\"lost\",\"lines\":2}\n");
        assert!(open);
        write(&writer, 6);
        writer.lines.send(Message::Close).unwrap();
        assert_eq!(gather(&inbox, &writer.lost), Some((line_text(6), false)));
        drop(writer);
        assert_eq!(gather(&inbox, &AtomicU64::new(0)), None);
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
