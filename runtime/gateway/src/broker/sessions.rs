//! Clients of the embedded broker.

use std::collections::{HashMap, VecDeque};
use std::net::IpAddr;
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::time::Instant;

use super::packet_monitor::UnreleasedIds;
use super::{CLIENTS_MAX, SESSION_EXPIRY};
use crate::access::{Account, User};

/// Largest number of sessions that outlive their connections; more are refused. Reason: messages wait in memory for
/// each absent client.
pub(super) const REMEMBERED_MAX: usize = 64;

/// Number of these sessions that are reserved for users who may operate the machine or serve M codes.
const REMEMBERED_RESERVED: usize = 24;

/// Maximum number of these sessions for one user. Without users, every client on the computer has all rights,
/// and only the total is limited.
const REMEMBERED_PER_USER_MAX: usize = 24;

/// A session that outlives its connection.
#[derive(Debug)]
struct PersistentSession {
    account: Account,
    /// When the client became absent.
    absent_since: Option<Instant>,
    unreleased: UnreleasedIds,
}

impl PersistentSession {
    fn is_expired(&self) -> bool {
        self.absent_since
            .is_some_and(|since| since.elapsed() >= SESSION_EXPIRY)
    }
}

/// An admitted client.
#[derive(Debug, Clone, Default)]
pub(super) struct AdmittedClient {
    /// Its host.
    pub(super) from: Option<IpAddr>,
    /// `None` if the broker requires no tokens.
    pub(super) user: Option<User>,
    /// Speaks MQTT 5, not 3.1.1.
    pub(super) speaks_5: bool,
    /// The credentials of its user are no longer valid; its connection is being closed.
    pub(super) is_revoked: bool,
}

/// All clients by client id.
#[derive(Debug, Default)]
pub(crate) struct Sessions {
    /// Clients that are admitted but not connected yet.
    admitted: Mutex<HashMap<String, AdmittedClient>>,
    // the latest connection of each client id, and the number of its open connections: a connection that was taken over
    // ends later
    connected: Mutex<HashMap<Arc<str>, (AdmittedClient, u32)>>,
    // sessions that outlive their connections
    remembered: Mutex<HashMap<String, PersistentSession>>,
    // hosts of disconnected clients, the latest last: their earlier messages may not have been read yet
    left: Mutex<VecDeque<(String, IpAddr)>>,
}

impl Sessions {
    /// Remembers a new client if its session outlives its connection; otherwise forgets it. `is_reserved`: its user may
    /// operate the machine or serve M codes.
    ///
    /// # Errors
    /// Returns the limit that is reached, as text.
    pub(super) fn remember(
        &self,
        client_id: &str,
        outlives: bool,
        account: Account,
        is_reserved: bool,
    ) -> Result<(), String> {
        let mut remembered = self.remembered.lock();
        if !outlives {
            remembered.remove(client_id);
            return Ok(());
        }
        if client_id.is_empty() {
            return Err("a session that outlives its connection needs a client id".to_owned());
        }
        let is_known = remembered.get(client_id).is_some_and(|known| !known.is_expired());
        if !is_known {
            let valid = || remembered.values().filter(|session| !session.is_expired());
            let own = valid().filter(|session| session.account == account);
            if matches!(account, Account::User(_)) && own.count() >= REMEMBERED_PER_USER_MAX {
                return Err(format!(
                    "the broker already remembers {REMEMBERED_PER_USER_MAX} disconnected clients of this \
                     user; use a clean session"
                ));
            }
            let reserved = if is_reserved { 0 } else { REMEMBERED_RESERVED };
            let count = valid().count();
            if count + reserved >= REMEMBERED_MAX {
                return Err(format!(
                    "the broker already remembers {count} disconnected clients; use a clean session"
                ));
            }
        }
        let unreleased = remembered.get(client_id).filter(|_| is_known);
        let session = PersistentSession {
            account,
            // the client is treated as absent until it is connected
            absent_since: Some(Instant::now()),
            unreleased: unreleased
                .map(|known| known.unreleased.clone())
                .unwrap_or_default(),
        };
        remembered.insert(client_id.to_owned(), session);
        Ok(())
    }

