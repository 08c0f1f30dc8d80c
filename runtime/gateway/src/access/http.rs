//! Access over HTTP: the user of a request, from its `Authorization: Bearer TOKEN`. Browsers cannot set that header on a
//! WebSocket, so there the token may be the sub-protocol `bearer.TOKEN`, next to `tandem.v1`, which the server selects.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use plc_protocol::wire::row::number;

use super::{Account, AuthenticatedUser, Rate, Rates, User, Users};
use crate::certificate::ClientCertificate;
use crate::problem::Problem;

/// Sub-protocol of our WebSocket.
pub(crate) const WEBSOCKET_PROTOCOL: &str = "tandem.v1";

/// Largest number of a coordinate system.
const CS_MAX: u8 = 8;

/// Prefix of a token among sub-protocols.
const TOKEN_PROTOCOL: &str = "bearer.";

/// Requests of one user: burst, and rate per second; more are 429.
const USER_BURST: u32 = 1000;
const USER_PER_SECOND: u32 = 500;

/// Rate of hold, stop and abort of one user, separate from other requests. Further ones are delayed, never rejected.
const URGENT_BURST: u32 = 1000;
const URGENT_PER_SECOND: u32 = 1000;

/// Requests of one kind (hold, stop or abort) for one coordinate system that one host makes without a login, if the
/// settings allow them: burst, and rate per second. Further ones are delayed; beyond [`STOP_DELAY_MAX`] they are 429. The
/// login page sends one request to each coordinate system at each press.
const STOP_BURST: u32 = 20;
const STOP_PER_SECOND: u32 = 5;

/// Longest delay of a hold, stop or abort without a login. Reason: one host, also with many browsers, does not press
/// faster for so long.
const STOP_DELAY_MAX: Duration = Duration::from_secs(1);

/// Bytes of the responses and frames for one user, in KiB: burst, and rate per second. Beyond it, requests are 429 and
/// frames wait, except for hold, stop and abort. Reason: to produce so much data can use a third of a processor core.
const USER_KIB_BURST: u32 = 128 * 1024;
const USER_KIB_PER_SECOND: u32 = 32 * 1024;

/// Rate of the requests of one host with a wrong token; they never delay valid ones, nor those without a token.
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
    // by host
    wrong: Rates<Account>,
    // KiB for each user name
    kib: Rates<String>,
    // pages of these origins may use the server, in addition to its own
    origins: Vec<HeaderValue>,
    // every client that reaches the server may hold, stop and abort
    stop_without_login: bool,
    // holds, stops and aborts without a login, by host, verb and coordinate system
    stops: Rates<(Account, StopPath)>,
}

impl Access {
    /// Creates the access control. Without users, every client that reaches the server is `admin`.
    pub(crate) fn new(users: Option<Users>) -> Self {
        Self {
            rates: Rates::new(USER_BURST, USER_PER_SECOND),
            urgent: Rates::new(URGENT_BURST, URGENT_PER_SECOND),
            users,
            wrong: Rates::new(WRONG_BURST, WRONG_PER_SECOND),
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

    /// Admits a hold, stop or abort without a login. [`Access::urgent_delay`] counts it.
    pub(crate) fn authorize_anonymous_stop(
        &self,
        from: Option<IpAddr>,
        path: &str,
    ) -> Result<AuthenticatedUser, Problem> {
        match self.stop_rate(from, path).check() {
            Err(wait) if wait > STOP_DELAY_MAX => Err(too_many(wait)),
            Err(_) | Ok(()) => Ok(User::Unidentified.into()),
        }
    }

    fn stop_rate(&self, from: Option<IpAddr>, path: &str) -> Arc<Rate> {
        let host = Account::named(None, from);
        self.stops.rate_for(&(host, StopPath::new(path)))
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
    pub(crate) fn is_from_user(&self, headers: &HeaderMap, certificate: Option<&ClientCertificate>) -> bool {
        self.identify(headers, certificate).is_some()
    }

    /// Returns the user of a request, without counting it.
    pub(crate) fn identify(
        &self,
        headers: &HeaderMap,
        certificate: Option<&ClientCertificate>,
    ) -> Option<User> {
        match &self.users {
            Some(users) => Some(users.identify(token(headers), certificate)?.user),
            None => Some(User::Anyone),
        }
    }

    /// Returns the user of a request. Hold, stop and abort, which are urgent, have a rate of their own:
    /// [`Access::urgent_delay`].
    pub(crate) fn user(
        &self,
        headers: &HeaderMap,
        (certificate, from): (Option<&ClientCertificate>, Option<IpAddr>),
        is_urgent: bool,
    ) -> Result<AuthenticatedUser, Problem> {
        let Some(users) = &self.users else {
            return Ok(User::Anyone.into());
        };
        let token = token(headers);
        let Some(shown) = users.identify(token, certificate) else {
            let charge = || self.wrong.rate_for(&Account::named(None, from)).try_charge();
            // a client without a token has not tried one: it must learn that the machine needs one
            return Err(match token.map_or(Ok(()), |_| charge()) {
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

    /// Counts a hold, stop or abort. Returns how long it is delayed to keep to the rate of its user.
    pub(crate) fn urgent_delay(&self, user: &User, from: Option<IpAddr>, path: &str) -> Duration {
        match user {
            User::Token(token) => self.urgent.rate_for(&token.name).charge(),
            User::Unidentified => self.stop_rate(from, path).charge(),
            User::Anyone | User::Unauthenticated => Duration::ZERO,
        }
    }

    /// Returns the users; `None` if no token is needed.
    pub(crate) fn users(&self) -> Option<&Users> {
        self.users.as_ref()
    }
}

/// The path of a hold, stop or abort: its coordinate system, 0 if there is none with this number, and its verb.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct StopPath(u8, String);

impl StopPath {
    fn new(path: &str) -> Self {
        let mut levels = path.rsplit('/');
        let verb = levels.next().unwrap_or_default().to_owned();
        let cs = levels.next().and_then(number).filter(|cs| *cs <= CS_MAX);
        Self(cs.unwrap_or(0), verb)
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
