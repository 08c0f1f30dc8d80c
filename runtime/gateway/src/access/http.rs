//! Access over HTTP: the user of a request, from its `Authorization: Bearer TOKEN`. Browsers cannot set that header on a
//! WebSocket, so there the token may be the sub-protocol `bearer.TOKEN`, next to `tandem.v1`, which the server selects.

use std::time::Duration;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};

use super::{Rate, Rates, Shown, User, Users};
use crate::problem::Problem;
use crate::tls::Fingerprint;

/// Sub-protocol of our WebSocket.
pub(crate) const WEBSOCKET_PROTOCOL: &str = "tandem.v1";

/// Prefix of a token among sub-protocols.
const TOKEN_PROTOCOL: &str = "bearer.";

/// Requests of one user: burst, and rate per second; more are 429.
const USER_BURST: u32 = 1000;
const USER_PER_SECOND: u32 = 500;

/// The same for hold, stop and abort, so that a flood of others holds up none of them.
const URGENT_BURST: u32 = 1000;
const URGENT_PER_SECOND: u32 = 500;

/// The same for all requests with a wrong token or none together; they never delay valid ones.
const WRONG_BURST: u32 = 50;
const WRONG_PER_SECOND: u32 = 10;

/// Identifies users and limits their requests.
#[derive(Debug)]
pub(crate) struct Access {
    users: Option<Users>,
    // by user name
    rates: Rates<String>,
    // the same for hold, stop and abort, beside all others
    urgent: Rates<String>,
    wrong: Rate,
    // pages of these origins may use the server, besides its own
    origins: Vec<HeaderValue>,
}

impl Access {
    /// Without users everyone who reaches the server is `admin`.
    pub(crate) fn new(users: Option<Users>) -> Self {
        Self {
            rates: Rates::new(USER_BURST, USER_PER_SECOND),
            urgent: Rates::new(URGENT_BURST, URGENT_PER_SECOND),
            users,
            wrong: Rate::new(WRONG_BURST, WRONG_PER_SECOND),
            origins: Vec::new(),
        }
    }

    /// The same, open to pages of these origins.
    pub(crate) fn open_to(self, origins: &[String]) -> Self {
        let origins = origins.iter().filter_map(|origin| origin.parse().ok()).collect();
        Self { origins, ..self }
    }

    /// Origins whose pages may use the server, besides its own.
    pub(crate) fn origins(&self) -> &[HeaderValue] {
        &self.origins
    }

    /// Whether a request comes from a user.
    pub(crate) fn knows(&self, headers: &HeaderMap, certificate: Option<&Fingerprint>) -> bool {
        let is_of_user = |users: &Users| users.who(token(headers), certificate).is_some();
        self.users.as_ref().is_none_or(is_of_user)
    }

    /// The user of a request. Hold, stop and abort, which are urgent, have a rate of their own.
    pub(crate) fn user(
        &self,
        headers: &HeaderMap,
        certificate: Option<&Fingerprint>,
        is_urgent: bool,
    ) -> Result<Shown, Problem> {
        let Some(users) = &self.users else {
            return Ok(User::Anyone.into());
        };
        let Some(shown) = users.who(token(headers), certificate) else {
            return Err(match self.wrong.take() {
                Ok(()) => Problem::new(
                    StatusCode::UNAUTHORIZED,
                    "unauthorized",
                    "this needs a token; send it as Authorization: Bearer TOKEN",
                ),
                Err(wait) => too_many(wait),
            });
        };
        let name = shown.user.name().unwrap_or_default().to_owned();
        let rates = if is_urgent { &self.urgent } else { &self.rates };
        rates.of(&name).take().map_err(too_many)?;
        Ok(shown)
    }

    /// The users; `None` if no token is needed.
    pub(crate) fn users(&self) -> Option<&Users> {
        self.users.as_ref()
    }
}

pub(crate) fn too_many(wait: Duration) -> Problem {
    let text = format!("too many requests; send it again in {} ms", wait.as_millis() + 1);
    Problem::new(StatusCode::TOO_MANY_REQUESTS, "too_many_requests", text).retry_after(wait)
}

/// The refusal of a known user.
pub(crate) fn forbidden(text: String) -> Problem {
    Problem::new(StatusCode::FORBIDDEN, "forbidden", text)
}

/// The token of a request. Two tokens count as none.
pub(crate) fn token(headers: &HeaderMap) -> Option<&[u8]> {
    let mut authorizations = headers.get_all(header::AUTHORIZATION).iter();
    let mut protocols = headers
        .get_all(header::SEC_WEBSOCKET_PROTOCOL)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .filter_map(|protocol| protocol.trim().strip_prefix(TOKEN_PROTOCOL));
    match (
        authorizations.next(),
        authorizations.next(),
        protocols.next(),
        protocols.next(),
    ) {
        (Some(value), None, None, None) => {
            let (scheme, token) = value.to_str().ok()?.split_once(' ')?;
            scheme
                .eq_ignore_ascii_case("bearer")
                .then_some(token.trim().as_bytes())
        }
        (None, None, Some(token), None) => Some(token.as_bytes()),
        _ => None,
    }
}
