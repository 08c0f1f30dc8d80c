//! Identifies users by their credentials, for HTTP, WebSocket and MQTT alike, and determines how long these are valid.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::time::{Instant, sleep_until};

use super::LiveTokens;
use super::login::{AuthenticatedUser, LoginEnd, Logins};
use crate::certificate::ClientCertificate;

/// Longest sleep until the end of a certificate. Reason: timers do not reach beyond two years.
const SLEEP_MAX: Duration = Duration::from_hours(24);

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
    /// The client certificate has expired.
    Certificate,
}

impl CloseReason {
    /// Returns the text that the client receives.
    pub(crate) fn text(self) -> &'static str {
        match self {
            CloseReason::Revoked => "the token is no longer valid",
            CloseReason::Login => "the login has ended; log in again",
            CloseReason::Certificate => {
                "the client certificate has expired; renew it with tandem cert client"
            }
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
        certificate: Option<&ClientCertificate>,
    ) -> Option<AuthenticatedUser> {
        let tokens = self.tokens.now();
        if let Some(shown) = shown {
            let by_token = tokens.user_of(shown).map(AuthenticatedUser::from);
            return by_token.or_else(|| self.logins.user_of(&tokens, shown));
        }
        let certificate = certificate?;
        let left = certificate.valid_until.duration_since(SystemTime::now()).ok()?;
        let user = tokens.user_of_certificate(&certificate.fingerprint)?;
        let until = Instant::now().checked_add(left);
        Some(AuthenticatedUser::by_certificate(user, until))
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
            () = wait_until(shown.until) => CloseReason::Certificate,
        }
    }
}

/// Waits until this time. With `None` it never returns.
async fn wait_until(end: Option<Instant>) {
    let Some(end) = end else {
        return std::future::pending().await;
    };
    while Instant::now() < end {
        sleep_until(end.min(Instant::now() + SLEEP_MAX)).await;
    }
}

/// Waits until a login expires, which activity delays.
async fn wait_until_expired(login: &LoginEnd) {
    while Instant::now() < login.until() {
        sleep_until(login.until()).await;
    }
}

#[cfg(test)]
mod tests {
    use sha2::{Digest as _, Sha256};

    use super::*;
    use crate::access::{Role, Tokens, certificate_entry};

    #[tokio::test(start_paused = true)]
    async fn a_connection_ends_with_the_certificate_that_opened_it() {
        let fingerprint = Sha256::digest(b"abc").into();
        let entry = certificate_entry("panel", Role::Operate, b"abc", None).unwrap();
        let tokens = Tokens::parse(&entry).unwrap();
        let users = Users::new(LiveTokens::fixed(Arc::new(tokens)), None);
        let presented = |valid_until| ClientCertificate {
            fingerprint,
            valid_until,
        };
        let begun = Instant::now();
        let left = Duration::from_hours(50);
        let shown = users.identify(None, Some(&presented(SystemTime::now() + left)));
        let reason = users.wait_until_invalid(&shown.expect("it is valid")).await;
        assert_eq!(reason, CloseReason::Certificate);
        let late = begun.elapsed().abs_diff(left);
        assert!(late < Duration::from_secs(1), "{late:?}");
        let expired = presented(SystemTime::now() - Duration::from_secs(1));
        assert!(users.identify(None, Some(&expired)).is_none());
    }
}
