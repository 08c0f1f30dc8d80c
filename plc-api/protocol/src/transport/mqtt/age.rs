//! The age of the machine's presence. A machine whose presence has expired is treated as offline, as if its
//! last will had arrived. Reason: when a node of a broker fails, the node publishes no last wills. The age
//! has no clock: the time is a parameter.

use std::time::{Duration, Instant};

use crate::types::machine::Presence;

/// Age of the last presence. The age increases only while the connection exists, and restarts with each
/// connection.
#[derive(Debug, Default)]
pub(super) struct MachineAge {
    expires: Option<Duration>,
    received: Option<Instant>,
    /// True if the presence has expired and no new presence has arrived since.
    was_missed: bool,
}

impl MachineAge {
    /// Restarts the age after a new connection.
    pub(super) fn restart_age(&mut self, now: Instant) {
        self.received = Some(now);
        self.was_missed = false;
    }

    /// Stops the age when the connection is lost.
    pub(super) fn pause(&mut self) {
        self.received = None;
    }

    /// Records a presence of the machine. A retained presence only shows that the machine was online earlier,
    /// so the age does not restart. Returns true if the presence had expired before: the broker may then have
    /// lost more messages of this connection.
    pub(super) fn record_presence(&mut self, presence: &Presence, retained: bool, now: Instant) -> bool {
        let expires_ms = presence.expires_ms.filter(|_| presence.online);
        self.expires = expires_ms.map(Duration::from_millis);
        if !retained || self.received.is_none() {
            self.received = Some(now);
        }
        !retained && std::mem::take(&mut self.was_missed)
    }

    /// Returns the time at which the presence expires, unless it is renewed.
    pub(super) fn expires_at(&self) -> Option<Instant> {
        Some(self.received? + self.expires?)
    }

    /// Returns true if the presence has expired, but only once until a new presence arrives.
    pub(super) fn take_expiry(&mut self, now: Instant) -> bool {
        let has_ended = self.expires_at().is_some_and(|end| end <= now);
        if has_ended {
            self.expires = None;
            self.was_missed = true;
        }
        has_ended
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn presence(expires_ms: Option<u64>) -> Presence {
        Presence {
            online: true,
            expires_ms,
            ..Presence::default()
        }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn machine_goes_offline_once_when_its_presence_expires_and_can_return() {
        let (mut age, begin) = (MachineAge::default(), Instant::now());
        age.restart_age(begin);
        assert!(!age.record_presence(&presence(Some(900)), true, begin + ms(10)));
        assert!(!age.take_expiry(begin + ms(899)), "from the connection on");
        assert!(age.take_expiry(begin + ms(900)));
        assert!(!age.take_expiry(begin + ms(5000)), "once");
        let again = |age: &mut MachineAge, retained| {
            age.record_presence(&presence(Some(900)), retained, begin + ms(6000))
        };
        assert!(!again(&mut age, true), "a retained presence shows nothing");
        assert!(again(&mut age, false), "it was missed");
        assert!(!again(&mut age, false), "told once");
        assert!(!age.take_expiry(begin + ms(6899)) && age.take_expiry(begin + ms(6900)));
        age.restart_age(begin + ms(7000));
        assert!(!again(&mut age, false), "a new connection has not lost messages");
    }

    #[test]
    fn an_outage_ends_nothing_nor_does_a_machine_that_does_not_say_it_again() {
        let (mut age, begin) = (MachineAge::default(), Instant::now());
        age.restart_age(begin);
        assert!(!age.record_presence(&presence(Some(900)), false, begin));
        age.pause();
        assert!(!age.take_expiry(begin + ms(60_000)));
        age.restart_age(begin + ms(60_000));
        assert!(!age.take_expiry(begin + ms(60_899)) && age.take_expiry(begin + ms(60_900)));
        assert!(
            age.record_presence(&presence(None), false, begin),
            "it was missed"
        );
        assert_eq!(age.expires_at(), None, "an earlier version does not expire");
    }
}
