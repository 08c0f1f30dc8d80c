//! The program store. Texts are UTF-8, as they are.

use std::sync::Arc;

use axum::Router;
use axum::extract::{Request as HttpRequest, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use plc_api::types::request::typed::{
    CheckProgram, DeleteProgram, IntermediateCode, Programs, ReadProgram, WriteProgram,
};
use serde_json::json;

use super::extract::{InPath, media_type, read_body};
use super::states::json_response;
use crate::problem::Problem;
use crate::shared::Shared;

/// Bytes of a program's text; more is 413.
const PROGRAM_MAX: usize = 64 * 1024 * 1024;

pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route("/programs", get(list))
        .route("/programs/{number}", get(read).put(write).delete(remove))
        .route("/programs/{number}/check", post(check))
        .route("/programs/{number}/intermediate", get(intermediate))
}

async fn list(State(shared): State<Arc<Shared>>) -> Result<Response, Problem> {
    let programs = shared.ask(Programs).await?;
    Ok(json_response(&json!({ "programs": programs })))
}

async fn read(State(shared): State<Arc<Shared>>, InPath(number): InPath<u16>) -> Result<Response, Problem> {
    Ok(text_of(shared.ask(ReadProgram(number)).await?))
}

async fn intermediate(
    State(shared): State<Arc<Shared>>,
    InPath(number): InPath<u16>,
) -> Result<Response, Problem> {
    // as large as an upload
    let _permit = shared.uploads.acquire().await;
    Ok(text_of(shared.ask(IntermediateCode(number)).await?))
}

fn text_of(text: String) -> Response {
    let kind = HeaderValue::from_static("text/plain; charset=utf-8");
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

/// 201 when new, else 200, both with `{diagnostics, m_codes, programs}`; stored even with errors.
async fn write(
    State(shared): State<Arc<Shared>>,
    InPath(number): InPath<u16>,
    request: HttpRequest,
) -> Result<Response, Problem> {
    let kind = media_type(request.headers());
    // the last one is what curl says of --data-binary when it is told nothing else
    let is_text = kind.is_none_or(|kind| {
        kind.starts_with("text/")
            || ["application/octet-stream", "application/x-www-form-urlencoded"].contains(&kind.as_str())
    });
    if !is_text {
        return Err(Problem::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "unsupported_media_type",
            "send the program's text with Content-Type: text/plain",
        ));
    }
    let _permit = shared.uploads.acquire().await;
    let bytes = read_body(request, PROGRAM_MAX).await?;
    let text = String::from_utf8(bytes).map_err(|error| {
        let place = error.utf8_error().valid_up_to();
        Problem::invalid(format!(
            "the text is not UTF-8 at byte {place}; save the program as UTF-8"
        ))
    })?;
    let check = shared.ask(WriteProgram(number, text)).await?;
    let mut response = json_response(&json!(check));
    if check.created {
        *response.status_mut() = StatusCode::CREATED;
    }
    Ok(response)
}

async fn remove(
    State(shared): State<Arc<Shared>>,
    InPath(number): InPath<u16>,
) -> Result<StatusCode, Problem> {
    shared.ask(DeleteProgram(number)).await?;
    Ok(StatusCode::NO_CONTENT)
}

async fn check(State(shared): State<Arc<Shared>>, InPath(number): InPath<u16>) -> Result<Response, Problem> {
    let check = shared.ask(CheckProgram(number)).await?;
    Ok(json_response(&json!(check)))
}
