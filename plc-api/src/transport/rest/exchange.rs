//! Requests as HTTP requests, and HTTP answers as answers. Pure: no I/O.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::http::Method;

use crate::types::CoordinateSystemNumber;
use crate::types::command::{Command, CommandMeta, CommandReply, CommandStatus, Verb};
use crate::types::data::{LastRun, Number, VariableArea, VariableValues};
use crate::types::lease::{LeaseRelease, LeaseRequest};
use crate::types::machine::AlarmRecord;
use crate::types::output::{HandlerPresence, HandshakeResult, HandshakeStatus};
use crate::types::program::{ProgramCheck, ProgramDiagnostic, ProgramInfo};
use crate::types::request::{Answer, Input, Refusal, RefusalCode, Request};
use crate::types::state::Execution;

/// Header with the number of the control lease under which a command is sent.
const LEASE_FENCE: &str = "lease-fence";

/// A request as it goes over HTTP, and how its answer is read.
#[derive(Debug, Clone)]
pub(super) struct Exchange {
    pub(super) method: Method,
    /// Below the interface's path.
    pub(super) path: String,
    pub(super) headers: Vec<(&'static str, String)>,
    pub(super) body: Option<String>,
    kind: Kind,
}

/// What an answer is.
#[derive(Debug, Clone, PartialEq)]
enum Kind {
    /// Nothing to read.
    Done,
    /// A message, read by whoever asked.
    Message,
    Command,
    Handshake {
        seq: u64,
        handler_id: String,
    },
    Variables,
    Tools,
    WorkOffsets,
    LastRun,
    Journal,
    Programs,
    ProgramText,
    Check,
    Handlers,
    Alarms,
}

impl Exchange {
    /// The exchange of a request.
    ///
    /// # Errors
    /// `not_supported` for what the interface has no route for.
    pub(super) fn of(request: Request) -> Result<Self, Refusal> {
        Ok(match request {
            Request::Command {
                cs,
                command,
                meta,
                wait,
            } => Self::command(cs, &command, meta, wait),
            Request::Lease { cs, request, meta } => Self::lease(cs, &request, meta),
            Request::CommandStatus(id) => Self::get(format!("/commands/{}", encoded(&id)), Kind::Command),
            Request::Claim(cs, _, claim) => {
                Self::handshake(cs, claim.seq, &claim.handler_id, "claim", &claim)
            }
            Request::Reset(cs, _, reset) => {
                Self::handshake(cs, reset.seq, &reset.handler_id, "reset", &reset)
            }
            Request::Ask(cs, _, ask) => Self::handshake(cs, ask.seq, &ask.handler_id, "ask", &ask),
            Request::AnswerQuestion(cs, _, answer) => {
                let client_id = answer.client_id.as_deref().unwrap_or_default();
                Self::handshake(cs, answer.seq, client_id, "answer", &answer)
            }
            Request::Progress(cs, _, report) => Self::of_output(cs, report.seq, "progress", &report),
            Request::Redeliver(cs, _, redeliver) => {
                Self::of_output(cs, redeliver.seq, "redeliver", &redeliver)
            }
            Request::Input(cs, input) => Self::input(cs, input)?,
            Request::Spindle(cs, command) => Self::put(format!("/cs/{cs}/spindle"), &json!(command)),
            Request::Tool(cs, id) => Self::put(format!("/cs/{cs}/tool"), &json!({ "id": id })),
            Request::SkipInput(motor, value) => {
                Self::put(format!("/motors/{motor}/skip_input"), &json!({ "value": value }))
            }
            Request::RaiseAlarm(raise) => Self::post("/alarms".to_owned(), &json!(raise)),
            Request::ReadVariables {
                area, from, count, ..
            } => Self::get(
                format!("{}&count={count}", variables(area, from)),
                Kind::Variables,
            ),
            Request::WriteVariables {
                area, from, values, ..
            } => Self::write_variables(area, from, values),
            Request::Tools => Self::get("/tools".to_owned(), Kind::Tools),
            Request::WriteTools(change) => Self::put("/tools".to_owned(), &json!(change)),
            Request::WorkOffsets(cs) => Self::get(format!("/cs/{cs}/work_offsets"), Kind::WorkOffsets),
            Request::WriteWorkOffsets(cs, change) => {
                Self::put(format!("/cs/{cs}/work_offsets"), &json!(change))
            }
            Request::LastRun(cs) => Self::get(format!("/cs/{cs}/last_run"), Kind::LastRun),
            Request::Journal { from, count } => Self::journal(from, count),
            Request::Handlers => Self::get("/handlers".to_owned(), Kind::Handlers),
            Request::Programs => Self::get("/programs".to_owned(), Kind::Programs),
            Request::ReadProgram(number) => Self::get(format!("/programs/{number}"), Kind::ProgramText),
            Request::WriteProgram(number, text) => Self::write_program(number, text),
            Request::DeleteProgram(number) => Self::delete_program(number),
            Request::CheckProgram(number) => Self {
                kind: Kind::Check,
                ..Self::post(format!("/programs/{number}/check"), &json!({}))
            },
            Request::IntermediateCode(number) => {
                Self::get(format!("/programs/{number}/intermediate"), Kind::ProgramText)
            }
            Request::AlarmHistory => Self::get("/alarms/history".to_owned(), Kind::Alarms),
            other => {
                let text = format!("REST has no route for this request: {other:?}");
                return Err(Refusal::new(RefusalCode::NotSupported, text));
            }
        })
    }

