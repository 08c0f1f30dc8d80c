//! Ages of handlers' presences. A handler repeats its presence. If the latest one is too old, the handler is treated as
//! offline, as after its last will: a node of a broker that fails publishes no last wills.
//!
//! Pure; the time is a parameter. The age starts at the arrival of a message, runs only while the receiver is
//! connected, and restarts with each connection. A retained presence does not renew it: it only shows that the handler
//! was online earlier.

use std::collections::BTreeMap;
use std::time::Duration;

use plc_protocol::handler_registry::HANDLERS_MAX;
use plc_protocol::types::output::HandlerPresence;
use tokio::time::Instant;

/// Largest number of watched presences. Reason: for each handler, the current instance and one that waits to replace
/// it.
const WATCHED_MAX: usize = 2 * HANDLERS_MAX;

/// A handler and its instance.
pub(crate) type HandlerInstance = (String, Option<String>);

/// Presences that expire.
#[derive(Debug, Default)]
pub(crate) struct PresenceAges {
    ages: BTreeMap<HandlerInstance, Age>,
    /// There is no connection, so no age increases.
    is_paused: bool,
}

/// Age of a presence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Age {
    expires: Duration,
    received: Instant,
    /// On this connection, a presence with the retain flag was published before the connection began.
    may_be_retained: bool,
}

impl PresenceAges {
    /// Records a received presence.
    pub(crate) fn record_presence(
        &mut self,
        id: &str,
        presence: &HandlerPresence,
        retain: bool,
        now: Instant,
    ) {
        let named = (id.to_owned(), presence.instance.clone());
        let Some(expires_ms) = presence.expires_ms.filter(|_| presence.online) else {
            self.ages.remove(&named);
            return;
        };
        let expires = Duration::from_millis(expires_ms);
        let has_room = self.ages.len() < WATCHED_MAX;
        match self.ages.get_mut(&named) {
            Some(age) if retain && age.may_be_retained => age.may_be_retained = false,
            Some(age) => *age = Age::new(expires, now),
            None if has_room => {
                self.ages.insert(named, Age::new(expires, now));
            }
            None => {}
        }
    }

    /// Returns the age of the presence of an instance.
    pub(crate) fn age(&self, id: &str, instance: Option<&String>) -> Option<Age> {
        self.ages.get(&(id.to_owned(), instance.cloned())).copied()
    }

    /// Replaces the age `refused` by the age before it, unless a later presence has replaced it.
    pub(crate) fn restore(
        &mut self,
        id: &str,
        instance: Option<&String>,
        refused: Option<Age>,
        earlier: Option<Age>,
    ) {
        if self.age(id, instance) != refused {
            return;
        }
        let named = (id.to_owned(), instance.cloned());
        match earlier {
            Some(age) => self.ages.insert(named, age),
            None => self.ages.remove(&named),
        };
    }

    /// Returns `false` if the limit is reached and this presence is not watched yet.
    pub(crate) fn has_room(&self, id: &str, presence: &HandlerPresence) -> bool {
        let named = (id.to_owned(), presence.instance.clone());
        self.ages.len() < WATCHED_MAX || self.ages.contains_key(&named)
    }

    /// Restarts all ages after a reconnect, because no presence could arrive in the meantime.
    pub(crate) fn restart_ages(&mut self, now: Instant) {
        self.is_paused = false;
        for age in self.ages.values_mut() {
            age.received = now;
            age.may_be_retained = true;
        }
    }

    /// Stops all ages: the connection is lost.
    pub(crate) fn pause(&mut self) {
        self.is_paused = true;
    }

    /// Returns when the first presence expires if it is not renewed.
    pub(crate) fn next_expiry(&self) -> Option<Instant> {
        let ages = self.ages.values().filter(|_| !self.is_paused);
        ages.map(Age::expires_at).min()
    }

    /// Removes and returns the expired presences.
    pub(crate) fn take_expired(&mut self, now: Instant) -> Vec<HandlerInstance> {
        let is_paused = self.is_paused;
        let ended = self
            .ages
            .extract_if(.., |_, age| !is_paused && age.expires_at() <= now);
        ended.map(|(named, _)| named).collect()
    }
}

impl Age {
    fn new(expires: Duration, received: Instant) -> Self {
        Self {
            expires,
            received,
            may_be_retained: false,
        }
    }

    fn expires_at(&self) -> Instant {
        self.received + self.expires
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn presence(expires_ms: Option<u64>) -> HandlerPresence {
        HandlerPresence {
            online: true,
            instance: Some("a".to_owned()),
            expires_ms,
            ..HandlerPresence::default()
        }
    }

    fn cell() -> Vec<HandlerInstance> {
        vec![("cell".to_owned(), Some("a".to_owned()))]
    }

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_presence_ends_at_its_age_unless_it_is_said_again_or_taken_back() {
        let (mut ages, begin) = (PresenceAges::default(), Instant::now());
        ages.record_presence("cell", &presence(Some(900)), false, begin);
        ages.record_presence("old", &presence(None), false, begin);
        ages.record_presence("cell", &presence(Some(900)), false, begin + ms(300));
        assert_eq!(ages.next_expiry(), Some(begin + ms(1200)));
        assert_eq!(ages.take_expired(begin + ms(1199)), []);
        assert_eq!(ages.take_expired(begin + ms(1200)), cell());
        assert_eq!(ages.next_expiry(), None, "without an age there is no end");
        ages.record_presence("cell", &presence(Some(900)), false, begin);
        let gone = HandlerPresence::offline(Some("a".to_owned()));
        ages.record_presence("cell", &gone, false, begin);
        assert_eq!(ages.next_expiry(), None);
    }

    #[test]
    fn an_outage_ends_nothing_and_a_retained_presence_renews_nothing() {
        let (mut ages, begin) = (PresenceAges::default(), Instant::now());
        ages.record_presence("cell", &presence(Some(900)), false, begin);
        ages.pause();
        assert_eq!(
            (ages.next_expiry(), ages.take_expired(begin + ms(30_000))),
            (None, vec![])
        );
        let connected = begin + ms(60_000);
        ages.restart_ages(connected);
        assert_eq!(ages.take_expired(connected + ms(899)), []);
        ages.record_presence("cell", &presence(Some(900)), true, connected + ms(500));
        assert_eq!(
            ages.next_expiry(),
            Some(connected + ms(900)),
            "the broker had retained it"
        );
        ages.record_presence("cell", &presence(Some(900)), true, connected + ms(800));
        assert_eq!(
            ages.next_expiry(),
            Some(connected + ms(1700)),
            "the presence was repeated"
        );
    }

    #[test]
    fn handler_known_by_retained_presence_has_its_expiry_to_repeat_it() {
        let (mut ages, begin) = (PresenceAges::default(), Instant::now());
        ages.restart_ages(begin);
        ages.record_presence("cell", &presence(Some(900)), true, begin + ms(5));
        assert_eq!(ages.take_expired(begin + ms(905)), cell());
    }

    #[test]
    fn the_presences_that_are_watched_are_bounded() {
        let (mut ages, begin) = (PresenceAges::default(), Instant::now());
        for n in 0..WATCHED_MAX + 5 {
            ages.record_presence(&n.to_string(), &presence(Some(900)), false, begin);
        }
        assert_eq!(ages.take_expired(begin + ms(900)).len(), WATCHED_MAX);
    }
}
