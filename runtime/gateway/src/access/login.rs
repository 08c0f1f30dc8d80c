//! Logins of persons with a name and a PIN, for which they get a token that is valid for some hours.
//!
//! A PIN is short, so guessing must be slow: each check costs memory and time (argon2id), one is made at a time, and
//! attempts are limited for each user and host ([`LoginBudgets`]). Requests with a valid token are not affected.

use std::net::IpAddr;
use std::panic::resume_unwind;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use parking_lot::Mutex;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use tokio::sync::Semaphore;
use tokio::task::JoinError;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tracing::warn;

use super::login_budget::LoginBudgets;
use super::pin::{hash, is_of, weakness};
use super::token::{Token, random_secret};
use super::{Tokens, User};
use crate::connection_slots::host_of;

/// Longest validity of a login's token. Reason: a shift, and some time.
pub(crate) const LOGIN_MAX: Duration = Duration::from_hours(12);

/// Largest number of logins of one user at one time; a further one ends the oldest.
const LOGINS_PER_USER_MAX: usize = 16;

/// Reason for rejecting a login.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LoginRefusal {
    /// The user does not exist, or the PIN is wrong.
    Wrong,
    /// Too many attempts; the next is accepted after this time.
    Wait(Duration),
    /// Too many logins are being checked.
    Busy,
}

/// A user, and the login by which it was authenticated.
#[derive(Debug, Clone)]
pub(crate) struct AuthenticatedUser {
    pub(crate) user: User,
    /// `None` for a token or a certificate.
    pub(super) login: Option<LoginEnd>,
    /// End of the certificate; `None` for a token or a login.
    pub(super) until: Option<Instant>,
}

impl AuthenticatedUser {
    /// Creates the user of a certificate, which expires at `until`.
    pub(super) fn by_certificate(user: User, until: Option<Instant>) -> Self {
        Self {
            user,
            login: None,
            until,
        }
    }

    /// Returns true for a person that has logged in.
    pub(crate) fn is_login(&self) -> bool {
        self.login.is_some()
    }

    /// Records activity of the person.
    pub(crate) fn be_active(&self) {
        if let Some(login) = &self.login {
            login.be_active();
        }
    }
}

impl From<User> for AuthenticatedUser {
    fn from(user: User) -> Self {
        Self {
            user,
            login: None,
            until: None,
        }
    }
}

/// The end of a login.
#[derive(Debug, Clone)]
pub(crate) struct LoginEnd {
    latest: Instant,
    idle_max: Option<Duration>,
    /// When the person was last active.
    active: Arc<Mutex<Instant>>,
    pub(super) given_back: CancellationToken,
}

impl LoginEnd {
    /// Returns when the login ends without further activity.
    pub(super) fn until(&self) -> Instant {
        let idle = self.idle_max.map(|idle_max| *self.active.lock() + idle_max);
        idle.map_or(self.latest, |idle| idle.min(self.latest))
    }

    fn be_active(&self) {
        *self.active.lock() = Instant::now();
    }
}

/// A login.
struct Login {
    /// SHA-256 of its token.
    digest: [u8; 32],
    user: Arc<Token>,
    end: LoginEnd,
}

impl Drop for Login {
    /// Notifies the connections of this login when it ends.
    fn drop(&mut self) {
        self.end.given_back.cancel();
    }
}

/// The valid logins.
pub(crate) struct Logins {
    in_force: Mutex<Vec<Login>>,
    budgets: LoginBudgets,
    /// One check at a time, so that guessing takes one core and 19 MiB at most.
    checks: Semaphore,
    /// A login ends after this time without activity. `None` disables this limit.
    idle_max: Option<Duration>,
}

impl std::fmt::Debug for Logins {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Logins").finish_non_exhaustive()
    }
}

impl Default for Logins {
    fn default() -> Self {
        Self::new(None)
    }
}

impl Logins {
    /// Creates an empty set of logins. Each login ends after `idle_max` without activity.
    pub(crate) fn new(idle_max: Option<Duration>) -> Self {
        Self {
            in_force: Mutex::default(),
            budgets: LoginBudgets::default(),
            checks: Semaphore::new(1),
            idle_max,
        }
    }

