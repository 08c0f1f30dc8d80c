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
    /// The machine has accepted it.
    is_accepted: bool,
}

/// A handler that is online.
#[derive(Debug)]
struct OnlineHandler {
    account: Account,
    /// The machine has accepted it.
    is_accepted: bool,
}

/// Part of a share that a request takes, until the machine has answered.
#[derive(Debug, Clone)]
pub(crate) enum TakenShare {
    Watch(String),
    Handler(String),
}

impl TakenShare {
    /// Returns the part of a user's share that a request takes.
    pub(crate) fn of_request(request: &Request) -> Option<Self> {
        match request {
            Request::Heartbeat(id, beat) if beat.ttl_ms > 0 => Some(Self::Watch(id.clone())),
            Request::Handler(id, presence) if presence.online => Some(Self::Handler(id.clone())),
            _ => None,
        }
    }
}

/// Watches and handlers with their users.
#[derive(Debug, Default)]
pub(crate) struct Shares {
    watches: Mutex<HashMap<String, Watch>>,
    handlers: Mutex<HashMap<String, OnlineHandler>>,
}

impl Shares {
    /// Counts a request of a user, until [`settle`](Self::settle) reports the answer of the machine.
    ///
    /// # Errors
    /// Returns `invalid` for an interval that the machine refuses; `unavailable` beyond the share of the user; `forbidden` for the watch of another user.
    pub(crate) fn count(&self, user: &User, request: &Request) -> Result<(), Refusal> {
        if user.name().is_none() {
            return Ok(());
        }
        let account = Account::new(user, None);
        match request {
            Request::Heartbeat(id, beat) => {
                beat.check()?;
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
        let is_accepted = watches.get(id).is_some_and(|known| known.is_accepted);
        let watch = Watch {
            account,
            until,
            is_accepted,
        };
        watches.insert(id.to_owned(), watch);
        Ok(())
    }

    fn count_handler(&self, id: &str, account: Account) -> Result<(), Refusal> {
        let mut handlers = self.handlers.lock();
        let own = handlers.values().filter(|of| of.account == account).count();
        if own >= HANDLERS_PER_USER_MAX && !handlers.contains_key(id) {
            let text = format!(
                "the limit of {own} online handlers for this user is reached; end one by a presence with \
                 online false"
            );
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let new = OnlineHandler {
            account,
            is_accepted: false,
        };
        handlers.entry(id.to_owned()).or_insert(new);
        Ok(())
    }

    /// Records the answer of the machine. A refused part is returned to the share, unless it was accepted earlier.
    pub(crate) fn settle(&self, taken: &TakenShare, is_accepted: bool) {
        match taken {
            TakenShare::Watch(id) => {
                let mut watches = self.watches.lock();
                if let Some(watch) = watches.get_mut(id) {
                    watch.is_accepted |= is_accepted;
                    if !watch.is_accepted {
                        watches.remove(id);
                    }
                }
            }
            TakenShare::Handler(id) => {
                let mut handlers = self.handlers.lock();
                if let Some(handler) = handlers.get_mut(id) {
                    handler.is_accepted |= is_accepted;
                    if !handler.is_accepted {
                        handlers.remove(id);
                    }
                }
            }
        }
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

    #[tokio::test(start_paused = true)]
    async fn refused_watch_takes_no_id_and_no_share() {
        let shares = Shares::default();
        let [anna, bert] = ["anna", "bert"].map(|name| Token::user_for_test(name, Role::Operate));
        for ttl_ms in [1, 60_001, 1_000_000_000_000, u64::MAX] {
            let refusal = shares.count(&anna, &beat("panel", ttl_ms)).unwrap_err();
            assert_eq!(refusal.code, RefusalCode::Invalid, "{ttl_ms}");
        }
        let refused = beat("panel", 60_000);
        shares.count(&anna, &refused).unwrap();
        let taken = TakenShare::of_request(&refused).unwrap();
        shares.settle(&taken, false);
        shares.count(&bert, &beat("panel", 1000)).unwrap();
        shares.settle(&taken, true);
        // a later refusal does not end the watch
        shares.count(&bert, &beat("panel", 1000)).unwrap();
        shares.settle(&taken, false);
        assert!(shares.count(&anna, &beat("panel", 1000)).is_err());
        let arm = handler("arm", true);
        for _ in 0..=HANDLERS_PER_USER_MAX {
            shares.count(&anna, &arm).unwrap();
            shares.settle(&TakenShare::of_request(&arm).unwrap(), false);
        }
        assert_eq!(shares.handlers.lock().len(), 0);
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
