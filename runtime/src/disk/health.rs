//! Which part of what is kept cannot be written now: noted by who writes, looked at by the watch over the data folder.

use std::collections::BTreeMap;
use std::fmt::Display;

use parking_lot::Mutex;
use plc_api::supervisor::Supervisor;
use tandem_model::alarm::{AlarmEntry, JOURNAL_FAILED, PROGRAMS_FAILED, STORE_FAILED};

/// What is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    Store,
    Journal,
    Programs,
}

impl Part {
    pub const ALL: [Part; 3] = [Part::Store, Part::Journal, Part::Programs];

    /// The alarm that stands while it cannot be written.
    pub fn alarm(self) -> &'static AlarmEntry {
        match self {
            Part::Store => &STORE_FAILED,
            Part::Journal => &JOURNAL_FAILED,
            Part::Programs => &PROGRAMS_FAILED,
        }
    }
}

/// Why each part cannot be written, as its last attempt has found.
#[derive(Debug, Default)]
pub(crate) struct Health {
    faults: Mutex<BTreeMap<Part, String>>,
    /// Of the threads that write, and of all others.
    pub supervisor: Supervisor,
}

impl Health {
    /// Notes the result of an attempt to write; the log tells of the first that fails and of the first that does not.
    pub fn note<T, E: Display>(&self, part: Part, attempt: &Result<T, E>) {
        let mut faults = self.faults.lock();
        match attempt {
            Ok(_) => {
                if faults.remove(&part).is_some() {
                    tracing::warn!("{}: it is written again", part.alarm().title);
                }
            }
            Err(error) => {
                let text = error.to_string();
                if !faults.contains_key(&part) {
                    tracing::error!("{}: {text}; it is tried again", part.alarm().title);
                }
                faults.insert(part, text);
            }
        }
    }

    /// Why a part cannot be written; `None`: its last attempt succeeded.
    pub fn fault(&self, part: Part) -> Option<String> {
        self.faults.lock().get(&part).cloned()
    }
}
