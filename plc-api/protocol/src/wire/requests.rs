//! Every request that a transport carries, one row for each request.

use serde_json::json;

use super::answer::{
    AcceptedCommand, AlarmHistory, AnswerForm, HandlerList, JournalAnswer, LastRunAnswer, json_of,
};
use super::io;
use super::lease_rows;
use super::parameter::{Fault, Query, QueryValues};
use super::path_parameter::{ALARM_ID, CS, ID, MOTOR, SKIP, WHAT};
use super::payloads::{
    CommandArgs, Empty, InputSet, NoArgs, StartArgs, VariableGet, VariableSet, VariableWrite, command_answer,
    handshake, of_area, read_command, read_input, read_runs, read_seconds, read_variables, switch, variables,
    with_filter, write_input, write_variables,
};
use super::program_rows;
use super::right::Right::{Handle, Operate, Raise, Read, Reset, Set, SetInput};
use super::route::{Headers, Route};
use super::row::{InboundTopic, NOT_AFTER, RequestParts, Row};
use super::row_macros::{about_an_output, carried, written};
use super::subject::Subject;
use super::trace;
use crate::types::command::{Command, CommandReply};
use crate::types::data::{JsonNumber, ToolChange, ToolTable, VariableValues, WorkOffsetTable};
use crate::types::explained::Explanation;
use crate::types::form::HasForm;
use crate::types::heartbeat::ClientHeartbeat;
use crate::types::line_start::{LineStart, LineState};
use crate::types::machine::AlarmRaise;
use crate::types::output::{self, CheckpointReport, HandlerPresence, HandshakeResult, ProgressReport};
use crate::types::question::{self, OperatorAnswer, ValidateResult};
use crate::types::request::{Input, OverrideChange, Request, SpindleCommand};
use crate::types::run::{Run, RunOrder, RunQuery, Runs};
use crate::types::state::{LockSet, Switch, Tool};
use crate::types::stored_data::StoredDataAnswer;

/// Default number of journal lines.
const JOURNAL_LINES: u32 = 100;

/// `IDS`, and the fields that limit the age of the command.
const IDS_AND_AGE: &[&str] = &["command_id", "client_id", "issued_at", "ttl_ms"];

/// `IDS_AND_AGE`, and `not_after`, for requests that can cause a motion.
const IDS_AND_AGES: &[&str] = &["command_id", "client_id", "issued_at", "ttl_ms", NOT_AFTER];

/// All fields of [`CommandMeta`](crate::types::command::CommandMeta).
pub(super) const COMMAND: &[&str] = &[
    "command_id",
    "client_id",
    "issued_at",
    "ttl_ms",
    "expect",
    NOT_AFTER,
    "fence",
];

/// Creates the route of a command to a coordinate system.
const fn command<T: HasForm>(pattern: &'static str, summary: &'static str) -> Route {
    with_reply(Route::post::<T>(Subject::Commands, pattern, &[CS], summary))
}

/// Adds answers, query and headers of a command.
const fn with_reply(route: Route) -> Route {
    route
        .gives::<CommandReply>()
        .or::<AcceptedCommand>(202)
        .query(Query::WAIT)
        .headers(Headers::Command)
}

/// Creates the route of an input of a coordinate system.
const fn input<T: HasForm>(pattern: &'static str, summary: &'static str) -> Route {
    Route::put::<T>(Subject::Inputs, pattern, &[CS], summary)
}

