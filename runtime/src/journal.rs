//! The journal: every event, in order. It goes to the log and to `data_dir` when serving, to a file or a list in a
//! simulation.

mod filter;
mod writer;

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use plc_api::handshake::Now;
use plc_api::server::{AccessKind, ServerTransport};
use plc_api::types::command::Verb;
use plc_api::types::data::LastRun;
use plc_api::types::io::IoValue;
use plc_api::types::machine::AlarmRecord;
use plc_api::types::output::OutputNotice;
use plc_api::types::request::RefusalCode;
use plc_api::types::run::RunEndedHow;
use plc_api::types::state::{Captured, Execution, Reason};
use plc_api::types::stored_data::StoredDataDecision;
use plc_api::types::{BootId, CoordinateSystemNumber};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use crate::order_key::OrderKey;
use crate::program_store::Edit;

pub use filter::LineFilter;
pub(crate) use writer::{JournalWriter, Message, WriteAhead};

/// Takes each line of the journal. True when that has woken a task, which must run before simulated time advances.
pub type Sink = Arc<Mutex<dyn FnMut(&Line) -> bool + Send>>;

/// One line of the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Seconds since the start.
    pub t_s: f64,
    /// Coordinate system; 0: the machine.
    pub cs: CoordinateSystemNumber,
    /// What happened.
    pub event: Event,
}

impl Line {
    /// The line as one JSON object: `event`, `cs`, `t_s` and the fields of the event.
    pub fn to_json(&self) -> Value {
        let mut object = serde_json::to_value(&self.event).unwrap_or_default();
        object["t_s"] = json!(self.t_s);
        object["cs"] = json!(self.cs);
        object
    }

    /// The line of a JSON object; `None`: it is damaged, or of an event that this version does not know.
    pub(crate) fn from_json(object: &Value) -> Option<Self> {
        Some(Self {
            t_s: f64::deserialize(object.get("t_s")?).ok()?,
            cs: CoordinateSystemNumber::deserialize(object.get("cs")?).ok()?,
            event: Event::deserialize(object).ok()?,
        })
    }
}

