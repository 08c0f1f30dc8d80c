//! The thread that writes the journal to disk: one JSON line per event. The thread collects lines for a short
//! time before each write.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, SystemTime};

use plc_protocol::types::{BootId, Timestamp};
use serde_json::{Value, json};
use tokio::time::Instant;

use super::ahead::{Ahead, OPEN, recover, recover_rests};
use super::journal_folder::{COMMAND_LINE, FILE_BYTES_MAX, Files, Newest, Object, Own, newest_own};
use super::replay::REPLAYED_LINES_MAX;
use crate::clock::Clock;
use crate::disk::{DataFolderPart, DiskPath, Generations, Health, number, tighten};
use crate::environment::Environment;
use crate::journal::{JournalMessage, JournalWriter, Line, WriteAhead};
use crate::threads::{StartedThread, Work};

/// Time without lines after which the thread checks that its file still exists, and retries after a disk
/// failure.
const RETRY: Duration = Duration::from_secs(1);

/// Maximum number of lines that wait for the disk; further lines are dropped and counted. Reason: this covers
/// several seconds on the busiest machine.
const WAITING_MAX: usize = 10_000;

/// Time in which lines are collected for one write, from the first line on. Reason: the journal may lag by 20
/// ms; one half is for collecting, the other for the disk.
const GATHER: Duration = Duration::from_millis(10);

/// Converts a line to the form in which it is stored.
fn object(boot_id: &BootId, n: u64, line: &Line, time: SystemTime) -> Object {
    let mut json = line.to_json();
    json["boot_id"] = json!(boot_id);
    json["n"] = json!(n);
    json["ts"] = json!(Timestamp::from_system_time(time));
    Object::from_json(&json)
}

/// A journal opened for writing. Lines that were only in the ring have been added to its files.
struct OpenedJournal {
    newest: Newest,
    own: Own,
    files: io::Result<Files>,
}

/// Converts a line of the ring to the form of the journal.
fn as_written(line: &Value) -> Object {
    let mut line = line.clone();
    if let Some(fields) = line.as_object_mut() {
        fields.remove(OPEN);
    }
    Object::from_json(&line)
}

fn open_journal(
    folder: &DiskPath,
    boot_id: BootId,
    generations: Arc<Generations>,
    clock: &Clock,
) -> OpenedJournal {
    let mut newest = newest_own(folder, REPLAYED_LINES_MAX, generations.machine());
    let missing = newest.missing(recover(folder, generations.machine()));
    let objects: Vec<Object> = missing.iter().map(as_written).collect();
    newest.lines.extend(missing);
    newest.lines.sort_by_key(number);
    newest.rests = newest.hold(recover_rests(folder, generations.machine()));
    let last = newest.lines.last().map_or(0, number).max(newest.highest);
    let own = Own {
        boot_id,
        started: Instant::now(),
        clock: clock.clone(),
        last: Arc::new(AtomicU64::new(last)),
        generations,
    };
    let files = Files::open(folder, FILE_BYTES_MAX, own.clone()).and_then(|mut files| {
        files.append(&objects)?;
        Ok(files)
    });
    newest.why_anew = files.as_ref().ok().and_then(|files| files.why_anew.clone());
    OpenedJournal { newest, own, files }
}

/// Writes a line into the journal of a machine whose runtime is not running.
///
/// # Errors
/// Returns an error if the disk operation fails.
pub fn append_line(
    folder: &DiskPath,
    generations: Arc<Generations>,
    clock: &Clock,
    line: &Line,
) -> io::Result<()> {
    let boot_id = BootId(COMMAND_LINE.to_owned());
    let OpenedJournal { own, files, .. } = open_journal(folder, boot_id, generations, clock);
    let mut files = files?;
    let n = own.last.fetch_add(1, Ordering::Relaxed) + 1;
    files.append(&[object(&own.boot_id, n, line, clock.time_of_day())])?;
    files.anchor()
}

/// The journal thread. Dropping this value writes all waiting lines and ends the thread.
#[derive(Debug)]
pub struct JournalThread {
    writer: JournalWriter,
    thread: Arc<dyn StartedThread>,
}

