//! The journal: every event, in order. A serving runtime writes it to the log and to `data_dir`; a simulation passes it
//! to a file or a list.

mod filter;
mod writer;

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use plc_protocol::handshake::Now;
use plc_protocol::server::{AccessKind, ServerTransport};
use plc_protocol::types::command::Verb;
use plc_protocol::types::data::LastRun;
use plc_protocol::types::io::IoValue;
use plc_protocol::types::machine::AlarmRecord;
use plc_protocol::types::output::OutputNotice;
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::run::RunEndedHow;
use plc_protocol::types::state::{CapturedPositions, Execution, Reason};
use plc_protocol::types::stored_data::StoredDataDecision;
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use crate::order_key::OrderKey;
use crate::program_store::Edit;

pub use filter::LineFilter;
pub use writer::{JournalMessage, JournalWriter, WriteAhead};

/// Function that receives each line of the journal. It returns true if it has woken a task that must run before
/// simulated time advances.
pub type Sink = Arc<Mutex<dyn FnMut(&Line) -> bool + Send>>;

/// One line of the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Seconds since the start of the runtime.
    pub t_s: f64,
    /// Number of the coordinate system; 0 stands for the whole machine.
    pub cs: CoordinateSystemNumber,
    /// The event.
    pub event: Event,
}

impl Line {
    /// Returns the line as one JSON object: `event`, `cs`, `t_s` and the fields of the event.
    pub fn to_json(&self) -> Value {
        let mut object = serde_json::to_value(&self.event).unwrap_or_default();
        object["t_s"] = json!(self.t_s);
        object["cs"] = json!(self.cs);
        object
    }

    /// Parses a line from a JSON object. Returns `None` if the object is damaged, or if this version does not know the
    /// event.
    pub fn from_json(object: &Value) -> Option<Self> {
        Some(Self {
            t_s: f64::deserialize(object.get("t_s")?).ok()?,
            cs: CoordinateSystemNumber::deserialize(object.get("cs")?).ok()?,
            event: Event::deserialize(object).ok()?,
        })
    }
}

