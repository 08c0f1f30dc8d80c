//! `/login`: a token for a person who types a name and a PIN.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;

use axum::Extension;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use plc_protocol::server::{AccessKind, ServerTransport};
use plc_protocol::wire::json_object;
use plc_protocol::wire::login::{CurrentUser, Login, LoginRequest};
use serde_json::json;
use tracing::{info, warn};

use super::{body, json_response};
use crate::access::AuthenticatedUser;
use crate::access::http::{token, too_many};
use crate::access::login::{LOGIN_MAX, LoginRefusal};
use crate::problem::Problem;
use crate::server::Peer;
use crate::server_state::ServerState;

/// Logs a person in.
pub(super) async fn log_in(
    State(shared): State<Arc<ServerState>>,
    request: Request,
) -> Result<Response, Problem> {
    let Some(users) = shared.access.users() else {
        let text =
            "this machine has no token file: every user of this computer has all rights without a login";
        return Err(Problem::not_found(text));
    };
    // a request without a connection comes from a test of the router
    let from = request
        .extensions()
        .get::<Peer>()
        .map_or(IpAddr::V4(Ipv4Addr::LOCALHOST), |peer| peer.address);
    let (head, body) = request.into_parts();
    let body = body::json(&head.headers, body).await?;
    let said: LoginRequest = json_object(&body).map_err(|error| {
        Problem::invalid(format!("write {{\"user\": \"anna\", \"pin\": \"...\"}}: {error}"))
    })?;
    let logged_in = users
        .logins
        .log_in(&users.tokens.now(), &said.user, said.pin, from)
        .await;
    let note = |what| {
        let (user, over) = (Some(said.user.as_str()), ServerTransport::Rest);
        (shared.machine).record_access(what, user, Some(from), over, "POST /login".to_owned());
    };
    let (token, user) = logged_in.map_err(|refused| {
        note(AccessKind::LoginRefused);
        warn!(
            "login of {:.64} from {from} refused: {refused:?}",
            said.user.escape_debug()
        );
        match refused {
            LoginRefusal::Wrong => {
                let text = "there is no such user with this PIN";
                Problem::new(StatusCode::UNAUTHORIZED, "unauthorized", text)
            }
            LoginRefusal::Wait(wait) => too_many(wait),
            LoginRefusal::Busy => {
                let text = "other users are logging in; try again";
                Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text)
            }
        }
    })?;
    let name = user.name().unwrap_or_default().to_owned();
    info!("{name} has logged in from {from}");
    note(AccessKind::Login);
    let answer = Login {
        token,
        user: name,
        role: user.role().name(),
        expires_s: LOGIN_MAX.as_secs(),
    };
    Ok(json_response(StatusCode::OK, json!(answer).to_string()))
}

/// Returns the user of the request.
pub(super) async fn current_user(Extension(shown): Extension<AuthenticatedUser>) -> Response {
    let answer = CurrentUser {
        user: shown.user.name().map(str::to_owned),
        role: shown.user.role().name(),
        is_login: shown.is_login(),
    };
    json_response(StatusCode::OK, json!(answer).to_string())
}

/// Ends the login whose token the request carries.
pub(super) async fn log_out(
    State(shared): State<Arc<ServerState>>,
    request: Request,
) -> Result<Response, Problem> {
    let shown = token(request.headers()).unwrap_or_default();
    let users = shared.access.users();
    if users.is_some_and(|users| users.logins.log_out(shown)) {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    Err(Problem::not_found(
        "this token does not belong to a login; remove its entry from the token file",
    ))
}
