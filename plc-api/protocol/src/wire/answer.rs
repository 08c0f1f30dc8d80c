//! Answers as REST transmits them: written by the server end, read by the client transport.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::problem::Problem;
use crate::types::command::{CommandReply, CommandStatus};
use crate::types::data::{LastRun, VariableKind, VariableValues};
use crate::types::machine::AlarmRecord;
use crate::types::output::{HandlerPresence, HandshakeResult, HandshakeStatus};
use crate::types::planned::PlannedPath;
use crate::types::program::{ProgramCheck, ProgramInfo, ProgramText};
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::{Answer, Request};

/// Form of a request's answer over REST.
#[derive(Debug, Clone)]
pub enum AnswerForm {
    /// A status without content.
    Nothing,
    /// Answer to a command: with `wait` the reply to the completed command, otherwise the id of the command.
    Command {
        /// True if the answer waits for the effect of the command.
        wait: bool,
    },
    /// The reply to a command that has started a run; the run is a new resource with its own address.
    Started,
    /// The reply to a request for the control lease.
    Lease,
    /// Result of a claim or reset. The fields are those of the request that a rejection does not contain.
    Handshake {
        /// Sequence number of the output.
        seq: u64,
        /// Sender of the claim or reset.
        handler_id: String,
        /// True if the request is an operator's answer to a question.
        is_answer: bool,
    },
    /// Values of variables; the fields are the range in the request.
    Variables {
        /// Letter of the variables.
        kind: VariableKind,
        /// Number of the first variable.
        from: u32,
    },
    /// Plain text: intermediate code, or the text of a program without its hash.
    Text,
    /// Text of a program, with its hash as `ETag`.
    Program,
    /// A planned path, with its tag as `ETag`.
    Path,
    /// Result of a check of a program; the status shows whether the program is new.
    Check,
    /// JSON of the answer's type.
    Json {
        /// Encodes the answer; returns `None` for an answer of another type.
        encode: fn(Answer) -> Option<Value>,
        /// Decodes the answer.
        decode: fn(&str) -> Result<Answer, Refusal>,
    },
}

/// Returns the form of an answer that is JSON of the type `T`.
pub(super) fn json_of<T>(_: &Request) -> AnswerForm
where
    T: TryFrom<Answer> + Into<Answer> + Serialize + DeserializeOwned,
{
    AnswerForm::Json {
        encode: |answer| T::try_from(answer).ok().map(|answer| json!(answer)),
        decode: |body| read::<T>(body).map(Into::into),
    }
}

/// An HTTP answer, ready for sending.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// Status 204 without content.
    Nothing,
    /// The status, and JSON as the body.
    Json(u16, String),
    /// A body of plain text.
    Text(String),
    /// Text of a program, with its hash.
    Program(ProgramText),
    /// Bytes of a planned path, with its tag.
    Bytes(PlannedPath),
    /// The status, the result of the check as JSON, and the hash of the stored program.
    Stored(u16, String, String),
    /// Status 201: JSON of the reply, and the address of the new resource.
    Created(String, String),
    /// Status 202: a command is accepted. The id of the command is part of the address of its status. A load
    /// and a start also have the hash of the program.
    Accepted(String, Option<String>),
}

/// Defines bodies of answers that contain the value of the answer in one field of an object.
macro_rules! in_a_field {
    ($($name:ident { $field:ident: $type:ty $(, $schema:meta)? })*) => {$(
        #[derive(Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub(super) struct $name {
            $(#[cfg_attr(feature = "schema", $schema)])?
            $field: $type,
        }

        impl TryFrom<Answer> for $name {
            type Error = Answer;

            fn try_from(answer: Answer) -> Result<Self, Answer> {
                Ok(Self { $field: answer.try_into()? })
            }
        }

        impl From<$name> for Answer {
            fn from(answer: $name) -> Self {
                answer.$field.into()
            }
        }
    )*};
}

in_a_field! {
    ProgramList { programs: Vec<ProgramInfo> }
    HandlerList { handlers: BTreeMap<String, HandlerPresence> }
    AlarmHistory { alarms: Vec<AlarmRecord> }
    LastRunAnswer { last_run: Option<LastRun> }
    JournalAnswer { lines: Vec<Value>, schemars(with = "Vec<JournalLine>") }
}

/// A line of the journal, with the fields of its event.
#[cfg(feature = "schema")]
#[derive(schemars::JsonSchema)]
#[schemars(inline, extend("additionalProperties" = true))]
#[allow(dead_code, reason = "the form of lines that are passed on unchanged")]
struct JournalLine {
    /// Time of the event.
    #[schemars(extend("format" = "date-time"))]
    ts: Option<String>,
    /// Seconds since the start of the runtime.
    t_s: Option<f64>,
    /// Coordinate system.
    cs: Option<u8>,
    /// Name of the event.
    event: String,
}

/// The answer to an accepted command.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "CommandAccepted"))]
pub(super) struct AcceptedCommand {
    command_id: String,
    /// Hash of the program that is loaded or started; only for `load` and `start`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    hash: Option<String>,
}

