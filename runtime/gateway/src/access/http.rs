//! Access over HTTP: the user of a request, from its `Authorization: Bearer TOKEN`. Browsers cannot set that header on a
//! WebSocket, so there the token may be the sub-protocol `bearer.TOKEN`, next to `tandem.v1`, which the server selects.

use std::net::IpAddr;
use std::time::Duration;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};

use super::{Account, AuthenticatedUser, Rate, Rates, User, Users};
use crate::problem::Problem;
use crate::tls::Fingerprint;

/// Sub-protocol of our WebSocket.
pub(crate) const WEBSOCKET_PROTOCOL: &str = "tandem.v1";

/// Prefix of a token among sub-protocols.
const TOKEN_PROTOCOL: &str = "bearer.";

/// Requests of one user: burst, and rate per second; more are 429.
const USER_BURST: u32 = 1000;
const USER_PER_SECOND: u32 = 500;

/// Rate of hold, stop and abort of one user, separate from other requests. Further ones are delayed, never rejected.
const URGENT_BURST: u32 = 1000;
const URGENT_PER_SECOND: u32 = 1000;

/// Holds, stops and aborts that one host requests without a login, if the settings allow them: burst, and
/// rate per second; more are 429. The limits are low because a person presses a button.
const STOP_BURST: u32 = 20;
const STOP_PER_SECOND: u32 = 5;

/// Bytes of the responses and frames for one user, in KiB: burst, and rate per second. Beyond it, requests are 429 and
/// frames wait, except for hold, stop and abort. Reason: to produce so much data can use a third of a processor core.
const USER_KIB_BURST: u32 = 128 * 1024;
const USER_KIB_PER_SECOND: u32 = 32 * 1024;

/// Rate of all requests together that have no token or a wrong one; they never delay valid ones.
const WRONG_BURST: u32 = 50;
const WRONG_PER_SECOND: u32 = 10;

/// Identifies users and limits their requests.
#[derive(Debug)]
pub(crate) struct Access {
    users: Option<Users>,
    // by user name
    rates: Rates<String>,
    // hold, stop and abort by user name, separate from other requests
    urgent: Rates<String>,
    wrong: Rate,
    // KiB for each user name
    kib: Rates<String>,
    // pages of these origins may use the server, in addition to its own
    origins: Vec<HeaderValue>,
    // every client that reaches the server may hold, stop and abort
    stop_without_login: bool,
    // holds, stops and aborts without a login, by host
    stops: Rates<Account>,
}

impl Access {
    /// Creates the access control. Without users, every client that reaches the server is `admin`.
    pub(crate) fn new(users: Option<Users>) -> Self {
        Self {
            rates: Rates::new(USER_BURST, USER_PER_SECOND),
            urgent: Rates::new(URGENT_BURST, URGENT_PER_SECOND),
            users,
            wrong: Rate::new(WRONG_BURST, WRONG_PER_SECOND),
            kib: Rates::new(USER_KIB_BURST, USER_KIB_PER_SECOND),
            origins: Vec::new(),
            stop_without_login: false,
            stops: Rates::new(STOP_BURST, STOP_PER_SECOND),
        }
    }

    /// Sets whether every client that reaches the server may hold, stop and abort.
    pub(crate) fn stop_without_login(self, stop_without_login: bool) -> Self {
        Self {
            stop_without_login,
            ..self
        }
    }

    /// Returns true if every client that reaches the server may hold, stop and abort.
    pub(crate) fn allows_stop_without_login(&self) -> bool {
        self.stop_without_login && self.users.is_some()
    }

    /// Counts a hold, stop or abort without a login.
    pub(crate) fn authorize_anonymous_stop(
        &self,
        from: Option<IpAddr>,
    ) -> Result<AuthenticatedUser, Problem> {
        let host = Account::named(None, from);
        self.stops.rate_for(&host).try_charge().map_err(too_many)?;
        Ok(User::Unidentified.into())
    }

    /// Allows access from pages of these origins.
    pub(crate) fn allow_origins(self, origins: &[String]) -> Self {
        let origins = origins.iter().filter_map(|origin| origin.parse().ok()).collect();
        Self { origins, ..self }
    }

    /// Returns the origins whose pages may use the server, in addition to its own.
    pub(crate) fn origins(&self) -> &[HeaderValue] {
        &self.origins
    }

    /// Returns true if a request comes from a user.
    pub(crate) fn is_from_user(&self, headers: &HeaderMap, certificate: Option<&Fingerprint>) -> bool {
        let is_of_user = |users: &Users| users.identify(token(headers), certificate).is_some();
        self.users.as_ref().is_none_or(is_of_user)
    }

    /// Returns the user of a request. Hold, stop and abort, which are urgent, have a rate of their own:
    /// [`Access::urgent_delay`].
    pub(crate) fn user(
        &self,
        headers: &HeaderMap,
        certificate: Option<&Fingerprint>,
        is_urgent: bool,
    ) -> Result<AuthenticatedUser, Problem> {
        let Some(users) = &self.users else {
            return Ok(User::Anyone.into());
        };
        let Some(shown) = users.identify(token(headers), certificate) else {
            return Err(match self.wrong.try_charge() {
                Ok(()) => Problem::new(
                    StatusCode::UNAUTHORIZED,
                    "unauthorized",
                    "this request needs a token; send the token as Authorization: Bearer TOKEN",
                ),
                Err(wait) => too_many(wait),
            });
        };
        if !is_urgent {
            let name = shown.user.name().unwrap_or_default().to_owned();
            self.kib.rate_for(&name).check().map_err(too_many)?;
            self.rates.rate_for(&name).try_charge().map_err(too_many)?;
        }
        Ok(shown)
    }

    /// Counts bytes that were produced for a user or read from it. Returns how long the user must wait before the next
    /// ones.
    pub(crate) fn count_bytes(&self, user: &User, bytes: u64) -> Duration {
        user.name().map_or(Duration::ZERO, |name| {
            self.kib
                .rate_for(&name.to_owned())
                .charge_many(bytes as f64 / 1024.0)
        })
    }

    /// Returns how long a hold, stop or abort of a user is delayed to keep to its rate.
    pub(crate) fn urgent_delay(&self, user: &User) -> Duration {
        match user.name() {
            Some(name) => self.urgent.rate_for(&name.to_owned()).charge(),
            None => Duration::ZERO,
        }
    }

    /// Returns the users; `None` if no token is needed.
    pub(crate) fn users(&self) -> Option<&Users> {
        self.users.as_ref()
    }
}

pub(crate) fn too_many(wait: Duration) -> Problem {
    let text = format!("too many requests; send it again in {} ms", wait.as_millis() + 1);
    Problem::new(StatusCode::TOO_MANY_REQUESTS, "too_many_requests", text).retry_after(wait)
}

/// Rejects a request of a known user.
pub(crate) fn forbidden(text: String) -> Problem {
    Problem::new(StatusCode::FORBIDDEN, "forbidden", text)
}

/// Returns the token of a request. Two tokens are treated as none.
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
