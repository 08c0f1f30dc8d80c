//! Variables, tools and work offsets: `GET` reads, `PUT` sets what it names, 204 when it counts.

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use axum::routing::get;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::data::{Number, ToolChange, VariableArea, VariableValues, WorkOffsetTable};
use plc_api::types::request::typed::{
    self, Journal, ReadVariables, WorkOffsets, WriteTools, WriteVariables, WriteWorkOffsets,
};
use serde::Deserialize;
use serde_json::json;

use super::extract::{InPath, InQuery, JsonBody};
use super::states::json_response;
use crate::problem::Problem;
use crate::shared::Shared;

pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route("/variables/p", get(read_p).put(write_p))
        .route("/cs/{cs}/variables/q", get(read_q).put(write_q))
        .route("/tools", get(tools).put(write_tools))
        .route("/cs/{cs}/last_run", get(last_run))
        .route("/journal", get(journal))
        .route("/cs/{cs}/work_offsets", get(work_offsets).put(write_work_offsets))
}

/// `?from=&count=`: number of the first variable, 0 where none is named, and how many, 1 where none is named for `GET`
/// and the number of values for `PUT`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Range {
    #[serde(default)]
    from: u32,
    count: Option<u32>,
}

/// Body of `PUT`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Values {
    values: Vec<Number>,
}

type Answered<T> = Result<T, Problem>;

async fn read_p(State(shared): State<Arc<Shared>>, InQuery(range): InQuery<Range>) -> Answered<Response> {
    read(&shared, VariableArea::Global, &range).await
}

async fn write_p(
    State(shared): State<Arc<Shared>>,
    InQuery(range): InQuery<Range>,
    JsonBody(values): JsonBody<Values>,
) -> Answered<StatusCode> {
    write(&shared, VariableArea::Global, &range, values).await
}

async fn read_q(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    InQuery(range): InQuery<Range>,
) -> Answered<Response> {
    read(&shared, VariableArea::CoordinateSystem(cs), &range).await
}

async fn write_q(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    InQuery(range): InQuery<Range>,
    JsonBody(values): JsonBody<Values>,
) -> Answered<StatusCode> {
    write(&shared, VariableArea::CoordinateSystem(cs), &range, values).await
}

async fn read(shared: &Shared, area: VariableArea, range: &Range) -> Answered<Response> {
    let request = ReadVariables {
        area,
        from: range.from,
        count: range.count.unwrap_or(1),
        meta: None,
    };
    let values = shared.ask(request).await?;
    let values = VariableValues::new(area.kind(), range.from, values);
    Ok(json_response(&json!(values)))
}

async fn write(shared: &Shared, area: VariableArea, range: &Range, body: Values) -> Answered<StatusCode> {
    if let Some(count) = range.count.filter(|count| *count as usize != body.values.len()) {
        let text = format!("count={count}, and the body has {} values", body.values.len());
        return Err(Problem::invalid(text));
    }
    let request = WriteVariables {
        area,
        from: range.from,
        values: body.values.into_iter().map(|number| number.0).collect(),
        meta: None,
    };
    shared.ask(request).await?;
    Ok(StatusCode::NO_CONTENT)
}

async fn tools(State(shared): State<Arc<Shared>>) -> Answered<Response> {
    Ok(json_response(&json!(shared.ask(typed::Tools).await?)))
}

async fn write_tools(
    State(shared): State<Arc<Shared>>,
    JsonBody(change): JsonBody<ToolChange>,
) -> Answered<StatusCode> {
    shared.ask(WriteTools(change)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// `{"last_run": {...}}`, or null where there was none before this start.
async fn last_run(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
) -> Answered<Response> {
    let last_run = shared.ask(typed::LastRun(cs)).await?;
    Ok(json_response(&json!({ "last_run": last_run })))
}

/// Lines where none is named.
const JOURNAL_LINES: u32 = 100;

/// `?from=&count=`: how many of the newest lines are left out, and how many are told, 100 where none is named.
async fn journal(State(shared): State<Arc<Shared>>, InQuery(range): InQuery<Range>) -> Answered<Response> {
    let request = Journal {
        from: range.from,
        count: range.count.unwrap_or(JOURNAL_LINES),
    };
    let lines = shared.ask(request).await?;
    Ok(json_response(&json!({ "lines": lines })))
}

async fn work_offsets(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
) -> Answered<Response> {
    Ok(json_response(&json!(shared.ask(WorkOffsets(cs)).await?)))
}

async fn write_work_offsets(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    JsonBody(change): JsonBody<WorkOffsetTable>,
) -> Answered<StatusCode> {
    shared.ask(WriteWorkOffsets(cs, change)).await?;
    Ok(StatusCode::NO_CONTENT)
}
