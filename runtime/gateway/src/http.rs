//! The router of everything served over HTTP: the interface below `/api/v1`, and the HMI.

use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{Method, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use tandem_mtconnect::Agent;

use crate::contract::routes::API;
use crate::problem::Problem;
use crate::shared::Shared;
use crate::{access, hmi, hmi_dir, mqtt_socket, mtconnect, origin, rest, server, websocket};

/// Everything that is served over HTTP.
pub(crate) fn router(shared: Arc<Shared>, mtconnect: Option<&Agent>) -> Router {
    let api = rest::routes()
        .merge(websocket::routes())
        .fallback(nothing_there)
        .layer(middleware::from_fn_with_state(
            Arc::clone(&shared),
            access::guard::guard,
        ))
        .layer(middleware::map_response(no_store));
    let mut all = Router::new()
        .nest(API, api)
        .merge(mtconnect::routes(mtconnect, &shared))
        .merge(mqtt_socket::routes(shared.entrance.as_ref()))
        .merge(hmi_dir::routes(shared.hmi.dir.as_deref()))
        .merge(hmi::routes())
        .method_not_allowed_fallback(wrong_method);
    let others = shared.access.origins();
    if !others.is_empty() {
        all = all.layer(origin::shared_with(others));
    }
    all.layer(middleware::from_fn_with_state(Arc::clone(&shared), origin::guard))
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), count))
        .layer(middleware::from_fn_with_state(
            Arc::clone(&shared),
            server::hold_place,
        ))
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

async fn no_store(response: Response) -> impl IntoResponse {
    ([(header::CACHE_CONTROL, "no-store")], response)
}

async fn count(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    shared.metrics.count_response(response.status().as_u16());
    response
}
