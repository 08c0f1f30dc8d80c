//! Slots for hold, stop, abort, the end of a jog and alarms, separate from those of all other requests.
//!
//! Each account has one slot for each kind of urgent request and coordinate system. A second request of the same kind waits for
//! the first, in order of arrival, and is never rejected. So no account can delay the urgent requests of another one.

use std::collections::HashMap;
use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::port::BoxFuture;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{Command, Verb};
use plc_protocol::types::request::Request;
use plc_protocol::wire::row::ParsedRequest;
use tokio::sync::OwnedMutexGuard;

use crate::access::Account;
use crate::publisher::Publisher;

/// Executes the urgent requests that the embedded broker receives.
pub(crate) trait ExecuteUrgent: Send + Sync {
    /// Passes a request to the machine. Returns when the machine has received it.
    fn execute(
        self: Arc<Self>,
        publisher: Publisher,
        account: Account,
        parsed: ParsedRequest,
    ) -> BoxFuture<'static, ()>;
}

/// Idle slots that are kept. Reason: a slot in use is never removed, so the number only limits memory.
const IDLE_SLOTS_MAX: usize = 1024;

/// Kind of an urgent request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum UrgentKind {
    /// Hold, stop or abort.
    Verb(Verb),
    /// The end of a jog.
    JogEnd,
    /// An alarm of a handler or a client.
    Alarm,
}

impl UrgentKind {
    /// Returns the kind of a request and its coordinate system (0 for all); `None` if it is not urgent.
    pub(crate) fn of_request(request: &Request) -> Option<(CoordinateSystemNumber, Self)> {
        match request {
            Request::Command {
                cs,
                command: Command::JogEnd { .. },
                ..
            } => Some((*cs, Self::JogEnd)),
            Request::Command { cs, command, .. } if command.is_urgent() => {
                Some((*cs, Self::Verb(command.verb())))
            }
            Request::RaiseAlarm(raise) => Some((raise.cs.unwrap_or(0), Self::Alarm)),
            _ => None,
        }
    }

    /// Returns true for hold, stop and abort.
    pub(crate) fn is_verb(self) -> bool {
        matches!(self, Self::Verb(_))
    }
}

type Key = (Account, CoordinateSystemNumber, UrgentKind);

/// The slots of all accounts.
#[derive(Debug, Default)]
pub(crate) struct UrgentSlots {
    by_key: Mutex<HashMap<Key, Arc<tokio::sync::Mutex<()>>>>,
}

/// A slot in use; dropping it admits the next request.
pub(crate) type UrgentSlot = OwnedMutexGuard<()>;

impl UrgentSlots {
    /// Waits for the slot of an account, in order of arrival.
    pub(crate) async fn enter(
        &self,
        account: Account,
        (cs, kind): (CoordinateSystemNumber, UrgentKind),
    ) -> UrgentSlot {
        let slot = {
            let mut by_key = self.by_key.lock();
            if by_key.len() > IDLE_SLOTS_MAX {
                by_key.retain(|_, slot| Arc::strong_count(slot) > 1);
            }
            Arc::clone(by_key.entry((account, cs, kind)).or_default())
        };
        slot.lock_owned().await
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;

    use super::*;

    fn account(name: &str) -> Account {
        Account::User(name.to_owned())
    }

    const STOP: (CoordinateSystemNumber, UrgentKind) = (1, UrgentKind::Verb(Verb::Stop));

    #[tokio::test]
    async fn one_request_per_account_verb_and_coordinate_system_is_pending() {
        let slots = UrgentSlots::default();
        let first = slots.enter(account("anna"), STOP).now_or_never().unwrap();
        let mut second = Box::pin(slots.enter(account("anna"), STOP));
        assert!((&mut second).now_or_never().is_none(), "it waits for the first");
        for (name, cs, kind) in [
            ("bert", 1, STOP.1),
            ("anna", 2, STOP.1),
            ("anna", 1, UrgentKind::Verb(Verb::Hold)),
            ("anna", 1, UrgentKind::JogEnd),
        ] {
            let other = slots.enter(account(name), (cs, kind)).now_or_never();
            assert!(other.is_some(), "{name} {cs} {kind:?}");
        }
        drop(first);
        assert!(second.now_or_never().is_some());
    }

    #[tokio::test]
    async fn idle_slots_are_removed_and_a_slot_in_use_stays() {
        let slots = UrgentSlots::default();
        let used = slots.enter(account("anna"), STOP).await;
        for n in 0..3 * IDLE_SLOTS_MAX {
            drop(slots.enter(account(&n.to_string()), STOP).await);
        }
        assert!(slots.by_key.lock().len() <= IDLE_SLOTS_MAX + 1);
        assert!(slots.enter(account("anna"), STOP).now_or_never().is_none());
        drop(used);
    }
}