    fn journal(from: u32, count: u32) -> Self {
        Self::get(format!("/journal?from={from}&count={count}"), Kind::Journal)
    }

    fn delete_program(number: u16) -> Self {
        Self::new(Method::DELETE, format!("/programs/{number}"), Kind::Done)
    }

    /// The position of the last servo cycle.
    pub(super) fn position(cs: CoordinateSystemNumber) -> Self {
        Self::get(format!("/cs/{cs}/position"), Kind::Message)
    }

    fn new(method: Method, path: String, kind: Kind) -> Self {
        Self {
            method,
            path,
            headers: Vec::new(),
            body: None,
            kind,
        }
    }

    fn get(path: String, kind: Kind) -> Self {
        Self::new(Method::GET, path, kind)
    }

    fn with_body(method: Method, path: String, body: &Value) -> Self {
        Self {
            headers: vec![("content-type", "application/json".to_owned())],
            body: Some(body.to_string()),
            ..Self::new(method, path, Kind::Done)
        }
    }

    fn post(path: String, body: &Value) -> Self {
        Self::with_body(Method::POST, path, body)
    }

    fn put(path: String, body: &Value) -> Self {
        Self::with_body(Method::PUT, path, body)
    }

    fn write_variables(area: VariableArea, from: u32, values: Vec<f64>) -> Self {
        let values: Vec<Number> = values.into_iter().map(Number).collect();
        Self::put(variables(area, from), &json!({ "values": values }))
    }

    fn write_program(number: u16, text: String) -> Self {
        Self {
            headers: vec![("content-type", "text/plain; charset=utf-8".to_owned())],
            body: Some(text),
            ..Self::new(Method::PUT, format!("/programs/{number}"), Kind::Check)
        }
    }

    /// Says something of an output.
    fn of_output(cs: CoordinateSystemNumber, seq: u64, what: &str, said: &impl Serialize) -> Self {
        Self::post(
            format!("/cs/{cs}/m_codes/{seq}/{what}"),
            &without_seq(json!(said)),
        )
    }

    /// The same, answered by how it went.
    fn handshake(
        cs: CoordinateSystemNumber,
        seq: u64,
        handler_id: &str,
        what: &str,
        said: &impl Serialize,
    ) -> Self {
        let handler_id = handler_id.to_owned();
        Self {
            kind: Kind::Handshake { seq, handler_id },
            ..Self::of_output(cs, seq, what, said)
        }
    }

