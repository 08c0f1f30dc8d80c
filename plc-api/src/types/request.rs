//! Everything that can be asked of a machine, and how it answers.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::CoordinateSystemNumber;
use super::command::{Command, CommandMeta, CommandReply};
use super::data::{LastRun, ToolChange, ToolTable, VariableArea, WorkOffsetTable};
use super::lease::LeaseRequest;
use super::machine::{AlarmRaise, AlarmRecord};
use super::output::{Claim, HandlerPresence, HandshakeResult, ProgressReport, Redeliver, Reset};
use super::program::{ProgramCheck, ProgramInfo};
use super::question::{Ask, OperatorAnswer, ValidateResult};
use super::state::{Lock, SpindleDirection};

pub use super::refusal::{Refusal, RefusalCode};

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
    /// Takes, releases or breaks the control lease; answered by [`Answer::Command`].
    Lease {
        /// Of whom.
        cs: CoordinateSystemNumber,
        /// What.
        request: LeaseRequest,
        /// From whom.
        meta: CommandMeta,
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
    /// The owner of an output asks the operator, or takes its question back; answered by [`Answer::Handshake`].
    Ask(CoordinateSystemNumber, Option<u16>, Ask),
    /// An operator answers; answered by [`Answer::Handshake`]: `unknown` when there is no such question or choice,
    /// `duplicate` when it has an answer.
    AnswerQuestion(CoordinateSystemNumber, Option<u16>, OperatorAnswer),
    /// A handler says whether an M code of a program that is being loaded may be put out with its parameters.
    ValidateResult(CoordinateSystemNumber, Option<u16>, ValidateResult),
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
    /// Sets the skip input of a motor, by its CNC motor number; it keeps the value. Not real time: what G31 captures is
    /// where the motor is when the servo hears of it.
    SkipInput(u16, bool),
    /// How punctual the servo thread is; answered by [`Answer::ServoTiming`], in simulated time refused.
    ServoTiming,
    /// Reads variables as they are at one moment; answered by [`Answer::Variables`].
    ReadVariables {
        /// Which.
        area: VariableArea,
        /// Number of the first.
        from: u32,
        /// How many, 1 to 1024.
        count: u32,
        /// Who asks, where the answer is also published on `reply/{client_id}`.
        meta: Option<CommandMeta>,
    },
    /// Writes variables, all of them between two blocks of any program, or none.
    WriteVariables {
        /// Which.
        area: VariableArea,
        /// Number of the first.
        from: u32,
        /// Their values, 1 to 1024.
        values: Vec<f64>,
        /// Who writes, where the answer is also published on `reply/{client_id}`: an id seen in the last 10 minutes
        /// gets the stored reply and writes nothing.
        meta: Option<CommandMeta>,
    },
    /// The tool table; answered by [`Answer::Tools`].
    Tools,
    /// Changes the tool table. Kept on disk before it is answered.
    WriteTools(ToolChange),
    /// Work offsets of a coordinate system; answered by [`Answer::WorkOffsets`].
    WorkOffsets(CoordinateSystemNumber),
    /// Changes work offsets. Kept on disk before it is answered.
    WriteWorkOffsets(CoordinateSystemNumber, WorkOffsetTable),
    /// How the last run before this start of the runtime stood; answered by [`Answer::LastRun`].
    LastRun(CoordinateSystemNumber),
    /// The newest `count` lines of the journal, 1 to 1000, but for the `from` newest; answered by [`Answer::Journal`].
    Journal {
        /// How many of the newest are left out.
        from: u32,
        /// How many.
        count: u32,
    },
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
    /// Intermediate code of a program of the store; answered by [`Answer::ProgramText`], or refused as
    /// `program_has_errors` with the diagnostics.
    IntermediateCode(u16),
    /// Publishes the outputs again that nobody has claimed: a transport has reconnected, and notices may be lost.
    Republish,
    /// Whether the runtime's server end for MQTT has its connection to the broker. True is taken for granted until it
    /// says otherwise.
    BusLink {
        /// It has.
        connected: bool,
    },
    /// Raises an alarm of a coordinate system, or of all.
    RaiseAlarm(AlarmRaise),
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
    /// Single block: each block ends at rest and waits for a resume.
    SingleBlock(bool),
    /// Dry run.
    DryRun(bool),
    /// Interlock: motion is held on its path while it is on, and nothing that moves begins or goes on.
    Interlock(Lock),
    /// Start lock: a start of a program or of manual data input is refused while it is on.
    StartLock(Lock),
    /// Overrides, percent; `None` stays.
    Override(OverrideChange),
}

/// Overrides to set, percent, absolute.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    /// Values of variables, ascending by number.
    Variables(Vec<f64>),
    /// The tool table.
    Tools(ToolTable),
    /// Work offsets.
    WorkOffsets(WorkOffsetTable),
    /// How the last run stood; `None`: there was none.
    LastRun(Option<LastRun>),
    /// Lines of the journal, in the order of time: JSON objects with `ts`, `t_s` (seconds since the start of the
    /// runtime), `cs`, `event`, and what belongs to the event.
    Journal(Vec<Value>),
    /// Programs of the store, ascending.
    Programs(Vec<ProgramInfo>),
    /// Text of a program, or its intermediate code.
    ProgramText(String),
    /// What checking says.
    Check(ProgramCheck),
    /// Handlers by id.
    Handlers(BTreeMap<String, HandlerPresence>),
    /// Alarms.
    Alarms(Vec<AlarmRecord>),
    /// Of the servo thread.
    ServoTiming(ServoTiming),
}

/// How punctual the servo thread has been since its start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ServoTiming {
    /// Servo period, s.
    pub period_s: f64,
    /// Servo cycles that were not finished when the next one was due.
    pub overruns: u64,
    /// How late after its time each cycle began.
    pub lateness: Durations,
    /// How long each cycle took.
    pub computing: Durations,
}

/// Durations that were measured, by size.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Durations {
    /// Upper bound of each bucket, s, ascending, and how many are in it and not in one before. The last bound is
    /// infinite.
    pub buckets: Vec<(f64, u64)>,
    /// Sum of all, s.
    pub sum_s: f64,
    /// The longest, s.
    pub max_s: f64,
}
