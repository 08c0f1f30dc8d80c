//! Levels that a program has set: sources of interlocks and start locks, and inputs and outputs of the plant.
//! While the program serves the machine, its handler owns these levels. After each new announcement of the
//! handler's presence, all levels are written again.

use std::collections::BTreeMap;
use std::sync::Mutex;

use plc_protocol::error::Result;
use plc_protocol::lock::lock;
use plc_protocol::port::{Port, RETRY};
use plc_protocol::types::io::{IoPoint, IoSet, IoValue};
use plc_protocol::types::lock::LockSet;
use plc_protocol::types::request::{Input, Request};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use tokio::sync::watch;

use crate::identity::Identity;

/// Kind of a lock input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LockKind {
    Interlock,
    StartLock,
}

impl LockKind {
    fn input(self, set: LockSet) -> Input {
        match self {
            LockKind::Interlock => Input::Interlock(set),
            LockKind::StartLock => Input::StartLock(set),
        }
    }
}

/// Port of the machine, and the name in which requests are sent to the machine.
type Asking<'a> = (&'a dyn Port, &'a str);

/// The target of a level: one source of an input of a coordinate system, or an input or output of the plant.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LevelTarget {
    Lock(CoordinateSystemNumber, LockKind, String),
    Io(IoPoint),
}

/// The value of a level.
#[derive(Debug, Clone)]
enum LevelValue {
    Lock(LockSet),
    Io(IoValue),
}

/// Returns the request that sets a level in the name of the handler `owner`.
fn request(place: &LevelTarget, level: LevelValue, owner: Option<&Identity>) -> Option<Request> {
    let handler_id = owner.map(Identity::id);
    let instance = owner.map(Identity::instance);
    match (place, level) {
        (LevelTarget::Lock(cs, kind, _), LevelValue::Lock(set)) => {
            let set = LockSet {
                handler_id,
                instance,
                ..set
            };
            Some(Request::Input(*cs, kind.input(set)))
        }
        (LevelTarget::Io(point), LevelValue::Io(value)) => {
            let set = IoSet {
                value,
                handler_id,
                instance,
            };
            Some(Request::WriteIo(point.clone(), set))
        }
        _ => None,
    }
}

/// The handler that owns the levels, of a program that serves the machine.
#[derive(Debug, Clone)]
struct LevelOwner {
    by: Identity,
    /// Boot of the machine that has accepted the handler; `None` before the acceptance.
    known_in: Option<BootId>,
}

/// Levels that a program has set, with their owner.
#[derive(Debug, Default)]
pub(crate) struct Levels {
    set: Mutex<BTreeMap<LevelTarget, LevelValue>>,
    /// Number of lock guards that keep each source on.
    held: Mutex<BTreeMap<LevelTarget, usize>>,
    owner: watch::Sender<Option<LevelOwner>>,
    /// Serializes the writes, so that each write sends the current value.
    turn: tokio::sync::Mutex<()>,
}

impl Levels {
    /// Returns true while a program serves the machine.
    pub(crate) fn has_owner(&self) -> bool {
        self.owner.borrow().is_some()
    }

    /// Sets the owner of the levels that are set from now on: a handler that starts to serve the machine.
    pub(crate) fn set_owner(&self, by: &Identity) {
        self.owner.send_replace(Some(LevelOwner {
            by: by.clone(),
            known_in: None,
        }));
    }

    /// Removes the owner after the handler has ended.
    pub(crate) fn clear_owner(&self) {
        self.owner.send_replace(None);
    }

    /// Waits until this boot of the machine has accepted the handler that owns the levels.
    pub(crate) async fn wait_until_announced(&self, boot: &BootId) {
        let mut owner = self.owner.subscribe();
        let known = owner.wait_for(|owner| {
            owner
                .as_ref()
                .is_some_and(|owner| owner.known_in.as_ref() == Some(boot))
        });
        // the wait cannot fail, because `self` owns the sender
        let _is_there = known.await.is_ok();
    }

    /// Returns the handler that owns the levels, or `None` until the machine has accepted the handler.
    pub(crate) fn owner(&self) -> Option<Identity> {
        let owner = self.owner.borrow();
        let known = owner.as_ref().filter(|owner| owner.known_in.is_some());
        known.map(|owner| owner.by.clone())
    }

    /// Writes all levels to this boot of the machine, after the machine has accepted the presence of the
    /// handler.
    pub(crate) async fn write_all(&self, asking: Asking<'_>, boot: &BootId) {
        self.owner.send_modify(|owner| {
            if let Some(owner) = owner {
                owner.known_in = Some(boot.clone());
            }
        });
        let places: Vec<_> = lock(&self.set).keys().cloned().collect();
        for place in places {
            if let Err(error) = self.write(asking, &place).await {
                tracing::warn!(%error, ?place, "a level was not written again");
            }
        }
    }

    /// Counts one more lock guard of a source.
    pub(crate) fn begin_hold(&self, place: LevelTarget) {
        *lock(&self.held).entry(place).or_default() += 1;
    }

    /// Counts one lock guard of a source less; returns true if no guard of the source remains.
    pub(crate) fn end_hold(&self, place: &LevelTarget) -> bool {
        let mut held = lock(&self.held);
        let left = held.get(place).map_or(0, |count| count - 1);
        if left == 0 {
            held.remove(place);
        } else {
            held.insert(place.clone(), left);
        }
        left == 0
    }

    /// Sets a source of an interlock or a start lock.
    ///
    /// # Errors
    /// Fails if the machine refuses the level. While a program serves the machine, waits until the machine
    /// can be reached.
    pub(crate) async fn set(
        &self,
        asking: Asking<'_>,
        cs: CoordinateSystemNumber,
        kind: LockKind,
        set: LockSet,
    ) -> Result<()> {
        let place = LevelTarget::Lock(cs, kind, set.source().to_owned());
        self.set_level(asking, place, LevelValue::Lock(set)).await
    }

    /// Writes an input or output of the plant.
    ///
    /// # Errors
    /// Fails like [`set`](Self::set).
    pub(crate) async fn set_io(&self, asking: Asking<'_>, point: IoPoint, value: IoValue) -> Result<()> {
        self.set_level(asking, LevelTarget::Io(point), LevelValue::Io(value))
            .await
    }

    async fn set_level(&self, asking: Asking<'_>, place: LevelTarget, level: LevelValue) -> Result<()> {
        lock(&self.set).insert(place.clone(), level);
        let written = self.write(asking, &place).await;
        if written.is_err() {
            lock(&self.set).remove(&place);
        }
        written
    }

    async fn write(&self, (port, name): Asking<'_>, place: &LevelTarget) -> Result<()> {
        loop {
            let mut owner = self.owner.subscribe();
            // the wait cannot fail, because `self` owns the sender
            let ready = owner.wait_for(|owner| owner.as_ref().is_none_or(|owner| owner.known_in.is_some()));
            let owner = ready.await.ok().and_then(|owner| owner.clone());
            let turn = self.turn.lock().await;
            let level = lock(&self.set).get(place).cloned();
            let by = owner.as_ref().map(|owner| &owner.by);
            let Some(request) = level.and_then(|level| request(place, level, by)) else {
                return Ok(());
            };
            let answer = port.request_as(name, request).await;
            drop(turn);
            match answer {
                Err(refusal) if refusal.code.may_pass() && self.has_owner() => {
                    tracing::warn!(%refusal, "a level is not written yet");
                    port.sleep(RETRY).await;
                }
                answer => return Ok(answer.map(drop)?),
            }
        }
    }
}
