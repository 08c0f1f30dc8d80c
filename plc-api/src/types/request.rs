//! Every request to a machine, and its answer.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::CoordinateSystemNumber;
use super::command::{self, CommandMeta, CommandReply};
use super::data::{self, ToolChange, ToolTable, VariableArea, WorkOffsetTable};
use super::explained::Explanation;
use super::handler::Departure;
use super::heartbeat::ClientHeartbeat;
use super::io::{IoForce, IoPoint, IoSet};
use super::lease::LeaseRequest;
use super::line_start::{self, LineStart};
use super::machine::{AlarmRaise, AlarmRecord};
use super::output::{self, CheckpointReport, HandlerPresence, HandshakeResult, ProgressReport};
use super::planned::{self, PathQuery};
use super::program::{ProgramCheck, ProgramFolder, ProgramInfo, ProgramText};
use super::question::{self, OperatorAnswer};
use super::run;
use super::state::{LockSet, SpindleDirection};
use super::stored_data::StoredDataAnswer;
use super::trace;
use super::upload::{ProgramCondition, ProgramUpload};

pub use super::refusal::{Refusal, RefusalCode};

/// A request whose answer has a type: each type of [`typed`].
pub trait TypedRequest: Into<Request> + Send {
    /// What the machine says to it. Of an `Option` a transport may leave it out.
    type Answer: TryFrom<Answer, Error = Answer> + Send;
}

