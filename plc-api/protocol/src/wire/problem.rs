//! Refusals over HTTP: problem details (RFC 9457) with a machine-readable `code`.

use serde::{Deserialize, Serialize};

use crate::types::command::{CommandReply, CommandStatus};
use crate::types::execution::Execution;
use crate::types::program::ProgramDiagnostic;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::verb::Verb;

/// A refusal over HTTP.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
pub struct Problem {
    /// Always `about:blank`, because the HTTP status gives the type of the problem.
    #[serde(rename = "type")]
    pub kind: String,
    /// Name of the HTTP status.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// Machine-readable reason: a [`RefusalCode`] or a code of the server.
    pub code: String,
    /// Description, reason and remedy.
    pub detail: String,
    /// If the reason is the state: the current state of the coordinate system.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Execution>,
    /// If the reason is the state: the commands that the state allows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allowed: Vec<Verb>,
    /// If the reason is errors in a program: the findings of the check.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub diagnostics: Vec<ProgramDiagnostic>,
    /// If a command was accepted and then failed: the reply of the command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reply: Option<Box<CommandReply>>,
    /// If the program belongs to a run that has not ended: the id of the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run_id: Option<String>,
}

impl Problem {
    /// Creates a problem with this status; the server adds the name of the status.
    pub fn new(status: u16, code: impl Into<String>, detail: impl Into<String>) -> Self {
        Self {
            kind: "about:blank".to_owned(),
            status,
            code: code.into(),
            detail: detail.into(),
            ..Self::default()
        }
    }

    /// Creates the problem of a malformed request or a value out of its range.
    pub fn invalid(detail: impl Into<String>) -> Self {
        Self::from(Refusal::new(RefusalCode::Invalid, detail))
    }

    /// Creates the problem of an object that does not exist.
    pub fn not_found(detail: impl Into<String>) -> Self {
        Self::from(Refusal::new(RefusalCode::NotFound, detail))
    }

    /// Creates the problem of a command that was accepted and then failed, or of a repeated command that was
    /// refused earlier.
    pub fn of_reply(reply: &CommandReply) -> Self {
        let status = code_of_word(&reply.code).map_or(409, status_of);
        Self {
            reply: (reply.status == CommandStatus::Failed).then(|| Box::new(reply.clone())),
            ..Self::new(status, reply.code.as_str(), reply.text.as_str())
        }
    }

    /// Creates the problem of an answer that does not match its request: a fault of the port.
    pub fn unexpected() -> Self {
        let text = "the answer of the machine does not match the request; this is a fault of the runtime, please report it";
        Self::new(500, "unexpected_answer", text)
    }

    /// Returns the refusal that this problem contains; `status` is the HTTP status of the answer.
    pub(super) fn refusal(self, status: u16) -> Refusal {
        let code = code_of_word(&self.code).unwrap_or(match status {
            404 => RefusalCode::NotFound,
            413 => RefusalCode::TooLarge,
            400..500 => RefusalCode::Invalid,
            _ => RefusalCode::Unavailable,
        });
        Refusal {
            state: self.state,
            allowed: self.allowed,
            diagnostics: self.diagnostics,
            run_id: self.run_id,
            ..Refusal::new(code, self.detail)
        }
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        Self {
            state: refusal.state,
            allowed: refusal.allowed,
            diagnostics: refusal.diagnostics,
            run_id: refusal.run_id,
            ..Self::new(status_of(refusal.code), code_word(refusal.code), refusal.text)
        }
    }
}

/// Returns the word for a code in replies and problems.
pub fn code_word(code: RefusalCode) -> String {
    match serde_json::to_value(code) {
        Ok(serde_json::Value::String(word)) => word,
        _ => "unavailable".to_owned(),
    }
}

/// Returns the code for a word in replies and problems.
pub(super) fn code_of_word(word: &str) -> Option<RefusalCode> {
    serde_json::from_value(word.into()).ok()
}

fn status_of(code: RefusalCode) -> u16 {
    match code {
        RefusalCode::NotFound => 404,
        RefusalCode::Forbidden => 403,
        RefusalCode::NotAllowed
        | RefusalCode::ProgramRuns
        | RefusalCode::StartLocked
        | RefusalCode::Busy
        | RefusalCode::LeaseLost
        | RefusalCode::HandlerTaken => 409,
        RefusalCode::PreconditionFailed | RefusalCode::Expired => 412,
        RefusalCode::ProgramHasErrors
        | RefusalCode::NotSigned
        | RefusalCode::LineRefused
        | RefusalCode::WrongDialect
        | RefusalCode::CommandIdReused => 422,
        RefusalCode::Invalid | RefusalCode::Retained => 400,
        RefusalCode::TooLarge => 413,
        RefusalCode::NotSupported => 501,
        RefusalCode::Unavailable => 503,
        RefusalCode::NoAnswer => 504,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_keeps_its_state_and_what_is_allowed() {
        let refusal = Refusal {
            state: Some(Execution::Active),
            allowed: vec![Verb::Hold, Verb::Stop],
            ..Refusal::new(RefusalCode::NotAllowed, "a program runs")
        };
        let problem = Problem::from(refusal.clone());
        assert_eq!(
            serde_json::to_value(&problem).unwrap(),
            serde_json::json!({
                "type": "about:blank", "title": "", "status": 409, "code": "not_allowed",
                "detail": "a program runs", "state": "ACTIVE", "allowed": ["hold", "stop"],
            })
        );
        assert_eq!(problem.refusal(409), refusal);
    }

    #[test]
    fn every_code_has_the_status_that_the_interface_names() {
        let table = [
            (RefusalCode::NotFound, 404),
            (RefusalCode::Forbidden, 403),
            (RefusalCode::NotAllowed, 409),
            (RefusalCode::ProgramRuns, 409),
            (RefusalCode::StartLocked, 409),
            (RefusalCode::Busy, 409),
            (RefusalCode::LeaseLost, 409),
            (RefusalCode::HandlerTaken, 409),
            (RefusalCode::PreconditionFailed, 412),
            (RefusalCode::ProgramHasErrors, 422),
            (RefusalCode::NotSigned, 422),
            (RefusalCode::LineRefused, 422),
            (RefusalCode::WrongDialect, 422),
            (RefusalCode::CommandIdReused, 422),
            (RefusalCode::Invalid, 400),
            (RefusalCode::TooLarge, 413),
            (RefusalCode::NotSupported, 501),
            (RefusalCode::Expired, 412),
            (RefusalCode::Unavailable, 503),
            (RefusalCode::NoAnswer, 504),
        ];
        for (code, status) in table {
            assert_eq!(status_of(code), status, "{code:?}");
            assert_eq!(code_of_word(&code_word(code)), Some(code));
        }
    }
}
