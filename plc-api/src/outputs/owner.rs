//! Who owns the outputs of a raw queue: a handler of one name, which the machine knows of.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::error::{Error, Result};
use crate::handlers::until_answered;
use crate::hub::{Filter, Subscription};
use crate::plc::Plc;
use crate::presence::{Gone, gone, here, tell};
use crate::types::message::{Message, Payload};
use crate::types::output::{Claim, HandledCode, HandshakeStatus, OutputState, Pending};
use crate::types::request::{Refusal, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber};

/// An output across boots.
pub(super) type Key = (BootId, CoordinateSystemNumber, u64);

/// What was given out and is not dropped yet; true while it is claimed and not answered.
type Held = Arc<Mutex<BTreeMap<Key, bool>>>;

/// What the queue and its outputs share; the machine is told that they have gone with the last of them.
#[derive(Debug)]
pub(super) struct Owner {
    held: Held,
    known: watch::Receiver<Option<std::result::Result<(), Refusal>>>,
    presence: JoinHandle<()>,
    gone: Gone,
}

impl Drop for Owner {
    fn drop(&mut self) {
        self.presence.abort();
    }
}

impl Owner {
    /// Tells the machine of it, and again whenever it must be told, from a task.
    pub(super) fn start(plc: &Plc, handler_id: Arc<str>, codes: Option<BTreeSet<u16>>) -> Self {
        let (known, is_known) = watch::channel(None);
        let held = Held::default();
        let keeper = Keeper {
            plc: plc.clone(),
            handler_id: Arc::clone(&handler_id),
            codes: codes.unwrap_or_default(),
            held: Arc::clone(&held),
            boot: None,
            systems: Vec::new(),
            is_told: false,
        };
        let said = plc.port().subscribe(Filter::Handshake);
        Self {
            held,
            known: is_known,
            presence: tokio::spawn(keeper.run(said, known)),
            gone: Gone {
                plc: plc.clone(),
                handler_id,
            },
        }
    }

    /// Waits until the machine knows of it.
    pub(super) async fn known(&self) -> Result<()> {
        let mut known = self.known.clone();
        let told = known.wait_for(Option::is_some).await;
        let told = told.map_err(|_| Error::Closed)?.clone();
        Ok(told.unwrap_or(Ok(()))?)
    }

    pub(super) fn plc(&self) -> &Plc {
        &self.gone.plc
    }

    pub(super) fn handler_id(&self) -> &str {
        &self.gone.handler_id
    }

    pub(super) fn hold(&self, key: &Key, claimed: bool) {
        lock(&self.held).insert(key.clone(), claimed);
    }

    /// Forgets an output; true when it was claimed and not answered.
    pub(super) fn forget(&self, key: &Key) -> bool {
        lock(&self.held).remove(key).unwrap_or(false)
    }

    pub(super) fn holds(&self, key: &Key) -> bool {
        lock(&self.held).contains_key(key)
    }
}

/// Keeps the machine informed that the queue is there.
struct Keeper {
    plc: Plc,
    handler_id: Arc<str>,
    codes: BTreeSet<u16>,
    held: Held,
    // the boot that is online now
    boot: Option<BootId>,
    systems: Vec<CoordinateSystemNumber>,
    // the machine knew of it once
    is_told: bool,
}

impl Keeper {
    async fn run(
        mut self,
        mut said: Subscription,
        known: watch::Sender<Option<std::result::Result<(), Refusal>>>,
    ) {
        while let Some(message) = said.next().await {
            if self.must_tell(&message) {
                let told = self.tell().await;
                let is_refused = told.is_err();
                known.send_replace(Some(told));
                if is_refused {
                    return;
                }
            }
            if let (Topic::CoordinateSystem(cs, CsTopic::Pending), Payload::Pending(pending)) =
                (&message.topic, &message.payload)
            {
                self.claim_again(&message.boot_id, *cs, pending).await;
            }
        }
    }

    fn must_tell(&mut self, message: &Message) -> bool {
        match (&message.topic, &message.payload) {
            (_, Payload::Presence(presence)) => {
                let boot = presence.online.then(|| message.boot_id.clone());
                let is_new = boot.is_some() && boot != self.boot;
                self.boot = boot;
                is_new && !self.systems.is_empty()
            }
            (_, Payload::Birth(birth)) => {
                let systems: Vec<_> = birth.coordinate_systems.iter().map(|cs| cs.number).collect();
                let is_new = systems != self.systems;
                self.systems = systems;
                is_new && self.boot.is_some()
            }
            // the last will of a connection that is no more came after this queue was announced
            (Topic::HandlerPresence(id), Payload::HandlerPresence(presence)) => {
                self.is_told && **id == *self.handler_id && !presence.online
            }
            _ => false,
        }
    }

    async fn tell(&mut self) -> std::result::Result<(), Refusal> {
        // claims of an earlier program of the same name that died unseen are given back first
        if !std::mem::replace(&mut self.is_told, true) {
            tell(&self.plc, &self.handler_id, gone()).await?;
        }
        let codes = &self.codes;
        let handles = self.systems.iter();
        let handles = handles.flat_map(|&cs| codes.iter().map(move |&m| HandledCode { cs, m }));
        tell(&self.plc, &self.handler_id, here(handles.collect(), false)).await
    }

    /// Only the connection was lost: takes back what is still worked on.
    async fn claim_again(&self, boot_id: &BootId, cs: CoordinateSystemNumber, pending: &Pending) {
        let lost = pending.outputs.iter();
        for output in lost.filter(|output| output.lost && output.state == OutputState::Output) {
            let (seq, m) = (output.output.seq, output.output.m);
            let key = (boot_id.clone(), cs, seq);
            if lock(&self.held).get(&key) != Some(&true) {
                continue;
            }
            let claim = Claim {
                boot_id: boot_id.clone(),
                seq,
                handler_id: self.handler_id.to_string(),
            };
            let status = until_answered(&self.plc, || Request::Claim(cs, Some(m), claim.clone())).await;
            if status != Some(HandshakeStatus::Accepted)
                && let Some(claimed) = lock(&self.held).get_mut(&key)
            {
                *claimed = false;
            }
        }
    }
}

fn lock(held: &Held) -> MutexGuard<'_, BTreeMap<Key, bool>> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}