impl JournalThread {
    /// Opens the journal of a folder and returns its newest lines; a missing folder is created. If the
    /// journal cannot be read or written, the machine runs nevertheless. The thread then tries again, and
    /// `health` reports the reason in the meantime.
    ///
    /// # Errors
    /// Returns an error if the operating system cannot create a thread.
    pub fn start(
        folder: &DiskPath,
        boot_id: BootId,
        generations: Arc<Generations>,
        health: Arc<Health>,
        environment: &Environment,
    ) -> io::Result<(Self, Newest)> {
        tighten(folder);
        let OpenedJournal { newest, own, files } =
            open_journal(folder, boot_id, generations, &environment.clock);
        let opened = files.and_then(|files| {
            let ahead = Ahead::create(folder, own.boot_id.clone(), &own.generations)?;
            Ok((files, ahead))
        });
        health.record_attempt(DataFolderPart::Journal, &opened);
        let (files, ahead) = opened.ok().unzip();
        let supervisor = health.supervisor.clone();
        let (lines, inbox) = sync_channel(WAITING_MAX);
        let writer = JournalWriter {
            lines,
            lost: Arc::default(),
            last: Arc::clone(&own.last),
            ahead: ahead.map(|ahead| Arc::new(ahead) as Arc<dyn WriteAhead>),
        };
        let work = JournalWork {
            own,
            folder: folder.clone(),
            files,
            health,
            lost: Arc::clone(&writer.lost),
            inbox,
            worked: Instant::now(),
        };
        let thread = environment.threads.start("journal", &supervisor, work)?;
        Ok((Self { writer, thread }, newest))
    }

    /// Returns a handle for callers.
    pub fn writer(&self) -> JournalWriter {
        self.writer.clone()
    }
}

impl Drop for JournalThread {
    fn drop(&mut self) {
        // Also joins a thread that has already ended.
        let _ = self.writer.lines.send(JournalMessage::Close);
        self.thread.join();
    }
}

/// State of the journal thread.
struct JournalWork {
    own: Own,
    folder: DiskPath,
    /// Open files; `None` from a failure until the files are opened again.
    files: Option<Files>,
    health: Arc<Health>,
    lost: Arc<AtomicU64>,
    inbox: Receiver<JournalMessage>,
    /// Time of the last round that wrote or checked something.
    worked: Instant,
}

impl Work for JournalWork {
    /// Returns the waiting time. It is bounded even if no lines arrive, so that the thread notices a failed
    /// disk or a removed folder.
    fn patience(&self) -> Duration {
        RETRY
    }

    fn delay(&self) -> Duration {
        GATHER
    }

    fn round(&mut self, patience: Duration) -> bool {
        let (batch, open) = match self.inbox.recv_timeout(patience) {
            Ok(first) => {
                if let JournalMessage::Line { handed_over, .. } = &first
                    && !patience.is_zero()
                {
                    std::thread::sleep(rest(handed_over.elapsed()));
                }
                gather(&self.own.boot_id, first, &self.inbox)
            }
            // A round that does not wait may come early; it does nothing then.
            Err(RecvTimeoutError::Timeout) if patience.is_zero() && self.worked.elapsed() < RETRY => {
                return true;
            }
            Err(RecvTimeoutError::Timeout) => (Vec::new(), true),
            Err(RecvTimeoutError::Disconnected) => return false,
        };
        self.worked = Instant::now();
        let (count, is_quiet) = (batch.len() as u64, batch.is_empty() || !open);
        let mut written = self.write(batch);
        if written.is_err() {
            self.lost.fetch_add(count, Ordering::Relaxed);
        } else if is_quiet || self.files.as_ref().is_some_and(Files::is_anchor_overdue) {
            written = self.anchor();
        }
        if written.is_err() {
            self.files = None;
        }
        self.health.record_attempt(DataFolderPart::Journal, &written);
        open
    }
}

impl JournalWork {
    /// Writes lines. If earlier lines could not be written, a separate line with their number follows.
    fn write(&mut self, mut batch: Vec<Object>) -> io::Result<()> {
        let files = match &mut self.files {
            Some(files) => files,
            none => none.insert(Files::open(&self.folder, FILE_BYTES_MAX, self.own.clone())?),
        };
        let lost = self.lost.load(Ordering::Relaxed);
        if lost > 0 {
            batch.push(self.own.line(json!({"event": "lost", "lines": lost})));
        }
        files.append(&batch)?;
        self.lost.fetch_sub(lost, Ordering::Relaxed);
        Ok(())
    }