/// All requests, by who carries them out. Each is a variant of [`Request`], one of the enum of those who carry it out, and a
/// type of [`typed`] of the same name, with its answer.
macro_rules! requests {
    (
        output {$(
            $(#[$o_doc:meta])*
            $o:ident($o_said:ident: $o_type:ty) -> $o_answer:ty;
        )*}
        coordinate_system {$(
            $(#[$c_doc:meta])*
            $c:ident $(( $($c_field:ident: $c_type:ty),* ))?
                $({ $($(#[$c_named_doc:meta])* $c_named:ident: $c_named_type:ty,)* })? -> $c_answer:ty;
        )*}
        every_coordinate_system {$(
            $(#[$e_doc:meta])*
            $e:ident($($e_field:ident: $e_type:ty),*) -> $e_answer:ty;
        )*}
        machine {$(
            $(#[$m_doc:meta])*
            $m:ident $(( $($m_field:ident: $m_type:ty),* ))?
                $({ $($(#[$m_named_doc:meta])* $m_named:ident: $m_named_type:ty,)* })? -> $m_answer:ty;
        )*}
        program {$(
            $(#[$p_doc:meta])*
            $p:ident($($p_field:ident: $p_type:ty),*) -> $p_answer:ty;
        )*}
    ) => {
        /// A request to a machine.
        #[derive(Debug, Clone, PartialEq)]
        #[non_exhaustive]
        pub enum Request {
            $($(#[$o_doc])* $o(CoordinateSystemNumber, Option<u16>, $o_type),)*
            $(
                $(#[$c_doc])*
                $c $(( CoordinateSystemNumber, $($c_type),* ))? $({
                    /// Of the coordinate system.
                    cs: CoordinateSystemNumber,
                    $($(#[$c_named_doc])* $c_named: $c_named_type,)*
                })?,
            )*
            $($(#[$e_doc])* $e($($e_type),*),)*
            $($(#[$m_doc])* $m $(( $($m_type),* ))? $({ $($(#[$m_named_doc])* $m_named: $m_named_type,)* })?,)*
            $($(#[$p_doc])* $p($($p_type),*),)*
        }

        /// What is said of one output: [`Ledger::carry_out`](crate::handshake::Ledger::carry_out) carries it out.
        #[derive(Debug, Clone, PartialEq)]
        pub enum OutputRequest {$($(#[$o_doc])* $o($o_type),)*}

        /// A request that a coordinate system carries out.
        #[derive(Debug, Clone, PartialEq)]
        pub enum CoordinateSystemRequest {
            /// Something is said of an output, with its M number where the transport names it.
            Output(Option<u16>, OutputRequest),
            /// An instance of a handler is absent; the machine knows how it left.
            HandlerLeft(String, Option<String>, Departure),
            /// The connection to the broker is new: open outputs that nobody owns are published again.
            Republish,
            $($(#[$c_doc])* $c $(( $($c_type),* ))? $({ $($(#[$c_named_doc])* $c_named: $c_named_type,)* })?,)*
            $($(#[$e_doc])* $e($($e_type),*),)*
        }

        /// A request that the machine carries out.
        #[derive(Debug, Clone, PartialEq)]
        pub enum MachineRequest {
            $($(#[$e_doc])* $e($($e_type),*),)*
            $($(#[$m_doc])* $m $(( $($m_type),* ))? $({ $($(#[$m_named_doc])* $m_named: $m_named_type,)* })?,)*
        }

        /// A request for one program of the store.
        #[derive(Debug, Clone, PartialEq)]
        pub enum ProgramRequest {$($(#[$p_doc])* $p($($p_type),*),)*}

        impl From<Request> for Destination {
            fn from(request: Request) -> Self {
                match request {
                    $(Request::$o(cs, m, said) => {
                        Destination::CoordinateSystem(cs, CoordinateSystemRequest::Output(m, OutputRequest::$o(said)))
                    })*
                    $(Request::$c $(( cs, $($c_field),* ))? $({ cs, $($c_named),* })? => {
                        let request = CoordinateSystemRequest::$c $(( $($c_field),* ))? $({ $($c_named),* })?;
                        Destination::CoordinateSystem(cs, request)
                    })*
                    $(Request::$e($($e_field),*) => Destination::Machine(MachineRequest::$e($($e_field),*)),)*
                    $(Request::$m $(( $($m_field),* ))? $({ $($m_named),* })? => {
                        Destination::Machine(MachineRequest::$m $(( $($m_field),* ))? $({ $($m_named),* })?)
                    })*
                    $(Request::$p($($p_field),*) => Destination::Program(ProgramRequest::$p($($p_field),*)),)*
                }
            }
        }

        impl Request {
            /// The coordinate system that it concerns; `None`: the machine.
            pub fn coordinate_system(&self) -> Option<CoordinateSystemNumber> {
                match self {
                    $(Request::$o(cs, ..) => Some(*cs),)*
                    $(Request::$c $(( cs, $(any!($c_field)),* ))? $({ cs, $($c_named: _),* })? => Some(*cs),)*
                    Request::ReadVariables { area, .. } | Request::WriteVariables { area, .. } => {
                        area.coordinate_system()
                    }
                    Request::WorkOffsets(cs) | Request::WriteWorkOffsets(cs, _) | Request::LastRun(cs) | Request::Trace(cs, _) => Some(*cs),
                    Request::RaiseAlarm(raise) => raise.cs,
                    _ => None,
                }
            }

            /// Of a request that says something of an output: its coordinate system, its sequence number, and its M number
            /// where it is named.
            pub(crate) fn output_mut(&mut self) -> Option<(CoordinateSystemNumber, u64, &mut Option<u16>)> {
                match self {
                    $(Request::$o(cs, m, said) => Some((*cs, said.seq, m)),)*
                    _ => None,
                }
            }
        }

        impl OutputRequest {
            /// Sequence number of the output.
            pub fn seq(&self) -> u64 {
                match self {$(
                    OutputRequest::$o(said) => said.seq,
                )*}
            }
        }

        /// Requests as types: each is the [`Request`] of its name, and knows its answer.
        pub mod typed {
            use super::*;

            $(typed! {
                $(#[$o_doc])*
                $o(cs: CoordinateSystemNumber, m: Option<u16>, $o_said: $o_type) -> $o_answer
            })*
            $(typed! {
                $(#[$c_doc])*
                $c $(( cs: CoordinateSystemNumber, $($c_field: $c_type),* ))? $({
                    /// Of the coordinate system.
                    cs: CoordinateSystemNumber,
                    $($(#[$c_named_doc])* $c_named: $c_named_type,)*
                })? -> $c_answer
            })*
            $(typed! {
                $(#[$e_doc])*
                $e($($e_field: $e_type),*) -> $e_answer
            })*
            $(typed! {
                $(#[$m_doc])*
                $m $(( $($m_field: $m_type),* ))? $({ $($(#[$m_named_doc])* $m_named: $m_named_type,)* })? -> $m_answer
            })*
            $(typed! {
                $(#[$p_doc])*
                $p($($p_field: $p_type),*) -> $p_answer
            })*
        }
    };
}

/// The pattern of a field that does not matter.
macro_rules! any {
    ($field:ident) => {
        _
    };
}

/// The type of one request.
macro_rules! typed {
    ($(#[$doc:meta])* $name:ident -> $answer:ty) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub struct $name;

        typed!(@impl $name, $name, Request::$name, $answer);
    };
    ($(#[$doc:meta])* $name:ident ( $($field:ident: $type:ty),* ) -> $answer:ty) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name($(pub $type),*);

        typed!(@impl $name, $name($($field),*), Request::$name($($field),*), $answer);
    };
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* } -> $answer:ty) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        typed!(@impl $name, $name { $($field),* }, Request::$name { $($field),* }, $answer);
    };
    (@impl $name:ident, $typed:pat, $request:expr, $answer:ty) => {
        impl From<$name> for Request {
            fn from($typed: $name) -> Self {
                $request
            }
        }

        impl TypedRequest for $name {
            type Answer = $answer;
        }
    };
}

requests! {
    // `m`, where the transport names it, must be the output's
    output {
        /// A handler takes an output.
        Claim(claim: output::Claim) -> HandshakeResult;
        /// An output is answered.
        Reset(reset: output::Reset) -> HandshakeResult;
        /// The owner of an output tells how far it is.
        Progress(report: ProgressReport) -> Option<HandshakeResult>;
        /// The owner of an output notes how far it has come, for whoever takes it up when it is lost.
        Checkpoint(report: CheckpointReport) -> Option<HandshakeResult>;
        /// An operator decides about an output whose handler was lost.
        Redeliver(how: output::Redeliver) -> Option<HandshakeResult>;
        /// The owner of an output asks the operator, or takes its question back.
        Ask(ask: question::Ask) -> Option<HandshakeResult>;
        /// An operator answers: `unknown` when there is no such question or choice, `duplicate` when it has an answer.
        AnswerQuestion(answer: OperatorAnswer) -> Option<HandshakeResult>;
    }
    coordinate_system {
        /// A command to a coordinate system.
        Command {
            /// What.
            command: command::Command,
            /// From whom, and under which condition.
            meta: CommandMeta,
            /// True: answer when the effect has been reached; false: when accepted.
            wait: bool,
        } -> CommandReply;
        /// Takes, releases or breaks the control lease.
        Lease {
            /// What.
            request: LeaseRequest,
            /// From whom.
            meta: CommandMeta,
        } -> CommandReply;
        /// A handler says whether an M code of a program that is being loaded may be put out with its parameters.
        ValidateResult(m: Option<u16>, result: question::ValidateResult) -> ();
        /// Sets an input.
        Input(input: crate::types::request::Input) -> ();
        /// Commands the spindle.
        Spindle(command: SpindleCommand) -> ();
        /// Tells which tool is in the spindle.
        Tool(id: u16) -> ();
    }
    // the machine carries them out, and every coordinate system does its part
    every_coordinate_system {
        /// A handler comes, changes what it handles, or goes. A coordinate system receives it of one that is online.
        Handler(id: String, presence: HandlerPresence) -> ();
        /// A client is heard that wants to be watched, or says that it goes.
        Heartbeat(id: String, beat: ClientHeartbeat) -> ();
        /// Raises an alarm of a coordinate system, or of all.
        RaiseAlarm(raise: AlarmRaise) -> ();
        /// Sets the skip input of a motor, by its CNC motor number; it keeps the value. Not real time: what G31 captures is
        /// where the motor is when the servo hears of it.
        SkipInput(motor: u16, value: bool) -> ();
    }
    machine {
        /// Answers the question about stored files that do not fit together.
        AnswerStoredData(answer: StoredDataAnswer) -> ();
        /// How far a command is.
        CommandStatus(id: String) -> CommandReply;
        /// All handlers that are or were there, by id.
        Handlers -> BTreeMap<String, HandlerPresence>;
        /// Reads variables as they are at one moment.
        ReadVariables {
            /// Which.
            area: VariableArea,
            /// Number of the first.
            from: u32,
            /// How many, 1 to 1024.
            count: u32,
            /// Who asks, where the answer is also published on `reply/{client_id}`.
            meta: Option<CommandMeta>,
        } -> Vec<f64>;
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
        } -> Option<CommandReply>;
        /// Writes an input or output of the plant.
        WriteIo(point: IoPoint, set: IoSet) -> ();
        /// Puts a value in the place of what is written to an input or output of the plant, or takes it back.
        ForceIo(point: IoPoint, force: IoForce) -> ();
        /// The tool table.
        Tools -> ToolTable;
        /// Changes the tool table. Kept on disk before it is answered.
        WriteTools(change: ToolChange) -> ();
        /// Work offsets of a coordinate system.
        WorkOffsets(cs: CoordinateSystemNumber) -> WorkOffsetTable;
        /// Changes work offsets. Kept on disk before it is answered.
        WriteWorkOffsets(cs: CoordinateSystemNumber, change: WorkOffsetTable) -> ();
        /// How the last run before this start of the runtime stood; `None`: there was none.
        LastRun(cs: CoordinateSystemNumber) -> Option<data::LastRun>;
        /// The newest `count` lines of the journal that the filter takes, 1 to 1000, but for the `from` newest of them.
        Journal {
            /// How many of the newest are left out.
            from: u32,
            /// How many.
            count: u32,
            /// Which.
            filter: data::JournalFilter,
        } -> Vec<Value>;
        /// Alarms raised since the start, newest last, at most 1000.
        AlarmHistory -> Vec<AlarmRecord>;
        /// What is in force at a line of the loaded program, and what a start from there does.
        LineState(cs: CoordinateSystemNumber, from: LineStart) -> line_start::LineState;
        /// The path of a text as manual data input would move now, as far as it is planned.
        ManualPath(cs: CoordinateSystemNumber, text: planned::ManualText) -> planned::PlannedPath;
        /// What a text would do as manual data input, as far as it is planned.
        ManualRehearsal(cs: CoordinateSystemNumber, text: planned::ManualText) -> planned::Rehearsal;
        /// What the axes of a coordinate system did in the last minute.
        Trace(cs: CoordinateSystemNumber, query: trace::TraceQuery) -> trace::Trace;
        /// A run, by its id; with a wait it is told when it has ended, or when the time is over.
        Run {
            /// Its id.
            id: String,
            /// How long its end is waited for, s, at most 60.
            wait_s: u32,
        } -> run::Run;
        /// Runs that have ended, and what was produced.
        Runs(query: run::RunQuery) -> run::Runs;
        /// Programs of the store.
        Programs -> Vec<ProgramInfo>;
        /// What a name means that people see: a diagnostic, an alarm, a code, a word of a state or a refusal, a key.
        Explain(what: String) -> Explanation;
    }
    program {
        /// Text of a program.
        ReadProgram(number: u16) -> String;
        /// Writes a program, stored even with errors.
        WriteProgram(number: u16, text: String) -> ProgramCheck;
        /// Removes a program.
        DeleteProgram(number: u16) -> ();
        /// Text of a program with its hash.
        FetchProgram(number: u16) -> ProgramText;
        /// Writes a program under a condition, stored even with errors.
        StoreProgram(number: u16, upload: ProgramUpload) -> ProgramCheck;
        /// Removes a program under a condition.
        RemoveProgram(number: u16, condition: ProgramCondition) -> ();
        /// Checks a program of the store.
        CheckProgram(number: u16) -> ProgramCheck;
        /// Checks a text as if it were this program, in a dialect; `None`: that of the lowest coordinate system.
        CheckText(number: u16, dialect: Option<String>, text: String) -> ProgramCheck;
        /// Puts a program of the store into a folder.
        PutInFolder(number: u16, folder: ProgramFolder) -> ();
        /// Intermediate code of a program of the store, or refused as `program_has_errors` with the diagnostics.
        IntermediateCode(number: u16) -> String;
        /// The path of a program of the store as it would run now, as far as it is planned.
        PlannedPath(number: u16, query: PathQuery) -> planned::PlannedPath;
        /// What a run of a program of the store does, as it would run now, as far as it is planned.
        Rehearsal(number: u16, cs: Option<CoordinateSystemNumber>) -> planned::Rehearsal;
    }
}

/// Who carries out a request.
#[derive(Debug, Clone, PartialEq)]
pub enum Destination {
    /// The coordinate system of this number.
    CoordinateSystem(CoordinateSystemNumber, CoordinateSystemRequest),
    /// The machine.
    Machine(MachineRequest),
    /// The store of programs.
    Program(ProgramRequest),
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
    Interlock(LockSet),
    /// Start lock: a start of a program or of manual data input is refused while it is on.
    StartLock(LockSet),
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

/// How a machine answers requests: one variant for each type of answer.
macro_rules! answers {
    ($($(#[$doc:meta])* $name:ident($type:ty),)*) => {
        /// How a machine answers a request that it carries out.
        #[derive(Debug, Clone, PartialEq)]
        #[non_exhaustive]
        pub enum Answer {
            /// Done, and there is nothing to say.
            Done,
            $($(#[$doc])* $name($type),)*
        }

        $(
            impl TryFrom<Answer> for $type {
                type Error = Answer;

                fn try_from(answer: Answer) -> Result<Self, Answer> {
                    match answer {
                        Answer::$name(said) => Ok(said),
                        other => Err(other),
                    }
                }
            }

            impl From<$type> for Answer {
                fn from(said: $type) -> Self {
                    Answer::$name(said)
                }
            }
        )*
    };
}

answers! {
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
    LastRun(Option<data::LastRun>),
    /// Lines of the journal, in the order of time: JSON objects with `ts`, `t_s` (seconds since the start of the
    /// runtime), `cs`, `event`, and what belongs to the event.
    Journal(Vec<Value>),
    /// Programs of the store, ascending.
    Programs(Vec<ProgramInfo>),
    /// Text of a program, or its intermediate code.
    ProgramText(String),
    /// A program.
    Program(ProgramText),
    /// What checking says.
    Check(ProgramCheck),
    /// Handlers by id.
    Handlers(BTreeMap<String, HandlerPresence>),
    /// Alarms.
    Alarms(Vec<AlarmRecord>),
    /// What a name means.
    Explanation(Explanation),
    /// The planned path of a program.
    Path(planned::PlannedPath),
    /// What a run does.
    Rehearsed(planned::Rehearsal),
    /// What is in force at a line.
    LineState(line_start::LineState),
    /// What the axes did lately.
    Trace(trace::Trace),
    /// A run.
    Run(run::Run),
    /// Runs that have ended.
    Runs(run::Runs),
}

impl TryFrom<Answer> for () {
    type Error = Answer;

    fn try_from(answer: Answer) -> Result<Self, Answer> {
        match answer {
            Answer::Done => Ok(()),
            other => Err(other),
        }
    }
}

/// Answers that a transport may leave out.
macro_rules! optional {
    ($($type:ty),*) => {$(
        impl TryFrom<Answer> for Option<$type> {
            type Error = Answer;

            fn try_from(answer: Answer) -> Result<Self, Answer> {
                match answer {
                    Answer::Done => Ok(None),
                    other => other.try_into().map(Some),
                }
            }
        }
    )*};
}

optional!(CommandReply, HandshakeResult);