    fn command(cs: CoordinateSystemNumber, command: &Command, meta: CommandMeta, wait: bool) -> Self {
        let (path, args) = match command {
            Command::AlarmAcknowledge { id } => (format!("/alarms/{id}/acknowledge"), json!({})),
            _ => (format!("/cs/{cs}/{}", word(command.verb())), command.args()),
        };
        let path = if wait { path + "?wait=1" } else { path };
        let mut exchange = Self::post(path, &args);
        exchange.kind = Kind::Command;
        exchange.headers.push(("idempotency-key", meta.command_id));
        if let Some(rev) = meta.expect.and_then(|expect| expect.state_rev) {
            exchange.headers.push(("if-match", format!("\"{rev}\"")));
        }
        if let Some(fence) = meta.fence {
            exchange.headers.push((LEASE_FENCE, fence.to_string()));
        }
        exchange
    }

    fn lease(cs: CoordinateSystemNumber, request: &LeaseRequest, meta: CommandMeta) -> Self {
        let path = format!("/cs/{cs}/lease");
        let mut exchange = match request {
            LeaseRequest::Take(take) => Self::post(path, &json!(take)),
            LeaseRequest::Release(LeaseRelease { fence }) => {
                let mut release = Self::new(Method::DELETE, path, Kind::Command);
                release.headers.push((LEASE_FENCE, fence.to_string()));
                release
            }
            LeaseRequest::Break => Self::post(path + "/break", &json!({})),
        };
        exchange.kind = Kind::Command;
        exchange.headers.push(("idempotency-key", meta.command_id));
        exchange
    }

    fn input(cs: CoordinateSystemNumber, input: Input) -> Result<Self, Refusal> {
        let (path, body) = match input {
            Input::OptionalSkip(set) => {
                let mut set = set.into_iter();
                let (Some((number, value)), None) = (set.next(), set.next()) else {
                    let text = "REST sets one block skip number at a time";
                    return Err(Refusal::new(RefusalCode::NotSupported, text));
                };
                (
                    format!("inputs/optional_skip/{number}"),
                    json!({ "value": value }),
                )
            }
            Input::OptionalStop(value) => ("inputs/optional_stop".to_owned(), json!({ "value": value })),
            Input::SingleBlock(value) => ("inputs/single_block".to_owned(), json!({ "value": value })),
            Input::DryRun(value) => ("inputs/dry_run".to_owned(), json!({ "value": value })),
            Input::Interlock(lock) => ("inputs/interlock".to_owned(), json!(lock)),
            Input::StartLock(lock) => ("inputs/start_lock".to_owned(), json!(lock)),
            Input::Override(change) => ("overrides".to_owned(), json!(change)),
        };
        Ok(Self::put(format!("/cs/{cs}/{path}"), &body))
    }

    /// What an HTTP answer says.
    ///
    /// # Errors
    /// The refusal that it carries.
    pub(super) fn answer(&self, status: u16, body: &str) -> Result<Answer, Refusal> {
        if !(200..300).contains(&status) {
            return self.refused(status, body);
        }
        Ok(match &self.kind {
            Kind::Done | Kind::Message => Answer::Done,
            Kind::Command => Answer::Command(command_reply(status, body)?),
            Kind::Handshake { .. } => Answer::Handshake(read(body)?),
            Kind::Variables => Answer::Variables(read::<VariableValues>(body)?.numbers()),
            Kind::Tools => Answer::Tools(read(body)?),
            Kind::WorkOffsets => Answer::WorkOffsets(read(body)?),
            Kind::LastRun => Answer::LastRun(read::<LastRuns>(body)?.last_run),
            Kind::Journal => Answer::Journal(read::<Lines>(body)?.lines),
            Kind::ProgramText => Answer::ProgramText(body.to_owned()),
            Kind::Check => {
                let check: ProgramCheck = read(body)?;
                Answer::Check(ProgramCheck {
                    created: status == 201,
                    ..check
                })
            }
            Kind::Programs => Answer::Programs(read::<Programs>(body)?.programs),
            Kind::Handlers => Answer::Handlers(read::<Handlers>(body)?.handlers),
            Kind::Alarms => Answer::Alarms(read::<Alarms>(body)?.alarms),
        })
    }