    /// Writes the newest line to the anchor. It is called when no lines arrive or the anchor is overdue,
    /// because it adds a wait for the disk.
    fn anchor(&mut self) -> io::Result<()> {
        match &mut self.files {
            Some(files) if files.is_ahead_of_anchor() => files.anchor(),
            _ => Ok(()),
        }
    }
}

/// Returns the remaining time for collecting lines; `age` is the time since the first waiting line arrived. A
/// line that arrived during the previous write has already waited. If a write takes at most [`GATHER`], a
/// line is on disk within twice that time.
fn rest(age: Duration) -> Duration {
    GATHER.saturating_sub(age)
}

/// Returns the lines that arrive until [`GATHER`] after the first one, and false if the journal must be
/// closed.
///
/// The thread sleeps during this time instead of waiting for each line. So only the first line wakes the
/// thread.
fn gather(boot_id: &BootId, first: JournalMessage, inbox: &Receiver<JournalMessage>) -> (Vec<Object>, bool) {
    let mut next = Some(first);
    let mut batch = Vec::new();
    while let Some(message) = next {
        match message {
            JournalMessage::Line { n, line, time, .. } => batch.push(object(boot_id, n, &line, time)),
            JournalMessage::Close => return (batch, false),
        }
        next = (batch.len() < WAITING_MAX)
            .then(|| inbox.try_recv().ok())
            .flatten();
    }
    (batch, true)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::journal::Event;
    use crate::persistence::journal_folder::newest;

    fn content(folder: &Path) -> String {
        fs::read_to_string(folder.join("journal.jsonl")).unwrap_or_default()
    }

    /// Returns line n, with a time at the start of 1970.
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

    /// Returns line `n` in its stored form, with the line number `number`.
    fn kept(number: usize, n: usize) -> Value {
        json!({
            "boot_id": "b1", "choices": [], "cs": 1, "event": "question", "n": number, "seq": n, "t_s": 0.5,
            "text": "", "ts": "1970-01-01T00:00:00.000000Z",
        })
    }

    /// Returns the lines of a journal without their hashes, and without the marks of the chain.
    fn lines(folder: &Path) -> Vec<Value> {
        let mut lines = newest(&folder.into(), 0, 1000).lines;
        lines.retain(|line| line["event"] != "chain");
        for line in &mut lines {
            line.as_object_mut().unwrap().remove("hash");
        }
        lines
    }

    fn start(folder: &Path) -> (JournalThread, Newest) {
        JournalThread::start(
            &folder.into(),
            BootId("b1".to_owned()),
            Arc::default(),
            Arc::default(),
            &Environment::default(),
        )
        .unwrap()
    }

    fn work(folder: &Path) -> JournalWork {
        let own = Own {
            boot_id: BootId("b1".to_owned()),
            started: Instant::now(),
            clock: Clock::real(),
            last: Arc::default(),
            generations: Arc::default(),
        };
        JournalWork {
            own,
            folder: folder.into(),
            files: None,
            health: Arc::default(),
            lost: Arc::default(),
            inbox: sync_channel(1).1,
            worked: Instant::now(),
        }
    }

    fn write(writer: &JournalWriter, n: usize) {
        writer.write_as(writer.reserve(), line(n), SystemTime::UNIX_EPOCH);
    }

    #[test]
    fn closed_journal_holds_all_lines_in_order_over_two_starts() {
        let folder = tempfile::tempdir().unwrap();
        for round in 0..2 {
            let (thread, _) = start(folder.path());
            assert_eq!(lines(folder.path()).len(), 100 * round);
            for n in 0..100 {
                write(&thread.writer(), 100 * round + n);
            }
        }
        // The first line is the mark that begins the chain; the chain continues over both starts.
        let expected: Vec<Value> = (0..200).map(|n| kept(n + 2, n)).collect();
        assert_eq!(lines(folder.path()), expected);
        assert_eq!(content(folder.path()).matches("\"begins\":true").count(), 1);
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
        let (batch, open) = gather(&boot_id, inbox.recv().unwrap(), &inbox);
        let objects = |numbers: &[(usize, usize)]| -> Vec<Object> {
            let kept = numbers.iter().map(|(number, n)| kept(*number, *n));
            kept.map(|line| Object::from_json(&line)).collect()
        };
        let first = objects(&[(1, 0), (2, 1), (3, 2), (4, 3)]);
        assert_eq!((batch, open), (first, true));
        let folder = tempfile::tempdir().unwrap();
        let mut work = work(folder.path());
        (work.own.last, work.lost) = (Arc::clone(&writer.last), Arc::clone(&writer.lost));
        work.write(Vec::new()).unwrap();
        let lost = lines(folder.path());
        let told = (&lost[0]["event"], &lost[0]["lines"], number(&lost[0]));
        assert_eq!(told, (&json!("lost"), &json!(2), 8));
        assert_eq!(writer.lost.load(Ordering::Relaxed), 0);
        write(&writer, 6);
        writer.lines.send(JournalMessage::Close).unwrap();
        let last = gather(&boot_id, inbox.recv().unwrap(), &inbox);
        assert_eq!(last, (objects(&[(9, 6)]), false));
    }

    #[test]
    fn damaged_or_unopenable_journal_does_not_prevent_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(
            path("journal.jsonl"),
            b"{\"n\":1,\"even\x80}\n\n{\"event\":\"boot\"}\n",
        )
        .unwrap();
        fs::create_dir(path("journal.1.jsonl")).unwrap();
        let (thread, newest) = start(folder.path());
        assert_eq!(newest.lines, Vec::<Value>::new());
        let warnings: Vec<String> = newest.warnings().collect();
        assert!(
            warnings[0].contains("journal.jsonl: 3 damaged lines"),
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
        let (thread, newest) = JournalThread::start(
            &no_folder.into(),
            boot_id,
            Arc::default(),
            Arc::clone(&health),
            &Environment::default(),
        )
        .unwrap();
        assert_eq!(newest.lines, Vec::<Value>::new());
        assert!(health.fault(DataFolderPart::Journal).is_some());
        write(&thread.writer(), 1);
    }

    #[test]
    fn lines_written_ahead_are_in_the_journal_of_the_next_start() {
        let folder = tempfile::tempdir().unwrap();
        let (thread, _) = start(folder.path());
        let started = |n: u64| Line {
            event: Event::Start {
                program: 60,
                run_id: format!("1-{n}"),
                program_hash: None,
                from_line: None,
                parts: None,
                order: None,
            },
            ..line(0)
        };
        let writer = thread.writer();
        writer.write_as(writer.reserve(), started(1), SystemTime::UNIX_EPOCH);
        drop(writer);
        drop(thread);
        // Creates the ring as a kill leaves it.
        let ahead = Ahead::create(
            &folder.path().into(),
            BootId("b1".to_owned()),
            &Generations::default(),
        )
        .unwrap();
        for n in 1..4 {
            ahead.write(n + 1, &started(n), SystemTime::UNIX_EPOCH).unwrap();
        }
        let (thread, newest) = start(folder.path());
        let runs = |lines: &[Value]| -> Vec<(u64, String)> {
            let run = |line: &Value| (number(line), line["run_id"].as_str().unwrap().to_owned());
            lines.iter().map(run).collect()
        };
        let of_runs = |mut lines: Vec<Value>| {
            lines.retain(|line| line["event"] == "start");
            runs(&lines)
        };
        let expected = [2, 3, 4].map(|n| (n, format!("1-{}", n - 1)));
        assert_eq!(of_runs(newest.lines), expected);
        drop(thread);
        let (thread, newest) = start(folder.path());
        assert_eq!(of_runs(newest.lines), expected);
        assert_eq!(thread.writer().last.load(Ordering::Relaxed), 4);
    }

    #[test]
    fn removed_journal_is_created_again_with_count_of_missing_lines() {
        let folder = tempfile::tempdir().unwrap();
        let mut work = work(&folder.path().join("journal"));
        let line = || vec![Object::from_json(&kept(1, 1))];
        work.write(line()).unwrap();
        fs::remove_dir_all(work.folder.as_path()).unwrap();
        assert!(work.write(line()).is_err());
        work.files = None;
        work.lost.store(1, Ordering::Relaxed);
        work.write(Vec::new()).unwrap();
        assert!(content(work.folder.as_path()).contains("\"lines\":1"));
        fs::remove_dir_all(folder.path()).unwrap();
        work.files = None;
        assert!(
            work.write(Vec::new()).is_err(),
            "the parent folder is not created again"
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
