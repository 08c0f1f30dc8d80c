//! MQTT end: everything that the port says goes out, everything that the interface takes comes in.
//!
//! [`Outbox`](outbox::Outbox) remembers what the broker has still to be told, [`inbound`] reads what it tells us,
//! [`dispatch`] asks the port, and [`link`] holds the connection. Nothing here ever holds up the port.

mod dispatch;
pub(crate) mod inbound;
mod link;
mod outbox;

use std::sync::Arc;
use std::time::Duration;

use plc_api::port::Port;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::broker::Refused;
use crate::metrics::Metrics;
use crate::settings::MqttSettings;
use link::Link;

/// Messages refused by the embedded broker that wait to be answered.
pub(crate) const REFUSED_MAX: usize = 64;

/// Time to say goodbye to the broker.
const STOP_MAX: Duration = Duration::from_secs(2);

/// What the MQTT end is made of.
pub(crate) struct Parts {
    pub(crate) port: Arc<dyn Port>,
    pub(crate) settings: MqttSettings,
    pub(crate) machine: String,
    /// Topic levels before all topics, with the last slash.
    pub(crate) root: String,
    /// Where the broker is.
    pub(crate) host: String,
    /// Its port.
    pub(crate) tcp_port: u16,
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
