//! The documents of the interface, which tests keep equal to its types and tables.

use std::sync::Arc;

use axum::Router;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use crate::shared::Shared;

const OPENAPI: &str = include_str!("../../api/openapi.json");
const ASYNCAPI: &str = include_str!("../../api/asyncapi.json");

pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route("/openapi.json", get(|| async { document(OPENAPI) }))
        .route("/asyncapi.json", get(|| async { document(ASYNCAPI) }))
}

fn document(text: &'static str) -> Response {
    let kind = HeaderValue::from_static("application/json");
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}