/// What happened in a coordinate system. In JSON one object: its name under `event`, and its fields.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The runtime has started.
    Boot {
        /// This start.
        boot_id: BootId,
        /// Version of the runtime.
        version: String,
    },
    /// The end of an earlier start of the runtime cut a run short.
    Interrupted(Box<LastRun>),
    /// A command was accepted.
    Command {
        /// What it commands.
        verb: Verb,
        /// Names the command.
        command_id: String,
        /// Who commands.
        client_id: String,
        /// The program that is loaded or started.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program: Option<u16>,
        /// Its hash.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program_hash: Option<String>,
    },
    /// What was asked is refused since the program is another one, or has no valid signature.
    Refused {
        /// What was asked: a command, or the route that changes a program.
        request: String,
        /// Which program.
        program: Option<u16>,
        /// Machine-readable reason.
        code: RefusalCode,
        /// Why.
        text: String,
        /// Who asked, where the request says so.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        client_id: Option<String>,
    },
    /// Somebody has logged in, could not, or may not do what it asked for.
    Access {
        /// What it was.
        what: AccessKind,
        /// Who: of a refused login the name that was typed.
        user: Option<String>,
        /// Address of its host, where it is known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from: Option<IpAddr>,
        /// How it came in.
        over: ServerTransport,
        /// Method and route, or the topic.
        request: String,
        /// How many more there were since the last such line, of which no line tells.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        left_out: Option<u64>,
    },
    /// A program has changed, or was removed.
    Program(Edit),
    /// A user has made a request that changes something; other lines tell what came of it.
    Request {
        /// Name of the user's token; `None`: without a token file, or let in by an external broker.
        user: Option<String>,
        /// Address of its host, where it is known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from: Option<IpAddr>,
        /// How it came in.
        over: ServerTransport,
        /// Method and path of its REST route.
        request: String,
        /// Its body, at most 200 characters.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        said: Option<String>,
        /// Names the command.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        command_id: Option<String>,
    },
    /// A run begins.
    Start {
        /// Main program; 0: manual data input, homing or a jog.
        program: u16,
        /// Names the run.
        run_id: String,
        /// Hash of the program.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program_hash: Option<String>,
        /// The line that it begins at, if not at the head.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from_line: Option<u32>,
        /// The order that begins it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        order: Option<OrderKey>,
        /// How many parts are ordered, if more than one. Each part begins with a line of this run.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        parts: Option<u32>,
    },
    /// The next part of a run is held back.
    PartsWait {
        /// By what.
        text: String,
    },
    /// Parts of a run that have not begun will not.
    PartsEnded {
        /// Why.
        how: RunEndedHow,
        /// What there is to say of it.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        text: String,
    },
    /// The motion of a block begins. Not written to disk: too many, and other events show what follows from them.
    Block {
        /// Program number.
        program: u16,
        /// Line of the source file, from 1.
        line: u32,
    },
    /// An auxiliary function output was made, for the first time.
    Output(Box<OutputNotice>),
    /// A handler has claimed an output.
    Claim {
        /// Sequence number of the output.
        seq: u64,
        /// Who claims.
        handler_id: String,
    },
    /// An output was reset, or failed by its handler.
    Reset {
        /// Sequence number of the output.
        seq: u64,
        /// Its M number.
        m: Option<u16>,
        /// Who resets.
        handler_id: String,
        /// Done, or failed.
        #[serde(flatten)]
        outcome: ResetOutcome,
        /// True: an operator's, regardless of the owner of the output.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        force: bool,
    },
    /// The owner of an output asks the operator.
    Question {
        /// Sequence number of the output.
        seq: u64,
        /// What is asked.
        text: String,
        /// What can be answered.
        choices: Vec<String>,
    },
    /// The operator has answered.
    Answer {
        /// Sequence number of the output.
        seq: u64,
        /// One of the choices.
        choice: String,
        /// Who answers.
        client_id: Option<String>,
    },
    /// The program pauses at M00, M01 or, with single block, at a block's end.
    Stop {
        /// 0 or 1; `None`: by single block.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        m: Option<u16>,
        /// Why, where no M code stops.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<Reason>,
        /// Program number.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program: Option<u16>,
        /// Line of the source file, from 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        line: Option<u32>,
    },
    /// The runtime itself holds the run.
    Hold {
        /// Why.
        reason: Reason,
        /// M number of the output that the run waits for.
        m: Option<u16>,
        /// Its sequence number.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seq: Option<u64>,
    },
    /// The run continues.
    Resume,
    /// Back trace begins or ends.
    BackTrace {
        /// True when it begins.
        on: bool,
    },
    /// A G31 has captured positions.
    Capture(Box<Captured>),
    /// A warning, which stops nothing.
    Warning {
        /// Program number.
        program: Option<u16>,
        /// Line of the source file, from 1.
        line: Option<u32>,
        /// What it warns of.
        text: String,
    },
    /// An alarm has stopped the coordinate system.
    Alarm(RaisedAlarm),
    /// The connection to the MQTT broker was made or lost.
    Bus {
        /// True when it was made.
        connected: bool,
    },
    /// The control lease has changed hands.
    Lease {
        /// What became of it.
        what: LeaseChange,
        /// Who held or holds it.
        holder: String,
        /// Its fence.
        fence: u64,
        /// The client that changed it; `None`: it expired.
        client_id: Option<String>,
    },
    /// An operator has put a value in the place of an input or output of the plant, or has taken it back.
    Force {
        /// Which, such as `io/in/door_closed`.
        io: String,
        /// The value; null: what is written counts again.
        value: Option<IoValue>,
        /// Who.
        user: Option<String>,
    },
    /// An output of the plant was written, and has another value or owner than before.
    IoWrite {
        /// Which, such as `io/out/clamp`.
        io: String,
        /// The value.
        value: IoValue,
        /// Its owner; null: a client without presence.
        handler_id: Option<String>,
    },
    /// The owner of an input or output of the plant has gone.
    IoLost {
        /// Which, such as `io/in/door_closed`.
        io: String,
        /// Its safe value.
        value: IoValue,
        /// The owner.
        handler_id: String,
    },
    /// Stored files do not fit together, or a person has decided about them.
    StoredData {
        /// The decision; `None`: a start has found them.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        decision: Option<StoredDataDecision>,
        /// What does not fit, in words.
        findings: Vec<String>,
    },
    /// The run has ended.
    End(RunEnd),
}

impl Event {
    /// True for an event that clients learn of before the journal has written its line.
    fn is_heard_of(&self) -> bool {
        matches!(self, Event::Start { .. } | Event::Output(_)) || self.is_counted()
    }

    /// True for an event that changes the counters of produced parts.
    fn is_counted(&self) -> bool {
        matches!(self, Event::End(_) | Event::PartsEnded { .. })
    }

    /// True for an event that closes outputs.
    fn closes_outputs(&self) -> bool {
        matches!(self, Event::Reset { .. } | Event::End(_))
    }
}

