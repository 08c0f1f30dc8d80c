//! Users who type who they are: a name and a PIN, for which they get a token that counts for some hours.
//!
//! A PIN is short, so guessing it is slow: each check costs memory and time (argon2id), one is made at a time, and wrong ones
//! are limited for each user and each host. Nothing of this concerns a token that somebody has already.

use std::net::IpAddr;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use parking_lot::Mutex;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use tokio::sync::Semaphore;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::pin::{hash, is_of};
use super::token::{Token, random_secret};
use super::{Rates, Tokens, User};
use crate::places::host_of;

/// How long the token of a login counts. Reason: a shift, and some time.
pub(crate) const LOGIN_MAX: Duration = Duration::from_hours(12);

/// Logins at one time; for one more the oldest ends.
const LOGINS_MAX: usize = 256;

/// Logins that wait for the check of another one.
const WAITING_MAX: usize = 8;

/// Tries of one user, and of one host: a burst, and then one in so many seconds. Reason: 6 digits then last for half a year of
/// guessing, and whoever mistypes a few times does not wait.
const USER_BURST: u32 = 10;
const USER_SECONDS: f64 = 30.0;
const HOST_BURST: u32 = 10;
const HOST_SECONDS: f64 = 15.0;

/// Rates of names that nobody has; several names have one. Reason: they are limited as those of users, so that nobody learns who
/// there is, and their number is bounded.
const UNKNOWN_RATES: u16 = 512;

/// Why nobody was let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Refused {
    /// There is no such user, or the PIN is another.
    Wrong,
    /// Too many tries; the next counts after this time.
    Wait(Duration),
    /// Too many others are being checked.
    Busy,
}

/// A user, and the login by which it is here.
#[derive(Debug, Clone)]
pub(crate) struct Shown {
    pub(crate) user: User,
    /// `None`: a token or a certificate.
    pub(super) login: Option<LoginEnd>,
}

impl Shown {
    /// True for a person who has logged in.
    pub(crate) fn is_login(&self) -> bool {
        self.login.is_some()
    }
}

impl From<User> for Shown {
    fn from(user: User) -> Self {
        Self { user, login: None }
    }
}

/// The end of a login.
#[derive(Debug, Clone)]
pub(crate) struct LoginEnd {
    pub(super) until: Instant,
    pub(super) given_back: CancellationToken,
}

/// A login.
struct Login {
    /// SHA-256 of its token.
    digest: [u8; 32],
    user: Arc<Token>,
    end: LoginEnd,
}

impl Drop for Login {
    /// Connections that were opened with it hear that it has ended.
    fn drop(&mut self) {
        self.end.given_back.cancel();
    }
}

/// The logins in force.
pub(crate) struct Logins {
    in_force: Mutex<Vec<Login>>,
    of_user: Rates<String>,
    of_unknown: Rates<u16>,
    of_host: Rates<IpAddr>,
    /// One check at a time, so that guessing takes one core and 19 MiB at most.
    checks: Semaphore,
    waiting: Semaphore,
}

impl std::fmt::Debug for Logins {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Logins").finish_non_exhaustive()
    }
}

impl Default for Logins {
    fn default() -> Self {
        Self {
            in_force: Mutex::default(),
            of_user: Rates::new(USER_BURST, 1.0 / USER_SECONDS),
            of_unknown: Rates::new(USER_BURST, 1.0 / USER_SECONDS),
            of_host: Rates::new(HOST_BURST, 1.0 / HOST_SECONDS),
            checks: Semaphore::new(1),
            waiting: Semaphore::new(WAITING_MAX),
        }
    }
}

impl Logins {
    /// A token for the user with this name and PIN.
    pub(crate) async fn log_in(
        &self,
        tokens: &Tokens,
        name: &str,
        pin: String,
        from: IpAddr,
    ) -> Result<(String, User), Refused> {
        let host = host_of(from);
        if !host.is_loopback() {
            self.of_host.of(&host).take().map_err(Refused::Wait)?;
        }
        let known = tokens.with_pin(name);
        let rate = match &known {
            Some(user) => self.of_user.of(&user.name),
            None => self.of_unknown.of(&place_of(name)),
        };
        rate.take().map_err(Refused::Wait)?;
        let Ok(_waiting) = self.waiting.try_acquire() else {
            return Err(Refused::Busy);
        };
        let Ok(_check) = self.checks.acquire().await else {
            return Err(Refused::Busy);
        };
        // an unknown name takes the time of a known one
        let phc = known.as_ref().and_then(|user| user.pin()).map(str::to_owned);
        let check = move || is_of(&pin, phc.as_deref().unwrap_or(&NOBODY));
        let is_right = tokio::task::spawn_blocking(check).await.unwrap_or(false);
        let user = known.filter(|_| is_right).ok_or(Refused::Wrong)?;
        let token = random_secret().map_err(|_| Refused::Busy)?;
        self.begin(&token, &user);
        Ok((token, User::Token(user)))
    }

