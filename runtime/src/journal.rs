//! The journal: what happened, in order. To the log and to `data_dir` when serving, to a file or a list in a simulation.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

use plc_api::handshake::Now;
use plc_api::types::CoordinateSystemNumber;
use serde_json::{Map, Value, json};
use tandem_model::Origin;

use crate::persistence::journal_file::JournalWriter;

/// The event of each block that begins: too many for a disk, and what follows from it is said by others.
const BLOCK: &str = "block";

/// Takes each line of the journal. True when that has woken a task: it runs before simulated time goes on.
pub type Sink = Arc<Mutex<dyn FnMut(&Line) -> bool + Send>>;

/// One line of the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Seconds since the start.
    pub t_s: f64,
    /// Coordinate system.
    pub cs: CoordinateSystemNumber,
    /// What happened.
    pub event: &'static str,
    fields: Fields,
}

/// What an entry says beside its event.
#[derive(Debug, Clone, PartialEq)]
enum Fields {
    Object(Map<String, Value>),
    /// Of a block. Made an object only for who reads it: most are counted.
    Place {
        program: u16,
        line: u32,
    },
}

impl Line {
    pub(crate) fn new(t_s: f64, cs: CoordinateSystemNumber, entry: Entry) -> Self {
        let Entry { event, fields } = entry;
        Self {
            t_s,
            cs,
            event,
            fields,
        }
    }

    /// Its fields by their names.
    pub fn fields(&self) -> Cow<'_, Map<String, Value>> {
        match &self.fields {
            Fields::Object(fields) => Cow::Borrowed(fields),
            Fields::Place { program, line } => Cow::Owned(
                [("program", json!(program)), ("line", json!(line))]
                    .map(|(name, value)| (name.to_owned(), value))
                    .into_iter()
                    .collect(),
            ),
        }
    }

    /// A field; null when the line has none of this name.
    pub fn field(&self, name: &str) -> Value {
        self.fields().get(name).cloned().unwrap_or_default()
    }

    /// The line as one JSON object.
    pub fn to_json(&self) -> Value {
        let mut object = self.fields().into_owned();
        object.insert("t_s".into(), json!(self.t_s));
        object.insert("cs".into(), json!(self.cs));
        object.insert("event".into(), json!(self.event));
        Value::Object(object)
    }
}

/// What a coordinate system reports.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    event: &'static str,
    fields: Fields,
}

impl Entry {
    /// A block begins.
    pub fn block(origin: Origin) -> Self {
        let Origin { program, line, .. } = origin;
        Self {
            event: BLOCK,
            fields: Fields::Place { program, line },
        }
    }

    /// An entry whose fields are those of a JSON object.
    pub fn new(event: &'static str, fields: Value) -> Self {
        let fields = match fields {
            Value::Object(fields) => fields,
            _ => Map::new(),
        };
        Self {
            event,
            fields: Fields::Object(fields),
        }
    }
}

/// Where lines go.
#[derive(Clone, Default)]
pub struct Journal {
    sink: Option<Sink>,
    disk: Option<JournalWriter>,
}

impl std::fmt::Debug for Journal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Journal").finish_non_exhaustive()
    }
}

impl Journal {
    /// A journal whose lines go to the log.
    pub fn to_log() -> Self {
        Self::default()
    }

    /// A journal whose lines go to `sink`.
    pub fn to_sink(sink: Sink) -> Self {
        Self {
            sink: Some(sink),
            disk: None,
        }
    }

    /// A journal whose lines go to the log and, but for blocks, to disk.
    pub(crate) fn to_disk(disk: JournalWriter) -> Self {
        Self {
            sink: None,
            disk: Some(disk),
        }
    }

    /// Writes a line. True when that has woken a task.
    pub(crate) fn record(&self, now: Now, cs: CoordinateSystemNumber, entry: Entry) -> bool {
        let line = Line::new(now.monotonic_s, cs, entry);
        let mut has_woken = false;
        match &self.sink {
            Some(sink) => has_woken = (sink.lock().unwrap_or_else(PoisonError::into_inner))(&line),
            None if line.event == BLOCK => tracing::debug!(target: "journal", "{}", line.to_json()),
            None => tracing::info!(target: "journal", "{}", line.to_json()),
        }
        // its text is made on the journal's thread: a handshake does not wait for it
        if let Some(disk) = self.disk.as_ref().filter(|_| line.event != BLOCK) {
            disk.write(line, now.time);
        }
        has_woken
    }
}
