//! Clients of the embedded broker.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::time::Instant;

use super::{CLIENTS_MAX, SESSION_EXPIRY};
use crate::access::User;

/// Sessions that outlive their connections; more are refused. Reason: messages wait in memory for each absent client.
pub(super) const REMEMBERED_MAX: usize = 64;

/// A client that was let in.
#[derive(Debug, Clone, Default)]
pub(super) struct Session {
    /// Its host.
    pub(super) from: Option<IpAddr>,
    /// `None`: the broker asks for no tokens.
    pub(super) user: Option<User>,
    /// Speaks MQTT 5, not 3.1.1.
    pub(super) speaks_5: bool,
    /// What its user has shown counts no more; its connection is being closed.
    pub(super) is_revoked: bool,
}

/// All clients by client id.
#[derive(Debug, Default)]
pub(crate) struct Sessions {
    /// Let in, not connected yet.
    admitted: Mutex<HashMap<String, Session>>,
    // the latest connection of each client id, and how many have not ended: one that was taken over ends later
    connected: Mutex<HashMap<Arc<str>, (Session, u32)>>,
    // sessions that outlive their connections, and since when the client is absent
    remembered: Mutex<HashMap<String, Option<Instant>>>,
}

impl Sessions {
    /// Remembers a new client if its session outlives its connection, forgets it otherwise. False beyond the limit.
    pub(super) fn remember(&self, client_id: &str, outlives: bool) -> bool {
        let mut remembered = self.remembered.lock();
        if !outlives {
            remembered.remove(client_id);
            return true;
        }
        remembered.retain(|_, away| away.is_none_or(|since| since.elapsed() < SESSION_EXPIRY));
        if client_id.is_empty() || remembered.len() >= REMEMBERED_MAX && !remembered.contains_key(client_id) {
            return false;
        }
        // absent until it is connected
        remembered.insert(client_id.to_owned(), Some(Instant::now()));
        true
    }

    pub(super) fn admit(&self, client_id: &str, session: Session) {
        let mut admitted = self.admitted.lock();
        // those that left before they were connected
        if admitted.len() > 2 * CLIENTS_MAX {
            admitted.clear();
        }
        admitted.insert(client_id.to_owned(), session);
    }

    /// A client is connected. `user` is called when it was not admitted under this id.
    pub(super) fn connect(&self, client_id: Arc<str>, user: impl FnOnce() -> Option<User>) {
        let admitted = self.admitted.lock().remove(&*client_id);
        if let Some(away) = self.remembered.lock().get_mut(&*client_id) {
            *away = None;
        }
        let session = admitted.unwrap_or_else(|| Session {
            user: user(),
            ..Session::default()
        });
        let mut connected = self.connected.lock();
        let count = connected.get(&client_id).map_or(0, |(_, count)| *count);
        connected.insert(client_id, (session, count + 1));
    }

    pub(super) fn disconnect(&self, client_id: &str) {
        let mut connected = self.connected.lock();
        if let Some((_, count)) = connected.get_mut(client_id) {
            *count -= 1;
            if *count == 0 {
                connected.remove(client_id);
                if let Some(away) = self.remembered.lock().get_mut(client_id) {
                    *away = Some(Instant::now());
                }
            }
        }
    }

    /// The host of a client that is connected.
    pub(crate) fn address_of(&self, client_id: &str) -> Option<IpAddr> {
        self.of(client_id)?.from
    }

    /// All that are connected.
    pub(crate) fn connected(&self) -> Vec<Arc<str>> {
        self.connected.lock().keys().cloned().collect()
    }

    pub(super) fn of(&self, client_id: &str) -> Option<Session> {
        let connected = self.connected.lock();
        connected.get(client_id).map(|(session, _)| session.clone())
    }

    /// What the user of a client has shown counts no more; its connection is being closed.
    pub(super) fn revoke(&self, client_id: &str) {
        if let Some((session, _)) = self.connected.lock().get_mut(client_id) {
            session.is_revoked = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connection_that_took_over_another_stays_when_that_has_ended() {
        let sessions = Sessions::default();
        sessions.connect("panel".into(), || None);
        sessions.connect("panel".into(), || Some(User::Anyone));
        sessions.disconnect("panel");
        assert_eq!(sessions.of("panel").unwrap().user, Some(User::Anyone));
        sessions.disconnect("panel");
        assert!(sessions.of("panel").is_none());
        sessions.disconnect("panel");
    }

    #[tokio::test(start_paused = true)]
    async fn sessions_that_outlive_their_connections_are_bounded_until_they_are_given_up() {
        let sessions = Sessions::default();
        for n in 0..REMEMBERED_MAX {
            assert!(sessions.remember(&n.to_string(), true), "{n}");
        }
        assert!(!sessions.remember("one more", true));
        assert!(sessions.remember("0", true), "it is known");
        assert!(sessions.remember("one more", false), "it leaves nothing");
        assert!(sessions.remember("0", false));
        assert!(sessions.remember("in its place", true));
        assert!(!sessions.remember("", true), "nobody could come back to it");
        tokio::time::advance(SESSION_EXPIRY).await;
        assert!(sessions.remember("when all are forgotten", true));
    }
}