    /// Returns the unreleased messages of a client's session. `is_new`: the client starts a new session.
    pub(super) fn unreleased(&self, client_id: &str, is_new: bool) -> UnreleasedIds {
        let mut remembered = self.remembered.lock();
        match remembered.get_mut(client_id) {
            Some(session) => {
                if is_new {
                    session.unreleased = UnreleasedIds::default();
                }
                session.unreleased.clone()
            }
            None => UnreleasedIds::default(),
        }
    }

    /// Returns true if the session of a client outlives its connection.
    pub(super) fn is_remembered(&self, client_id: &str) -> bool {
        self.remembered.lock().contains_key(client_id)
    }

    /// Removes expired sessions and returns their client ids.
    pub(super) fn take_expired(&self) -> Vec<String> {
        let mut remembered = self.remembered.lock();
        let expired = remembered.extract_if(|_, session| session.is_expired());
        expired.map(|(client_id, _)| client_id).collect()
    }

    pub(super) fn admit(&self, client_id: &str, session: AdmittedClient) {
        let mut admitted = self.admitted.lock();
        // removes clients that disconnected before the library reported them as connected
        if admitted.len() > 2 * CLIENTS_MAX {
            admitted.clear();
        }
        admitted.insert(client_id.to_owned(), session);
    }

    /// Records that a client is connected. Calls `user` if it was not admitted under this id.
    pub(super) fn connect(&self, client_id: Arc<str>, user: impl FnOnce() -> Option<User>) {
        let admitted = self.admitted.lock().remove(&*client_id);
        if let Some(session) = self.remembered.lock().get_mut(&*client_id) {
            session.absent_since = None;
        }
        let session = admitted.unwrap_or_else(|| AdmittedClient {
            user: user(),
            ..AdmittedClient::default()
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
                let from = connected.remove(client_id).and_then(|(session, _)| session.from);
                self.remember_host(client_id, from);
                if let Some(session) = self.remembered.lock().get_mut(client_id) {
                    session.absent_since = Some(Instant::now());
                }
            }
        }
    }

    fn remember_host(&self, client_id: &str, from: Option<IpAddr>) {
        let mut left = self.left.lock();
        if left.len() >= CLIENTS_MAX {
            left.pop_front();
        }
        left.extend(from.map(|from| (client_id.to_owned(), from)));
    }

    /// Returns the host of a client that is connected or has just disconnected.
    pub(crate) fn address_of(&self, client_id: &str) -> Option<IpAddr> {
        if let Some(session) = self.connected_client(client_id) {
            return session.from;
        }
        let left = self.left.lock();
        let of_client = left.iter().rev().find(|(id, _)| id == client_id);
        of_client.map(|(_, from)| *from)
    }

    /// Returns the ids of all connected clients.
    pub(crate) fn connected(&self) -> Vec<Arc<str>> {
        self.connected.lock().keys().cloned().collect()
    }

    pub(super) fn connected_client(&self, client_id: &str) -> Option<AdmittedClient> {
        let connected = self.connected.lock();
        connected.get(client_id).map(|(session, _)| session.clone())
    }

