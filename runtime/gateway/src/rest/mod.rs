//! REST: a route for everything that can be read or requested.

mod body;
mod documents;
mod login;
mod query;
mod requests;
mod states;

use std::sync::Arc;

use axum::extract::rejection::RawPathParamsRejection;
use axum::extract::{RawPathParams, State};
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, MethodRouter};
use axum::{Extension, Router};
use plc_protocol::wire::parameter::Fault;
use plc_protocol::wire::row::check_path;

use crate::contract::routes::{ROUTES, Serves};
use crate::problem::Problem;
use crate::server_state::ServerState;

/// Returns the routes, without their common path prefix.
pub(crate) fn routes() -> Router<Arc<ServerState>> {
    let mut router = Router::new()
        .merge(states::own_routes())
        .merge(documents::routes());
    for (path, places) in ROUTES.iter() {
        let mut methods = MethodRouter::new();
        for (route, serves) in places {
            let filter = match route.method {
                "GET" => MethodFilter::GET,
                "PUT" => MethodFilter::PUT,
                "DELETE" => MethodFilter::DELETE,
                _ => MethodFilter::POST,
            };
            methods = match *serves {
                Serves::Request(row) => {
                    let serve = move |State(shared), Extension(user), request| {
                        requests::serve(shared, user, row, route, request)
                    };
                    methods.on(filter, serve)
                }
                Serves::State(row) => methods.on(filter, move |shared, uri, params| {
                    states::one(shared, uri, params, row)
                }),
                Serves::Own(_) => continue,
            };
        }
        if places.iter().any(|(_, serves)| !matches!(serves, Serves::Own(_))) {
            router = router.route(path, methods);
        }
    }
    router
}

/// Returns the names in a path with their values; an invalid value is 404.
fn params<'a>(
    raw: &'a Result<RawPathParams, RawPathParamsRejection>,
    uri: &Uri,
) -> Result<Vec<(&'a str, &'a str)>, Problem> {
    let params: Option<Vec<_>> = raw.as_ref().ok().map(|raw| raw.iter().collect());
    let params = params.filter(|params| check_path(params));
    params.ok_or_else(|| nothing_at(uri))
}

fn nothing_at(uri: &Uri) -> Problem {
    Problem::not_found(format!("there is nothing at {}", uri.path()))
}

/// Returns the response to a malformed request.
fn problem_of(fault: Fault, uri: &Uri) -> Problem {
    match fault {
        Fault::Level(_) => nothing_at(uri),
        Fault::NotFound(text) => Problem::not_found(text),
        Fault::Json(error) => Problem::invalid(format!("the JSON body is invalid: {error}")),
        Fault::Invalid(text) => Problem::invalid(text),
    }
}

/// Returns a JSON answer.
fn json_response(status: StatusCode, text: String) -> Response {
    let kind = HeaderValue::from_static("application/json");
    (status, [(header::CONTENT_TYPE, kind)], text).into_response()
}
