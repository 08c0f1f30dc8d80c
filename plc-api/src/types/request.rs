//! Everything that can be asked of a machine, and how it answers.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;
use super::command::{Command, CommandMeta, CommandReply, Verb};
use super::machine::AlarmRecord;
use super::output::{Claim, HandlerPresence, HandshakeResult, ProgressReport, Redeliver, Reset};
use super::program::{ProgramCheck, ProgramDiagnostic, ProgramInfo};
use super::state::{Execution, Lock, SpindleDirection};

/// A request to a machine.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// A command to a coordinate system.
    Command {
        /// To whom.
        cs: CoordinateSystemNumber,
        /// What.
        command: Command,
        /// From whom, and under which condition.
        meta: CommandMeta,
        /// True: answer when the effect has been reached; false: when accepted.
        wait: bool,
    },
    /// How far a command is; answered by [`Answer::Command`].
    CommandStatus(String),
    /// A handler takes an output. `m`, where the transport names it, must be the output's.
    Claim(CoordinateSystemNumber, Option<u16>, Claim),
    /// An output is answered.
    Reset(CoordinateSystemNumber, Option<u16>, Reset),
    /// The owner of an output tells how far it is.
    Progress(CoordinateSystemNumber, Option<u16>, ProgressReport),
    /// An operator decides about an output whose handler was lost.
    Redeliver(CoordinateSystemNumber, Option<u16>, Redeliver),
    /// A handler comes, changes what it handles, or goes.
    Handler(String, HandlerPresence),
    /// All handlers that are or were there; answered by [`Answer::Handlers`].
    Handlers,
    /// Sets an input.
    Input(CoordinateSystemNumber, Input),
    /// Commands the spindle.
    Spindle(CoordinateSystemNumber, SpindleCommand),
    /// Tells which tool is in the spindle.
    Tool(CoordinateSystemNumber, u16),
    /// Programs of the store; answered by [`Answer::Programs`].
    Programs,
    /// Text of a program; answered by [`Answer::ProgramText`].
    ReadProgram(u16),
    /// Writes a program, stored even with errors; answered by [`Answer::Check`].
    WriteProgram(u16, String),
    /// Removes a program.
    DeleteProgram(u16),
    /// Checks a program of the store; answered by [`Answer::Check`].
    CheckProgram(u16),
    /// Publishes the outputs again that nobody has claimed: a transport has reconnected, and notices may be lost.
    Republish,
    /// A server end refused something that an operator should know; raised as a warning. At most 500 characters.
    Warn(String),
    /// Alarms raised since the start, newest last, at most 1000; answered by [`Answer::Alarms`].
    AlarmHistory,
}

/// An input of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// Optional block skip by number, 1 to 31; numbers not named stay.
    OptionalSkip(BTreeMap<u8, bool>),
    /// Optional stop (M01).
    OptionalStop(bool),
    /// Single block.
    SingleBlock(bool),
    /// Dry run.
    DryRun(bool),
    /// Interlock: motion stops between blocks while it is on.
    Interlock(Lock),
    /// Start lock: a start is refused while it is on.
    StartLock(Lock),
    /// Overrides, percent; `None` stays.
    Override(OverrideChange),
}

/// Overrides to set, percent, absolute.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OverrideChange {
    /// 0 to 200.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feed: Option<f64>,
    /// 0 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rapid: Option<f64>,
    /// 0 to 200.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spindle: Option<f64>,
}

/// Payload of `spindle/set`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpindleCommand {
    /// How it shall turn.
    pub direction: SpindleDirection,
    /// Speed, r/min; for `cw` and `ccw`.
    #[serde(default)]
    pub rpm: f64,
}

/// How a machine answers a request that it carries out.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// Done, and there is nothing to say.
    Done,
    /// Of a command.
    Command(CommandReply),
    /// Of a claim or reset.
    Handshake(HandshakeResult),
    /// Programs of the store, ascending.
    Programs(Vec<ProgramInfo>),
    /// Text of a program.
    ProgramText(String),
    /// What checking says.
    Check(ProgramCheck),
    /// Handlers by id.
    Handlers(BTreeMap<String, HandlerPresence>),
    /// Alarms.
    Alarms(Vec<AlarmRecord>),
}

/// Why a request is not carried out; nothing has changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Refusal {
    /// Machine-readable.
    pub code: RefusalCode,
    /// What, why, and what to do.
    pub text: String,
    /// With `not_allowed`: the state that refuses.
    pub state: Option<Execution>,
    /// With `not_allowed`: what is allowed now.
    pub allowed: Vec<Verb>,
    /// With `program_has_errors`: the findings.
    pub diagnostics: Vec<ProgramDiagnostic>,
}

impl Refusal {
    /// A refusal of this code.
    pub fn new(code: RefusalCode, text: impl Into<String>) -> Self {
        Self {
            code,
            text: text.into(),
            state: None,
            allowed: Vec::new(),
            diagnostics: Vec::new(),
        }
    }
}

/// Machine-readable reason of a refusal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RefusalCode {
    /// There is no such coordinate system, program, command, alarm or value (404).
    NotFound,
    /// The state does not allow it (409).
    NotAllowed,
    /// The program runs (409).
    ProgramRuns,
    /// A start lock is on (409).
    StartLocked,
    /// The condition of the command does not hold (412).
    PreconditionFailed,
    /// The program has errors (422).
    ProgramHasErrors,
    /// The request is not well-formed, or a value is out of its range (400).
    Invalid,
    /// Larger than the limit (413).
    TooLarge,
    /// Known, and not built yet (501).
    NotSupported,
    /// A command over MQTT came with the retain flag (refused there only).
    Retained,
    /// The command is older than its `ttl_ms` (412).
    Expired,
    /// The runtime cannot do it now: it stops, or its store fails (503).
    Unavailable,
}
