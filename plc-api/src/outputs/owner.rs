//! The named handler that owns the outputs of a raw queue.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use plc_protocol::error::{Error, Result};
use plc_protocol::lock::lock;
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::claim::OutputId;
use crate::handler_session::{Event, HandlerSession, OfflineGuard};
use crate::identity::Identity;
use crate::plc::Plc;

/// Outputs that exist as [`RawOutput`](super::RawOutput). The value is true while the output is claimed and
/// not answered.
type OutputsInUse = Arc<Mutex<BTreeMap<OutputId, bool>>>;

/// The handler that the queue and its outputs share. When the queue and all its outputs have been dropped,
/// the handler reports to the machine that it is offline.
#[derive(Debug)]
pub(super) struct OutputsOwner {
    held: OutputsInUse,
    known: watch::Receiver<Option<Result<()>>>,
    presence: JoinHandle<()>,
    offline: OfflineGuard,
}

impl Drop for OutputsOwner {
    fn drop(&mut self) {
        self.presence.abort();
    }
}

impl OutputsOwner {
    pub(super) fn start(presence: HandlerSession) -> Self {
        let (known, is_known) = watch::channel(None);
        let held = OutputsInUse::default();
        Self {
            held: Arc::clone(&held),
            known: is_known,
            offline: presence.offline_on_drop(),
            presence: tokio::spawn(maintain_presence(presence, held, known)),
        }
    }

    pub(super) async fn wait_until_known(&self) -> Result<()> {
        let mut known = self.known.clone();
        let outcome = known.wait_for(Option::is_some).await;
        let outcome = outcome.map_err(|_| Error::Closed)?.clone();
        outcome.unwrap_or(Ok(()))
    }

    /// Waits until the machine refuses the handler, or another instance has taken over.
    pub(super) async fn wait_until_refused(&self) -> Error {
        let mut known = self.known.clone();
        let outcome = known.wait_for(|known| matches!(known, Some(Err(_)))).await;
        let error = outcome.ok().and_then(|outcome| outcome.clone()?.err());
        match error {
            Some(error) => error,
            None => std::future::pending().await,
        }
    }

    pub(super) fn plc(&self) -> &Plc {
        &self.offline.plc
    }

    pub(super) fn by(&self) -> &Identity {
        &self.offline.by
    }

    pub(super) fn hold(&self, id: &OutputId, claimed: bool) {
        lock(&self.held).insert(id.clone(), claimed);
    }

    /// Removes an output from the outputs in use; returns true if the output was claimed and not answered.
    pub(super) fn forget(&self, id: &OutputId) -> bool {
        lock(&self.held).remove(id).unwrap_or(false)
    }

    pub(super) fn holds(&self, id: &OutputId) -> bool {
        lock(&self.held).contains_key(id)
    }
}

/// Announces the handler and repeats lost claims, until the machine ends the connection or refuses the
/// handler.
async fn maintain_presence(
    mut presence: HandlerSession,
    held: OutputsInUse,
    known: watch::Sender<Option<Result<()>>>,
) {
    loop {
        match presence.next().await {
            Ok(None) => return,
            Ok(Some(Event::Announced)) => {
                known.send_replace(Some(Ok(())));
            }
            Ok(Some(Event::Message(..))) => {
                for (id, m) in presence.lost_outputs() {
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
            Err(error) => {
                known.send_replace(Some(Err(error)));
                return;
            }
        }
    }
}
