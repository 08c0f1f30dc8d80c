//! The thread that stores changed values: it checks for changes every [`INTERVAL`], and immediately if a
//! caller waits.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::hub::Hub;
use plc_protocol::types::data::LastRun;
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::PendingOutput;
use plc_protocol::types::state::{Execution, Reason};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber, Timestamp};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::variables::VariableArray;
use tandem_store::clock::Clock;
use tandem_store::disk::{DataFolderPart, DiskPath, Generations, Health};
use tandem_store::persistence::Generation;
use tandem_store::persistence::Store;
use tandem_store::persistence::image::{
    Image, KeptRun, LastRuns, PRODUCTION_KEY, Page, RUN_LINES_KEY, pages, run_key,
};
use tandem_store::persistence::positions::{position_key, positions};
use tandem_store::persistence::{STORE_FILE, inspect_store};
use tandem_store::runs::RunBook;
use tandem_store::tables::{KeptValues, Tables, keep, value_key};
use tandem_store::threads::{StartedThread, Threads, Work};
use tokio::sync::oneshot;

use crate::coordinate_system::View;

/// Time between two checks. Reason: the store may lag by 100 ms; one half is for the check, the other for the
/// disk.
const INTERVAL: Duration = Duration::from_millis(50);

/// Time between two generations, s. Reason: restored values are at most this old, and the disk load stays
/// low.
const GENERATION_S: f64 = 600.0;

/// Maximum time from the previous check to the end of a commit, s; a later end is logged.
const BEHIND_MAX_S: f64 = 0.1;

type Done = oneshot::Sender<Result<(), String>>;

enum StateWriterMessage {
    /// Values to write in the same commit as all changes, and the channel for the result to the waiting
    /// caller.
    Write(KeptValues, Done),
    Close,
}

/// Handle of the thread for its callers.
#[derive(Debug, Clone)]
pub(crate) struct StateWriter {
    messages: Sender<StateWriterMessage>,
    thread: Arc<dyn StartedThread>,
}

impl StateWriter {
    /// Writes values and blocks the calling thread. The values are on disk when this function returns.
    ///
    /// # Errors
    /// Returns the reason as text if the disk operation fails.
    pub fn write(&self, values: KeptValues) -> Result<(), String> {
        let mut written = self.send(values);
        if self.thread.work_for_caller() {
            return written.try_recv().unwrap_or_else(|_| stopping());
        }
        written.blocking_recv().unwrap_or_else(|_| stopping())
    }

    /// Waits until all earlier changes are on disk.
    ///
    /// # Errors
    /// Returns a description if the disk operation fails.
    pub async fn flush(&self) -> Result<(), String> {
        let written = self.send(KeptValues::new());
        self.thread.work_for_caller();
        written.await.unwrap_or_else(|_| stopping())
    }

    fn send(&self, values: KeptValues) -> oneshot::Receiver<Result<(), String>> {
        let (done, written) = oneshot::channel();
        // If the thread has ended, the message is dropped, and `done` with it.
        let _ = self.messages.send(StateWriterMessage::Write(values, done));
        written
    }
}

fn stopping() -> Result<(), String> {
    Err("the runtime is stopping".to_owned())
}

/// The state writer thread. Dropping this value writes the remaining changes and ends the thread.
#[derive(Debug)]
pub(crate) struct StateWriterThread {
    writer: StateWriter,
}

impl StateWriterThread {
    /// Starts the thread for the store of a folder, whose content is `kept`; `store` is `None` if the disk
    /// has failed.
    ///
    /// # Errors
    /// Returns an error if the operating system cannot create a thread.
    pub fn start(
        folder: DiskPath,
        store: Option<Store>,
        kept: Image,
        source: Source,
        threads: &Threads,
    ) -> io::Result<Self> {
        let (messages, inbox) = channel();
        let supervisor = source.health.supervisor.clone();
        let work = StateWriterWork {
            folder,
            store,
            generation: GenerationPace::default(),
            kept,
            last_runs: source.last_runs.clone(),
            pace: Pace::default(),
            source,
            inbox,
        };
        let thread = threads.start("state-writer", &supervisor, work)?;
        Ok(Self {
            writer: StateWriter { messages, thread },
        })
    }