    /// Returns a token for the user with this name and PIN.
    pub(crate) async fn log_in(
        &self,
        tokens: &Tokens,
        name: &str,
        pin: String,
        from: IpAddr,
    ) -> Result<(String, User), LoginRefusal> {
        let tried = self
            .budgets
            .count(name, host_of(from))
            .map_err(LoginRefusal::Wait)?;
        let known = tokens.with_pin(name);
        let Some(_waiting) = self.budgets.wait(&tried) else {
            return Err(LoginRefusal::Busy);
        };
        let Ok(_check) = self.checks.acquire().await else {
            return Err(LoginRefusal::Busy);
        };
        // an unknown name takes as long as a known one
        let phc = known.as_ref().and_then(|user| user.pin()).map(str::to_owned);
        let check = move || {
            let is_right = is_of(&pin, phc.as_deref().unwrap_or(&UNKNOWN_USER_HASH));
            (is_right, weakness(&pin))
        };
        let (is_right, weakness) = match tokio::task::spawn_blocking(check)
            .await
            .map_err(JoinError::try_into_panic)
        {
            Ok(checked) => checked,
            // the supervisor of the connection reports the panic
            Err(Ok(panicked)) => resume_unwind(panicked),
            Err(Err(_)) => return Err(LoginRefusal::Busy),
        };
        let user = known.filter(|_| is_right).ok_or(LoginRefusal::Wrong)?;
        self.budgets.succeed(&tried);
        if let Some(weakness) = weakness {
            let name = &user.name;
            warn!(
                "the PIN of {name} is easy to guess ({weakness}); create a new one with tandem token {name} \
                 --pin"
            );
        }
        let token = random_secret().map_err(|_| LoginRefusal::Busy)?;
        self.add_login(&token, &user);
        Ok((token, User::Token(user)))
    }

    fn add_login(&self, token: &str, user: &Arc<Token>) {
        let now = Instant::now();
        let mut logins = self.in_force.lock();
        logins.retain(|login| now < login.end.until());
        let of_user = |login: &Login| login.user.name == user.name;
        if logins.iter().filter(|login| of_user(login)).count() >= LOGINS_PER_USER_MAX
            && let Some(oldest) = logins.iter().position(of_user)
        {
            logins.remove(oldest);
        }
        logins.push(Login {
            digest: Sha256::digest(token.as_bytes()).into(),
            user: Arc::clone(user),
            end: LoginEnd {
                latest: now + LOGIN_MAX,
                idle_max: self.idle_max,
                active: Arc::new(Mutex::new(now)),
                given_back: CancellationToken::new(),
            },
        });
    }

    /// Returns the owner of a login's token, as long as its entry is in the token file.
    pub(crate) fn user_of(&self, tokens: &Tokens, presented: &[u8]) -> Option<AuthenticatedUser> {
        let (digest, now): ([u8; 32], _) = (Sha256::digest(presented).into(), Instant::now());
        let logins = self.in_force.lock();
        let mut found = logins
            .iter()
            .filter(|login| now < login.end.until() && bool::from(login.digest.ct_eq(&digest)));
        let login = found.next()?;
        let user = User::Token(Arc::clone(&login.user));
        tokens.has(&user).then(|| AuthenticatedUser {
            user,
            login: Some(login.end.clone()),
            until: None,
        })
    }

    /// Ends the login of a token. Returns `false` if there is none.
    pub(crate) fn log_out(&self, presented: &[u8]) -> bool {
        let digest: [u8; 32] = Sha256::digest(presented).into();
        let mut logins = self.in_force.lock();
        let before = logins.len();
        logins.retain(|login| !bool::from(login.digest.ct_eq(&digest)));
        logins.len() < before
    }
}

