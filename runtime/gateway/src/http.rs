//! The router of all HTTP paths: the interface below `/api/v1`, and the HMI.

use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{Method, StatusCode, Uri};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use tandem_mtconnect::Agent;

use crate::connection_slots::host_of;
use crate::contract::routes::API;
use crate::problem::Problem;
use crate::server::Peer;
use crate::server_state::ServerState;
use crate::{access, hmi, hmi_dir, mqtt_socket, mtconnect, origin, rest, server, websocket};

/// Creates the router of all HTTP paths.
pub(crate) fn router(shared: Arc<ServerState>, mtconnect: Option<&Agent>) -> Router {
    let api = rest::routes()
        .merge(websocket::routes())
        .fallback(nothing_there)
        .layer(middleware::from_fn_with_state(
            Arc::clone(&shared),
            access::guard::guard,
        ));
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
    all.layer(middleware::from_fn_with_state(Arc::clone(&shared), enter))
        .with_state(shared)
}

/// Common steps of all requests: a slot for the connection, checks of Host and Origin, counting of responses, headers
/// for browsers. They are one layer, because each layer costs every request half a microsecond.
async fn enter(State(shared): State<Arc<ServerState>>, request: Request, next: Next) -> Response {
    let place = server::hold_slot(&shared, &request);
    let refusing = place.as_ref().filter(|place| !place.is_served());
    let mut response = if let Some(place) = refusing {
        place.refusal().into_response()
    } else {
        let host = request
            .extensions()
            .get::<Peer>()
            .map(|peer| host_of(peer.address));
        let response = match origin::admit(&shared, &request) {
            Ok(()) => next.run(request).await,
            Err(problem) => problem.into_response(),
        };
        let response = shared.unread.count(host, response).await;
        shared.metrics.count_response(response.status().as_u16());
        response
    };
    if let Some(place) = place {
        place.answered(&mut response);
    }
    hmi::add_security_headers(&mut response);
    response
}

async fn nothing_there(uri: Uri) -> Problem {
    Problem::not_found(format!("there is nothing at {}", uri.path()))
}

async fn wrong_method(method: Method, uri: Uri) -> Problem {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "method_not_allowed",
        format!(
            "{method} is not allowed for {}; the Allow header lists the allowed methods",
            uri.path()
        ),
    )
}
