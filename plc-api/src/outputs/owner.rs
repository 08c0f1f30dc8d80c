//! The owner of the outputs of a raw queue: a named handler that the machine knows.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::claim::OutputId;
use crate::error::{Error, Result};
use crate::lock::lock;
use crate::plc::Plc;
use crate::presence::{Event, Gone, Presence};
use crate::types::request::Refusal;

/// What was given out and is not dropped yet; true while it is claimed and not answered.
type Held = Arc<Mutex<BTreeMap<OutputId, bool>>>;

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
    /// The machine is told of it, and again whenever it must be told, from a task.
    pub(super) fn start(presence: Presence) -> Self {
        let (known, is_known) = watch::channel(None);
        let held = Held::default();
        Self {
            held: Arc::clone(&held),
            known: is_known,
            gone: presence.gone(),
            presence: tokio::spawn(keep(presence, held, known)),
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

    pub(super) fn hold(&self, id: &OutputId, claimed: bool) {
        lock(&self.held).insert(id.clone(), claimed);
    }

    /// Forgets an output; true when it was claimed and not answered.
    pub(super) fn forget(&self, id: &OutputId) -> bool {
        lock(&self.held).remove(id).unwrap_or(false)
    }

    pub(super) fn holds(&self, id: &OutputId) -> bool {
        lock(&self.held).contains_key(id)
    }
}

/// Keeps the machine informed that the queue is there, until it ends or does not take it.
async fn keep(
    mut presence: Presence,
    held: Held,
    known: watch::Sender<Option<std::result::Result<(), Refusal>>>,
) {
    loop {
        match presence.next().await {
            Ok(None) => return,
            Ok(Some(Event::Announced)) => {
                known.send_replace(Some(Ok(())));
            }
            Ok(Some(Event::Said(..))) => {
                for (id, m) in presence.lost() {
                    if lock(&held).get(&id) == Some(&true) {
                        presence.reclaim(id, m);
                    }
                }
            }
            Ok(Some(Event::Reclaimed(id, is_ours))) => {
                if let Some(claimed) = lock(&held).get_mut(&id) {
                    *claimed &= is_ours;
                }
            }
            Err(refusal) => {
                known.send_replace(Some(Err(refusal)));
                return;
            }
        }
    }
}
