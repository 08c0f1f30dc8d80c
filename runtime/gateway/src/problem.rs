//! Refusals over HTTP: problem details (RFC 9457) with a machine-readable `code`.

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use plc_api::types::command::{CommandReply, Verb};
use plc_api::types::program::ProgramDiagnostic;
use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::state::Execution;
use serde::Serialize;

/// A refusal as HTTP says it. Boxed, since it is the rare way out of every handler.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub(crate) struct Problem(Box<Details>);

/// What a [`Problem`] says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Details {
    #[serde(rename = "type")]
    kind: &'static str,
    title: &'static str,
    status: u16,
    /// Machine-readable.
    code: String,
    /// What, why, and what to do.
    detail: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    state: Option<Execution>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    allowed: Vec<Verb>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    diagnostics: Vec<ProgramDiagnostic>,
}

impl Problem {
    pub(crate) fn new(status: StatusCode, code: impl Into<String>, detail: impl Into<String>) -> Self {
        Self(Box::new(Details {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Problem"),
            status: status.as_u16(),
            code: code.into(),
            detail: detail.into(),
            state: None,
            allowed: Vec::new(),
            diagnostics: Vec::new(),
        }))
    }

    /// Status number and code, for tests.
    #[cfg(test)]
    pub(crate) fn status_and_code(&self) -> (u16, &str) {
        (self.0.status, &self.0.code)
    }

    pub(crate) fn not_found(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", detail)
    }

    pub(crate) fn invalid(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "invalid", detail)
    }

    /// Of a command that was accepted and then failed, or was refused before under the same id.
    pub(crate) fn of_reply(reply: &CommandReply) -> Self {
        let status = code_of_word(&reply.code).map_or(StatusCode::CONFLICT, status_of);
        Self::new(status, reply.code.clone(), reply.text.clone())
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        let mut problem = Self::new(status_of(refusal.code), code_word(refusal.code), refusal.text);
        problem.0.state = refusal.state;
        problem.0.allowed = refusal.allowed;
        problem.0.diagnostics = refusal.diagnostics;
        problem
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let body = serde_json::to_string(&self).unwrap_or_else(|_| "{}".to_owned());
        let mut response = Response::new(Body::from(body));
        *response.status_mut() =
            StatusCode::from_u16(self.0.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let status = response.status();
        let headers = response.headers_mut();
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/problem+json"),
        );
        if status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if status == StatusCode::PAYLOAD_TOO_LARGE {
            // what is left of the body is not read, so nothing can follow it
            headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
        }
        response
    }
}

/// The word of a code as it stands in replies and problems.
pub(crate) fn code_word(code: RefusalCode) -> String {
    match serde_json::to_value(code) {
        Ok(serde_json::Value::String(word)) => word,
        _ => "unavailable".to_owned(),
    }
}

fn code_of_word(word: &str) -> Option<RefusalCode> {
    serde_json::from_value(serde_json::Value::String(word.to_owned())).ok()
}

fn status_of(code: RefusalCode) -> StatusCode {
    match code {
        RefusalCode::NotFound => StatusCode::NOT_FOUND,
        RefusalCode::NotAllowed
        | RefusalCode::ProgramRuns
        | RefusalCode::StartLocked
        | RefusalCode::Busy
        | RefusalCode::LeaseLost => StatusCode::CONFLICT,
        RefusalCode::PreconditionFailed | RefusalCode::Expired => StatusCode::PRECONDITION_FAILED,
        RefusalCode::ProgramHasErrors | RefusalCode::CommandIdReused => StatusCode::UNPROCESSABLE_ENTITY,
        RefusalCode::Invalid | RefusalCode::Retained => StatusCode::BAD_REQUEST,
        RefusalCode::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
        RefusalCode::NotSupported => StatusCode::NOT_IMPLEMENTED,
        RefusalCode::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
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
        let value = serde_json::to_value(Problem::from(refusal)).unwrap();
        assert_eq!(
            value,
            serde_json::json!({
                "type": "about:blank", "title": "Conflict", "status": 409, "code": "not_allowed",
                "detail": "a program runs", "state": "ACTIVE", "allowed": ["hold", "stop"],
            })
        );
    }

    #[test]
    fn a_missing_token_says_which_scheme_and_a_body_too_large_ends_the_connection() {
        let header = |status, name| {
            let response = Problem::new(status, "code", "detail").into_response();
            response.headers().get(name).cloned()
        };
        let unauthorized = header(StatusCode::UNAUTHORIZED, header::WWW_AUTHENTICATE);
        assert_eq!(unauthorized.unwrap(), "Bearer");
        let large = header(StatusCode::PAYLOAD_TOO_LARGE, header::CONNECTION);
        assert_eq!(large.unwrap(), "close");
        assert_eq!(header(StatusCode::CONFLICT, header::CONNECTION), None);
    }

    #[test]
    fn every_code_has_the_status_that_the_interface_names() {
        let table = [
            (RefusalCode::NotFound, 404),
            (RefusalCode::NotAllowed, 409),
            (RefusalCode::ProgramRuns, 409),
            (RefusalCode::StartLocked, 409),
            (RefusalCode::Busy, 409),
            (RefusalCode::LeaseLost, 409),
            (RefusalCode::PreconditionFailed, 412),
            (RefusalCode::ProgramHasErrors, 422),
            (RefusalCode::CommandIdReused, 422),
            (RefusalCode::Invalid, 400),
            (RefusalCode::TooLarge, 413),
            (RefusalCode::NotSupported, 501),
            (RefusalCode::Expired, 412),
            (RefusalCode::Unavailable, 503),
        ];
        for (code, status) in table {
            assert_eq!(status_of(code).as_u16(), status, "{code:?}");
            assert_eq!(code_of_word(&code_word(code)), Some(code));
        }
    }
}