/// An event in a coordinate system. In JSON an event is one object: its name under `event`, and its fields.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The runtime has started.
    Boot {
        /// Identifies this start.
        boot_id: BootId,
        /// Version of the runtime.
        version: String,
    },
    /// An earlier runtime ended during a run, without an end of this run.
    Interrupted(Box<LastRun>),
    /// A command was accepted.
    Command {
        /// Kind of the command.
        verb: Verb,
        /// Id of the command.
        command_id: String,
        /// The client that issued the command.
        client_id: String,
        /// Number of the program that is loaded or started.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program: Option<u16>,
        /// Hash of that program.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program_hash: Option<String>,
    },
    /// A request was rejected because the program is a different one or has no valid signature.
    Refused {
        /// The rejected request: a command, or the route of the change of a program.
        request: String,
        /// Number of the program.
        program: Option<u16>,
        /// Machine-readable reason.
        code: RefusalCode,
        /// Reason as text.
        text: String,
        /// The client that sent the request, if the request names it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        client_id: Option<String>,
    },
    /// A login, a failed login, or a request without the necessary rights.
    Access {
        /// Kind of the access.
        what: AccessKind,
        /// Name of the user; for a rejected login the name that was entered.
        user: Option<String>,
        /// Address of the client's host, if known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from: Option<IpAddr>,
        /// Transport of the request.
        over: ServerTransport,
        /// Method and route of the request, or its topic.
        request: String,
        /// Number of such events without a line of their own since the last line of this kind.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        left_out: Option<u64>,
    },
    /// A program was changed or removed.
    Program(Edit),
    /// A user has sent a request that changes something. The result of the request has lines of its own.
    Request {
        /// Name of the user's token; `None` if there is no token file, or if an external broker authorized
        /// the user.
        user: Option<String>,
        /// Address of the user's host, if known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from: Option<IpAddr>,
        /// Transport of the request.
        over: ServerTransport,
        /// Method and path of its REST route.
        request: String,
        /// Body of the request, at most 200 characters.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        said: Option<String>,
        /// Id of the command.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        command_id: Option<String>,
    },
    /// A run has begun, or a further part of a run.
    Start {
        /// Number of the main program; 0 for manual data input, homing or a jog.
        program: u16,
        /// Name of the run.
        run_id: String,
        /// Hash of the program.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program_hash: Option<String>,
        /// The line at which the run begins, if it is not line 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from_line: Option<u32>,
        /// The order that starts the run.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        order: Option<OrderKey>,
        /// Number of ordered parts, if more than one. Each part begins with a line of this run.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        parts: Option<u32>,
    },
    /// A condition delays the next part of a run.
    PartsWait {
        /// The condition as text.
        text: String,
    },
    /// The remaining parts of a run are cancelled.
    PartsEnded {
        /// Cause of the cancellation.
        how: RunEndedHow,
        /// Additional text.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        text: String,
    },
    /// The motion of a block has begun. Not written to disk, because blocks are too many; other events record their
    /// effects.
    Block {
        /// Program number.
        program: u16,
        /// Line of the source file, from 1.
        line: u32,
    },
    /// An output was issued for the first time.
    Output(Box<OutputNotice>),
    /// A handler has claimed an output.
    Claim {
        /// Sequence number of the output.
        seq: u64,
        /// Id of the handler.
        handler_id: String,
    },
    /// An output was reset, or its handler reported a failure.
    Reset {
        /// Sequence number of the output.
        seq: u64,
        /// M number of the output.
        m: Option<u16>,
        /// Id of the handler that reset the output.
        handler_id: String,
        /// Success or failure of the handler's work.
        #[serde(flatten)]
        outcome: ResetOutcome,
        /// True if an operator reset the output, regardless of its owner.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        force: bool,
    },
    /// The owner of an output asks the operator a question.
    Question {
        /// Sequence number of the output.
        seq: u64,
        /// Text of the question.
        text: String,
        /// Possible answers.
        choices: Vec<String>,
    },
    /// The operator has answered the question of an output.
    Answer {
        /// Sequence number of the output.
        seq: u64,
        /// The choice of the operator.
        choice: String,
        /// The client that sent the answer.
        client_id: Option<String>,
    },
    /// The program has stopped at M00, at M01 or, in single block, at the end of a block.
    Stop {
        /// 0 for M00, 1 for M01; `None` in single block.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        m: Option<u16>,
        /// Reason of the stop if no M code causes it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<Reason>,
        /// Program number.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program: Option<u16>,
        /// Line of the source file, from 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        line: Option<u32>,
    },
    /// The runtime itself holds the run, not an operator.
    Hold {
        /// Reason of the hold.
        reason: Reason,
        /// M number of the output that the run waits for.
        m: Option<u16>,
        /// Sequence number of that output.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seq: Option<u64>,
    },
    /// The run continues.
    Resume,
    /// A back trace has begun or ended.
    BackTrace {
        /// True if the back trace has begun.
        on: bool,
    },
    /// A G31 block has captured positions.
    Capture(Box<CapturedPositions>),
    /// A warning, which stops nothing.
    Warning {
        /// Program number.
        program: Option<u16>,
        /// Line of the source file, from 1.
        line: Option<u32>,
        /// Text of the warning.
        text: String,
    },
    /// An alarm has stopped the coordinate system.
    Alarm(RaisedAlarm),
    /// The connection to the MQTT broker was established or lost.
    Bus {
        /// True if the connection was established.
        connected: bool,
    },
    /// The control lease was taken, released or broken, or has expired.
    Lease {
        /// The change of the lease.
        what: LeaseChange,
        /// Holder of the lease after the change, otherwise the previous holder.
        holder: String,
        /// Fence of the lease.
        fence: u64,
        /// The client that changed the lease; `None` if the lease expired.
        client_id: Option<String>,
    },
    /// An operator has forced the value of an input or output of the plant, or has ended the forcing.
    Force {
        /// Name of the input or output, such as `io/in/door_closed`.
        io: String,
        /// The forced value; null if the forcing has ended, so that the written value applies again.
        value: Option<IoValue>,
        /// Name of the operator.
        user: Option<String>,
    },
    /// An output of the plant was written, and its value or owner has changed.
    IoWrite {
        /// Name of the output, such as `io/out/clamp`.
        io: String,
        /// The written value.
        value: IoValue,
        /// Id of the owner; null for a client without presence.
        handler_id: Option<String>,
    },
    /// The owner of an input or output of the plant is lost.
    IoLost {
        /// Name of the input or output, such as `io/in/door_closed`.
        io: String,
        /// Value of the point after the loss of its owner.
        value: IoValue,
        /// Id of the lost owner.
        handler_id: String,
    },
    /// Stored files are inconsistent, or a person has decided how to proceed with them.
    StoredData {
        /// The decision; `None` if a start has found the inconsistency.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        decision: Option<StoredDataDecision>,
        /// Descriptions of the inconsistencies.
        findings: Vec<String>,
    },
    /// The runtime has found an internal inconsistency: an event that the current state does not expect. The event has
    /// changed nothing. This line is a bug report.
    Inconsistency {
        /// The state and the event.
        text: String,
    },
    /// The run has ended.
    End(RunEnd),
}

impl Event {
    /// Returns true if clients may receive messages about this event before the journal has written its line.
    fn may_be_published_early(&self) -> bool {
        matches!(self, Event::Start { .. } | Event::Output(_)) || self.is_counted()
    }

    /// Returns true if the event changes the counters of produced parts.
    fn is_counted(&self) -> bool {
        matches!(self, Event::End(_) | Event::PartsEnded { .. })
    }

