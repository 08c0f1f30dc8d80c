//! Limits for each user on the watches and online handlers that the machine remembers.
//!
//! The machine itself has a limit for all clients. A user's share keeps that user from taking it all. A watch belongs
//! to the user that requested it. Without users, every client on the computer has all rights, and only the limits of
//! the machine apply.

use std::collections::HashMap;
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::types::request::{Refusal, RefusalCode, Request};
use plc_protocol::wire::right::Right;
use tokio::time::Instant;

use crate::access::{Account, User};

/// Largest number of watches of one user, of the 64 of each coordinate system. Reason: three users leave room for
/// further ones.
const WATCHES_PER_USER_MAX: usize = 16;

/// Largest number of watches of all users who may not operate the machine; the other 16 are reserved for operators.
const WATCHES_UNRESERVED_MAX: usize = 48;

/// Largest number of handlers of one user that are online, of the 256 of the machine.
const HANDLERS_PER_USER_MAX: usize = 64;

/// A watch.
#[derive(Debug)]
struct Watch {
    account: Account,
    until: Instant,
}

/// Watches and handlers with their users.
#[derive(Debug, Default)]
pub(crate) struct Shares {
    watches: Mutex<HashMap<String, Watch>>,
    handlers: Mutex<HashMap<String, Account>>,
}

impl Shares {
    /// Counts a request of a user.
    ///
    /// # Errors
    /// Returns `unavailable` beyond the share of the user; `forbidden` for the watch of another user.
    pub(crate) fn count(&self, user: &User, request: &Request) -> Result<(), Refusal> {
        if user.name().is_none() {
            return Ok(());
        }
        let account = Account::new(user, None);
        match request {
            Request::Heartbeat(id, beat) => {
                self.count_watch(id, beat.ttl_ms, account, user.has(Right::Operate))
            }
            Request::Handler(id, presence) if presence.online => self.count_handler(id, account),
            _ => Ok(()),
        }
    }

    fn count_watch(&self, id: &str, ttl_ms: u64, account: Account, may_operate: bool) -> Result<(), Refusal> {
        let mut watches = self.watches.lock();
        let now = Instant::now();
        watches.retain(|_, watch| now < watch.until);
        if watches.get(id).is_some_and(|watch| watch.account != account) {
            let text = format!("client {id} is watched for another user; use another id");
            return Err(Refusal::new(RefusalCode::Forbidden, text));
        }
        if ttl_ms == 0 {
            watches.remove(id);
            return Ok(());
        }
        if !watches.contains_key(id) {
            let own = watches.values().filter(|watch| watch.account == account).count();
            if own >= WATCHES_PER_USER_MAX || !may_operate && watches.len() >= WATCHES_UNRESERVED_MAX {
                let text = format!(
                    "client {id} is not watched, because {own} clients of this user and {} of all users \
                     are; end one watch \
                     by a heartbeat with ttl_ms 0",
                    watches.len()
                );
                return Err(Refusal::new(RefusalCode::Unavailable, text));
            }
        }
        let until = now + Duration::from_millis(ttl_ms);
        watches.insert(id.to_owned(), Watch { account, until });
        Ok(())
    }

    fn count_handler(&self, id: &str, account: Account) -> Result<(), Refusal> {
        let mut handlers = self.handlers.lock();
        let own = handlers.values().filter(|of| **of == account).count();
        if own >= HANDLERS_PER_USER_MAX && !handlers.contains_key(id) {
            let text = format!(
                "the limit of {own} online handlers for this user is reached; end one by a presence with \
                 online false"
            );
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        handlers.entry(id.to_owned()).or_insert(account);
        Ok(())
    }

    /// Records that a handler is offline.
    pub(crate) fn record_offline(&self, request: &Request) {
        if let Request::Handler(id, presence) = request
            && !presence.online
        {
            self.handlers.lock().remove(id);
        }
    }
}

#[cfg(test)]
mod tests {
    use plc_protocol::types::heartbeat::ClientHeartbeat;
    use plc_protocol::types::output::HandlerPresence;

    use super::*;
    use crate::Role;
    use crate::access::Token;

    fn beat(id: &str, ttl_ms: u64) -> Request {
        Request::Heartbeat(id.to_owned(), ClientHeartbeat { ttl_ms, cs: None })
    }

    fn handler(id: &str, online: bool) -> Request {
        let presence = HandlerPresence {
            online,
            ..HandlerPresence::default()
        };
        Request::Handler(id.to_owned(), presence)
    }

    #[tokio::test(start_paused = true)]
    async fn one_user_takes_no_watch_of_others_and_the_last_are_for_operators() {
        let shares = Shares::default();
        let user = |n: usize| Token::user_for_test(&format!("handler-{n}"), Role::Handler);
        let taken = |user: &User, name: &str| {
            (0..64)
                .filter(|n| shares.count(user, &beat(&format!("{name}-{n}"), 1000)).is_ok())
                .count()
        };
        for n in 0..3 {
            assert_eq!(taken(&user(n), &n.to_string()), WATCHES_PER_USER_MAX);
        }
        assert_eq!(taken(&user(3), "3"), 0);
        let operator = Token::user_for_test("operator", Role::Operate);
        assert_eq!(taken(&operator, "panel"), 16);
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!(
            taken(&user(3), "3"),
            WATCHES_PER_USER_MAX,
            "lost watches are not counted"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn a_watch_is_ended_by_its_own_user_only() {
        let shares = Shares::default();
        let [anna, bert] = ["anna", "bert"].map(|name| Token::user_for_test(name, Role::Operate));
        shares.count(&anna, &beat("panel", 1000)).unwrap();
        let refusal = shares.count(&bert, &beat("panel", 0)).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Forbidden);
        assert!(
            shares.count(&User::Anyone, &beat("panel", 0)).is_ok(),
            "without users"
        );
        assert!(shares.count(&anna, &beat("panel", 0)).is_ok());
        assert!(shares.count(&bert, &beat("panel", 1000)).is_ok());
    }

    #[tokio::test]
    async fn one_user_announces_a_share_of_the_handlers_until_one_is_offline() {
        let shares = Shares::default();
        let [admin, other] = ["admin", "other"].map(|name| Token::user_for_test(name, Role::Admin));
        for n in 0..HANDLERS_PER_USER_MAX {
            shares.count(&admin, &handler(&n.to_string(), true)).unwrap();
        }
        assert!(shares.count(&admin, &handler("more", true)).is_err());
        assert!(shares.count(&admin, &handler("0", true)).is_ok(), "it is known");
        assert!(shares.count(&other, &handler("more", true)).is_ok());
        shares.record_offline(&handler("0", false));
        assert!(shares.count(&admin, &handler("in its place", true)).is_ok());
    }
}