    /// Returns a handle for callers.
    pub fn writer(&self) -> StateWriter {
        self.writer.clone()
    }
}

impl Drop for StateWriterThread {
    fn drop(&mut self) {
        // Also joins a thread that has already ended.
        let _ = self.writer.messages.send(StateWriterMessage::Close);
        self.writer.thread.join();
    }
}

/// Sources that the thread checks for changes.
pub(crate) struct Source {
    pub boot_id: BootId,
    pub clock: Clock,
    pub tables: Arc<Tables>,
    /// Latest published messages.
    pub hub: Hub,
    pub views: Vec<(CoordinateSystemNumber, Arc<View>)>,
    pub settings: Vec<CoordinateSystemSettings>,
    /// Last runs as the store contains them.
    pub last_runs: LastRuns,
    pub health: Arc<Health>,
    pub runs: Arc<Mutex<RunBook>>,
    pub generations: Arc<Generations>,
}

impl Source {
    /// Returns the values that differ from the stored ones, and updates `last_runs` to the current runs.
    fn changes(&self, kept: &Image, last_runs: &mut LastRuns) -> Image {
        let mut change = Image::default();
        let tables = &self.tables;
        {
            let _no_range_is_written = tables.read();
            changed_pages(0, &tables.global(), kept, &mut change);
            for cs in tables.coordinate_systems() {
                changed_pages(cs, &tables.variables(cs).coordinate_system, kept, &mut change);
            }
        }
        for (cs, view) in &self.views {
            // The line number is read before the run, so the run includes at least the lines up to this
            // number.
            let line = view.published_line();
            if let Some(run) = self.last_run(*cs, view, last_runs.get(cs).map(|kept| &kept.run)) {
                let last_run = KeptRun { run, line };
                keep(&mut change.values, value_key("last_run", *cs), &last_run);
                last_runs.insert(*cs, last_run);
            }
            if let Some(Payload::Tool(tool)) = self.payload(*cs, CsTopic::Tool) {
                keep(&mut change.values, value_key("tool", *cs), &tool.id);
            }
        }
        for settings in &self.settings {
            let view = self.views.iter().find(|(cs, _)| *cs == settings.number);
            // the position of a motor that is not homed is unknown and cannot be stored
            if let Some(at) = view.and_then(|(_, view)| view.homed_position()) {
                let positions = positions(settings, at);
                keep(&mut change.values, position_key(settings.number), &positions);
            }
        }
        self.changed_runs(kept, &mut change);
        change
    }

    /// Adds the active runs, and the ended runs that are not stored yet.
    fn changed_runs(&self, kept: &Image, all: &mut Image) {
        let runs = self.runs.lock();
        let mut change = Image::default();
        for (cs, _) in &self.views {
            let (key, open) = (value_key("open_run", *cs), runs.open(*cs));
            if open.is_some() || kept.has(&key) {
                keep(&mut change.values, key, &open);
            }
        }
        for ended in runs.ended() {
            let key = run_key(ended.n);
            keep(&mut change.values, key.clone(), ended);
            if change.values.get(&key) == kept.values.get(&key) {
                break;
            }
        }
        let production = runs.production();
        if !production.is_empty() {
            keep(&mut change.values, PRODUCTION_KEY.to_owned(), &production);
        }
        let mut change = change.beyond(kept);
        // This commit also stores the numbers of the journal lines that these values include.
        if !change.is_empty() {
            keep(&mut change.values, RUN_LINES_KEY.to_owned(), runs.lines());
        }
        all.take_over(change);
    }

    fn payload(&self, cs: CoordinateSystemNumber, topic: CsTopic) -> Option<Payload> {
        let message = self.hub.read(&Topic::cs(cs, topic))?;
        Some(message.payload.clone())
    }