/// How an output was reset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "result", rename_all = "snake_case")]
pub enum ResetOutcome {
    /// The work is done.
    Ok,
    /// It failed.
    Fault {
        /// The handler's alarm code, 0 to 9999.
        code: Option<u16>,
        /// The alarm's text.
        text: Option<String>,
    },
}

/// An alarm that has stopped a coordinate system.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RaisedAlarm {
    /// An alarm of this coordinate system.
    OfThis(Box<AlarmRecord>),
    /// An alarm of all, which a sequence program has raised.
    OfAll {
        /// Number of the alarm.
        number: u16,
        /// What happened.
        text: String,
    },
}

impl RaisedAlarm {
    /// Number of the alarm.
    pub fn number(&self) -> u16 {
        match self {
            RaisedAlarm::OfThis(record) => record.number,
            RaisedAlarm::OfAll { number, .. } => *number,
        }
    }

    /// Number and text, for people.
    pub(crate) fn said(&self) -> String {
        let (number, text) = match self {
            RaisedAlarm::OfThis(record) => (record.number, &record.text),
            RaisedAlarm::OfAll { number, text } => (*number, text),
        };
        format!("{number}, {text}")
    }
}

/// What became of a control lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeaseChange {
    /// Somebody took it.
    Taken,
    /// Its holder gave it back.
    Released,
    /// An administrator broke it.
    Broken,
    /// Its time was over.
    Expired,
}

/// How a run has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RunEnd {
    /// Before its end.
    CutShort {
        /// The state that it leads to.
        outcome: Execution,
        /// The state's reason.
        #[serde(deserialize_with = "Option::deserialize")]
        reason: Option<Reason>,
        /// Program whose motion ran; none where nothing had run.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program: Option<u16>,
        /// Its line.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        line: Option<u32>,
    },
    /// At its end.
    Completed {
        /// The state that it leads to.
        outcome: Execution,
    },
}

impl RunEnd {
    /// The state that the end of the run leads to.
    pub fn outcome(&self) -> Execution {
        match self {
            RunEnd::CutShort { outcome, .. } | RunEnd::Completed { outcome } => *outcome,
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

    /// Number of the last line that goes to disk; 0 where none does.
    pub(crate) fn last_number(&self) -> u64 {
        self.disk
            .as_ref()
            .map_or(0, |disk| disk.last.load(Ordering::Acquire))
    }

    /// Numbers go on behind this one.
    pub(crate) fn go_on_after(&self, number: u64) {
        if let Some(disk) = &self.disk {
            disk.last.fetch_max(number, Ordering::AcqRel);
        }
    }

    /// True if its lines go to disk.
    pub(crate) fn is_on_disk(&self) -> bool {
        self.disk.is_some()
    }

    /// Writes where the axes of a coordinate system rest, by motor number; `None`: they move. A kill after this returns does not
    /// lose it.
    pub(crate) fn note_rest(&self, cs: CoordinateSystemNumber, positions: Option<&BTreeMap<u16, f64>>) {
        let ahead = self.disk.as_ref().and_then(|disk| disk.ahead.as_ref());
        if let Some(ahead) = ahead
            && let Err(error) = ahead.rest(cs, self.last_number(), positions)
        {
            tracing::debug!("where coordinate system {cs} rests is not written ahead: {error}");
        }
    }

    /// The number of the next line that goes to disk; 0 if none does.
    pub(crate) fn reserve(&self) -> u64 {
        self.disk.as_ref().map_or(0, JournalWriter::reserve)
    }

    /// Writes a line of this number. True when that has woken a task.
    pub(crate) fn record(&self, n: u64, now: Now, cs: CoordinateSystemNumber, event: Event) -> bool {
        let is_block = matches!(event, Event::Block { .. });
        let line = Line {
            t_s: now.monotonic_s,
            cs,
            event,
        };
        let mut has_woken = false;
        match &self.sink {
            Some(sink) => has_woken = (sink.lock().unwrap_or_else(PoisonError::into_inner))(&line),
            None if is_block => tracing::debug!(target: "journal", "{}", line.to_json()),
            None => tracing::info!(target: "journal", "{}", line.to_json()),
        }
        // Its text is made on the journal's thread: a handshake does not wait for it.
        if let Some(disk) = self.disk.as_ref().filter(|_| !is_block) {
            disk.write_as(n, line, now.time);
        }
        has_woken
    }
}

#[cfg(test)]
mod tests;
