//! Access over HTTP: whose token a request carries.
//!
//! The token stands in `Authorization: Bearer TOKEN`. Browsers cannot set that header on a WebSocket: there it may be
//! one of the sub-protocols, `bearer.TOKEN`, beside `tandem.v1`, which the server chooses.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::http::{HeaderMap, StatusCode, header};
use parking_lot::Mutex;

use super::{LiveTokens, Rate, Tokens, User};
use crate::problem::Problem;

/// Sub-protocol of our WebSocket.
pub(crate) const WEBSOCKET_PROTOCOL: &str = "tandem.v1";

/// What stands before a token among sub-protocols.
const TOKEN_PROTOCOL: &str = "bearer.";

/// Requests of one user: at once, and a second after that; more are 429.
const USER_BURST: u32 = 1000;
const USER_PER_SECOND: u32 = 500;

/// The same for requests with a wrong token or none, of all together; right ones are not held up by them.
const WRONG_BURST: u32 = 50;
const WRONG_PER_SECOND: u32 = 10;

/// Who may use the server.
#[derive(Debug)]
pub(crate) struct Access {
    tokens: Option<LiveTokens>,
    // by the name of a user
    rates: Mutex<BTreeMap<String, Arc<Rate>>>,
    wrong: Rate,
}

impl Access {
    /// Without tokens everyone who reaches the server is `admin`.
    pub(crate) fn new(tokens: Option<LiveTokens>) -> Self {
        Self {
            rates: Mutex::default(),
            tokens,
            wrong: Rate::new(WRONG_BURST, WRONG_PER_SECOND),
        }
    }

    /// The user of a request.
    pub(crate) fn user(&self, headers: &HeaderMap) -> Result<User, Problem> {
        let Some(tokens) = &self.tokens else {
            return Ok(User::anyone());
        };
        let tokens = tokens.now();
        let Some(user) = token(headers).and_then(|token| tokens.user_of(token)) else {
            return Err(match self.wrong.take() {
                Ok(()) => Problem::new(
                    StatusCode::UNAUTHORIZED,
                    "unauthorized",
                    "this needs a token; send it as Authorization: Bearer TOKEN",
                ),
                Err(wait) => too_many(wait),
            });
        };
        match user.name.as_ref().map(|name| self.rate_of(name, &tokens).take()) {
            Some(Err(wait)) => Err(too_many(wait)),
            Some(Ok(())) | None => Ok(user),
        }
    }

    /// The tokens of now; `None` where none are asked for.
    pub(crate) fn tokens(&self) -> Option<LiveTokens> {
        self.tokens.clone()
    }

    fn rate_of(&self, name: &str, tokens: &Tokens) -> Arc<Rate> {
        let mut rates = self.rates.lock();
        if let Some(rate) = rates.get(name) {
            return Arc::clone(rate);
        }
        // users of an earlier list go when a new one comes
        rates.retain(|known, _| tokens.user_named(known).is_some());
        let rate = Arc::new(Rate::new(USER_BURST, USER_PER_SECOND));
        rates.insert(name.to_owned(), Arc::clone(&rate));
        rate
    }
}

fn too_many(wait: Duration) -> Problem {
    let text = format!("too many requests; send it again in {} ms", wait.as_millis() + 1);
    Problem::new(StatusCode::TOO_MANY_REQUESTS, "too_many_requests", text)
}

/// A refusal of a user who is known.
pub(crate) fn forbidden(text: String) -> Problem {
    Problem::new(StatusCode::FORBIDDEN, "forbidden", text)
}

/// The token of a request. Two tokens are none.
fn token(headers: &HeaderMap) -> Option<&[u8]> {
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