    /// Returns the state of the last run in this boot, if it has changed.
    fn last_run(&self, cs: CoordinateSystemNumber, view: &View, before: Option<&LastRun>) -> Option<LastRun> {
        let at = Timestamp::from_system_time(self.clock.wall());
        let Some(Payload::State(state)) = self.payload(cs, CsTopic::State) else {
            return None;
        };
        let Some(run_id) = state.run_id else {
            return before.and_then(|before| taken_over(before, state.reason));
        };
        let outputs = match self.payload(cs, CsTopic::Pending) {
            // An instance belongs to a process and has no meaning in another boot.
            Some(Payload::Pending(pending)) => (pending.outputs.into_iter())
                .map(|output| PendingOutput {
                    instance: None,
                    lost_instance: None,
                    ..output
                })
                .collect(),
            _ => Vec::new(),
        };
        let executing = view.executing();
        let mut now = LastRun {
            boot_id: self.boot_id.clone(),
            run_id,
            program: state.program,
            running: Some(executing.program).filter(|program| *program != 0),
            line: executing.line,
            execution: state.execution,
            outputs,
            at: before.map(|before| before.at.clone()).unwrap_or_default(),
        };
        if before == Some(&now) {
            return None;
        }
        now.at = at;
        Some(now)
    }
}

/// Returns an interrupted run of an earlier start as stopped, after an operator has loaded a program or
/// reset. The runtime then no longer reports the run as interrupted.
fn taken_over(before: &LastRun, reason: Option<Reason>) -> Option<LastRun> {
    let is_new = before.is_under_way() && reason != Some(Reason::Restarted);
    is_new.then(|| LastRun {
        execution: Execution::Stopped,
        outputs: Vec::new(),
        ..before.clone()
    })
}

fn changed_pages(area: u8, array: &VariableArray, kept: &Image, change: &mut Image) {
    const NEVER_SET: Page = Page([0; tandem_store::persistence::PAGE_VARIABLES]);
    for place in 0..pages(array) {
        let page = Page::from_array(array, place);
        if *kept.pages.get(&(area, place)).unwrap_or(&NEVER_SET) != page {
            change.pages.insert((area, place), page);
        }
    }
}

/// Measures the lag of the store. A check finds each change, and the end of that check's commit puts the
/// change on disk. If commits take at most [`INTERVAL`], the lag is at most twice the interval.
#[derive(Debug, Default)]
struct Pace {
    looked_s: Option<f64>,
}

impl Pace {
    /// Returns the time until the next check, which is due [`INTERVAL`] after the last one.
    fn wait(&self, now_s: f64) -> Duration {
        let since_s = self.looked_s.map_or(0.0, |looked_s| now_s - looked_s);
        INTERVAL.saturating_sub(Duration::from_secs_f64(since_s.max(0.0)))
    }

    /// Records a check whose commit has ended, and returns the maximum age of its oldest change, s.
    fn on_commit(&mut self, looked_s: f64, ended_s: f64) -> f64 {
        let before_s = self.looked_s.replace(looked_s).unwrap_or(looked_s);
        ended_s - before_s
    }
}

/// Decides when the last good generation is written: after the start, at the end of the runtime, and every
/// [`GENERATION_S`] seconds if values have changed.
#[derive(Debug, Default)]
struct GenerationPace {
    /// Time of the last write, and the number of the newest change at that time.
    written: Option<(f64, u64)>,
}

impl GenerationPace {
    fn is_due(&self, now_s: f64, last: u64, is_closing: bool) -> bool {
        self.written
            .is_none_or(|(then_s, then)| then != last && (is_closing || now_s - then_s >= GENERATION_S))
    }
}

struct StateWriterWork {
    folder: DiskPath,
    /// Open store; `None` from a failure until the store is opened again.
    store: Option<Store>,
    generation: GenerationPace,
    kept: Image,
    last_runs: LastRuns,
    source: Source,
    pace: Pace,
    inbox: Receiver<StateWriterMessage>,
}

impl Work for StateWriterWork {
    fn patience(&self) -> Duration {
        self.pace.wait(self.source.clock.now_s())
    }

