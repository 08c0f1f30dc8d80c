//! Every request that crosses a wire, one row each.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::answer::AnswerForm;
use super::right::Right::{Administrate, Handle, Operate, Raise, Read, Reset};
use super::route::Content::{Json, Text};
use super::route::{Content, Headers, NO_CONTENT, Query, Route};
use super::row::{Envelope, Fault, IDEMPOTENCY_KEY, LEASE_FENCE, Parts, Received, Row, Topic};
use crate::types::command::Command;
use crate::types::data::{Number, VariableArea};
use crate::types::lease::{LeaseRelease, LeaseRequest};
use crate::types::request::{Input, Request};
use crate::types::state::{Switch, Tool};

/// Optional block skips: numbers from 1 to this.
const SKIP_MAX: u8 = 31;

/// Lines of the journal where no number is named.
const JOURNAL_LINES: u32 = 100;

/// Gives the parts of a request of this row; another request is given back.
macro_rules! write {
    ($($request:pat => $parts:expr),+) => {
        |request| match request {
            $($request => Ok($parts),)+
            other => Err(other),
        }
    };
}

const REPLY: &[(u16, Content)] = &[(200, Json("CommandReply"))];
const COMMANDED: &[(u16, Content)] = &[(200, Json("CommandReply")), (202, Json("CommandAccepted"))];
const RESULT: &[(u16, Content)] = &[(200, Json("HandshakeResult"))];
const VALUES: &[(u16, Content)] = &[(200, Json("VariableValues"))];
const CHECKED: &[(u16, Content)] = &[(200, Json("ProgramCheck"))];
const STORED: &[(u16, Content)] = &[(200, Json("ProgramCheck")), (201, Json("ProgramCheck"))];

const fn command(pattern: &'static str, summary: &'static str, args: &'static str) -> Route {
    let route = Route::post(pattern, Operate, summary, args, COMMANDED);
    route.query(Query::Wait).headers(Headers::Command)
}

const fn read(pattern: &'static str, summary: &'static str, answer: &'static [(u16, Content)]) -> Route {
    Route::get(pattern, summary, answer).query(Query::Range)
}

const fn topic(pattern: &'static str, right: super::right::Right, schema: &'static str) -> Topic {
    Topic {
        pattern,
        right,
        retained: false,
        schema,
        envelope: Envelope::Nothing,
    }
}

/// A topic whose messages are answered on `reply/{client_id}`.
const fn commanded(
    pattern: &'static str,
    right: super::right::Right,
    schema: &'static str,
    envelope: Envelope,
) -> Topic {
    Topic {
        envelope,
        ..topic(pattern, right, schema)
    }
}

