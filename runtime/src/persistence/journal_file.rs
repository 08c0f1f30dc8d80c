//! The thread that writes the journal to disk: a line of JSON for each event, gathered for a short time.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use plc_api::types::{BootId, Timestamp};
use serde_json::json;

use super::ahead::{Ahead, recover};
use super::journal_folder::{FILE_BYTES_MAX, Files, Newest, newest};
use super::replay::REPLAYED_LINES_MAX;
use crate::disk::{Health, Part, number, seal, tighten};
use crate::journal::{JournalWriter, Line, Message, WriteAhead};

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

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::Value;

    use super::*;
    use crate::journal::Event;

    fn content(folder: &Path) -> String {
        fs::read_to_string(folder.join("journal.jsonl")).unwrap_or_default()
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

    fn write(writer: &JournalWriter, n: usize) {
        writer.write(line(n), SystemTime::UNIX_EPOCH);
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
        assert_eq!(content(folder.path()), expected.concat());
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
        assert!(content(&work.folder).contains("\"lines\":1"));
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