    fn round(&mut self, mut patience: Duration) -> bool {
        let (mut values, mut waiting, mut open) = (KeptValues::new(), Vec::new(), true);
        // One commit writes all values that callers have sent in the meantime.
        while open {
            match self.inbox.recv_timeout(std::mem::take(&mut patience)) {
                Ok(StateWriterMessage::Write(more, done)) => {
                    values.extend(more);
                    waiting.push(done);
                }
                Ok(StateWriterMessage::Close) | Err(RecvTimeoutError::Disconnected) => open = false,
                Err(RecvTimeoutError::Timeout) => break,
            }
        }
        let written = self.turn(values);
        self.keep_generation(!open);
        for done in waiting {
            // The caller may have stopped waiting.
            let _ = done.send(written.clone());
        }
        open
    }
}

impl StateWriterWork {
    /// Performs one check, and commits the given values with the changes found.
    fn turn(&mut self, values: KeptValues) -> Result<(), String> {
        let looked_s = self.source.clock.now_s();
        let mut last_runs = self.last_runs.clone();
        let mut change = self.source.changes(&self.kept, &mut last_runs);
        change.values.extend(values);
        let change = change.beyond(&self.kept);
        let written = self.commit(&change);
        let behind_s = self.pace.on_commit(looked_s, self.source.clock.now_s());
        let path = self.folder.join(STORE_FILE);
        let written = written.map_err(|error| format!("{}: {error}", path.display()));
        self.source.health.record_attempt(DataFolderPart::Store, &written);
        written?;
        self.kept.take_over(change);
        self.last_runs = last_runs;
        if behind_s > BEHIND_MAX_S {
            tracing::warn!("the disk is slow: stored values lagged by {behind_s:.3} s");
        }
        Ok(())
    }

    fn commit(&mut self, change: &Image) -> io::Result<()> {
        let Some(mut store) = self.store.take() else {
            // This inspection detects damage that occurred since the failure.
            let inspected = inspect_store(&self.folder);
            let (mut store, _) = Store::open(&self.folder, &inspected, &self.source.generations)?;
            let mut all = self.kept.clone();
            all.take_over(change.clone());
            store.commit(&all)?;
            self.store = Some(store);
            return Ok(());
        };
        if change.is_empty() {
            store.check()?;
        } else {
            store.commit(change)?;
        }
        self.store = Some(store);
        Ok(())
    }

    fn time_of_day(&self) -> Timestamp {
        Timestamp::from_system_time(self.source.clock.time_of_day())
    }

    /// Writes the last good generation when it is due, unless values are lost.
    fn keep_generation(&mut self, is_closing: bool) {
        let (now_s, last) = (self.source.clock.now_s(), self.store.as_ref().map(Store::last));
        let Some(last) = last.filter(|last| self.generation.is_due(now_s, *last, is_closing)) else {
            return;
        };
        self.generation.written = Some((now_s, last));
        if self.source.tables.lost().is_empty()
            && let Err(error) = Generation::write(
                &self.folder,
                &self.kept,
                &self.time_of_day(),
                &self.source.generations,
            )
        {
            tracing::warn!("the last good generation is not written: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn generation_due_at_start_at_end_and_ten_minutes_after_a_change() {
        let pace = |written| GenerationPace { written };
        for (written, now_s, last, is_closing, is_due) in [
            (None, 0.0, 1, false, true),
            (Some((0.0, 1)), 700.0, 1, true, false),
            (Some((0.0, 1)), 500.0, 2, false, false),
            (Some((0.0, 1)), 500.0, 2, true, true),
            (Some((0.0, 1)), 600.0, 2, false, true),
        ] {
            assert_eq!(
                pace(written).is_due(now_s, last, is_closing),
                is_due,
                "{written:?} {now_s}"
            );
        }
    }

    #[test]
    fn with_commits_of_up_to_50_ms_what_is_kept_is_at_most_100_ms_behind() {
        let (mut pace, mut now_s, mut longest_s) = (Pace::default(), 0.0, 0.0_f64);
        for round in 0..500_u32 {
            let looked_s = now_s;
            now_s += f64::from(round * 7 % 51) / 1000.0;
            longest_s = longest_s.max(pace.on_commit(looked_s, now_s));
            now_s += pace.wait(now_s).as_secs_f64();
        }
        assert!(longest_s > 0.09, "{longest_s}");
        assert!(longest_s <= 0.1 + 1e-6, "{longest_s}");
    }
}
