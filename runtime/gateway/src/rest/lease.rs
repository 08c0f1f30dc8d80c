//! The control lease: `POST` takes and renews it, `DELETE` gives it back, `POST .../break` ends that of another.

use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use axum::routing::post;
use axum::{Extension, Router};
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::CommandStatus;
use plc_api::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use plc_api::types::request::typed::Lease;
use serde_json::{Value, json};

use super::commands::{fence, meta};
use super::extract::{InPath, JsonBody};
use super::states::json_response;
use crate::access::User;
use crate::problem::Problem;
use crate::shared::Shared;

pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route("/cs/{cs}/lease", post(take).delete(release))
        .route("/cs/{cs}/lease/break", post(end))
}

async fn take(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    headers: HeaderMap,
    JsonBody(take): JsonBody<LeaseTake>,
) -> Result<Response, Problem> {
    ask(&shared, &user, cs, &headers, LeaseRequest::Take(take)).await
}

async fn release(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let fence = fence(&headers)?
        .ok_or_else(|| Problem::invalid("name the lease that is given back by the header Lease-Fence"))?;
    let release = LeaseRequest::Release(LeaseRelease { fence });
    ask(&shared, &user, cs, &headers, release).await
}

async fn end(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    headers: HeaderMap,
    JsonBody(_): JsonBody<Value>,
) -> Result<Response, Problem> {
    ask(&shared, &user, cs, &headers, LeaseRequest::Break).await
}

async fn ask(
    shared: &Shared,
    user: &User,
    cs: CoordinateSystemNumber,
    headers: &HeaderMap,
    request: LeaseRequest,
) -> Result<Response, Problem> {
    let meta = meta(shared, user, headers)?;
    let reply = shared.ask(Lease { cs, request, meta }).await?;
    if reply.status == CommandStatus::Rejected {
        return Err(Problem::of_reply(&reply));
    }
    Ok(json_response(&json!(reply)))
}
