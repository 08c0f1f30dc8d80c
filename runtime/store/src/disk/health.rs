//! Records which parts of the stored data cannot be written at present. The writing threads record the
//! results of their attempts; the watch over the data folder reads them.

use std::collections::BTreeMap;
use std::fmt::Display;

use parking_lot::Mutex;
use plc_protocol::supervisor::Supervisor;
use tandem_model::alarm::{AlarmEntry, JOURNAL_FAILED, PROGRAMS_FAILED, STORE_FAILED};

/// Part of the stored data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum DataFolderPart {
    /// The store of the values.
    Store,
    /// The journal.
    Journal,
    /// The programs.
    Programs,
}

impl DataFolderPart {
    /// All parts.
    pub const ALL: [DataFolderPart; 3] = [
        DataFolderPart::Store,
        DataFolderPart::Journal,
        DataFolderPart::Programs,
    ];

    /// Returns the alarm that is active while this part cannot be written.
    pub fn alarm(self) -> &'static AlarmEntry {
        match self {
            DataFolderPart::Store => &STORE_FAILED,
            DataFolderPart::Journal => &JOURNAL_FAILED,
            DataFolderPart::Programs => &PROGRAMS_FAILED,
        }
    }
}

/// Reason why each part cannot be written, from the last attempt to write that part.
#[derive(Debug, Default)]
pub struct Health {
    faults: Mutex<BTreeMap<DataFolderPart, String>>,
    /// Supervisor of the writing threads and of all other threads.
    pub supervisor: Supervisor,
}

impl Health {
    /// Records the result of an attempt to write a part. The first failure and the first success after it are
    /// logged.
    pub fn record_attempt<T, E: Display>(&self, part: DataFolderPart, attempt: &Result<T, E>) {
        let mut faults = self.faults.lock();
        match attempt {
            Ok(_) => {
                if faults.remove(&part).is_some() {
                    tracing::warn!("{}: can be written again", part.alarm().title);
                }
            }
            Err(error) => {
                let text = error.to_string();
                if !faults.contains_key(&part) {
                    tracing::error!("{}: {text}; the runtime tries again", part.alarm().title);
                }
                faults.insert(part, text);
            }
        }
    }

    /// Returns the reason why a part cannot be written; `None` if the last attempt succeeded.
    pub fn fault(&self, part: DataFolderPart) -> Option<String> {
        self.faults.lock().get(&part).cloned()
    }
}