impl AnswerForm {
    /// Encodes an answer for sending.
    ///
    /// # Errors
    /// Returns the problem to send if the answer is a refusal on REST, such as a rejected claim, or does not
    /// have this form.
    pub fn encode(&self, answer: Answer) -> Result<Reply, Box<Problem>> {
        let json = |value: Value| Ok(Reply::Json(200, value.to_string()));
        match (self, answer) {
            (AnswerForm::Nothing, _) => Ok(Reply::Nothing),
            (AnswerForm::Command { wait }, Answer::Command(reply)) => match reply.status {
                CommandStatus::Rejected | CommandStatus::Failed => Err(Problem::of_reply(&reply).into()),
                CommandStatus::Done if *wait => json(json!(reply)),
                CommandStatus::Done | CommandStatus::Accepted => {
                    Ok(Reply::Accepted(reply.command_id, reply.hash))
                }
            },
            (AnswerForm::Started, Answer::Command(reply)) => match reply.status {
                CommandStatus::Rejected | CommandStatus::Failed => Err(Problem::of_reply(&reply).into()),
                CommandStatus::Done | CommandStatus::Accepted => {
                    let route = format!("/runs/{}", reply.run_id.as_deref().unwrap_or_default());
                    Ok(Reply::Created(json!(reply).to_string(), route))
                }
            },
            (AnswerForm::Lease, Answer::Command(reply)) if reply.status == CommandStatus::Rejected => {
                Err(Problem::of_reply(&reply).into())
            }
            (AnswerForm::Lease, Answer::Command(reply)) => json(json!(reply)),
            (AnswerForm::Handshake { is_answer, .. }, Answer::Handshake(result)) => {
                match handshake_problem(&result, *is_answer) {
                    None => json(json!(result)),
                    Some(problem) => Err(problem.into()),
                }
            }
            (AnswerForm::Variables { kind, from }, Answer::Variables(values)) => {
                json(json!(VariableValues::new(*kind, *from, values)))
            }
            (AnswerForm::Text, Answer::ProgramText(text)) => Ok(Reply::Text(text)),
            (AnswerForm::Text, Answer::Program(program)) => Ok(Reply::Text(program.text)),
            (AnswerForm::Program, Answer::Program(program)) => Ok(Reply::Program(program)),
            (AnswerForm::Path, Answer::Path(path)) => Ok(Reply::Bytes(path)),
            (AnswerForm::Check, Answer::Check(check)) => {
                let status = if check.created { 201 } else { 200 };
                let body = json!(check).to_string();
                Ok(Reply::Stored(status, body, check.hash))
            }
            (AnswerForm::Json { encode, .. }, answer) => {
                encode(answer).map_or_else(|| Err(Problem::unexpected().into()), json)
            }
            _ => Err(Problem::unexpected().into()),
        }
    }

    /// Decodes an HTTP answer. `etag` is the value of its header `ETag`, or empty.
    ///
    /// # Errors
    /// Fails with the refusal that the answer contains.
    pub fn decode(&self, status: u16, etag: &str, body: Vec<u8>) -> Result<Answer, Refusal> {
        if !(200..300).contains(&status) {
            return self.refused(status, &String::from_utf8_lossy(&body));
        }
        if matches!(self, AnswerForm::Path) {
            let tag = etag.trim_matches('"').to_owned();
            return Ok(Answer::Path(PlannedPath::new(tag, body)));
        }
        let body = String::from_utf8(body).map_err(|_| {
            let text = "the answer of the machine does not have the form of the route: it is not UTF-8 text";
            Refusal::new(RefusalCode::Unavailable, text)
        })?;
        let body = body.as_str();
        Ok(match self {
            AnswerForm::Nothing | AnswerForm::Path => Answer::Done,
            // 200 contains the reply of the completed command; 202 contains only the id of an accepted
            // command
            AnswerForm::Command { .. } if status == 202 => {
                let AcceptedCommand { command_id, hash } = read(body)?;
                Answer::Command(CommandReply {
                    command_id,
                    status: CommandStatus::Accepted,
                    code: "ok".to_owned(),
                    text: String::new(),
                    state_rev: 0,
                    variables: None,
                    lease: None,
                    hash,
                    run_id: None,
                    moved: BTreeMap::new(),
                })
            }
            AnswerForm::Command { .. } | AnswerForm::Started | AnswerForm::Lease => {
                Answer::Command(read(body)?)
            }
            AnswerForm::Handshake { .. } => Answer::Handshake(read(body)?),
            AnswerForm::Variables { .. } => Answer::Variables(read::<VariableValues>(body)?.numbers()),
            AnswerForm::Text => Answer::ProgramText(body.to_owned()),
            AnswerForm::Program => Answer::Program(ProgramText {
                text: body.to_owned(),
                hash: etag.trim_matches('"').to_owned(),
            }),
            AnswerForm::Check => Answer::Check(ProgramCheck {
                created: status == 201,
                ..read(body)?
            }),
            AnswerForm::Json { decode, .. } => decode(body)?,
        })
    }