    fn refused(&self, status: u16, body: &str) -> Result<Answer, Refusal> {
        let problem: Problem = serde_json::from_str(body).unwrap_or_else(|_| Problem {
            code: String::new(),
            detail: format!("HTTP status {status}"),
            ..Problem::default()
        });
        if let Kind::Handshake { seq, handler_id } = &self.kind
            && let Ok(status) = serde_json::from_value::<HandshakeStatus>(json!(problem.code))
        {
            return Ok(Answer::Handshake(HandshakeResult {
                seq: *seq,
                handler_id: handler_id.clone(),
                status,
            }));
        }
        let code = serde_json::from_value(json!(problem.code)).unwrap_or(match status {
            404 => RefusalCode::NotFound,
            413 => RefusalCode::TooLarge,
            400..500 => RefusalCode::Invalid,
            _ => RefusalCode::Unavailable,
        });
        Err(Refusal {
            state: problem.state,
            allowed: problem.allowed,
            diagnostics: problem.diagnostics,
            ..Refusal::new(code, problem.detail)
        })
    }
}

/// What problem+json tells beyond its status.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Problem {
    code: String,
    detail: String,
    state: Option<Execution>,
    allowed: Vec<Verb>,
    diagnostics: Vec<ProgramDiagnostic>,
}

#[derive(Deserialize)]
struct Programs {
    programs: Vec<ProgramInfo>,
}

#[derive(Deserialize)]
struct LastRuns {
    last_run: Option<LastRun>,
}

#[derive(Deserialize)]
struct Lines {
    lines: Vec<Value>,
}

#[derive(Deserialize)]
struct Handlers {
    handlers: BTreeMap<String, HandlerPresence>,
}

#[derive(Deserialize)]
struct Alarms {
    alarms: Vec<AlarmRecord>,
}

/// 200 carries the reply; 202 only the id of a command that has been accepted.
fn command_reply(status: u16, body: &str) -> Result<CommandReply, Refusal> {
    #[derive(Deserialize)]
    struct Accepted {
        command_id: String,
    }
    if status != 202 {
        return read(body);
    }
    let Accepted { command_id } = read(body)?;
    Ok(CommandReply {
        command_id,
        status: CommandStatus::Accepted,
        code: "ok".to_owned(),
        text: String::new(),
        state_rev: 0,
        variables: None,
        lease: None,
    })
}

/// Where variables from a number on are read and written.
fn variables(area: VariableArea, from: u32) -> String {
    match area {
        VariableArea::Global => format!("/variables/p?from={from}"),
        VariableArea::CoordinateSystem(cs) => format!("/cs/{cs}/variables/q?from={from}"),
    }
}

fn read<T: DeserializeOwned>(body: &str) -> Result<T, Refusal> {
    serde_json::from_str(body).map_err(|error| {
        let text = format!("the machine's answer is not of the route's form: {error}");
        Refusal::new(RefusalCode::Unavailable, text)
    })
}

fn without_seq(mut body: Value) -> Value {
    if let Value::Object(fields) = &mut body {
        // The path names it.
        fields.remove("seq");
    }
    body
}

fn word(verb: Verb) -> String {
    match serde_json::to_value(verb) {
        Ok(Value::String(word)) => word,
        _ => String::new(),
    }
}