/// Every request. What is said of an output names it by its sequence number in the path of a route, and by its M number
/// in that of a topic. An alarm is acknowledged by its own route; the server says which coordinate system it is of.
#[rustfmt::skip]
#[allow(clippy::result_large_err, reason = "a request that is not of the row is given back as it is")]
pub static ROWS: [Row; 36] = [
    Row { routes: &[Route::post("/cs/{cs}/m_codes/{seq}/claim", Handle, "Claims an output. It is given back when the presence of this handler_id, told over a WebSocket or MQTT, ends.", "ClaimBody", RESULT)],
        topic: Some(topic("cs/{cs}/m_code/{m}/claim", Handle, "Claim")),
        read: |at| Ok(Request::Claim(at.cs()?, at.m()?, at.json()?)),
        answer: handshake,
        write: write!(Request::Claim(cs, m, claim) => Parts::of_output(cs, m, claim.seq, &claim)) },
    Row { routes: &[Route::post("/cs/{cs}/m_codes/{seq}/reset", Reset, "Resets an output, or tells its fault.", "ResetBody", RESULT)],
        topic: Some(topic("cs/{cs}/m_code/{m}/reset", Reset, "Reset")),
        read: |at| Ok(Request::Reset(at.cs()?, at.m()?, at.json()?)),
        answer: handshake,
        write: write!(Request::Reset(cs, m, reset) => Parts::of_output(cs, m, reset.seq, &reset)) },
    Row { routes: &[Route::post("/cs/{cs}/m_codes/{seq}/progress", Handle, "Tells how far an output's work is.", "ProgressBody", NO_CONTENT)],
        topic: Some(topic("cs/{cs}/m_code/{m}/progress", Handle, "ProgressReport")),
        read: |at| Ok(Request::Progress(at.cs()?, at.m()?, at.json()?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::Progress(cs, m, report) => Parts::of_output(cs, m, report.seq, &report)) },
    Row { routes: &[Route::post("/cs/{cs}/m_codes/{seq}/redeliver", Operate, "Gives an output whose handler was lost to a handler again.", "RedeliverBody", NO_CONTENT)],
        topic: Some(topic("cs/{cs}/m_code/{m}/redeliver", Operate, "Redeliver")),
        read: |at| Ok(Request::Redeliver(at.cs()?, at.m()?, at.json()?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::Redeliver(cs, m, redeliver) => Parts::of_output(cs, m, redeliver.seq, &redeliver)) },
    Row { routes: &[Route::post("/cs/{cs}/m_codes/{seq}/ask", Handle, "Asks the operator about an output.", "AskBody", RESULT)],
        topic: Some(topic("cs/{cs}/m_code/{m}/ask", Handle, "Ask")),
        read: |at| Ok(Request::Ask(at.cs()?, at.m()?, at.json()?)),
        answer: handshake,
        write: write!(Request::Ask(cs, m, ask) => Parts::of_output(cs, m, ask.seq, &ask)) },
    Row { routes: &[Route::post("/cs/{cs}/m_codes/{seq}/answer", Operate, "Answers a question of a handler.", "AnswerBody", RESULT)],
        topic: Some(topic("cs/{cs}/m_code/{m}/answer", Operate, "OperatorAnswer")),
        read: |at| Ok(Request::AnswerQuestion(at.cs()?, at.m()?, at.json()?)),
        answer: handshake,
        write: write!(Request::AnswerQuestion(cs, m, answer) => Parts::of_output(cs, m, answer.seq, &answer)) },
    // to a REST server a frame of the WebSocket carries it
    Row { routes: &[],
        topic: Some(topic("cs/{cs}/m_code/{m}/validate_result", Handle, "ValidateResult")),
        read: |at| Ok(Request::ValidateResult(at.cs()?, at.m()?, at.json()?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::ValidateResult(cs, Some(m), result) => Parts::of(cs).with("m", m).json(&result)) },
    Row { routes: &[
            Route::put("/cs/{cs}/inputs/{input=optional_skip}/{number}", Operate, "Sets one optional block skip, 1 to 31.", "Switch").number_max(31),
            Route::put("/cs/{cs}/inputs/{input=optional_stop}", Operate, "Sets the optional stop input.", "Switch"),
            Route::put("/cs/{cs}/inputs/{input=single_block}", Operate, "Sets the single block input.", "Switch"),
            Route::put("/cs/{cs}/inputs/{input=dry_run}", Operate, "Sets the dry run input.", "Switch"),
            Route::put("/cs/{cs}/inputs/{input=interlock}", Operate, "Sets the interlock input.", "Lock"),
            Route::put("/cs/{cs}/inputs/{input=start_lock}", Operate, "Sets the start lock input.", "Lock"),
        ],
        topic: Some(topic("cs/{cs}/input/{input}/set", Operate, "InputSet")),
        read: |at| Ok(Request::Input(at.cs()?, input(&at)?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(
            Request::Input(cs, Input::OptionalSkip(set)) => set_skips(cs, set),
            Request::Input(cs, Input::OptionalStop(value)) => set_input(cs, "optional_stop", &Toggle { value }),
            Request::Input(cs, Input::SingleBlock(value)) => set_input(cs, "single_block", &Toggle { value }),
            Request::Input(cs, Input::DryRun(value)) => set_input(cs, "dry_run", &Toggle { value }),
            Request::Input(cs, Input::Interlock(lock)) => set_input(cs, "interlock", &lock),
            Request::Input(cs, Input::StartLock(lock)) => set_input(cs, "start_lock", &lock)) },
    Row { routes: &[Route::put("/cs/{cs}/overrides", Operate, "Sets overrides, percent; those left out stay.", "OverrideChange")],
        topic: Some(topic("cs/{cs}/override/set", Operate, "OverrideChange")),
        read: |at| Ok(Request::Input(at.cs()?, Input::Override(at.json()?))),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::Input(cs, Input::Override(change)) => Parts::of(cs).json(&change)) },
    Row { routes: &[Route::put("/cs/{cs}/spindle", Operate, "Commands the spindle.", "SpindleCommand")],
        topic: Some(topic("cs/{cs}/spindle/set", Operate, "SpindleCommand")),
        read: |at| Ok(Request::Spindle(at.cs()?, at.json()?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::Spindle(cs, command) => Parts::of(cs).json(&command)) },
    Row { routes: &[Route::put("/cs/{cs}/tool", Operate, "Selects a tool.", "Tool")],
        topic: Some(topic("cs/{cs}/tool/set", Operate, "Tool")),
        read: |at| Ok(Request::Tool(at.cs()?, at.json::<Tool>()?.id)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::Tool(cs, id) => Parts::of(cs).json(&Tool { id })) },
    Row { routes: &[command("/alarms/{id}/acknowledge", "Acknowledges an alarm.", "NoArgs")],
        topic: None,
        read: |at| { at.json::<Value>()?; asked(&at, Command::AlarmAcknowledge { id: at.number("id")? }) },
        answer: command_answer,
        write: write!(Request::Command { cs, command: Command::AlarmAcknowledge { id }, meta, wait } =>
            Parts::of(cs).with("id", id).with("verb", "alarm_acknowledge").json(&json!({ "id": id })).meta(meta).waiting(wait)) },
    Row { routes: &[
            command("/cs/{cs}/{verb=load}", "Loads a program of the store.", "LoadArgs"),
            command("/cs/{cs}/{verb=start}", "Starts the loaded program from its head.", "NoArgs"),
            command("/cs/{cs}/{verb=hold}", "Feed hold.", "NoArgs"),
            command("/cs/{cs}/{verb=resume}", "Goes on after a pause.", "NoArgs"),
            command("/cs/{cs}/{verb=stop}", "Decelerates on the path and ends the run.", "NoArgs"),
            command("/cs/{cs}/{verb=reset}", "Ends the run, cancels outputs, clears alarms.", "NoArgs"),
            command("/cs/{cs}/{verb=abort}", "Brakes each motor at once and ends the run.", "NoArgs"),
            command("/cs/{cs}/{verb=mdi}", "Runs a text of NC blocks.", "MdiArgs"),
            command("/cs/{cs}/{verb=jog}", "Moves one axis by hand.", "JogArgs"),
            command("/cs/{cs}/{verb=home}", "Returns axes to their reference points.", "HomeArgs"),
            command("/cs/{cs}/{verb=back_trace}", "Goes back along the passed path, or ends that.", "BackTraceArgs"),
        ],
        topic: Some(commanded("cs/{cs}/command/{verb}", Operate, "CommandMessage", Envelope::Command)),
        read: |at| { at.cs()?; asked(&at, Command::parse(at.text("verb").unwrap_or_default(), &at.json()?).map_err(Fault::Invalid)?) },
        answer: command_answer,
        write: write!(Request::Command { cs, command, meta, wait } =>
            Parts::of(cs).with("verb", json!(command.verb()).as_str().unwrap_or_default()).json(&command.args()).meta(meta).waiting(wait)) },
    Row { routes: &[Route::post("/cs/{cs}/lease", Operate, "Takes the control lease, or renews it with its fence.", "LeaseTake", REPLY).headers(Headers::Key)],
        topic: Some(commanded("cs/{cs}/lease/{verb=take}", Operate, "LeaseTakeMessage", Envelope::Lease)),
        read: |at| lease(&at, |at| at.json().map(LeaseRequest::Take)),
        answer: |_| AnswerForm::Lease,
        write: write!(Request::Lease { cs, request: LeaseRequest::Take(take), meta } => Parts::of(cs).with("verb", "take").json(&take).header(IDEMPOTENCY_KEY, meta.command_id)) },
    Row { routes: &[Route::new("DELETE", "/cs/{cs}/lease", Some(Operate), "Gives the control lease back; Lease-Fence says which.", REPLY).headers(Headers::KeyAndFence)],
        topic: Some(commanded("cs/{cs}/lease/{verb=release}", Operate, "LeaseReleaseMessage", Envelope::Lease)),
        read: |at| lease(&at, release),
        answer: |_| AnswerForm::Lease,
        write: write!(Request::Lease { cs, request: LeaseRequest::Release(release), meta } => Parts::of(cs).with("verb", "release").payload(&release).header(IDEMPOTENCY_KEY, meta.command_id).header(LEASE_FENCE, release.fence)) },
    Row { routes: &[Route::post("/cs/{cs}/lease/break", Administrate, "Ends the control lease, whoever holds it.", "NoArgs", REPLY).headers(Headers::Key)],
        topic: Some(commanded("cs/{cs}/lease/{verb=break}", Administrate, "LeaseBreakMessage", Envelope::Lease)),
        read: |at| lease(&at, |at| at.json().map(|_: Value| LeaseRequest::Break)),
        answer: |_| AnswerForm::Lease,
        write: write!(Request::Lease { cs, request: LeaseRequest::Break, meta } => Parts::of(cs).with("verb", "break").json(&json!({})).header(IDEMPOTENCY_KEY, meta.command_id)) },
    Row { routes: &[Route::get("/commands/{id}", "How far a command is.", REPLY)],
        topic: None,
        read: |at| Ok(Request::CommandStatus(at.text("id").unwrap_or_default().to_owned())),
        answer: |_| AnswerForm::Status,
        write: write!(Request::CommandStatus(id) => Parts::default().with("id", id)) },
    Row { routes: &[
            read("/variables/{kind=p}", "P variables.", VALUES).refusals(&[400, 413]),
            read("/cs/{cs}/variables/{kind=q}", "Q variables.", VALUES).refusals(&[400, 413]),
        ],
        topic: Some(commanded("cs/{cs}/variable/{verb=get}", Operate, "VariableGet", Envelope::Variables)),
        read: |at| Ok(Request::ReadVariables { area: area(&at)?, from: at.query.from, count: at.query.count.unwrap_or(1), meta: None }),
        answer: variables,
        write: write!(Request::ReadVariables { area, from, count, .. } => of_area(area, "get").query("from", from).query("count", count)) },
    Row { routes: &[
            Route::put("/variables/{kind=p}", Operate, "Sets P variables, all or none.", "VariableWrite").query(Query::Range),
            Route::put("/cs/{cs}/variables/{kind=q}", Operate, "Sets Q variables, all or none.", "VariableWrite").query(Query::Range),
        ],
        topic: Some(commanded("cs/{cs}/variable/{verb=set}", Operate, "VariableSet", Envelope::Variables)),
        read: |at| Ok(Request::WriteVariables { area: area(&at)?, from: at.query.from, values: values(&at)?, meta: None }),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::WriteVariables { area, from, values, .. } =>
            of_area(area, "set").query("from", from).json(&Values { values: values.into_iter().map(Number).collect() })) },
    Row { routes: &[Route::put("/motors/{number}/skip_input", Operate, "Sets the skip input of a motor; not real time.", "Switch")],
        topic: Some(topic("motor/{number}/skip_input/set", Operate, "Switch")),
        read: |at| Ok(Request::SkipInput(at.number("number")?, switch(&at)?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::SkipInput(motor, value) => Parts::default().with("number", motor).json(&Toggle { value })) },
    Row { routes: &[Route::post("/alarms", Raise, "Raises an alarm of a coordinate system, or of all.", "AlarmRaise", NO_CONTENT)],
        topic: Some(topic("alarm/raise", Raise, "AlarmRaise")),
        read: |at| at.json().map(Request::RaiseAlarm),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::RaiseAlarm(raise) => Parts::default().json(&raise)) },
    // to a REST server a frame of the WebSocket carries it
    Row { routes: &[],
        topic: Some(Topic { pattern: "handler/{id}/presence", right: Handle, retained: true, schema: "HandlerPresence", envelope: Envelope::Nothing }),
        read: |at| Ok(Request::Handler(at.text("id").unwrap_or_default().to_owned(), at.json()?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::Handler(id, presence) => Parts::default().with("id", id).json(&presence)) },
    Row { routes: &[Route::get("/handlers", "Handlers of auxiliary function outputs.", &[(200, Json("Handlers"))])],
        topic: None,
        read: |_| Ok(Request::Handlers),
        answer: |_| AnswerForm::Handlers,
        write: write!(Request::Handlers => Parts::default()) },
    Row { routes: &[Route::get("/alarms/history", "Alarms of the past.", &[(200, Json("AlarmHistory"))])],
        topic: None,
        read: |_| Ok(Request::AlarmHistory),
        answer: |_| AnswerForm::Alarms,
        write: write!(Request::AlarmHistory => Parts::default()) },
    Row { routes: &[Route::get("/tools", "The tool table.", &[(200, Json("ToolTable"))])],
        topic: None,
        read: |_| Ok(Request::Tools),
        answer: |_| AnswerForm::Tools,
        write: write!(Request::Tools => Parts::default()) },
    Row { routes: &[Route::put("/tools", Operate, "Sets and removes tools; those not named stay.", "ToolChange")],
        topic: None,
        read: |at| at.json().map(Request::WriteTools),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::WriteTools(change) => Parts::default().json(&change)) },
    Row { routes: &[Route::get("/cs/{cs}/work_offsets", "Work offsets.", &[(200, Json("WorkOffsetTable"))])],
        topic: None,
        read: |at| at.cs().map(Request::WorkOffsets),
        answer: |_| AnswerForm::WorkOffsets,
        write: write!(Request::WorkOffsets(cs) => Parts::of(cs)) },
    Row { routes: &[Route::put("/cs/{cs}/work_offsets", Operate, "Sets work offsets; what is not named stays.", "WorkOffsetTable")],
        topic: None,
        read: |at| Ok(Request::WriteWorkOffsets(at.cs()?, at.json()?)),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::WriteWorkOffsets(cs, change) => Parts::of(cs).json(&change)) },
    Row { routes: &[Route::get("/cs/{cs}/last_run", "The last run before this start of the runtime.", &[(200, Json("LastRunAnswer"))])],
        topic: None,
        read: |at| at.cs().map(Request::LastRun),
        answer: |_| AnswerForm::LastRun,
        write: write!(Request::LastRun(cs) => Parts::of(cs)) },
    Row { routes: &[read("/journal", "The newest count lines of the journal but for the from newest, in the order of time.", &[(200, Json("JournalAnswer"))]).refusals(&[400, 404])],
        topic: None,
        read: |at| Ok(Request::Journal { from: at.query.from, count: at.query.count.unwrap_or(JOURNAL_LINES) }),
        answer: |_| AnswerForm::Journal,
        write: write!(Request::Journal { from, count } => Parts::default().query("from", from).query("count", count)) },
    Row { routes: &[Route::get("/programs", "Programs of the store.", &[(200, Json("Programs"))])],
        topic: None,
        read: |_| Ok(Request::Programs),
        answer: |_| AnswerForm::Programs,
        write: write!(Request::Programs => Parts::default()) },
    Row { routes: &[Route::get("/programs/{number}", "Text of a program.", &[(200, Text)])],
        topic: None,
        read: |at| at.number("number").map(Request::ReadProgram),
        answer: |_| AnswerForm::ProgramText,
        write: write!(Request::ReadProgram(number) => Parts::default().with("number", number)) },
    Row { routes: &[Route::new("PUT", "/programs/{number}", Some(Administrate), "Stores a program, even with errors.", STORED).text()],
        topic: None,
        read: |at| Ok(Request::WriteProgram(at.number("number")?, text(at)?)),
        answer: |_| AnswerForm::Check,
        write: write!(Request::WriteProgram(number, text) => Parts::default().with("number", number).text(text)) },
    Row { routes: &[Route::new("DELETE", "/programs/{number}", Some(Administrate), "Deletes a program.", NO_CONTENT)],
        topic: None,
        read: |at| at.number("number").map(Request::DeleteProgram),
        answer: |_| AnswerForm::Nothing,
        write: write!(Request::DeleteProgram(number) => Parts::default().with("number", number)) },
    Row { routes: &[Route::new("POST", "/programs/{number}/check", Some(Read), "Checks a program of the store.", CHECKED)],
        topic: None,
        read: |at| at.number("number").map(Request::CheckProgram),
        answer: |_| AnswerForm::Check,
        write: write!(Request::CheckProgram(number) => Parts::default().with("number", number).json(&json!({}))) },
    Row { routes: &[Route::get("/programs/{number}/intermediate", "Intermediate code of a program.", &[(200, Text)]).refusals(&[422])],
        topic: None,
        read: |at| at.number("number").map(Request::IntermediateCode),
        answer: |_| AnswerForm::ProgramText,
        write: write!(Request::IntermediateCode(number) => Parts::default().with("number", number)) },
];

/// Body of an input with one value.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Toggle {
    value: bool,
}

/// Optional block skips over MQTT.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Skips {
    set: BTreeMap<u8, bool>,
}

/// Body of a write of variables.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Values {
    values: Vec<Number>,
}