    /// Returns true if the event closes outputs.
    fn closes_outputs(&self) -> bool {
        matches!(self, Event::Reset { .. } | Event::End(_))
    }
}

/// Result of the reset of an output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "result", rename_all = "snake_case")]
pub enum ResetOutcome {
    /// The handler's work is done.
    Ok,
    /// The handler's work has failed.
    Fault {
        /// Alarm code of the handler, 0 to 9999.
        code: Option<u16>,
        /// Text of the alarm.
        text: Option<String>,
    },
}

/// An alarm that has stopped a coordinate system.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RaisedAlarm {
    /// An alarm of this coordinate system.
    OfThis(Box<AlarmRecord>),
    /// An alarm of all coordinate systems, raised by a sequence program.
    OfAll {
        /// Number of the alarm.
        number: u16,
        /// Text of the alarm.
        text: String,
    },
}

impl RaisedAlarm {
    /// Returns the number of the alarm.
    pub fn number(&self) -> u16 {
        match self {
            RaisedAlarm::OfThis(record) => record.number,
            RaisedAlarm::OfAll { number, .. } => *number,
        }
    }

    /// Returns number and text of the alarm for display.
    pub fn display_text(&self) -> String {
        let (number, text) = match self {
            RaisedAlarm::OfThis(record) => (record.number, &record.text),
            RaisedAlarm::OfAll { number, text } => (*number, text),
        };
        format!("{number}, {text}")
    }
}

/// Change of a control lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeaseChange {
    /// A client took the lease.
    Taken,
    /// The holder released the lease.
    Released,
    /// An administrator revoked the lease.
    Broken,
    /// The lease expired.
    Expired,
}

/// Result of the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RunEnd {
    /// The run ended before the end of the program.
    CutShort {
        /// State word after the end.
        outcome: Execution,
        /// Reason of that state word.
        #[serde(deserialize_with = "Option::deserialize")]
        reason: Option<Reason>,
        /// Program of the block that was moving; `None` if nothing had moved.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        program: Option<u16>,
        /// Line of that program.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        line: Option<u32>,
    },
    /// The run reached the end of the program.
    Completed {
        /// State word after the end.
        outcome: Execution,
    },
}

impl RunEnd {
    /// Returns the state word after the end of the run.
    pub fn outcome(&self) -> Execution {
        match self {
            RunEnd::CutShort { outcome, .. } | RunEnd::Completed { outcome } => *outcome,
        }
    }
}

/// Destination of the lines of the journal.
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
    /// Creates a journal whose lines go to the log.
    pub fn to_log() -> Self {
        Self::default()
    }

    /// Creates a journal whose lines go to `sink`.
    pub fn to_sink(sink: Sink) -> Self {
        Self {
            sink: Some(sink),
            disk: None,
        }
    }

    /// Creates a journal whose lines go to the log and, except for blocks, to disk.
    pub fn to_disk(disk: JournalWriter) -> Self {
        Self {
            sink: None,
            disk: Some(disk),
        }
    }

    /// Returns the number of the last line written to disk; 0 if lines are not written to disk.
    pub fn last_number(&self) -> u64 {
        self.disk
            .as_ref()
            .map_or(0, |disk| disk.last.load(Ordering::Acquire))
    }

    /// Continues the numbers of the lines after `number`.
    pub fn continue_numbers_after(&self, number: u64) {
        if let Some(disk) = &self.disk {
            disk.last.fetch_max(number, Ordering::AcqRel);
        }
    }

    /// Returns true if lines are written to disk.
    pub fn is_on_disk(&self) -> bool {
        self.disk.is_some()
    }

    /// Records the rest positions of a coordinate system's motors by motor number; `None` while they move. When this
    /// method returns, the record is safe even if the process is killed.
    pub fn note_rest(&self, cs: CoordinateSystemNumber, positions: Option<&BTreeMap<u16, f64>>) {
        let ahead = self.disk.as_ref().and_then(|disk| disk.ahead.as_ref());
        if let Some(ahead) = ahead
            && let Err(error) = ahead.rest(cs, self.last_number(), positions)
        {
            tracing::debug!("the rest position of coordinate system {cs} is not written ahead: {error}");
        }
    }

    /// Reserves the number of the next line on disk. Returns 0 if lines are not written to disk.
    pub fn reserve(&self) -> u64 {
        self.disk.as_ref().map_or(0, JournalWriter::reserve)
    }

    /// Writes a line with the number `n`. Returns true if a sink has woken a task.
    pub fn record(&self, n: u64, now: Now, cs: CoordinateSystemNumber, event: Event) -> bool {
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
        // The thread of the journal composes the text, so that a handshake does not wait for it.
        if let Some(disk) = self.disk.as_ref().filter(|_| !is_block) {
            disk.write_as(n, line, now.time);
        }
        has_woken
    }
}

#[cfg(test)]
mod tests;
