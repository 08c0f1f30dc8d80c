//! Identifies users by their credentials, for HTTP, WebSocket and MQTT alike, and determines how long these are valid.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep_until};

use super::LiveTokens;
use super::login::{AuthenticatedUser, LoginEnd, Logins};

/// The users of a machine: those of the token file, and persons who have logged in.
#[derive(Debug, Clone)]
pub(crate) struct Users {
    pub(crate) tokens: LiveTokens,
    pub(crate) logins: Arc<Logins>,
}

/// Why a connection is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CloseReason {
    /// The entry of the token, person or certificate is no longer valid.
    Revoked,
    /// The login has expired, or its user has ended it.
    Login,
}

impl CloseReason {
    /// Returns the text that the client receives.
    pub(crate) fn text(self) -> &'static str {
        match self {
            CloseReason::Revoked => "the token is no longer valid",
            CloseReason::Login => "the login has ended; log in again",
        }
    }
}

impl Users {
    /// Creates the users of these tokens, without logins. A login without activity for `idle_max` ends.
    pub(crate) fn new(tokens: LiveTokens, idle_max: Option<Duration>) -> Self {
        Self {
            tokens,
            logins: Arc::new(Logins::new(idle_max)),
        }
    }

    /// Returns the user of a token or of a login's token. Without a token, the user of the certificate.
    pub(crate) fn identify(
        &self,
        shown: Option<&[u8]>,
        certificate: Option<&[u8; 32]>,
    ) -> Option<AuthenticatedUser> {
        let tokens = self.tokens.now();
        match shown {
            Some(shown) => {
                let by_token = tokens.user_of(shown).map(AuthenticatedUser::from);
                by_token.or_else(|| self.logins.user_of(&tokens, shown))
            }
            None => tokens
                .user_of_certificate(certificate?)
                .map(AuthenticatedUser::from),
        }
    }

    /// Waits until the credentials are no longer valid.
    pub(crate) async fn wait_until_invalid(&self, shown: &AuthenticatedUser) -> CloseReason {
        let mut tokens = self.tokens.clone();
        let revoked = async {
            while tokens.now().has(&shown.user) {
                tokens.changed().await;
            }
        };
        let login = async {
            match &shown.login {
                None => std::future::pending().await,
                Some(login) => tokio::select! {
                    () = wait_until_expired(login) => {}
                    () = login.given_back.cancelled() => {}
                },
            }
        };
        tokio::select! {
            () = revoked => CloseReason::Revoked,
            () = login => CloseReason::Login,
        }
    }
}

/// Waits until a login expires, which activity delays.
async fn wait_until_expired(login: &LoginEnd) {
    while Instant::now() < login.until() {
        sleep_until(login.until()).await;
    }
}