    fn begin(&self, token: &str, user: &Arc<Token>) {
        let now = Instant::now();
        let mut logins = self.in_force.lock();
        logins.retain(|login| now < login.end.until);
        if logins.len() >= LOGINS_MAX {
            logins.remove(0);
        }
        logins.push(Login {
            digest: Sha256::digest(token.as_bytes()).into(),
            user: Arc::clone(user),
            end: LoginEnd {
                until: now + LOGIN_MAX,
                given_back: CancellationToken::new(),
            },
        });
    }

    /// The owner of the token of a login, as long as its entry is in the token file.
    pub(crate) fn user_of(&self, tokens: &Tokens, presented: &[u8]) -> Option<Shown> {
        let (digest, now): ([u8; 32], _) = (Sha256::digest(presented).into(), Instant::now());
        let logins = self.in_force.lock();
        let mut found = logins
            .iter()
            .filter(|login| now < login.end.until && bool::from(login.digest.ct_eq(&digest)));
        let login = found.next()?;
        let user = User::Token(Arc::clone(&login.user));
        tokens.has(&user).then(|| Shown {
            user,
            login: Some(login.end.clone()),
        })
    }

    /// Ends the login of a token. False when there is none.
    pub(crate) fn log_out(&self, presented: &[u8]) -> bool {
        let digest: [u8; 32] = Sha256::digest(presented).into();
        let mut logins = self.in_force.lock();
        let before = logins.len();
        logins.retain(|login| !bool::from(login.digest.ct_eq(&digest)));
        logins.len() < before
    }
}

/// Which of these rates is that of a name.
fn place_of(name: &str) -> u16 {
    let digest = Sha256::digest(name);
    u16::from_be_bytes([digest[0], digest[1]]) % UNKNOWN_RATES
}

/// The hash of a PIN that nobody has.
static NOBODY: LazyLock<String> =
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
    async fn a_name_and_its_pin_give_a_token_that_counts_until_it_is_given_back_or_its_entry_is_gone() {
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
            "the file does not know it"
        );
        let without = Tokens::parse(&new_token("cell", Role::View, None).unwrap().entry).unwrap();
        assert!(logins.user_of(&without, token.as_bytes()).is_none());
        assert!(logins.log_out(token.as_bytes()) && !logins.log_out(token.as_bytes()));
        assert!(logins.user_of(&tokens, token.as_bytes()).is_none());
    }

    #[tokio::test]
    async fn a_wrong_pin_and_an_unknown_name_are_the_same_and_neither_is_a_token_a_pin() {
        let (logins, tokens) = (Logins::default(), tokens());
        for (name, pin) in [
            ("anna", "493020"),
            ("anna", ""),
            ("bert", "493021"),
            ("cell", "493021"),
        ] {
            let refused = logins.log_in(&tokens, name, pin.into(), HERE).await.unwrap_err();
            assert_eq!(refused, Refused::Wrong, "{name} {pin}");
        }
        assert_eq!(tokens.user_of(b"493021"), None);
    }

    #[tokio::test(start_paused = true)]
    async fn tries_are_limited_for_a_user_and_for_a_host_and_a_login_that_is_there_stays() {
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
        for n in 0..USER_BURST - 1 {
            assert_eq!(
                try_from("anna", [10, 0, 0, u8::try_from(n).unwrap()]).await,
                Refused::Wrong
            );
        }
        assert!(matches!(try_from("anna", [10, 0, 0, 99]).await, Refused::Wait(_)));
        for n in 0..USER_BURST {
            let host = [10, 0, 2, u8::try_from(n).unwrap()];
            assert_eq!(try_from("nobody", host).await, Refused::Wrong);
        }
        let unknown = try_from("nobody", [10, 0, 2, 99]).await;
        assert!(matches!(unknown, Refused::Wait(_)), "as for a user");
        for _ in 0..HOST_BURST {
            assert_eq!(try_from("bert", [10, 0, 1, 1]).await, Refused::Wrong);
        }
        assert!(matches!(try_from("carl", [10, 0, 1, 1]).await, Refused::Wait(_)));
        assert!(logins.user_of(&tokens, token.as_bytes()).is_some());
        tokio::time::advance(Duration::from_secs(31)).await;
        assert!(
            logins
                .log_in(&tokens, "anna", "493021".into(), HERE)
                .await
                .is_ok()
        );
        tokio::time::advance(LOGIN_MAX).await;
        assert!(
            logins.user_of(&tokens, token.as_bytes()).is_none(),
            "its time is over"
        );
    }
}
