//! Inputs, overrides, spindle and tool: `PUT` sets, 204 when it counts.

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::put;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::request::{Input, OverrideChange, SpindleCommand, TypedRequest, typed};
use plc_api::types::state::{Lock, Tool};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::extract::{InPath, JsonBody};
use crate::problem::Problem;
use crate::shared::Shared;

/// Body of an input with one value.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Value {
    value: bool,
}

pub(super) fn routes() -> Router<Arc<Shared>> {
    let router = Router::new()
        .route("/cs/{cs}/inputs/optional_skip/{number}", put(optional_skip))
        .route("/motors/{number}/skip_input", put(skip_input));
    let router = set(router, "inputs/optional_stop", |cs, Value { value }| {
        typed::Input(cs, Input::OptionalStop(value))
    });
    let router = set(router, "inputs/single_block", |cs, Value { value }| {
        typed::Input(cs, Input::SingleBlock(value))
    });
    let router = set(router, "inputs/dry_run", |cs, Value { value }| {
        typed::Input(cs, Input::DryRun(value))
    });
    let router = set(router, "inputs/interlock", |cs, lock: Lock| {
        typed::Input(cs, Input::Interlock(lock))
    });
    let router = set(router, "inputs/start_lock", |cs, lock: Lock| {
        typed::Input(cs, Input::StartLock(lock))
    });
    let router = set(router, "overrides", |cs, change: OverrideChange| {
        typed::Input(cs, Input::Override(change))
    });
    let router = set(router, "spindle", |cs, command: SpindleCommand| {
        typed::Spindle(cs, command)
    });
    set(router, "tool", |cs, tool: Tool| typed::Tool(cs, tool.id))
}

/// Adds `PUT /cs/{cs}/{path}` with a body of type `T`.
fn set<T: DeserializeOwned + Send + 'static, R: TypedRequest + 'static>(
    router: Router<Arc<Shared>>,
    path: &str,
    request: fn(CoordinateSystemNumber, T) -> R,
) -> Router<Arc<Shared>> {
    let handler = move |State(shared): State<Arc<Shared>>,
                        InPath(cs): InPath<CoordinateSystemNumber>,
                        JsonBody(body): JsonBody<T>| async move {
        shared.ask(request(cs, body)).await?;
        Ok::<_, Problem>(StatusCode::NO_CONTENT)
    };
    router.route(&format!("/cs/{{cs}}/{path}"), put(handler))
}

async fn skip_input(
    State(shared): State<Arc<Shared>>,
    InPath(motor): InPath<u16>,
    JsonBody(Value { value }): JsonBody<Value>,
) -> Result<StatusCode, Problem> {
    shared.ask(typed::SkipInput(motor, value)).await?;
    Ok(StatusCode::NO_CONTENT)
}

async fn optional_skip(
    State(shared): State<Arc<Shared>>,
    InPath((cs, number)): InPath<(CoordinateSystemNumber, u8)>,
    JsonBody(Value { value }): JsonBody<Value>,
) -> Result<StatusCode, Problem> {
    if !(1..=31).contains(&number) {
        return Err(Problem::not_found(format!(
            "there is no optional block skip {number}; write 1 to 31"
        )));
    }
    let input = Input::OptionalSkip([(number, value)].into());
    shared.ask(typed::Input(cs, input)).await?;
    Ok(StatusCode::NO_CONTENT)
}
