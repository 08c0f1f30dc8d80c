//! Other machines at the shared broker, for the page that shows several machines.
//!
//! A separate connection listens to them. It only reads, and exists only while that page is shown; the machine's own
//! connection is not affected. [`registry`] stores the messages that the [`listener`] receives.

mod listener;
mod registry;

use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::wire::machines::{Machines, SharedBroker};
use tokio::sync::Notify;
use tokio::time::Instant;

pub(crate) use listener::Listener;
use registry::Registry;

/// The other machines, and those of the configuration.
#[derive(Debug)]
pub(crate) struct PeerMachines {
    /// `[hmi] machines`.
    addresses: Vec<String>,
    state: Mutex<PeerMachinesState>,
    requested: Notify,
}

#[derive(Debug)]
struct PeerMachinesState {
    broker: SharedBroker,
    registry: Registry,
    asked_at: Instant,
}

impl PeerMachines {
    /// Creates the state for this machine, with an external broker or without one.
    pub(crate) fn new(machine: &str, addresses: Vec<String>, has_shared_broker: bool) -> Arc<Self> {
        Arc::new(Self {
            addresses,
            state: Mutex::new(PeerMachinesState {
                broker: if has_shared_broker {
                    SharedBroker::Connecting
                } else {
                    SharedBroker::None
                },
                registry: Registry::new(machine),
                asked_at: Instant::now(),
            }),
            requested: Notify::new(),
        })
    }

    /// Returns the current data. Repeated calls keep it up to date.
    pub(crate) fn machines(&self) -> Machines {
        let now = Instant::now();
        let mut heard = self.state.lock();
        heard.asked_at = now;
        self.requested.notify_one();
        Machines {
            addresses: self.addresses.clone(),
            broker: heard.broker,
            machines: heard.registry.machines(now),
        }
    }
}
