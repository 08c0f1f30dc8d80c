//! Handlers that registered by an HTTP request. Only the age of its presence shows whether such a handler is online.

use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::server::ServerTransport;
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use tokio::sync::Notify;
use tokio::time::Instant;
use tracing::warn;

use crate::machine::Machine;
use crate::presence_ages::{Age, PresenceAges};

/// Delay of the watch above which this process is treated as stalled. Reason: requests that arrived meanwhile are not
/// read yet, so the ages of all presences restart.
const STALL: Duration = Duration::from_millis(200);

/// Handlers that registered over HTTP.
#[derive(Debug, Default)]
pub(crate) struct Registrations {
    ages: Mutex<PresenceAges>,
    changed: Notify,
}

/// A registration that the machine has not accepted yet.
#[derive(Debug)]
pub(crate) struct RegistrationChange {
    earlier: Option<Age>,
    begun: Option<Age>,
}

impl Registrations {
    /// Watches the age of a presence that will be sent to the machine. Returns the change, which must be undone if the
    /// machine refuses the presence.
    ///
    /// # Errors
    /// Returns `unavailable` if the limit of watched presences is reached.
    pub(crate) fn add_registration(
        &self,
        id: &str,
        presence: &HandlerPresence,
    ) -> Result<RegistrationChange, Refusal> {
        let mut ages = self.ages.lock();
        if !ages.has_room(id, presence) {
            let text =
                "too many handlers are registered over HTTP; end some, or wait until their presences expire";
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let earlier = ages.age(id, presence.instance.as_ref());
        ages.record_presence(id, presence, false, Instant::now());
        self.changed.notify_one();
        Ok(RegistrationChange {
            earlier,
            begun: ages.age(id, presence.instance.as_ref()),
        })
    }

    /// Watches the earlier presence again: the machine has refused the later one, and the earlier one is still valid.
    pub(crate) fn undo(&self, id: &str, instance: Option<&String>, change: &RegistrationChange) {
        let mut ages = self.ages.lock();
        ages.restore(id, instance, change.begun, change.earlier);
        self.changed.notify_one();
    }

    /// Ends the watch: the handler has left.
    pub(crate) fn remove_registration(&self, id: &str, instance: Option<&String>) {
        let gone = HandlerPresence::offline(instance.cloned());
        self.ages.lock().record_presence(id, &gone, false, Instant::now());
    }

    /// Reports handlers whose presence expires, until it is dropped.
    pub(crate) async fn watch(&self, machine: &Machine) {
        loop {
            let next = self.ages.lock().next_expiry();
            tokio::select! {
                () = self.changed.notified() => continue,
                () = tokio::time::sleep_until(next.unwrap_or_else(Instant::now)), if next.is_some() => {}
            }
            let now = Instant::now();
            if next.is_some_and(|due| now.duration_since(due) > STALL) {
                self.ages.lock().restart_ages(now);
                continue;
            }
            let ended = self.ages.lock().take_expired(now);
            for (id, instance) in ended {
                warn!("handler {id:?} did not register again within its expires_ms and is lost");
                let gone = Machine::offline_report(id, instance, ServerTransport::Rest);
                // fails if the runtime is stopping
                let _ = machine.execute_request(gone).await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use plc_protocol::types::request::Request;

    use super::*;
    use crate::tests::StubPort;

    fn presence(expires_ms: u64) -> HandlerPresence {
        HandlerPresence {
            online: true,
            instance: Some("a".to_owned()),
            expires_ms: Some(expires_ms),
            ..HandlerPresence::default()
        }
    }

    /// Returns the handlers that were reported as offline.
    fn offline_handlers(port: &StubPort) -> Vec<String> {
        let asked = port.asked();
        let gone = asked.into_iter().filter_map(|request| match request {
            Request::Handler(id, presence) if !presence.online => Some(id),
            _ => None,
        });
        gone.collect()
    }

    #[tokio::test(start_paused = true)]
    async fn a_registration_ends_at_its_age_unless_it_is_repeated() {
        let port = StubPort::new();
        let machine = Machine::new(port.clone());
        let registrations = Registrations::default();
        let test = async {
            registrations.add_registration("cell", &presence(900)).unwrap();
            registrations.add_registration("left", &presence(900)).unwrap();
            registrations.remove_registration("left", Some(&"a".to_owned()));
            tokio::time::sleep(Duration::from_millis(800)).await;
            registrations.add_registration("cell", &presence(900)).unwrap();
            tokio::time::sleep(Duration::from_millis(899)).await;
            assert_eq!(offline_handlers(&port), <[&str; 0]>::default());
            tokio::time::sleep(Duration::from_millis(2)).await;
            assert_eq!(offline_handlers(&port), ["cell"]);
        };
        tokio::select! {
            () = registrations.watch(&machine) => {}
            () = test => {}
        }
    }

    #[tokio::test(start_paused = true)]
    async fn refused_registration_leaves_the_age_of_the_earlier_one() {
        let port = StubPort::new();
        let machine = Machine::new(port.clone());
        let registrations = Registrations::default();
        let instance = "a".to_owned();
        let test = async {
            registrations.add_registration("cell", &presence(900)).unwrap();
            tokio::time::sleep(Duration::from_millis(800)).await;
            let refused = registrations.add_registration("cell", &presence(60_000)).unwrap();
            registrations.undo("cell", Some(&instance), &refused);
            let new = registrations.add_registration("new", &presence(50)).unwrap();
            registrations.undo("new", Some(&instance), &new);
            tokio::time::sleep(Duration::from_millis(102)).await;
            assert_eq!(offline_handlers(&port), ["cell"]);
        };
        tokio::select! {
            () = registrations.watch(&machine) => {}
            () = test => {}
        }
    }
}
