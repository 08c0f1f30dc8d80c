//! Who is connected to the embedded broker, and the end of a session whose token counts no more.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use mqtt5::broker::events::ClientConnectEvent;
use parking_lot::Mutex;
use rumqttc::{AsyncClient, Event, MqttOptions, Packet, QoS};
use tokio::time::Instant;
use tracing::warn;

use super::{CLIENTS_MAX, SESSION_EXPIRY};
use crate::access::{Rate, Tokens, User};

/// Tries with a wrong token from one address: at once, and a second after that; more are told to come later.
const WRONG_BURST: u32 = 50;
const WRONG_PER_SECOND: u32 = 10;

/// Addresses whose wrong tries are counted; the count of all is forgotten when there are more.
const WRONG_ADDRESSES_MAX: usize = 1024;

/// Sessions that outlive their connections; more are refused. Reason: messages wait in memory for each that is away.
pub(super) const REMEMBERED_MAX: usize = 64;

/// Time to end a session.
const END_MAX: Duration = Duration::from_secs(2);

/// A connected client.
#[derive(Debug, Clone)]
pub(super) struct Session {
    /// `None`: no tokens are asked for, or the runtime itself.
    pub(super) user: Option<User>,
    /// False for a client of MQTT 3.1.1, and where nothing is known.
    pub(super) speaks_5: bool,
    will: Option<Will>,
}

/// A client that is let in.
#[derive(Debug)]
pub(super) struct Admitted {
    pub(super) user: Option<User>,
    pub(super) speaks_5: bool,
}

#[derive(Debug, Clone)]
struct Will {
    topic: String,
    payload: Vec<u8>,
    retain: bool,
}

/// All clients by client id.
#[derive(Debug, Default)]
pub(super) struct Sessions {
    /// Let in, and not connected yet.
    admitted: Mutex<HashMap<String, Admitted>>,
    // the latest connection of each client id, and how many have not ended: one that is taken over ends later
    connected: Mutex<HashMap<Arc<str>, (Session, u32)>>,
    wrong: Mutex<HashMap<IpAddr, Rate>>,
    // sessions that outlive their connections, and since when each is away
    remembered: Mutex<HashMap<String, Option<Instant>>>,
}

impl Sessions {
    /// Counts a try with a wrong token. False beyond the rate of its address.
    pub(super) fn count_wrong(&self, address: IpAddr) -> bool {
        let mut wrong = self.wrong.lock();
        if wrong.len() >= WRONG_ADDRESSES_MAX && !wrong.contains_key(&address) {
            wrong.clear();
        }
        let new = || Rate::new(WRONG_BURST, WRONG_PER_SECOND);
        wrong.entry(address).or_insert_with(new).take().is_ok()
    }

    /// Counts a client that comes, whose session outlives its connection or does not. False beyond the limit.
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
        // away until it is connected
        remembered.insert(client_id.to_owned(), Some(Instant::now()));
        true
    }

    pub(super) fn admit(&self, client_id: &str, client: Admitted) {
        let mut admitted = self.admitted.lock();
        // those that were let in and went before they were connected
        if admitted.len() > 2 * CLIENTS_MAX {
            admitted.clear();
        }
        admitted.insert(client_id.to_owned(), client);
    }

    /// A client is connected; where nobody noted whom the broker let in, `user` is asked.
    pub(super) fn connect(&self, event: ClientConnectEvent, user: impl FnOnce() -> Option<User>) {
        let admitted = self.admitted.lock().remove(&*event.client_id);
        if let Some(away) = self.remembered.lock().get_mut(&*event.client_id) {
            *away = None;
        }
        let will = event
            .will_topic
            .zip(event.will_payload)
            .map(|(topic, payload)| Will {
                topic: topic.to_string(),
                payload: payload.to_vec(),
                retain: event.will_retain.unwrap_or(false),
            });
        let session = Session {
            speaks_5: admitted.as_ref().is_some_and(|client| client.speaks_5),
            user: admitted.and_then(|client| client.user).or_else(user),
            will,
        };
        let mut connected = self.connected.lock();
        let count = connected.get(&event.client_id).map_or(0, |(_, count)| *count);
        connected.insert(event.client_id, (session, count + 1));
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

    pub(super) fn of(&self, client_id: &str) -> Option<Session> {
        let connected = self.connected.lock();
        connected.get(client_id).map(|(session, _)| session.clone())
    }

    /// Sessions of tokens that are not in the list any more, or have another role there.
    pub(super) fn revoked(&self, tokens: &Tokens) -> Vec<(Arc<str>, Session)> {
        let connected = self.connected.lock();
        let revoked = connected
            .iter()
            .filter(|(_, (session, _))| session.user.as_ref().is_some_and(|user| !tokens.has(user)));
        revoked
            .map(|(client_id, (session, _))| (Arc::clone(client_id), session.clone()))
            .collect()
    }
}

