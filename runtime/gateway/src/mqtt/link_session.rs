//! The state of one connection to the broker.

use plc_protocol::transport::BROKER_SILENCE_MAX;
use tokio::time::Instant;

use super::arrival_queue::ArrivalQueue;
use super::wire::{ConnectionLoss, Event, Version, Wire};

/// State of one connection.
pub(super) struct LinkSession<W> {
    pub(super) wire: W,
    /// Messages of an external broker; the embedded one has a lane for urgent requests.
    pub(super) arrived: Option<ArrivalQueue>,
    pub(super) version: Version,
    /// Bytes of a packet that the broker accepts; 0 before it has answered.
    pub(super) packet_max: usize,
    /// When the oldest wait for a missing acknowledgement began.
    pub(super) silent_since: Option<Instant>,
    pub(super) warned_of_refusal: bool,
}

impl<W: Wire> LinkSession<W> {
    /// Returns the next event, or an error if the broker is silent.
    pub(super) async fn next(&mut self) -> Result<Event, ConnectionLoss> {
        let (wire, arrived) = (&mut self.wire, &mut self.arrived);
        let next = async {
            match arrived {
                Some(arrived) => arrived.next(wire).await,
                None => wire.next().await,
            }
        };
        let Some(since) = self.silent_since else {
            return next.await;
        };
        let next = tokio::time::timeout_at(since + BROKER_SILENCE_MAX, next);
        next.await.unwrap_or_else(|_| {
            let wait_s = BROKER_SILENCE_MAX.as_secs();
            Err(ConnectionLoss {
                why: format!("the broker has acknowledged nothing for {wait_s} s"),
                version_unknown: false,
            })
        })
    }
}
