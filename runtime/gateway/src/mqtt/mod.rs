//! MQTT end: everything that the port says goes out, everything that the interface takes comes in.
//!
//! [`Outbox`](outbox::Outbox) remembers what the broker has still to be told, [`decode`](plc_api::wire::mqtt::decode) reads what it tells us,
//! [`dispatch`] asks the port, [`link`] holds the connection, and [`wire`] speaks to
//! the broker. Nothing here ever holds up the port.

mod dispatch;
mod link;
mod outbox;
mod wire;

use std::sync::Arc;
use std::time::Duration;

use plc_api::server::ServedPort;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::broker_address::{BrokerAddress, Refused};
use crate::metrics::Metrics;
use crate::settings::MqttSettings;
use link::Link;

/// Messages refused by the embedded broker that wait to be answered.
pub(crate) const REFUSED_MAX: usize = 64;

/// Time to say goodbye to the broker.
const STOP_MAX: Duration = Duration::from_secs(2);

/// Client id of the runtime at its broker. It holds the prefix: machines of one name push each other off otherwise.
pub(crate) fn client_id(settings: &MqttSettings, machine: &str) -> String {
    if settings.client_id.is_empty() {
        match settings.prefix.as_str() {
            "" => format!("tandem-{machine}"),
            prefix => format!("tandem-{}-{machine}", prefix.replace('/', "-")),
        }
    } else {
        settings.client_id.clone()
    }
}

/// What the MQTT end is made of.
pub(crate) struct Parts {
    pub(crate) port: Arc<dyn ServedPort>,
    pub(crate) settings: MqttSettings,
    pub(crate) machine: String,
    /// Topic levels before all topics, with the last slash.
    pub(crate) root: String,
    /// Where the broker is.
    pub(crate) at: BrokerAddress,
    pub(crate) position_interval: Duration,
    pub(crate) refused: mpsc::Receiver<Refused>,
    pub(crate) metrics: Arc<Metrics>,
}

/// The MQTT end while it runs.
#[derive(Debug)]
pub(crate) struct MqttEnd {
    stop: CancellationToken,
    task: JoinHandle<()>,
}

impl MqttEnd {
    pub(crate) fn start(parts: Parts) -> Self {
        let stop = CancellationToken::new();
        let task = tokio::spawn(Link::new(parts, stop.clone()).run());
        Self { stop, task }
    }

    /// Publishes that the runtime has gone, disconnects and stops.
    pub(crate) async fn stop(mut self) {
        self.stop.cancel();
        if tokio::time::timeout(STOP_MAX, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }

    /// Ends without a goodbye, as a runtime that is killed.
    #[cfg(test)]
    pub(crate) fn crash(self) {
        self.task.abort();
    }
}