    fn refused(&self, status: u16, body: &str) -> Result<Answer, Refusal> {
        let problem: Problem = serde_json::from_str(body)
            .unwrap_or_else(|_| Problem::new(status, "", format!("HTTP status {status}")));
        if let AnswerForm::Handshake { seq, handler_id, .. } = self
            && let Ok(status) = serde_json::from_value(json!(problem.code))
        {
            return Ok(Answer::Handshake(HandshakeResult::new(
                *seq,
                handler_id.clone(),
                status,
            )));
        }
        if let (AnswerForm::Command { .. } | AnswerForm::Started, Some(reply)) = (self, &problem.reply) {
            // the command was accepted and failed later, so this is not a refusal
            return Ok(Answer::Command(CommandReply::clone(reply)));
        }
        Err(problem.refusal(status))
    }
}

impl Reply {
    /// Returns the body of the answer to an accepted command.
    pub fn accepted_body(command_id: &str, hash: Option<&str>) -> String {
        json!(AcceptedCommand {
            command_id: command_id.to_owned(),
            hash: hash.map(str::to_owned),
        })
        .to_string()
    }
}

/// Returns the problem of a rejected claim or reset, whose status becomes the code of the problem. Returns
/// `None` if the claim or reset is accepted now or was accepted earlier.
fn handshake_problem(result: &HandshakeResult, is_answer: bool) -> Option<Problem> {
    let seq = result.seq;
    let (code, text) = match result.status {
        HandshakeStatus::Accepted | HandshakeStatus::Duplicate => return None,
        HandshakeStatus::Unknown if is_answer => {
            let text = format!("output {seq} has no such question, or the question has no such choice");
            return Some(Problem::new(409, "unknown", text));
        }
        HandshakeStatus::Stale => (
            "stale",
            "it was cancelled, failed, timed out, or belongs to another boot",
        ),
        HandshakeStatus::Unknown => ("unknown", "this boot has not issued it"),
        HandshakeStatus::NotOwner => (
            "not_owner",
            result.text.as_deref().unwrap_or("another handler owns it"),
        ),
        HandshakeStatus::Withheld => (
            "withheld",
            result
                .text
                .as_deref()
                .unwrap_or("its handler was lost, and an operator decides"),
        ),
        HandshakeStatus::Refused => ("invalid", result.text.as_deref().unwrap_or("invalid message")),
    };
    let text = format!("output {seq}: {text}; nothing was changed");
    Some(Problem::new(409, code, text))
}

fn read<T: DeserializeOwned>(body: &str) -> Result<T, Refusal> {
    serde_json::from_str(body).map_err(|error| {
        let text = format!("the answer of the machine does not have the form of the route: {error}");
        Refusal::new(RefusalCode::Unavailable, text)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::execution::Execution;
    use crate::types::verb::Verb;

    const COMMAND: AnswerForm = AnswerForm::Command { wait: true };

    #[test]
    fn accepted_command_returns_its_id_and_a_done_command_its_reply() {
        let Ok(Answer::Command(reply)) =
            COMMAND.decode(202, "", Reply::accepted_body("c", None).into_bytes())
        else {
            panic!("no reply")
        };
        assert_eq!(
            (reply.command_id.as_str(), reply.status),
            ("c", CommandStatus::Accepted)
        );
        let done = r#"{"command_id":"c","status":"done","code":"ok","text":"","state_rev":4}"#;
        let Ok(Answer::Command(reply)) = COMMAND.decode(200, "", done.into()) else {
            panic!("no reply")
        };
        assert_eq!((reply.status, reply.state_rev), (CommandStatus::Done, 4));
    }

    #[test]
    fn a_problem_is_the_refusal_that_it_was() {
        let body = r#"{"type":"about:blank","title":"Conflict","status":409,"code":"not_allowed","detail":"no",
            "state":"ACTIVE","allowed":["hold"]}"#;
        let refusal = COMMAND.decode(409, "", body.into()).unwrap_err();
        assert_eq!(
            (refusal.code, refusal.text.as_str(), refusal.state),
            (RefusalCode::NotAllowed, "no", Some(Execution::Active))
        );
        assert_eq!(refusal.allowed, [Verb::Hold]);
        let refusal = COMMAND.decode(502, "", "<html>".into()).unwrap_err();
        assert_eq!(
            (refusal.code, refusal.text.as_str()),
            (RefusalCode::Unavailable, "HTTP status 502")
        );
    }

    #[test]
    fn a_claim_that_does_not_count_is_a_result_and_no_error() {
        let form = AnswerForm::Handshake {
            seq: 7,
            handler_id: "h".into(),
            is_answer: false,
        };
        for status in [
            HandshakeStatus::NotOwner,
            HandshakeStatus::Stale,
            HandshakeStatus::Unknown,
            HandshakeStatus::Withheld,
        ] {
            let answer = Answer::Handshake(HandshakeResult::new(7, "h", status));
            let problem = form.encode(answer.clone()).unwrap_err();
            let body = serde_json::to_string(&problem).unwrap();
            assert_eq!(form.decode(problem.status, "", body.into_bytes()), Ok(answer));
        }
    }
}
