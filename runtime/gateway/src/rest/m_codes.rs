//! Auxiliary function outputs: claim, reset, progress, redelivery, questions to the operator. The path names the output, the body who and how.
//!
//! A claim or reset that counts, or counted before, answers 200 `{seq, handler_id, status}`; any other is 409 with
//! the status (`stale`, `unknown`, `not_owner`) as its code.

use std::sync::Arc;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use axum::routing::post;
use axum::{Extension, Router};
use plc_api::types::output::{
    Claim, HandshakeResult, HandshakeStatus, ProgressReport, Redeliver, Redelivery, Reset, ResetResult,
};
use plc_api::types::question::{Ask, OperatorAnswer};
use plc_api::types::request::typed;
use plc_api::types::{BootId, CoordinateSystemNumber};
use serde::Deserialize;
use serde_json::json;

use super::extract::{InPath, JsonBody};
use super::states::json_response;
use crate::access::User;
use crate::access::http::forbidden;
use crate::problem::Problem;
use crate::shared::{Shared, unexpected};

type OutputPath = InPath<(CoordinateSystemNumber, u64)>;

pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route("/cs/{cs}/m_codes/{seq}/claim", post(claim))
        .route("/cs/{cs}/m_codes/{seq}/reset", post(reset))
        .route("/cs/{cs}/m_codes/{seq}/progress", post(progress))
        .route("/cs/{cs}/m_codes/{seq}/redeliver", post(redeliver))
        .route("/cs/{cs}/m_codes/{seq}/ask", post(ask))
        .route("/cs/{cs}/m_codes/{seq}/answer", post(answer))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ClaimBody {
    boot_id: BootId,
    handler_id: String,
}

async fn claim(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath((cs, seq)): OutputPath,
    JsonBody(body): JsonBody<ClaimBody>,
) -> Result<Response, Problem> {
    user.speaks_as(&body.handler_id).map_err(forbidden)?;
    let claim = Claim {
        boot_id: body.boot_id,
        seq,
        handler_id: body.handler_id,
    };
    handshake(Some(shared.ask(typed::Claim(cs, None, claim)).await?))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ResetBody {
    boot_id: BootId,
    handler_id: String,
    result: ResetResult,
    code: Option<u16>,
    text: Option<String>,
    force: Option<bool>,
}

async fn reset(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath((cs, seq)): OutputPath,
    JsonBody(body): JsonBody<ResetBody>,
) -> Result<Response, Problem> {
    user.resets_as(&body.handler_id, body.force.unwrap_or(false))
        .map_err(forbidden)?;
    let reset = Reset {
        boot_id: body.boot_id,
        seq,
        handler_id: body.handler_id,
        result: body.result,
        code: body.code,
        text: body.text,
        force: body.force,
    };
    handshake(Some(shared.ask(typed::Reset(cs, None, reset)).await?))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProgressBody {
    boot_id: BootId,
    handler_id: String,
    text: String,
    percent: Option<f64>,
}

async fn progress(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath((cs, seq)): OutputPath,
    JsonBody(body): JsonBody<ProgressBody>,
) -> Result<StatusCode, Problem> {
    user.speaks_as(&body.handler_id).map_err(forbidden)?;
    let report = ProgressReport {
        boot_id: body.boot_id,
        seq,
        handler_id: body.handler_id,
        text: body.text,
        percent: body.percent,
    };
    shared.ask(typed::Progress(cs, None, report)).await?;
    Ok(StatusCode::NO_CONTENT)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RedeliverBody {
    boot_id: BootId,
    how: Redelivery,
}

async fn redeliver(
    State(shared): State<Arc<Shared>>,
    InPath((cs, seq)): OutputPath,
    JsonBody(body): JsonBody<RedeliverBody>,
) -> Result<StatusCode, Problem> {
    let redeliver = Redeliver {
        boot_id: body.boot_id,
        seq,
        how: body.how,
    };
    shared.ask(typed::Redeliver(cs, None, redeliver)).await?;
    Ok(StatusCode::NO_CONTENT)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AskBody {
    boot_id: BootId,
    handler_id: String,
    question_id: String,
    #[serde(default)]
    text: String,
    #[serde(default)]
    choices: Vec<String>,
}

async fn ask(
    State(shared): State<Arc<Shared>>,
    InPath((cs, seq)): OutputPath,
    JsonBody(body): JsonBody<AskBody>,
) -> Result<Response, Problem> {
    let ask = Ask {
        boot_id: body.boot_id,
        seq,
        handler_id: body.handler_id,
        question_id: body.question_id,
        text: body.text,
        choices: body.choices,
    };
    handshake(shared.ask(typed::Ask(cs, None, ask)).await?)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnswerBody {
    boot_id: BootId,
    question_id: String,
    choice: String,
    client_id: Option<String>,
}

/// An operator's answer to a question. One that counts, or was given before, answers 200.
async fn answer(
    State(shared): State<Arc<Shared>>,
    InPath((cs, seq)): OutputPath,
    JsonBody(body): JsonBody<AnswerBody>,
) -> Result<Response, Problem> {
    let answer = OperatorAnswer {
        boot_id: body.boot_id,
        seq,
        question_id: body.question_id,
        choice: body.choice,
        client_id: body.client_id,
    };
    let answered = shared.ask(typed::AnswerQuestion(cs, None, answer)).await?;
    if answered.as_ref().map(|result| result.status) == Some(HandshakeStatus::Unknown) {
        let text = format!("output {seq} asks no such question, or the choice is none of its choices");
        return Err(Problem::new(StatusCode::CONFLICT, "unknown", text));
    }
    handshake(answered)
}

fn handshake(answer: Option<HandshakeResult>) -> Result<Response, Problem> {
    let result = answer.ok_or_else(unexpected)?;
    let (code, text) = match result.status {
        HandshakeStatus::Accepted | HandshakeStatus::Duplicate => return Ok(json_response(&json!(result))),
        HandshakeStatus::Stale => (
            "stale",
            "it was cancelled, failed, timed out, or belongs to another boot",
        ),
        HandshakeStatus::Unknown => ("unknown", "this boot never made it"),
        HandshakeStatus::NotOwner => ("not_owner", "another handler owns it"),
    };
    let HandshakeResult { seq, .. } = result;
    Err(Problem::new(
        StatusCode::CONFLICT,
        code,
        format!("output {seq}: {text}; nothing was changed"),
    ))
}
