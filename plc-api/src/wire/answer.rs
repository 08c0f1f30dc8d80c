//! Answers as REST carries them, written by the server end and read by the client transport.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::problem::Problem;
use crate::types::command::{CommandReply, CommandStatus};
use crate::types::data::{LastRun, VariableKind, VariableValues};
use crate::types::machine::AlarmRecord;
use crate::types::output::{HandlerPresence, HandshakeResult, HandshakeStatus};
use crate::types::program::{ProgramCheck, ProgramInfo};
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::Answer;

/// How the answer of a request crosses REST.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "each variant is the answer of the same name")]
pub enum AnswerForm {
    Nothing,
    /// With `wait` the reply of a command that is done, else its id.
    Command {
        wait: bool,
    },
    Lease,
    /// How far a command is.
    Status,
    /// With what a result names that is none of the machine's.
    Handshake {
        seq: u64,
        handler_id: String,
        is_answer: bool,
    },
    /// With what the request named.
    Variables {
        kind: VariableKind,
        from: u32,
    },
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

/// An answer as it goes out.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// 204.
    Nothing,
    /// Status and JSON.
    Json(u16, String),
    /// Plain text.
    Text(String),
    /// 202: a command is accepted; where to ask for the rest is named by its id.
    Accepted(String),
}

#[derive(Serialize, Deserialize)]
struct Programs {
    programs: Vec<ProgramInfo>,
}

#[derive(Serialize, Deserialize)]
struct LastRuns {
    last_run: Option<LastRun>,
}

#[derive(Serialize, Deserialize)]
struct Lines {
    lines: Vec<Value>,
}

#[derive(Serialize, Deserialize)]
struct Handlers {
    handlers: BTreeMap<String, HandlerPresence>,
}

#[derive(Serialize, Deserialize)]
struct Alarms {
    alarms: Vec<AlarmRecord>,
}

#[derive(Serialize, Deserialize)]
struct Accepted {
    command_id: String,
}

impl AnswerForm {
    /// The answer as it goes out.
    ///
    /// # Errors
    /// The problem that it is on REST, such as a claim that does not count; an answer that is not of this form is one, too.
    pub fn encode(&self, answer: Answer) -> Result<Reply, Box<Problem>> {
        let json = |value: Value| Ok(Reply::Json(200, value.to_string()));
        match (self, answer) {
            (AnswerForm::Nothing, _) => Ok(Reply::Nothing),
            (AnswerForm::Command { wait }, Answer::Command(reply)) => match reply.status {
                CommandStatus::Rejected | CommandStatus::Failed => Err(Problem::of_reply(&reply).into()),
                CommandStatus::Done if *wait => json(json!(reply)),
                CommandStatus::Done | CommandStatus::Accepted => Ok(Reply::Accepted(reply.command_id)),
            },
            (AnswerForm::Lease, Answer::Command(reply)) if reply.status == CommandStatus::Rejected => {
                Err(Problem::of_reply(&reply).into())
            }
            (AnswerForm::Lease | AnswerForm::Status, Answer::Command(reply)) => json(json!(reply)),
            (AnswerForm::Handshake { is_answer, .. }, Answer::Handshake(result)) => {
                match handshake_problem(&result, *is_answer) {
                    None => json(json!(result)),
                    Some(problem) => Err(problem.into()),
                }
            }
            (AnswerForm::Variables { kind, from }, Answer::Variables(values)) => {
                json(json!(VariableValues::new(*kind, *from, values)))
            }
            (AnswerForm::Tools, Answer::Tools(table)) => json(json!(table)),
            (AnswerForm::WorkOffsets, Answer::WorkOffsets(table)) => json(json!(table)),
            (AnswerForm::LastRun, Answer::LastRun(last_run)) => json(json!(LastRuns { last_run })),
            (AnswerForm::Journal, Answer::Journal(lines)) => json(json!(Lines { lines })),
            (AnswerForm::Programs, Answer::Programs(programs)) => json(json!(Programs { programs })),
            (AnswerForm::ProgramText, Answer::ProgramText(text)) => Ok(Reply::Text(text)),
            (AnswerForm::Check, Answer::Check(check)) => {
                let status = if check.created { 201 } else { 200 };
                Ok(Reply::Json(status, json!(check).to_string()))
            }
            (AnswerForm::Handlers, Answer::Handlers(handlers)) => json(json!(Handlers { handlers })),
            (AnswerForm::Alarms, Answer::Alarms(alarms)) => json(json!(Alarms { alarms })),
            _ => Err(Problem::unexpected().into()),
        }
    }

