//! Watch over the data folder. Raises alarms for files that cannot be written, are damaged or were changed outside of
//! the runtime, and for a full disk. Ends each alarm when its cause has ended. Has its own thread, because a disk may
//! be slow.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use tandem_model::alarm::{
    AlarmEntry, DATA_FOLDER_FAILED, PROGRAM_CHANGED, PROGRAM_DAMAGED, STORED_DATA_QUESTION, VALUES_LOST,
};
use tandem_store::disk::{DataFolderPart, DiskPath};
use tandem_store::journal::Event;
use tandem_store::threads::{StartedThread, Threads, Work};

use crate::shared::SharedState;

/// Interval at which the faults that other threads have found are checked.
const INTERVAL: Duration = Duration::from_millis(100);

/// Number of these intervals between two inspections of the disk.
const DISK_EVERY: u32 = 10;

/// Free bytes below which a disk is reported as full. Reason: a change of all stored data needs fewer bytes.
const FREE_MIN: u64 = 1 << 20;

/// Maximum number of items that the text of an alarm names.
const NAMED_MAX: usize = 20;

/// Handle of the watch thread. Dropping it ends the thread.
#[derive(Debug)]
pub(crate) struct DataWatch {
    stop: Option<Sender<()>>,
    thread: Arc<dyn StartedThread>,
}

impl DataWatch {
    /// Starts to watch the data folder of a machine.
    ///
    /// # Errors
    /// Returns an error if the operating system provides no thread.
    pub fn start(folder: &DiskPath, shared: Arc<SharedState>, threads: &Threads) -> io::Result<Self> {
        let (stop, stopped) = channel();
        let supervisor = shared.supervisor.clone();
        let watch = DataWatchState {
            folder: folder.clone(),
            shared,
            stopped,
            looks: 0,
        };
        let thread = threads.start("data-watch", &supervisor, watch)?;
        Ok(Self {
            stop: Some(stop),
            thread,
        })
    }
}

impl Drop for DataWatch {
    fn drop(&mut self) {
        drop(self.stop.take());
        self.thread.join();
    }
}

/// State of the watch thread.
struct DataWatchState {
    folder: DiskPath,
    shared: Arc<SharedState>,
    stopped: Receiver<()>,
    looks: u32,
}

impl Work for DataWatchState {
    fn patience(&self) -> Duration {
        INTERVAL
    }

    fn round(&mut self, patience: Duration) -> bool {
        if self.stopped.recv_timeout(patience) != Err(RecvTimeoutError::Timeout) {
            return false;
        }
        let shared = &self.shared;
        if self.looks.is_multiple_of(DISK_EVERY) {
            look_at_disk(&self.folder, shared);
        }
        self.looks = self.looks.wrapping_add(1);
        for part in DataFolderPart::ALL {
            shared.update_standing_warning(part.alarm(), shared.health.fault(part).as_deref());
        }
        true
    }
}

fn look_at_disk(folder: &DiskPath, shared: &SharedState) {
    let places = [folder.clone(), folder.join("programs"), folder.join("journal")];
    let faults: Vec<String> = places.iter().filter_map(fault).collect();
    shared.update_standing_warning(&DATA_FOLDER_FAILED, list(&faults).as_deref());
    if shared.health.fault(DataFolderPart::Programs).is_some() {
        // The result is recorded: it shows whether the folder can be written again.
        let _ = shared.record_attempt(DataFolderPart::Programs, shared.store.probe());
    }
    match shared.store.look_again() {
        Ok(changed) => {
            for (text, edit) in changed {
                shared.record(0, Event::Program(edit));
                warn_changed(shared, &text);
                shared.wake_all();
            }
        }
        gone => shared.health.record_attempt(DataFolderPart::Programs, &gone),
    }
    let damaged: Vec<String> = (shared.store.damaged().iter())
        .map(|(number, how)| format!("program {number} ({how})"))
        .collect();
    shared.update_standing_warning(&PROGRAM_DAMAGED, list(&damaged).as_deref());
    shared.update_standing_warning(&VALUES_LOST, list(&shared.tables.lost()).as_deref());
    let question = shared.stored_data.lock().text();
    shared.update_standing_warning(&STORED_DATA_QUESTION, question.as_deref());
}

/// Returns a description of the fault of a folder; `None` if the folder can be used.
fn fault(place: &DiskPath) -> Option<String> {
    let named = |what: &str| Some(format!("{}: {what}", place.display()));
    match place.metadata() {
        Err(error) => return named(&format!("the folder does not exist ({error})")),
        Ok(metadata) if !metadata.is_folder() => return named("it is not a folder"),
        Ok(_) => {}
    }
    let space = match place.space() {
        Err(error) => return named(&error.to_string()),
        Ok(space) if space.is_read_only => return named("the disk is read-only"),
        Ok(space) => space,
    };
    if let Some(free_bytes) = space.free_bytes.filter(|free_bytes| *free_bytes < FREE_MIN) {
        return named(&format!("the disk is full: {} KiB are left", free_bytes >> 10));
    }
    match place.check_writable() {
        Err(error) => named(&format!("the folder is not writable ({error})")),
        Ok(()) => None,
    }
}

/// Returns one text for all items; `None` if the list is empty.
pub(crate) fn list(all: &[String]) -> Option<String> {
    let more = match all.len().saturating_sub(NAMED_MAX) {
        0 => String::new(),
        more => format!("; and {more} more"),
    };
    let named = all[..all.len().min(NAMED_MAX)].join("; ");
    (!all.is_empty()).then_some(named + &more)
}

/// Raises a warning in the log, as an event and in the history. The warning is not active.
pub(crate) fn warn_once(shared: &SharedState, entry: &AlarmEntry, text: &str) {
    tracing::warn!("{}: {text}", entry.title);
    shared.raise(warning(entry, text));
}

/// Raises a warning about a program that was changed outside of the runtime. Also writes it to the journal, because the
/// machine may execute the change.
pub(crate) fn warn_changed(shared: &SharedState, text: &str) {
    warn_once(shared, &PROGRAM_CHANGED, text);
    for system in &shared.machine.coordinate_systems {
        let warning = Event::Warning {
            program: None,
            line: None,
            text: format!("{}: {text}", PROGRAM_CHANGED.title),
        };
        shared.record(system.settings.number, warning);
    }
}

/// Raises a warning that stays active until a reset.
pub(crate) fn warn_standing(shared: &SharedState, entry: &AlarmEntry, text: &str) {
    tracing::warn!("{}: {text}", entry.title);
    shared.raise_standing(warning(entry, text));
}

fn warning(entry: &AlarmEntry, text: &str) -> AlarmRecord {
    AlarmRecord {
        severity: AlarmSeverity::Warning,
        number: entry.number,
        text: format!("{}: {text}", entry.title),
        ..AlarmRecord::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_gone_or_no_folder_is_a_fault_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(fault(&folder.path().into()), None);
        let file = folder.path().join("file");
        assert!(
            fault(&file.as_path().into())
                .unwrap()
                .contains("file: the folder does not exist")
        );
        std::fs::write(&file, "").unwrap();
        assert!(
            fault(&file.as_path().into())
                .unwrap()
                .ends_with("it is not a folder")
        );
    }

    #[test]
    fn a_list_names_twenty_and_counts_the_rest() {
        let all: Vec<String> = (0..22).map(|n| n.to_string()).collect();
        assert_eq!(list(&all[..0]), None);
        assert_eq!(list(&all[..2]).unwrap(), "0; 1");
        assert!(list(&all).unwrap().ends_with("; 19; and 2 more"));
    }
}