/// Ends a session: a second connection with its client id ends the first, and this one says the will of that, since a
/// user who is not known any more may say nothing.
pub(super) async fn end(
    broker: SocketAddr,
    credentials: &(String, String),
    client_id: &str,
    session: Session,
) {
    let mut options = MqttOptions::new(client_id, broker.ip().to_string(), broker.port());
    options
        .set_credentials(&credentials.0, &credentials.1)
        .set_clean_session(true)
        .set_keep_alive(Duration::from_secs(5));
    let (client, mut events) = AsyncClient::new(options, 8);
    let ended = tokio::time::timeout(END_MAX, async {
        loop {
            match events.poll().await? {
                Event::Incoming(Packet::ConnAck(_)) => match &session.will {
                    Some(will) => {
                        let payload = will.payload.clone();
                        client
                            .publish(&will.topic, QoS::AtLeastOnce, will.retain, payload)
                            .await?;
                    }
                    None => client.disconnect().await?,
                },
                Event::Incoming(Packet::PubAck(_)) => client.disconnect().await?,
                Event::Outgoing(rumqttc::Outgoing::Disconnect) => {
                    return Ok::<(), Box<dyn std::error::Error + Send + Sync>>(());
                }
                _ => {}
            }
        }
    })
    .await;
    let name = session.user.and_then(|user| user.name).unwrap_or_default();
    match ended {
        Ok(Ok(())) => {
            warn!("MQTT client {client_id:.64} of {name} is disconnected: its token counts no more");
        }
        Ok(Err(error)) => warn!(
            "MQTT client {client_id:.64} of {name}, whose token counts no more, is not disconnected: {error}"
        ),
        Err(_) => warn!(
            "MQTT client {client_id:.64} of {name}, whose token counts no more, is not disconnected in time"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connection_that_took_over_another_stays_when_that_has_ended() {
        let sessions = Sessions::default();
        let connect = || ClientConnectEvent {
            client_id: "panel".into(),
            user_id: None,
            clean_start: true,
            session_expiry_interval: 0,
            will_topic: None,
            will_payload: None,
            will_qos: None,
            will_retain: None,
        };
        sessions.connect(connect(), || None);
        sessions.connect(connect(), || Some(User::anyone()));
        sessions.disconnect("panel");
        assert_eq!(sessions.of("panel").unwrap().user, Some(User::anyone()));
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

    #[tokio::test(start_paused = true)]
    async fn wrong_tries_are_counted_by_address() {
        let sessions = Sessions::default();
        let (one, other) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        for _ in 0..WRONG_BURST {
            assert!(sessions.count_wrong(one));
        }
        assert!(!sessions.count_wrong(one));
        assert!(sessions.count_wrong(other));
        tokio::time::advance(Duration::from_secs(1)).await;
        assert!((0..WRONG_PER_SECOND).all(|_| sessions.count_wrong(one)));
        assert!(!sessions.count_wrong(one));
        for n in 0..u32::try_from(2 * WRONG_ADDRESSES_MAX).unwrap() {
            sessions.count_wrong(IpAddr::from(n.to_be_bytes()));
        }
        assert!(sessions.wrong.lock().len() <= WRONG_ADDRESSES_MAX);
    }
}