/// As one level of a path.
fn encoded(text: &str) -> String {
    use std::fmt::Write as _;
    text.bytes().fold(String::new(), |mut path, byte| {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            path.push(char::from(byte));
        } else {
            // Writing to a String cannot fail.
            let _ = write!(path, "%{byte:02X}");
        }
        path
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::claim::reset_of;
    use crate::types::BootId;
    use crate::types::command::Expect;

    fn sent(request: Request) -> (String, String, Value) {
        let exchange = Exchange::of(request).unwrap();
        let body = exchange
            .body
            .as_deref()
            .map_or(Value::Null, |body| serde_json::from_str(body).unwrap());
        (exchange.method.to_string(), exchange.path, body)
    }

    fn command(command: Command, wait: bool) -> Request {
        let meta = CommandMeta {
            command_id: "c 1".into(),
            client_id: "plc".into(),
            expect: Some(Expect {
                boot_id: None,
                state_rev: Some(12),
            }),
            ..CommandMeta::default()
        };
        Request::Command {
            cs: 2,
            command,
            meta,
            wait,
        }
    }

    #[test]
    fn requests_have_the_routes_and_bodies_of_section_5() {
        let post = |path: &str, body| ("POST".to_owned(), path.to_owned(), body);
        let put = |path: &str, body| ("PUT".to_owned(), path.to_owned(), body);
        assert_eq!(
            sent(command(Command::Load { program: 7 }, true)),
            post("/cs/2/load?wait=1", json!({"program": 7}))
        );
        assert_eq!(
            sent(command(Command::AlarmAcknowledge { id: 5 }, false)),
            post("/alarms/5/acknowledge", json!({}))
        );
        let reset = reset_of(&BootId("b".into()), 7, "h", None);
        assert_eq!(
            sent(Request::Reset(1, Some(100), reset)),
            post(
                "/cs/1/m_codes/7/reset",
                json!({"boot_id": "b", "handler_id": "h", "result": "ok"})
            )
        );
        assert_eq!(
            sent(Request::Input(1, Input::OptionalSkip([(3, true)].into()))),
            put("/cs/1/inputs/optional_skip/3", json!({"value": true}))
        );
        assert_eq!(
            sent(Request::IntermediateCode(7)),
            (
                "GET".to_owned(),
                "/programs/7/intermediate".to_owned(),
                Value::Null
            )
        );
        assert_eq!(sent(Request::Tool(1, 4)), put("/cs/1/tool", json!({"id": 4})));
    }

    #[test]
    fn a_command_carries_its_id_and_condition_in_headers() {
        let headers = Exchange::of(command(Command::Start, false)).unwrap().headers;
        assert!(headers.contains(&("idempotency-key", "c 1".to_owned())));
        assert!(headers.contains(&("if-match", "\"12\"".to_owned())));
    }

    #[test]
    fn an_accepted_command_is_answered_with_its_id_and_a_done_one_with_its_reply() {
        let exchange = Exchange::of(command(Command::Start, true)).unwrap();
        let Ok(Answer::Command(reply)) = exchange.answer(202, r#"{"command_id":"c"}"#) else {
            panic!("no reply")
        };
        assert_eq!(
            (reply.command_id.as_str(), reply.status),
            ("c", CommandStatus::Accepted)
        );
        let done = r#"{"command_id":"c","status":"done","code":"ok","text":"","state_rev":4}"#;
        let Ok(Answer::Command(reply)) = exchange.answer(200, done) else {
            panic!("no reply")
        };
        assert_eq!((reply.status, reply.state_rev), (CommandStatus::Done, 4));
    }

    #[test]
    fn a_problem_is_the_refusal_that_it_was() {
        let exchange = Exchange::of(command(Command::Start, true)).unwrap();
        let body = r#"{"type":"about:blank","title":"Conflict","status":409,"code":"not_allowed","detail":"no",
            "state":"ACTIVE","allowed":["hold"]}"#;
        let refusal = exchange.answer(409, body).unwrap_err();
        assert_eq!(
            (refusal.code, refusal.text.as_str(), refusal.state),
            (RefusalCode::NotAllowed, "no", Some(Execution::Active))
        );
        assert_eq!(refusal.allowed, [Verb::Hold]);
        let refusal = exchange.answer(502, "<html>").unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable);
    }

    #[test]
    fn a_claim_that_does_not_count_is_a_result_and_no_error() {
        let reset = reset_of(&BootId("b".into()), 7, "h", None);
        let exchange = Exchange::of(Request::Reset(1, None, reset)).unwrap();
        let body = r#"{"status":409,"code":"not_owner","detail":"another handler owns it"}"#;
        let result = HandshakeResult {
            seq: 7,
            handler_id: "h".into(),
            status: HandshakeStatus::NotOwner,
        };
        assert_eq!(exchange.answer(409, body), Ok(Answer::Handshake(result)));
    }
}