/// Hash of a PIN that belongs to no user.
static UNKNOWN_USER_HASH: LazyLock<String> =
    LazyLock::new(|| random_secret().and_then(|pin| hash(&pin)).unwrap_or_default());

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{Role, new_token, pin_entry};

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    fn tokens() -> Tokens {
        let person = pin_entry("anna", Role::Operate, "493021", None).unwrap();
        Tokens::parse(&(person + &new_token("cell", Role::View, None).unwrap().entry)).unwrap()
    }

    #[tokio::test]
    async fn name_and_pin_give_a_token_valid_until_logout_or_removal_of_the_entry() {
        let (logins, tokens) = (Logins::default(), tokens());
        let (token, user) = logins
            .log_in(&tokens, "anna", "493021".into(), HERE)
            .await
            .unwrap();
        assert_eq!((user.name(), user.role()), (Some("anna"), Role::Operate));
        let shown = logins.user_of(&tokens, token.as_bytes());
        assert_eq!(shown.map(|shown| shown.user), Some(user));
        assert_eq!(
            tokens.user_of(token.as_bytes()),
            None,
            "the file has no such entry"
        );
        let without = Tokens::parse(&new_token("cell", Role::View, None).unwrap().entry).unwrap();
        assert!(logins.user_of(&without, token.as_bytes()).is_none());
        assert!(logins.log_out(token.as_bytes()) && !logins.log_out(token.as_bytes()));
        assert!(logins.user_of(&tokens, token.as_bytes()).is_none());
    }

    #[tokio::test]
    async fn wrong_pin_and_unknown_name_look_the_same_and_a_pin_is_not_a_token() {
        let (logins, tokens) = (Logins::default(), tokens());
        for (name, pin) in [
            ("anna", "493020"),
            ("anna", ""),
            ("bert", "493021"),
            ("cell", "493021"),
        ] {
            let refused = logins.log_in(&tokens, name, pin.into(), HERE).await.unwrap_err();
            assert_eq!(refused, LoginRefusal::Wrong, "{name} {pin}");
        }
        assert_eq!(tokens.user_of(b"493021"), None);
    }

    #[tokio::test(start_paused = true)]
    async fn attempts_are_limited_per_user_and_host_and_a_current_login_stays() {
        let (logins, tokens) = (Logins::default(), tokens());
        let (token, _) = logins
            .log_in(&tokens, "anna", "493021".into(), HERE)
            .await
            .unwrap();
        let try_from = async |name: &str, host: [u8; 4]| {
            logins
                .log_in(&tokens, name, "000000".into(), host.into())
                .await
                .unwrap_err()
        };
        // known and unknown names alike
        for (name, host) in [("anna", 1), ("nobody", 2)] {
            for _ in 0..10 {
                assert_eq!(
                    try_from(name, [10, 0, 0, host]).await,
                    LoginRefusal::Wrong,
                    "{name}"
                );
            }
            assert!(
                matches!(try_from(name, [10, 0, 0, host]).await, LoginRefusal::Wait(_)),
                "{name}"
            );
        }
        assert!(
            matches!(try_from("carl", [10, 0, 0, 1]).await, LoginRefusal::Wait(_)),
            "the host"
        );
        assert!(logins.user_of(&tokens, token.as_bytes()).is_some());
        let again = logins.log_in(&tokens, "anna", "493021".into(), HERE).await;
        assert!(again.is_ok(), "a stranger on another host does not block it");
        tokio::time::advance(LOGIN_MAX).await;
        assert!(
            logins.user_of(&tokens, token.as_bytes()).is_none(),
            "its time has expired"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn a_login_without_activity_ends_and_one_in_use_stays() {
        let logins = Logins::new(Some(Duration::from_hours(1)));
        let tokens = tokens();
        let (token, _) = logins
            .log_in(&tokens, "anna", "493021".into(), HERE)
            .await
            .unwrap();
        for _ in 0..5 {
            tokio::time::advance(Duration::from_mins(59)).await;
            logins
                .user_of(&tokens, token.as_bytes())
                .expect("it is in use")
                .be_active();
        }
        tokio::time::advance(Duration::from_mins(59)).await;
        assert!(
            logins.user_of(&tokens, token.as_bytes()).is_some(),
            "reading is no activity"
        );
        tokio::time::advance(Duration::from_mins(1)).await;
        assert!(logins.user_of(&tokens, token.as_bytes()).is_none());
    }

    #[tokio::test]
    async fn one_user_ends_no_login_of_another() {
        let (logins, tokens) = (Logins::default(), tokens());
        let bert = pin_entry("bert", Role::Operate, "750318", None).unwrap();
        let bert = Tokens::parse(&bert).unwrap();
        let (kept, _) = logins
            .log_in(&tokens, "anna", "493021".into(), HERE)
            .await
            .unwrap();
        let user = bert.with_pin("bert").unwrap();
        for n in 0..300 {
            logins.add_login(&n.to_string(), &user);
        }
        assert_eq!(logins.in_force.lock().len(), 1 + LOGINS_PER_USER_MAX);
        assert!(logins.user_of(&tokens, kept.as_bytes()).is_some());
    }
}