    /// Records that the credentials of a client are no longer valid; its connection is being closed.
    pub(super) fn revoke(&self, client_id: &str) {
        if let Some((session, _)) = self.connected.lock().get_mut(client_id) {
            session.is_revoked = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::packet_monitor::ExactlyOnce;
    use super::*;

    #[test]
    fn a_connection_that_took_over_another_stays_when_that_has_ended() {
        let sessions = Sessions::default();
        sessions.connect("panel".into(), || None);
        sessions.connect("panel".into(), || Some(User::Anyone));
        sessions.disconnect("panel");
        assert_eq!(
            sessions.connected_client("panel").unwrap().user,
            Some(User::Anyone)
        );
        sessions.disconnect("panel");
        assert!(sessions.connected_client("panel").is_none());
        sessions.disconnect("panel");
    }

    #[test]
    fn addresses_of_disconnected_clients_are_kept_up_to_the_client_limit() {
        let sessions = Sessions::default();
        let host = |n: usize| {
            IpAddr::from([
                10,
                0,
                u8::try_from(n / 256).unwrap(),
                u8::try_from(n % 256).unwrap(),
            ])
        };
        for n in 0..=CLIENTS_MAX {
            let id = n.to_string();
            let session = AdmittedClient {
                from: Some(host(n)),
                ..AdmittedClient::default()
            };
            sessions.admit(&id, session);
            sessions.connect(id.as_str().into(), || None);
            assert_eq!(sessions.address_of(&id), Some(host(n)));
            sessions.disconnect(&id);
            assert_eq!(sessions.address_of(&id), Some(host(n)));
        }
        assert_eq!(sessions.address_of("0"), None, "the first one to leave");
        assert_eq!(sessions.address_of("1"), Some(host(1)));
    }

    #[tokio::test(start_paused = true)]
    async fn sessions_outliving_their_connections_are_bounded_until_they_expire() {
        let sessions = Sessions::default();
        let host = Account::Host(None);
        let remember = |id: &str, outlives| sessions.remember(id, outlives, host.clone(), true).is_ok();
        for n in 0..REMEMBERED_MAX {
            assert!(remember(&n.to_string(), true), "{n}");
        }
        assert!(!remember("one more", true));
        assert!(remember("0", true), "it is known");
        assert!(remember("one more", false), "it leaves nothing");
        assert!(remember("0", false));
        assert!(remember("in its place", true));
        assert!(!remember("", true), "no client could resume it");
        tokio::time::advance(SESSION_EXPIRY).await;
        assert!(remember("when all are removed", true));
    }

    #[tokio::test(start_paused = true)]
    async fn unreleased_messages_last_as_long_as_their_session() {
        let sessions = Sessions::default();
        let remember = |outlives| {
            let account = Account::Host(None);
            sessions.remember("panel", outlives, account, true).unwrap();
        };
        remember(true);
        assert_eq!(sessions.unreleased("panel", true).deliver(7), ExactlyOnce::New);
        remember(true);
        let ids = sessions.unreleased("panel", false);
        assert_eq!(ids.deliver(7), ExactlyOnce::Repeated);
        assert_eq!(sessions.unreleased("panel", true).deliver(7), ExactlyOnce::New);
        tokio::time::advance(SESSION_EXPIRY).await;
        assert_eq!(sessions.take_expired(), ["panel"]);
        remember(true);
        assert_eq!(sessions.unreleased("panel", false).deliver(7), ExactlyOnce::New);
        remember(false);
        assert!(!sessions.is_remembered("panel"));
        assert_eq!(sessions.unreleased("panel", false).deliver(7), ExactlyOnce::New);
    }

    #[tokio::test]
    async fn viewers_leave_sessions_to_users_who_operate_or_handle() {
        let sessions = Sessions::default();
        let user = |name: &str| Account::User(name.to_owned());
        let remembered = |name: &str, is_reserved: bool| {
            let tried = (0..REMEMBERED_MAX).filter(|n| {
                sessions
                    .remember(&format!("{name}-{n}"), true, user(name), is_reserved)
                    .is_ok()
            });
            tried.count()
        };
        let viewers = [remembered("view-1", false), remembered("view-2", false)];
        assert_eq!(
            viewers,
            [
                REMEMBERED_PER_USER_MAX,
                REMEMBERED_MAX - REMEMBERED_RESERVED - REMEMBERED_PER_USER_MAX
            ]
        );
        assert_eq!(remembered("view-3", false), 0);
        assert_eq!(remembered("operate", true), REMEMBERED_RESERVED);
    }
}
