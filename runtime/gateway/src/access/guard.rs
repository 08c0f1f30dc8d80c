//! Admits a request to its route if its user has the right for it.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::http::{Access, forbidden};
use super::{Shown, User};
use crate::contract::routes::{API, Found, find};
use crate::problem::Problem;
use crate::server::{certificate_of, is_urgent};
use crate::shared::Shared;
use crate::tls::Fingerprint;

/// Admits requests to routes of the table only, and only from users with the right. Handlers find the [`User`], and
/// what it has [`Shown`], in the request's extensions.
pub(crate) async fn guard(State(shared): State<Arc<Shared>>, mut request: Request, next: Next) -> Response {
    let path = request.extensions().get::<MatchedPath>().cloned();
    let path = path.as_ref().map(MatchedPath::as_str);
    let certificate = certificate_of(request.extensions());
    match admit(
        &shared.access,
        request.method(),
        path,
        request.headers(),
        certificate,
    ) {
        Ok(shown) => {
            request.extensions_mut().insert(shown.user.clone());
            request.extensions_mut().insert(shown);
            next.run(request).await
        }
        Err(refused) => *refused,
    }
}

fn admit(
    access: &Access,
    method: &Method,
    path: Option<&str>,
    headers: &HeaderMap,
    certificate: Option<&Fingerprint>,
) -> Result<Shown, Box<Response>> {
    let refuse = |problem: Problem| Box::new(problem.into_response());
    let found = path
        .and_then(|path| path.strip_prefix(API))
        .map_or(Found::Nothing, |path| find(method, path));
    if matches!(found, Found::Route(None)) {
        return Ok(User::Stranger.into());
    }
    let is_urgent = path.is_some_and(|path| is_urgent(method, path));
    let shown = access.user(headers, certificate, is_urgent).map_err(refuse)?;
    let user = &shown.user;
    match found {
        Found::Route(right) if right.is_none_or(|right| user.has(right)) => Ok(shown),
        Found::Route(_) => Err(refuse(forbidden(format!(
            "role {} may not {method} here",
            user.role().word()
        )))),
        Found::OtherMethods(allowed) => {
            let text = format!("{method} is not for this path; {allowed} are");
            let problem = Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", text);
            Err(Box::new(([(header::ALLOW, allowed)], problem).into_response()))
        }
        // a path without a route: the fallback answers 404
        Found::Nothing if path.is_none() => Ok(shown),
        Found::Nothing => Err(refuse(Problem::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "route_without_right",
            "this route stands in no table of rights; this is a fault of the runtime, please report it",
        ))),
    }
}