/// Rows of all requests. The route that acknowledges an alarm contains no coordinate system; the server finds
/// it.
#[allow(
    clippy::result_large_err,
    reason = "a request that is not of the row is given back as it is"
)]
pub static ROWS: [Row; 53] = [
    about_an_output!(Claim(output::Claim) "claim" Handle -> HandshakeResult, on "cs/{cs}/m_code/{m}/result" =>
        "Claims an output for a registered handler. The claim is released when the presence of this handler_id ends."),
    about_an_output!(Reset(output::Reset) "reset" Reset -> HandshakeResult, on "cs/{cs}/m_code/{m}/result" =>
        "Resets an output, or reports its fault."),
    about_an_output!(Progress(ProgressReport) "progress" Handle =>
        "Reports the progress of the work on an output."),
    about_an_output!(Checkpoint(CheckpointReport) "checkpoint" Handle =>
        "Stores a checkpoint of the work on an output, for the handler that claims the output if its owner is lost."),
    about_an_output!(Redeliver(output::Redeliver) "redeliver" Operate =>
        "Delivers an output that has lost its handler to a handler again."),
    about_an_output!(Ask(question::Ask) "ask" Handle -> HandshakeResult =>
        "Asks the operator about an output."),
    about_an_output!(AnswerQuestion(OperatorAnswer) "answer" Operate -> HandshakeResult =>
        "Answers a question of a handler."),
    // has no route: to a REST server, the WebSocket carries this request
    Row {
        topic: Some(InboundTopic::new::<ValidateResult>(
            "cs/{cs}/m_code/{m}/validate_result",
            "Answers a validate message: whether the M code may be issued with these parameters.",
        )),
        ..Row::new(Handle, |incoming| Ok(Request::ValidateResult(incoming.cs()?, incoming.optional_number("m")?, incoming.json()?)),
            written!(Request::ValidateResult(cs, Some(m), result) => RequestParts::for_coordinate_system(cs).with("m", m).json(&result)),
        )
    },
    Row {
        routes: &[
            Route::put::<Switch>(
                Subject::Inputs,
                "/cs/{cs}/inputs/{input=optional_skip}/{number}",
                &[CS, SKIP],
                "Sets one optional block skip, 1 to 31.",
            ),
            input::<Switch>("/cs/{cs}/inputs/{input=optional_stop}", "Sets the optional stop input."),
            input::<Switch>("/cs/{cs}/inputs/{input=single_block}", "Sets the single block input."),
            input::<Switch>("/cs/{cs}/inputs/{input=dry_run}", "Sets the dry run input."),
            input::<LockSet>("/cs/{cs}/inputs/{input=interlock}", "Sets a source of the interlock."),
            input::<LockSet>("/cs/{cs}/inputs/{input=start_lock}", "Sets a source of the start lock."),
        ],
        topic: Some(InboundTopic::new::<InputSet>(
            "cs/{cs}/input/{input}/set",
            "Sets an input: optional_skip (numbers 1 to 31), optional_stop, single_block, dry_run, interlock or start_lock.",
        )),
        ..Row::new(SetInput, |incoming| Ok(Request::Input(incoming.cs()?, read_input(&incoming)?)),
            |request| match request {
                Request::Input(cs, input) => write_input(cs, input),
                other => Err(other),
            },
        )
    },
    io::WRITE,
    io::FORCE,
    trace::TRACE,
    Row {
        routes: &[Route::put::<OverrideChange>(
            Subject::Inputs,
            "/cs/{cs}/overrides",
            &[CS],
            "Sets overrides, percent; those left out stay.",
        )],
        topic: Some(InboundTopic::new::<OverrideChange>(
            "cs/{cs}/override/set",
            "Sets overrides, percent; those left out stay.",
        )),
        ..Row::new(Operate, |incoming| Ok(Request::Input(incoming.cs()?, Input::Override(incoming.json()?))),
            written!(Request::Input(cs, Input::Override(change)) => RequestParts::for_coordinate_system(cs).json(&change)),
        )
    },
    Row {
        routes: &[Route::put::<SpindleCommand>(
            Subject::Inputs,
            "/cs/{cs}/spindle",
            &[CS],
            "Commands the spindle.",
        )],
        topic: Some(InboundTopic::new::<SpindleCommand>("cs/{cs}/spindle/set", "Commands the spindle.")),
        ..carried!(Set, Spindle(cs: number, command: json))
    },
    Row {
        routes: &[Route::put::<Tool>(
            Subject::Inputs,
            "/cs/{cs}/tool",
            &[CS],
            "Reports the tool in the spindle.",
        )],
        topic: Some(InboundTopic::new::<Tool>("cs/{cs}/tool/set", "Reports the tool in the spindle.")),
        ..Row::new(Set, |incoming| Ok(Request::Tool(incoming.cs()?, incoming.json::<Tool>()?.id)),
            written!(Request::Tool(cs, id) => RequestParts::for_coordinate_system(cs).json(&Tool { id })),
        )
    },
    Row {
        routes: &[with_reply(Route::post::<Empty>(
            Subject::Alarms,
            "/alarms/{id}/acknowledge",
            &[ALARM_ID],
            "Acknowledges an alarm.",
        ))],
        answer: command_answer,
        ..Row::new(Operate, |incoming| {
                incoming.json::<Empty>()?;
                let id = incoming.number("id")?;
                read_command(&incoming, Command::AlarmAcknowledge { id })
            },
            written!(Request::Command { cs, command: Command::AlarmAcknowledge { id }, meta, wait } => {
                    let parts = RequestParts::for_coordinate_system(cs).with("id", id).with("verb", "alarm_acknowledge");
                    let args = json!({ "id": id });
                    parts.json(&args).payload(&CommandArgs { args }).meta(meta).waiting(wait)
                }),
        )
    },
    Row {
        routes: &[Route::post::<RunOrder>(
            Subject::Commands,
            "/cs/{cs}/runs",
            &[CS],
            "Loads a program, if the order names one, and runs it once for each part; a further part starts only after \
             PROGRAM_COMPLETED.",
        )
        .gives_new::<CommandReply>()
        .refusals(&[422])
        .headers(Headers::Command)],
        answer: |_| AnswerForm::Started,
        ..Row::new(Operate, |incoming| {
                let args = incoming.json()?;
                let command = Command::parse("run", &args).map_err(Fault::Invalid)?;
                let (cs, meta) = (incoming.cs()?, incoming.meta()?);
                Ok(Request::Command { cs, command, meta, wait: true })
            },
            written!(Request::Command { cs, command: Command::Run(order), meta, .. } => {
                    let args = json!(order);
                    let parts = RequestParts::for_coordinate_system(cs).with("verb", "run").json(&args);
                    parts.payload(&CommandArgs { args }).meta(meta)
                }),
        )
    },
    Row {
        routes: &[
            command::<Command>("/cs/{cs}/{verb=load}", "Loads a program of the store."),
            command::<StartArgs>("/cs/{cs}/{verb=start}", "Starts the loaded program, from its beginning or from a line."),
            command::<NoArgs>("/cs/{cs}/{verb=hold}", "Feed hold."),
            command::<Empty>("/cs/{cs}/{verb=resume}", "Continues after a pause."),
            command::<NoArgs>("/cs/{cs}/{verb=stop}", "Decelerates on the path and ends the run."),
            command::<Empty>("/cs/{cs}/{verb=reset}", "Ends the run, cancels outputs, clears alarms."),
            command::<NoArgs>("/cs/{cs}/{verb=abort}", "Brakes each motor at once and ends the run."),
            command::<Command>("/cs/{cs}/{verb=mdi}", "Runs a text of NC blocks."),
            command::<Command>("/cs/{cs}/{verb=jog}", "Jogs one axis, or ends the jog."),
            command::<Command>("/cs/{cs}/{verb=home}", "Returns axes to their reference points."),
            command::<Command>("/cs/{cs}/{verb=back_trace}", "Moves back along the passed path, or ends the back trace."),
        ],
        topic: Some(
            InboundTopic::new::<CommandArgs>(
                "cs/{cs}/command/{verb}",
                "Commands a coordinate system: load, start, run, hold, resume, stop, reset, abort, alarm_acknowledge, mdi, jog, home \
                 or back_trace.",
            )
            .envelope(COMMAND),
        ),
        answer: command_answer,
        ..Row::new(Operate, |incoming| {
                incoming.cs()?;
                let args = if incoming.is_rest() {
                    incoming.json()?
                } else {
                    incoming.json::<CommandArgs>()?.args
                };
                let command = Command::parse(incoming.text("verb"), &args).map_err(Fault::Invalid)?;
                read_command(&incoming, command)
            },
            written!(Request::Command { cs, command, meta, wait } => {
                    let (verb, args) = (json!(command.verb()), command.args());
                    let parts = RequestParts::for_coordinate_system(cs).with("verb", verb.as_str().unwrap_or_default()).json(&args);
                    parts.payload(&CommandArgs { args }).meta(meta).waiting(wait)
                }),
        )
    },
    Row {
        routes: &[Route::get(
            Subject::Machine,
            "/runs/{id}",
            &[ID],
            "A run: progress, kind of the end, alarms, waits and times; with wait=60 the answer follows when the run has ended, or after 60 s.",
        )
            .gives::<Run>()
            .refusals(&[400])
            .query(Query::SECONDS)],
        answer: json_of::<Run>,
        ..Row::new(Read, |incoming| Ok(Request::Run { id: incoming.text("id").to_owned(), wait_s: read_seconds(&incoming)? }),
            written!(Request::Run { id, wait_s } => {
                    let parts = RequestParts::default().with("id", id);
                    if wait_s == 0 { parts } else { parts.query("wait", wait_s) }
                }),
        )
    },
    Row {
        routes: &[Route::get(
            Subject::Machine,
            "/runs",
            &[],
            "Runs that have ended, the newest first, and the production counters of each program.",
        )
            .gives::<Runs>()
            .refusals(&[400])
            .query(Query::RUNS)],
        answer: json_of::<Runs>,
        ..Row::new(Read, |incoming| Ok(Request::Runs(read_runs(&incoming)?)),
            written!(Request::Runs(RunQuery { cs, from, count }) => {
                    let parts = RequestParts::default().query("from", from).query("count", count);
                    match cs { Some(cs) => parts.query("cs", cs), None => parts }
                }),
        )
    },
    lease_rows::TAKE,
    lease_rows::RELEASE,
    lease_rows::BREAK,
    Row {
        routes: &[
            Route::post::<LineStart>(
                Subject::States,
                "/cs/{cs}/line_state",
                &[CS],
                "The state in force at a line of the loaded program, and the actions of a start from that line; nothing changes.",
            )
            .gives::<LineState>()
            .refusals(&[422]),
        ],
        answer: json_of::<LineState>,
        ..carried!(Read, LineState(cs: number, from: json))
    },
    Row {
        routes: &[Route::get(
            Subject::Commands,
            "/commands/{id}",
            &[ID],
            "Status of a command.",
        ).gives::<CommandReply>()],
        answer: json_of::<CommandReply>,
        ..carried!(Read, CommandStatus(id: name))
    },
    Row {
        routes: &[
            Route::get(Subject::Values, "/variables/{kind=p}", &[], "P variables.")
                .gives::<VariableValues>()
                .query(Query::RANGE)
                .refusals(&[400, 413]),
            Route::get(Subject::Values, "/cs/{cs}/variables/{kind=q}", &[CS], "Q variables.")
                .gives::<VariableValues>()
                .query(Query::RANGE)
                .refusals(&[400, 413]),
        ],
        topic: Some(
            InboundTopic::new::<VariableGet>(
                "cs/{cs}/variable/{verb=get}",
                "Reads up to 1024 P or Q variables at one moment.",
            )
            .envelope(IDS_AND_AGE),
        ),
        answer: variables,
        ..Row::new(Read, |incoming| read_variables(&incoming), written!(Request::ReadVariables { area, from, count, .. } => {
                let parts = of_area(area, "get").query("from", from).query("count", count);
                parts.payload(&VariableGet { kind: area.kind(), from, count })
            }))
    },
    Row {
        routes: &[
            Route::put::<VariableWrite>(
                Subject::Values,
                "/variables/{kind=p}",
                &[],
                "Sets P variables, all or none.",
            )
                .query(Query::RANGE_TO_WRITE),
            Route::put::<VariableWrite>(
                Subject::Values,
                "/cs/{cs}/variables/{kind=q}",
                &[CS],
                "Sets Q variables, all or none.",
            )
                .query(Query::RANGE_TO_WRITE),
        ],
        topic: Some(
            InboundTopic::new::<VariableSet>(
                "cs/{cs}/variable/{verb=set}",
                "Sets up to 1024 P or Q variables together, all or none.",
            )
            .envelope(IDS_AND_AGES),
        ),
        ..Row::new(Set, |incoming| write_variables(&incoming), written!(Request::WriteVariables { area, from, values, .. } => {
                let values: Vec<_> = values.into_iter().map(JsonNumber).collect();
                let parts = of_area(area, "set").query("from", from);
                let payload = VariableSet { kind: area.kind(), from, values };
                parts.payload(&payload).json(&VariableWrite::from_values(payload.values))
            }))
    },
    Row {
        routes: &[Route::put::<Switch>(
            Subject::Inputs,
            "/motors/{number}/skip_input",
            &[MOTOR],
            "Sets the skip input of a motor; not real time.",
        )],
        topic: Some(InboundTopic::new::<Switch>(
            "motor/{number}/skip_input/set",
            "Sets the skip input of a motor (G31); not real time: G31 captures the position at which the servo receives the value.",
        )),
        ..Row::new(Operate, |incoming| Ok(Request::SkipInput(incoming.number("number")?, switch(&incoming)?)),
            written!(Request::SkipInput(motor, value) => {
                    RequestParts::default().with("number", motor).json(&Switch { value })
                }),
        )
    },
    Row {
        routes: &[Route::post::<AlarmRaise>(
            Subject::Alarms,
            "/alarms",
            &[],
            "Raises an alarm of a coordinate system, or of the whole machine.",
        )],
        topic: Some(InboundTopic::new::<AlarmRaise>(
            "alarm/raise",
            "Raises an alarm, 10000 + code, that stops one coordinate system (cs), or the whole machine.",
        )),
        ..carried!(Raise, RaiseAlarm(raise: json))
    },
    Row {
        routes: &[Route::post::<StoredDataAnswer>(
            Subject::Machine,
            "/stored_data/answer",
            &[],
            "Accepts or refuses stored files that do not fit together.",
        )],
        topic: Some(InboundTopic::new::<StoredDataAnswer>(
            "stored_data/answer",
            "Accepts or refuses stored files that do not fit together.",
        )),
        ..carried!(Operate, AnswerStoredData(answer: json))
    },
    Row {
        routes: &[Route::put::<ClientHeartbeat>(
            Subject::Inputs,
            "/clients/{id}/heartbeat",
            &[ID],
            "Requests that the machine watches this client: if the next heartbeat is late, runs are held (CLIENT_LOST).",
        )],
        topic: Some(InboundTopic::new::<ClientHeartbeat>(
            "client/{id}/heartbeat",
            "Requests that the machine watches this client: if the next heartbeat is late, runs are held (CLIENT_LOST).",
        )),
        ..carried!(Raise, Heartbeat(id: name, beat: json))
    },
    Row {
        routes: &[Route::put::<HandlerPresence>(
            Subject::MCodes,
            "/handlers/{id}",
            &[ID],
            "Registers a handler with its instance and expires_ms, renews the registration within that time, or reports that the \
             handler has left. A claim needs the registration. While an instance is registered, another one is refused (409 \
             handler_taken), unless it contains take_over.",
        )
        .refusals(&[409])],
        topic: Some(
            InboundTopic::new::<HandlerPresence>(
                "handler/{id}/presence",
                "Presence of a handler, with the M codes that it serves; use it also as the last will. When it turns offline, \
                 the outputs that this id has claimed are released (HANDLER_LOST).",
            )
            .retained(),
        ),
        ..carried!(Handle, Handler(id: name, presence: json))
    },
    Row {
        routes: &[Route::get(
            Subject::MCodes,
            "/handlers",
            &[],
            "Handlers of auxiliary function outputs.",
        ).gives::<HandlerList>()],
        answer: json_of::<HandlerList>,
        ..carried!(Read, Handlers)
    },
    Row {
        routes: &[Route::get(
            Subject::Alarms,
            "/alarms/history",
            &[],
            "Alarms since the start.",
        ).gives::<AlarmHistory>()],
        answer: json_of::<AlarmHistory>,
        ..carried!(Read, AlarmHistory)
    },
    Row {
        routes: &[Route::get(
            Subject::Machine,
            "/explain/{what}",
            &[WHAT],
            "Meaning of a name: an alarm, a diagnostic, a code, a word of a state or a refusal, a configuration key.",
        )
        .gives::<Explanation>()],
        answer: json_of::<Explanation>,
        ..carried!(Read, Explain(what: name))
    },
    Row {
        routes: &[Route::get(Subject::Values, "/tools", &[], "The tool table.").gives::<ToolTable>()],
        answer: json_of::<ToolTable>,
        ..carried!(Read, Tools)
    },
    Row {
        routes: &[Route::put::<ToolChange>(
            Subject::Values,
            "/tools",
            &[],
            "Sets and removes tools; other tools do not change.",
        )],
        ..carried!(Operate, WriteTools(change: json))
    },
    Row {
        routes: &[Route::get(
            Subject::Values,
            "/cs/{cs}/work_offsets",
            &[CS],
            "Work offsets.",
        ).gives::<WorkOffsetTable>()],
        answer: json_of::<WorkOffsetTable>,
        ..carried!(Read, WorkOffsets(cs: number))
    },
    Row {
        routes: &[Route::put::<WorkOffsetTable>(
            Subject::Values,
            "/cs/{cs}/work_offsets",
            &[CS],
            "Sets work offsets; other offsets and axes do not change.",
        )],
        ..carried!(Operate, WriteWorkOffsets(cs: number, change: json))
    },
    Row {
        routes: &[
            Route::get(
                Subject::States,
                "/cs/{cs}/last_run",
                &[CS],
                "The last run before this start of the runtime.",
            ).gives::<LastRunAnswer>(),
        ],
        answer: json_of::<LastRunAnswer>,
        ..carried!(Read, LastRun(cs: number))
    },
    Row {
        routes: &[Route::get(
            Subject::Alarms,
            "/journal",
            &[],
            "Lines of the journal that match the filter, in the order of time: the newest count lines after skipping the from newest lines.",
        )
        .gives::<JournalAnswer>()
        .query(Query::JOURNAL)
        .refusals(&[400, 404])],
        answer: json_of::<JournalAnswer>,
        ..Row::new(Read, |incoming| {
                let QueryValues { from, count, filter, .. } = incoming.query;
                Ok(Request::Journal { from: from.unwrap_or_default(), count: count.unwrap_or(JOURNAL_LINES), filter })
            },
            written!(Request::Journal { from, count, filter } => {
                    with_filter(RequestParts::default().query("from", from).query("count", count), filter)
                }),
        )
    },
    program_rows::LIST,
    program_rows::TEXT,
    program_rows::STORE,
    program_rows::REMOVE,
    program_rows::CHECK,
    program_rows::INTERMEDIATE,
    program_rows::PATH,
    program_rows::REHEARSAL,
    program_rows::CHECK_TEXT,
    program_rows::FOLDER,
    program_rows::MANUAL_PATH,
    program_rows::MANUAL_REHEARSAL,
];
