//! REST: `/api/v1`, one route for each thing that can be read or asked.

mod commands;
mod data;
mod documents;
mod extract;
mod inputs;
mod lease;
mod m_codes;
mod programs;
mod states;

use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::Response;

use crate::problem::Problem;
use crate::shared::Shared;
use crate::{access, hmi, origin, websocket};

/// Path before all routes of the interface.
pub(crate) const API: &str = "/api/v1";

/// Everything that is served over HTTP.
pub(crate) fn router(shared: Arc<Shared>) -> Router {
    let api = Router::new()
        .merge(states::routes())
        .merge(commands::routes())
        .merge(inputs::routes())
        .merge(lease::routes())
        .merge(data::routes())
        .merge(m_codes::routes())
        .merge(programs::routes())
        .merge(documents::routes())
        .merge(websocket::routes())
        .fallback(nothing_there)
        .layer(middleware::from_fn_with_state(
            Arc::clone(&shared),
            access::http::guard,
        ))
        .layer(middleware::map_response(no_store));
    Router::new()
        .nest(API, api)
        .merge(hmi::routes())
        .method_not_allowed_fallback(wrong_method)
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), origin::guard))
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), count))
        .layer(middleware::map_response(hmi::security_headers))
        .with_state(shared)
}

async fn nothing_there(uri: Uri) -> Problem {
    Problem::not_found(format!("there is nothing at {}", uri.path()))
}

async fn wrong_method(method: Method, uri: Uri) -> Problem {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "method_not_allowed",
        format!(
            "{method} is not for {}; the Allow header says what is",
            uri.path()
        ),
    )
}

async fn no_store(mut response: Response) -> Response {
    response
        .headers_mut()
        .insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

async fn count(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    shared.metrics.count_response(response.status().as_u16());
    response
}
