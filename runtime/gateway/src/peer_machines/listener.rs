//! The connection that receives the states of other machines from the shared broker.

use std::sync::Arc;
use std::time::Duration;

use plc_protocol::wire::machines::{SharedBroker, TOPICS};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

use super::PeerMachines;
use crate::broker_address::BrokerAddress;
use crate::error::GatewayError;
use crate::mqtt::{Connect, ConnectionLoss, Event, Version, Wire, client_id};
use crate::settings::MqttSettings;

/// Time for which the connection stays open after the last request for the other machines.
const ASKED_FOR: Duration = Duration::from_mins(1);
/// Number of messages in a row after which other tasks may run.
const TURN: u32 = 64;

/// The task that receives the states of other machines while a client requests them.
pub(crate) struct Listener<C> {
    pub(crate) peer_machines: Arc<PeerMachines>,
    pub(crate) at: C,
    pub(crate) client_id: String,
    /// The part of a topic before the machine name, such as `tandem/v1/`.
    pub(crate) base: String,
    pub(crate) stop: CancellationToken,
}

impl Listener<BrokerAddress> {
    /// Creates a listener with its own connection to the broker of this machine.
    ///
    /// # Errors
    /// Returns an error if the address of the broker cannot be used.
    pub(crate) fn for_broker(
        settings: &MqttSettings,
        machine: &str,
        neighbours: Arc<PeerMachines>,
        stop: CancellationToken,
    ) -> Result<Self, GatewayError> {
        Ok(Self {
            peer_machines: neighbours,
            at: BrokerAddress::of_settings(settings)?,
            client_id: format!("{}-machines", client_id(settings, machine)),
            base: settings.base(),
            stop,
        })
    }
}

impl<C: Connect> Listener<C> {
    /// Receives states after each request of a client, until `stop` is cancelled.
    pub(crate) async fn run(&self) {
        loop {
            tokio::select! {
                () = self.stop.cancelled() => return,
                () = self.peer_machines.requested.notified() => {}
            }
            self.listen().await;
            let mut heard = self.peer_machines.state.lock();
            heard.broker = SharedBroker::Connecting;
            heard.registry.clear();
        }
    }

    /// Connects repeatedly as long as there are requests.
    async fn listen(&self) {
        let (mut backoff, mut node, mut version) = (self.at.backoff(), 0, Version::V5);
        while !self.stop.is_cancelled() && Instant::now() < self.deadline() {
            let Err(lost) = self.connection(node, version).await else {
                return;
            };
            self.peer_machines.state.lock().broker = SharedBroker::Connecting;
            debug!("no messages of other machines are received: {}", lost.why);
            if lost.version_unknown && version == Version::V5 {
                version = Version::V3_1_1;
                continue;
            }
            (node, version) = ((node + 1) % self.at.nodes(), Version::V5);
            tokio::select! {
                () = self.stop.cancelled() => return,
                () = tokio::time::sleep(backoff.next_wait()) => {}
            }
        }
    }

    /// Returns when listening ends.
    fn deadline(&self) -> Instant {
        self.peer_machines.state.lock().asked_at + ASKED_FOR
    }

    /// Runs one connection; returns `Ok` when the requests end.
    async fn connection(&self, node: usize, version: Version) -> Result<(), ConnectionLoss> {
        let mut wire = self.at.open(node, &self.client_id, None, version);
        let mut until_turn = TURN;
        loop {
            let event = tokio::select! {
                () = self.stop.cancelled() => return Ok(()),
                () = tokio::time::sleep_until(self.deadline()) => {
                    if Instant::now() >= self.deadline() {
                        wire.disconnect();
                        return Ok(());
                    }
                    continue;
                }
                event = wire.next() => event?,
            };
            match event {
                Event::Connected { .. } => {
                    info!("messages of other machines at the broker are received");
                    let base = &self.base;
                    wire.subscribe(TOPICS.iter().map(|topic| format!("{base}+/{topic}")));
                    let mut heard = self.peer_machines.state.lock();
                    heard.registry.clear();
                    heard.broker = SharedBroker::Connected;
                }
                Event::Published { publish, .. } => {
                    if let Some(of_machine) = publish.topic.strip_prefix(&self.base)
                        && let Some((machine, path)) = of_machine.split_once('/')
                    {
                        let mut heard = self.peer_machines.state.lock();
                        (heard.registry).store_message(machine, path, &publish.payload, Instant::now());
                    }
                }
                Event::SubscriptionRefused => {
                    warn!(
                        "the access rules of the MQTT broker forbid this machine to read other machines \
                         below {}",
                        self.base
                    );
                }
                Event::Acknowledged { .. } | Event::Disconnected => {}
            }
            until_turn -= 1;
            if until_turn == 0 {
                until_turn = TURN;
                tokio::task::yield_now().await;
            }
        }
    }
}
