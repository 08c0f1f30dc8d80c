//! Admits a request to its route if its user has the right for it.

use std::net::IpAddr;
use std::sync::Arc;

use axum::body::HttpBody;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use plc_protocol::server::{AccessKind, ServerTransport};
use plc_protocol::wire::right::Right;

use super::activity::is_activity;
use super::http::{Access, forbidden, token};
use super::{AuthenticatedUser, User};
use crate::certificate::ClientCertificate;
use crate::contract::routes::{API, RouteMatch, find};
use crate::problem::Problem;
use crate::server::{Peer, certificate_of, is_urgent};
use crate::server_state::ServerState;

/// Admits requests only to routes of the table, and only from users with the right. Handlers find the [`User`] and its
/// [`Shown`] credentials in the request's extensions. Responses must not be cached.
pub(crate) async fn guard(
    State(shared): State<Arc<ServerState>>,
    mut request: Request,
    next: Next,
) -> Response {
    let path = request.extensions().get::<MatchedPath>().cloned();
    let path = path.as_ref().map(MatchedPath::as_str);
    let certificate = certificate_of(request.extensions());
    let from = request.extensions().get::<Peer>().map(|peer| peer.address);
    let mut response = match admit(&shared.access, path, &request, (certificate, from)) {
        Ok(shown) => {
            if is_activity(request.method(), path) {
                shown.be_active();
            }
            if path.is_some_and(|path| is_urgent(request.method(), path)) {
                let access = &shared.access;
                let delay = access.urgent_delay(&shown.user, from, request.uri().path());
                tokio::time::sleep(delay).await;
            }
            let user = shown.user.clone();
            request.extensions_mut().insert(user.clone());
            request.extensions_mut().insert(shown);
            let response = next.run(request).await;
            // a body without an exact size is read from a file
            let bytes = response.body().size_hint().exact().unwrap_or(0);
            // if these bytes exceed the user's rate, the user's next requests are rejected for a time (429)
            shared.access.count_bytes(&user, bytes);
            response
        }
        Err(refused) => {
            if let Some((what, user)) = refused.noted {
                let from = request.extensions().get::<Peer>().map(|peer| peer.address);
                let route = format!("{} {}", request.method(), request.uri().path());
                let machine = &shared.machine;
                machine.record_access(what, user.as_deref(), from, ServerTransport::Rest, route);
            }
            refused.response
        }
    };
    let no_store = HeaderValue::from_static("no-store");
    response.headers_mut().insert(header::CACHE_CONTROL, no_store);
    response
}

/// Admits a request outside the table of routes, if it only reads and its user may do so.
pub(crate) async fn guard_reading(
    State(shared): State<Arc<ServerState>>,
    request: Request,
    next: Next,
) -> Response {
    let certificate = certificate_of(request.extensions());
    let from = request.extensions().get::<Peer>().map(|peer| peer.address);
    match shared.access.user(request.headers(), (certificate, from), false) {
        Ok(shown) if shown.user.has(Right::Read) => next.run(request).await,
        Ok(_) => forbidden("this user may not read".to_owned()).into_response(),
        Err(problem) => problem.into_response(),
    }
}

/// A rejected request.
struct Rejection {
    response: Response,
    /// The journal entry: the kind of access and the user.
    noted: Option<(AccessKind, Option<String>)>,
}

impl Rejection {
    fn new(response: Response, noted: Option<(AccessKind, Option<String>)>) -> Box<Self> {
        Box::new(Self { response, noted })
    }
}

fn admit(
    access: &Access,
    path: Option<&str>,
    request: &Request,
    (certificate, from): (Option<&ClientCertificate>, Option<IpAddr>),
) -> Result<AuthenticatedUser, Box<Rejection>> {
    let (method, headers) = (request.method(), request.headers());
    let refuse = |problem: Problem| Rejection::new(problem.into_response(), None);
    let found = path
        .and_then(|path| path.strip_prefix(API))
        .map_or(RouteMatch::Nothing, |path| find(method, path));
    if matches!(found, RouteMatch::Route(None)) {
        return Ok(User::Unauthenticated.into());
    }
    let is_urgent = path.is_some_and(|path| is_urgent(method, path));
    if is_urgent && access.allows_stop_without_login() && !access.is_from_user(headers, certificate) {
        return access
            .authorize_anonymous_stop(from, request.uri().path())
            .map_err(refuse);
    }
    let shown = access
        .user(headers, (certificate, from), is_urgent)
        .map_err(|problem| {
            let response = problem.into_response();
            // a wrong token; a client without a token has not tried one
            let is_wrong = response.status() == StatusCode::UNAUTHORIZED && token(headers).is_some();
            Rejection::new(response, is_wrong.then_some((AccessKind::LoginRefused, None)))
        })?;
    let user = &shown.user;
    match found {
        RouteMatch::Route(right) if right.is_none_or(|right| user.has(right)) => Ok(shown),
        RouteMatch::Route(_) => {
            let text = format!("role {} may not {method} here", user.role().name());
            let noted = (AccessKind::Forbidden, user.name().map(str::to_owned));
            Err(Rejection::new(forbidden(text).into_response(), Some(noted)))
        }
        RouteMatch::OtherMethods(allowed) => {
            let text = format!("{method} is not allowed for this path; allowed: {allowed}");
            let problem = Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", text);
            Err(Rejection::new(
                ([(header::ALLOW, allowed)], problem).into_response(),
                None,
            ))
        }
        // a path without a route: the fallback answers 404
        RouteMatch::Nothing if path.is_none() => Ok(shown),
        RouteMatch::Nothing => Err(refuse(Problem::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "route_without_right",
            "this route is missing in the table of rights; this is a fault of the runtime, please report it",
        ))),
    }
}