fn command_answer(request: &Request) -> AnswerForm {
    let wait = matches!(request, Request::Command { wait: true, .. });
    AnswerForm::Command { wait }
}

fn handshake(request: &Request) -> AnswerForm {
    let (seq, handler_id) = match request {
        Request::Claim(_, _, claim) => (claim.seq, claim.handler_id.as_str()),
        Request::Reset(_, _, reset) => (reset.seq, reset.handler_id.as_str()),
        Request::Ask(_, _, ask) => (ask.seq, ask.handler_id.as_str()),
        Request::AnswerQuestion(_, _, answer) => {
            (answer.seq, answer.client_id.as_deref().unwrap_or_default())
        }
        _ => return AnswerForm::Nothing,
    };
    AnswerForm::Handshake {
        seq,
        handler_id: handler_id.to_owned(),
        is_answer: matches!(request, Request::AnswerQuestion(..)),
    }
}

fn variables(request: &Request) -> AnswerForm {
    match request {
        Request::ReadVariables { area, from, .. } => AnswerForm::Variables {
            kind: area.kind(),
            from: *from,
        },
        _ => AnswerForm::Nothing,
    }
}

fn asked(at: &Received<'_>, command: Command) -> Result<Request, Fault> {
    let (cs, meta, wait) = (at.cs()?, at.meta()?, at.wait()?);
    Ok(Request::Command {
        cs,
        command,
        meta,
        wait,
    })
}

