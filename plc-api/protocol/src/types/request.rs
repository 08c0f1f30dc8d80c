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

/// A request with a typed answer. Each type of [`typed`] implements this trait.
pub trait TypedRequest: Into<Request> + Send {
    /// Type of the machine's answer. If it is an `Option`, a transport may omit the answer.
    type Answer: TryFrom<Answer, Error = Answer> + Send;
}

/// All requests, grouped by the part of the machine that executes them. Each request becomes a variant of
/// [`Request`], a variant of the enum of its group, and a type of the same name in [`typed`] with the type of
/// its answer.
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
                    /// Number of the coordinate system.
                    cs: CoordinateSystemNumber,
                    $($(#[$c_named_doc])* $c_named: $c_named_type,)*
                })?,
            )*
            $($(#[$e_doc])* $e($($e_type),*),)*
            $($(#[$m_doc])* $m $(( $($m_type),* ))? $({ $($(#[$m_named_doc])* $m_named: $m_named_type,)* })?,)*
            $($(#[$p_doc])* $p($($p_type),*),)*
        }

        /// A message about one output, executed by
        /// [`Ledger::execute_request`](crate::handshake::Ledger::execute_request).
        #[derive(Debug, Clone, PartialEq)]
        pub enum OutputRequest {$($(#[$o_doc])* $o($o_type),)*}

        /// A request that a coordinate system executes.
        #[derive(Debug, Clone, PartialEq)]
        pub enum CoordinateSystemRequest {
            /// A message about an output, with its M number if the transport provides it.
            Output(Option<u16>, OutputRequest),
            /// An instance of a handler went offline: id of the handler, instance, kind of the departure.
            HandlerLeft(String, Option<String>, Departure),
            /// The connection to the broker was restored: open outputs without an owner are published again.
            Republish,
            $($(#[$c_doc])* $c $(( $($c_type),* ))? $({ $($(#[$c_named_doc])* $c_named: $c_named_type,)* })?,)*
            $($(#[$e_doc])* $e($($e_type),*),)*
        }

        /// A request that the machine executes.
        #[derive(Debug, Clone, PartialEq)]
        pub enum MachineRequest {
            $($(#[$e_doc])* $e($($e_type),*),)*
            $($(#[$m_doc])* $m $(( $($m_type),* ))? $({ $($(#[$m_named_doc])* $m_named: $m_named_type,)* })?,)*
        }

        /// A request about one program of the store.
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
            /// Returns the coordinate system that the request concerns; `None` for a request to the whole
            /// machine.
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

            /// Returns the coordinate system, the sequence number and the M number (if the request contains
            /// it) of a request about an output.
            pub(crate) fn output_mut(&mut self) -> Option<(CoordinateSystemNumber, u64, &mut Option<u16>)> {
                match self {
                    $(Request::$o(cs, m, said) => Some((*cs, said.seq, m)),)*
                    _ => None,
                }
            }
        }

        impl OutputRequest {
            /// Returns the sequence number of the output.
            pub fn seq(&self) -> u64 {
                match self {$(
                    OutputRequest::$o(said) => said.seq,
                )*}
            }
        }

        /// Requests as types: each corresponds to the [`Request`] of the same name and determines the type of
        /// its answer.
        pub mod typed {
            use super::*;

            $(typed! {
                $(#[$o_doc])*
                $o(cs: CoordinateSystemNumber, m: Option<u16>, $o_said: $o_type) -> $o_answer
            })*
            $(typed! {
                $(#[$c_doc])*
                $c $(( cs: CoordinateSystemNumber, $($c_field: $c_type),* ))? $({
                    /// Number of the coordinate system.
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

/// Expands to a pattern that ignores a field.
macro_rules! any {
    ($field:ident) => {
        _
    };
}

/// Defines the type of one request.
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
    // if the transport provides `m`, it must be the M number of the output
    output {
        /// A handler claims an output.
        Claim(claim: output::Claim) -> HandshakeResult;
        /// A handler or an operator resets an output.
        Reset(reset: output::Reset) -> HandshakeResult;
        /// The owner of an output reports its progress.
        Progress(report: ProgressReport) -> Option<HandshakeResult>;
        /// The owner of an output stores a checkpoint of its work, for the handler that claims the output if
        /// this owner is lost.
        Checkpoint(report: CheckpointReport) -> Option<HandshakeResult>;
        /// An operator decides how the output of a lost handler continues.
        Redeliver(how: output::Redeliver) -> Option<HandshakeResult>;
        /// The owner of an output asks the operator a question, or withdraws the question.
        Ask(ask: question::Ask) -> Option<HandshakeResult>;
        /// An operator answers a question. The result is `unknown` if the question or choice does not exist,
        /// `duplicate` if the question has an answer.
        AnswerQuestion(answer: OperatorAnswer) -> Option<HandshakeResult>;
    }
    coordinate_system {
        /// A command to a coordinate system.
        Command {
            /// The command.
            command: command::Command,
            /// Sender and conditions.
            meta: CommandMeta,
            /// True to receive the answer when the effect has been reached, false to receive it when the
            /// command is accepted.
            wait: bool,
        } -> CommandReply;
        /// Takes, releases or breaks the control lease.
        Lease {
            /// The operation on the lease.
            request: LeaseRequest,
            /// Sender of the request.
            meta: CommandMeta,
        } -> CommandReply;
        /// A handler reports whether an M code of a program that is being loaded may be issued with its
        /// parameters.
        ValidateResult(m: Option<u16>, result: question::ValidateResult) -> ();
        /// Sets an input.
        Input(input: crate::types::request::Input) -> ();
        /// Commands the spindle.
        Spindle(command: SpindleCommand) -> ();
        /// Sets the number of the tool in the spindle.
        Tool(id: u16) -> ();
    }
    // the machine executes these requests, and every coordinate system applies its part
    every_coordinate_system {
        /// A handler comes online, changes its M codes, or leaves. A coordinate system receives this request
        /// for online handlers only.
        Handler(id: String, presence: HandlerPresence) -> ();
        /// Heartbeat of a client that the machine watches, or the end of this watch.
        Heartbeat(id: String, beat: ClientHeartbeat) -> ();
        /// Raises an alarm of a coordinate system, or of the whole machine.
        RaiseAlarm(raise: AlarmRaise) -> ();
        /// Sets the skip input of a motor, by its CNC motor number; the input keeps the value. The
        /// transmission is not real time: G31 captures the position that the motor has when the servo
        /// receives the value.
        SkipInput(motor: u16, value: bool) -> ();
    }
    machine {
        /// Answers the question about inconsistent stored files.
        AnswerStoredData(answer: StoredDataAnswer) -> ();
        /// Reads the status of a command by its id.
        CommandStatus(id: String) -> CommandReply;
        /// Reads the presences of all handlers that are or were online, by handler id.
        Handlers -> BTreeMap<String, HandlerPresence>;
        /// Reads variables, all at the same moment.
        ReadVariables {
            /// The variables: P, or Q of a coordinate system.
            area: VariableArea,
            /// Number of the first variable.
            from: u32,
            /// Number of variables, 1 to 1024.
            count: u32,
            /// Sender of the request, if the answer is also published on `reply/{client_id}`.
            meta: Option<CommandMeta>,
        } -> Vec<f64>;
        /// Writes all given variables between two blocks of any program, or none of them.
        WriteVariables {
            /// The variables: P, or Q of a coordinate system.
            area: VariableArea,
            /// Number of the first variable.
            from: u32,
            /// Values of the variables, 1 to 1024.
            values: Vec<f64>,
            /// Sender of the request, if the answer is also published on `reply/{client_id}`. A command id
            /// that was received in the last 10 minutes gets the stored reply, and nothing is written.
            meta: Option<CommandMeta>,
        } -> Option<CommandReply>;
        /// Writes an input or output of the plant.
        WriteIo(point: IoPoint, set: IoSet) -> ();
        /// Forces a value on an input or output of the plant, which replaces the written value, or ends the
        /// forcing.
        ForceIo(point: IoPoint, force: IoForce) -> ();
        /// Reads the tool table.
        Tools -> ToolTable;
        /// Changes the tool table. The machine stores the change on disk before it answers.
        WriteTools(change: ToolChange) -> ();
        /// Reads the work offsets of a coordinate system.
        WorkOffsets(cs: CoordinateSystemNumber) -> WorkOffsetTable;
        /// Changes work offsets. The machine stores the change on disk before it answers.
        WriteWorkOffsets(cs: CoordinateSystemNumber, change: WorkOffsetTable) -> ();
        /// Reads the state of the last run in an earlier boot of the runtime; `None` if there was no run.
        LastRun(cs: CoordinateSystemNumber) -> Option<data::LastRun>;
        /// Reads journal lines that match the filter: `count` lines (1 to 1000), without the newest `from`
        /// lines.
        Journal {
            /// Number of newest lines to skip.
            from: u32,
            /// Number of lines.
            count: u32,
            /// The filter.
            filter: data::JournalFilter,
        } -> Vec<Value>;
        /// Reads the alarms raised since the start of the runtime, newest last, at most 1000.
        AlarmHistory -> Vec<AlarmRecord>;
        /// Reads the state in force at a line of the loaded program, and the actions of a start from that
        /// line.
        LineState(cs: CoordinateSystemNumber, from: LineStart) -> line_start::LineState;
        /// Predicts the path of a text, run now as manual data input, as far as the path is planned.
        ManualPath(cs: CoordinateSystemNumber, text: planned::ManualText) -> planned::PlannedPath;
        /// Predicts the effects of a text, run now as manual data input, as far as the path is planned.
        ManualRehearsal(cs: CoordinateSystemNumber, text: planned::ManualText) -> planned::Rehearsal;
        /// Reads the motion of the axes of a coordinate system in the last minute.
        Trace(cs: CoordinateSystemNumber, query: trace::TraceQuery) -> trace::Trace;
        /// Reads a run by its id. The machine answers when the run has ended, or after `wait_s` at the
        /// latest.
        Run {
            /// Id of the run.
            id: String,
            /// Longest wait for the end of the run, s, at most 60; 0 for an answer at once.
            wait_s: u32,
        } -> run::Run;
        /// Reads the runs that have ended, and the production counters.
        Runs(query: run::RunQuery) -> run::Runs;
        /// Lists the programs of the store.
        Programs -> Vec<ProgramInfo>;
        /// Explains a name in the HMI, in a message or in the configuration: a diagnostic, an alarm, a code,
        /// a word for a state or a refusal, or a configuration key.
        Explain(what: String) -> Explanation;
    }
    program {
        /// Reads the text of a program.
        ReadProgram(number: u16) -> String;
        /// Writes a program. A program with errors is also stored.
        WriteProgram(number: u16, text: String) -> ProgramCheck;
        /// Removes a program from the store.
        DeleteProgram(number: u16) -> ();
        /// Reads the text of a program with its hash.
        FetchProgram(number: u16) -> ProgramText;
        /// Writes a program if the condition holds. A program with errors is also stored.
        StoreProgram(number: u16, upload: ProgramUpload) -> ProgramCheck;
        /// Removes a program from the store if the condition holds.
        RemoveProgram(number: u16, condition: ProgramCondition) -> ();
        /// Checks a program of the store.
        CheckProgram(number: u16) -> ProgramCheck;
        /// Checks a text, in a dialect, as if it were the program `number`. `None` means the dialect of the
        /// lowest coordinate system.
        CheckText(number: u16, dialect: Option<String>, text: String) -> ProgramCheck;
        /// Puts a program of the store into a folder.
        PutInFolder(number: u16, folder: ProgramFolder) -> ();
        /// Reads the intermediate code of a program of the store. If the program has errors, the request is
        /// refused as `program_has_errors` with the diagnostics.
        IntermediateCode(number: u16) -> String;
        /// Predicts the path of a program of the store, run now, as far as the path is planned.
        PlannedPath(number: u16, query: PathQuery) -> planned::PlannedPath;
        /// Predicts the effects of a program of the store, run now, as far as the path is planned.
        Rehearsal(number: u16, cs: Option<CoordinateSystemNumber>) -> planned::Rehearsal;
    }
}

/// Receiver that executes a request.
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
    /// Optional block skips by number, 1 to 31; numbers that are not named do not change.
    OptionalSkip(BTreeMap<u8, bool>),
    /// Optional stop (M01).
    OptionalStop(bool),
    /// Single block: each block ends at rest and waits for a resume.
    SingleBlock(bool),
    /// Dry run: motion at the dry run feedrate instead of F.
    DryRun(bool),
    /// Interlock: while it is on, motion is held on its path, and no motion begins or continues.
    Interlock(LockSet),
    /// Start lock: a start of a program or of manual data input is refused while it is on.
    StartLock(LockSet),
    /// Overrides, percent; `None` leaves an override unchanged.
    Override(OverrideChange),
}

/// Overrides to set, percent, absolute.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OverrideChange {
    /// Feed override, 0 to 200.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feed: Option<f64>,
    /// Rapid override, 0 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rapid: Option<f64>,
    /// Spindle override, 0 to 200.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spindle: Option<f64>,
}

/// Payload of `spindle/set`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SpindleCommand {
    /// Commanded direction, a stop or an orientation.
    pub direction: SpindleDirection,
    /// Speed, r/min; used with `cw` and `ccw`.
    #[serde(default)]
    pub rpm: f64,
}

/// Defines the answers of a machine: one variant for each type of answer.
macro_rules! answers {
    ($($(#[$doc:meta])* $name:ident($type:ty),)*) => {
        /// The answer of a machine to a request that it has executed.
        #[derive(Debug, Clone, PartialEq)]
        #[non_exhaustive]
        pub enum Answer {
            /// Executed; the answer has no content.
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
    /// Reply to a command.
    Command(CommandReply),
    /// Result of a message about an output.
    Handshake(HandshakeResult),
    /// Values of variables, ascending by number.
    Variables(Vec<f64>),
    /// The tool table.
    Tools(ToolTable),
    /// Work offsets.
    WorkOffsets(WorkOffsetTable),
    /// State of the last run in an earlier boot; `None` if there was no run.
    LastRun(Option<data::LastRun>),
    /// Lines of the journal in time order: JSON objects with `ts`, `t_s` (seconds since the start of the
    /// runtime), `cs`, `event` and the fields of that event.
    Journal(Vec<Value>),
    /// Programs of the store, ascending.
    Programs(Vec<ProgramInfo>),
    /// Text of a program, or its intermediate code.
    ProgramText(String),
    /// A program with its hash.
    Program(ProgramText),
    /// Result of a check of a program.
    Check(ProgramCheck),
    /// Presences of handlers, by handler id.
    Handlers(BTreeMap<String, HandlerPresence>),
    /// Alarms raised since the start of the runtime.
    Alarms(Vec<AlarmRecord>),
    /// Explanation of a name.
    Explanation(Explanation),
    /// The planned path of a program.
    Path(planned::PlannedPath),
    /// Predicted effects of a run.
    Rehearsed(planned::Rehearsal),
    /// State in force at a line of a program.
    LineState(line_start::LineState),
    /// Recent motion of the axes.
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

/// Defines answers that a transport may omit.
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