    /// What an HTTP answer says.
    ///
    /// # Errors
    /// The refusal that it carries.
    pub fn decode(&self, status: u16, body: &str) -> Result<Answer, Refusal> {
        if !(200..300).contains(&status) {
            return self.refused(status, body);
        }
        Ok(match self {
            AnswerForm::Nothing => Answer::Done,
            // 200 carries the reply; 202 only the id of a command that has been accepted
            AnswerForm::Command { .. } if status == 202 => {
                let Accepted { command_id } = read(body)?;
                Answer::Command(CommandReply {
                    command_id,
                    status: CommandStatus::Accepted,
                    code: "ok".to_owned(),
                    text: String::new(),
                    state_rev: 0,
                    variables: None,
                    lease: None,
                })
            }
            AnswerForm::Command { .. } | AnswerForm::Lease | AnswerForm::Status => {
                Answer::Command(read(body)?)
            }
            AnswerForm::Handshake { .. } => Answer::Handshake(read(body)?),
            AnswerForm::Variables { .. } => Answer::Variables(read::<VariableValues>(body)?.numbers()),
            AnswerForm::Tools => Answer::Tools(read(body)?),
            AnswerForm::WorkOffsets => Answer::WorkOffsets(read(body)?),
            AnswerForm::LastRun => Answer::LastRun(read::<LastRuns>(body)?.last_run),
            AnswerForm::Journal => Answer::Journal(read::<Lines>(body)?.lines),
            AnswerForm::ProgramText => Answer::ProgramText(body.to_owned()),
            AnswerForm::Check => Answer::Check(ProgramCheck {
                created: status == 201,
                ..read(body)?
            }),
            AnswerForm::Programs => Answer::Programs(read::<Programs>(body)?.programs),
            AnswerForm::Handlers => Answer::Handlers(read::<Handlers>(body)?.handlers),
            AnswerForm::Alarms => Answer::Alarms(read::<Alarms>(body)?.alarms),
        })
    }

    fn refused(&self, status: u16, body: &str) -> Result<Answer, Refusal> {
        let problem: Problem = serde_json::from_str(body)
            .unwrap_or_else(|_| Problem::new(status, "", format!("HTTP status {status}")));
        if let AnswerForm::Handshake { seq, handler_id, .. } = self
            && let Ok(status) = serde_json::from_value(json!(problem.code))
        {
            return Ok(Answer::Handshake(HandshakeResult {
                seq: *seq,
                handler_id: handler_id.clone(),
                status,
            }));
        }
        Err(problem.refusal(status))
    }
}

impl Reply {
    /// The body that a command's id is answered with.
    pub fn accepted_body(command_id: &str) -> String {
        json!({ "command_id": command_id }).to_string()
    }
}

/// A claim or reset that counts, or counted before, is answered by its result; any other is a problem with the status as
/// its code.
fn handshake_problem(result: &HandshakeResult, is_answer: bool) -> Option<Problem> {
    let seq = result.seq;
    let (code, text) = match result.status {
        HandshakeStatus::Accepted | HandshakeStatus::Duplicate => return None,
        HandshakeStatus::Unknown if is_answer => {
            let text = format!("output {seq} asks no such question, or the choice is none of its choices");
            return Some(Problem::new(409, "unknown", text));
        }
        HandshakeStatus::Stale => (
            "stale",
            "it was cancelled, failed, timed out, or belongs to another boot",
        ),
        HandshakeStatus::Unknown => ("unknown", "this boot never made it"),
        HandshakeStatus::NotOwner => ("not_owner", "another handler owns it"),
    };
    let text = format!("output {seq}: {text}; nothing was changed");
    Some(Problem::new(409, code, text))
}

fn read<T: DeserializeOwned>(body: &str) -> Result<T, Refusal> {
    serde_json::from_str(body).map_err(|error| {
        let text = format!("the machine's answer is not of the route's form: {error}");
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
    fn an_accepted_command_is_answered_with_its_id_and_a_done_one_with_its_reply() {
        let Ok(Answer::Command(reply)) = COMMAND.decode(202, &Reply::accepted_body("c")) else {
            panic!("no reply")
        };
        assert_eq!(
            (reply.command_id.as_str(), reply.status),
            ("c", CommandStatus::Accepted)
        );
        let done = r#"{"command_id":"c","status":"done","code":"ok","text":"","state_rev":4}"#;
        let Ok(Answer::Command(reply)) = COMMAND.decode(200, done) else {
            panic!("no reply")
        };
        assert_eq!((reply.status, reply.state_rev), (CommandStatus::Done, 4));
    }

    #[test]
    fn a_problem_is_the_refusal_that_it_was() {
        let body = r#"{"type":"about:blank","title":"Conflict","status":409,"code":"not_allowed","detail":"no",
            "state":"ACTIVE","allowed":["hold"]}"#;
        let refusal = COMMAND.decode(409, body).unwrap_err();
        assert_eq!(
            (refusal.code, refusal.text.as_str(), refusal.state),
            (RefusalCode::NotAllowed, "no", Some(Execution::Active))
        );
        assert_eq!(refusal.allowed, [Verb::Hold]);
        let refusal = COMMAND.decode(502, "<html>").unwrap_err();
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
        ] {
            let answer = Answer::Handshake(HandshakeResult {
                seq: 7,
                handler_id: "h".into(),
                status,
            });
            let problem = form.encode(answer.clone()).unwrap_err();
            let body = serde_json::to_string(&problem).unwrap();
            assert_eq!(form.decode(problem.status, &body), Ok(answer));
        }
    }
}