fn lease(
    at: &Received<'_>,
    request: fn(&Received<'_>) -> Result<LeaseRequest, Fault>,
) -> Result<Request, Fault> {
    let (cs, request, meta) = (at.cs()?, request(at)?, at.meta()?);
    Ok(Request::Lease { cs, request, meta })
}

fn release(at: &Received<'_>) -> Result<LeaseRequest, Fault> {
    let text = "name the lease that is given back by the header Lease-Fence";
    let fence = at.fence()?.ok_or_else(|| Fault::Invalid(text.to_owned()))?;
    Ok(LeaseRequest::Release(LeaseRelease { fence }))
}

/// Over MQTT other fields are passed over.
fn switch(at: &Received<'_>) -> Result<bool, Fault> {
    if at.is_rest() {
        at.json().map(|Toggle { value }| value)
    } else {
        at.json().map(|Switch { value }| value)
    }
}

fn input(at: &Received<'_>) -> Result<Input, Fault> {
    Ok(match at.text("input").unwrap_or_default() {
        "optional_skip" => Input::OptionalSkip(skips(at)?),
        "optional_stop" => Input::OptionalStop(switch(at)?),
        "single_block" => Input::SingleBlock(switch(at)?),
        "dry_run" => Input::DryRun(switch(at)?),
        "interlock" => Input::Interlock(at.json()?),
        "start_lock" => Input::StartLock(at.json()?),
        _ => return Err(Fault::Invalid("there is no such input".to_owned())),
    })
}

fn set_input(cs: u8, name: &str, said: &impl Serialize) -> Parts {
    Parts::of(cs).with("input", name).json(said)
}

/// Over REST the path names one of them.
fn skips(at: &Received<'_>) -> Result<BTreeMap<u8, bool>, Fault> {
    if !at.is_rest() {
        return at.json().map(|Skips { set }| set);
    }
    let (number, value) = (at.number("number")?, switch(at)?);
    if !(1..=SKIP_MAX).contains(&number) {
        let text = format!("there is no optional block skip {number}; write 1 to {SKIP_MAX}");
        return Err(Fault::NotFound(text));
    }
    Ok([(number, value)].into())
}

fn set_skips(cs: u8, set: BTreeMap<u8, bool>) -> Parts {
    let parts = Parts::of(cs).with("input", "optional_skip");
    let parts = match set.first_key_value() {
        Some((number, value)) => parts.with("number", number).json(&Toggle { value: *value }),
        None => parts,
    };
    parts.payload(&Skips { set })
}

fn area(at: &Received<'_>) -> Result<VariableArea, Fault> {
    Ok(match at.text("cs") {
        None => VariableArea::Global,
        Some(_) => VariableArea::CoordinateSystem(at.cs()?),
    })
}

fn of_area(area: VariableArea, verb: &str) -> Parts {
    let parts = match area {
        VariableArea::Global => Parts::default().with("kind", "p"),
        VariableArea::CoordinateSystem(cs) => Parts::of(cs).with("kind", "q"),
    };
    parts.with("verb", verb)
}

fn values(at: &Received<'_>) -> Result<Vec<f64>, Fault> {
    let Values { values } = at.json()?;
    if let Some(count) = at.query.count.filter(|count| *count as usize != values.len()) {
        let text = format!("count={count}, and the body has {} values", values.len());
        return Err(Fault::Invalid(text));
    }
    Ok(values.into_iter().map(|number| number.0).collect())
}

fn text(at: Received<'_>) -> Result<String, Fault> {
    String::from_utf8(at.body.into_owned()).map_err(|error| {
        let place = error.utf8_error().valid_up_to();
        Fault::Invalid(format!(
            "the text is not UTF-8 at byte {place}; save the program as UTF-8"
        ))
    })
}
