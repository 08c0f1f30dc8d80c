//! Heartbeats of the servo, for clients that watch the machine, and heartbeats of clients that the machine
//! watches.

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;
use super::refusal::{Refusal, RefusalCode};

/// Shortest time within which a watched client must send its next heartbeat, ms. Reason: delays of the
/// network and of a busy computer must fit into this time.
pub const CLIENT_TTL_MIN_MS: u64 = 100;

/// Longest time within which a watched client must send its next heartbeat, ms.
pub const CLIENT_TTL_MAX_MS: u64 = 60_000;

/// Payload of `heartbeat`, published 10 times a second while the servo runs; not published while the servo is
/// stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Heartbeat {
    /// Number of servo cycles since the start, without omitted cycles.
    pub cycle: u64,
}

/// Payload of `client/{id}/heartbeat`: requests that the machine watches this client. If the next heartbeat
/// is late, the machine holds the run of `cs`, or all runs: `FEED_HOLD`, reason `CLIENT_LOST`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ClientHeartbeat {
    /// Time within which the machine must receive the next heartbeat, ms: 100 to 60000. 0 ends the watch,
    /// because the client leaves.
    pub ttl_ms: u64,
    /// The coordinate system whose run is held; left out or null for all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cs: Option<CoordinateSystemNumber>,
}

impl ClientHeartbeat {
    /// Validates the time until the next heartbeat.
    ///
    /// # Errors
    /// Fails with `invalid` if the time is out of its range.
    pub fn check(self) -> Result<(), Refusal> {
        let ttl_ms = self.ttl_ms;
        if ttl_ms == 0 || (CLIENT_TTL_MIN_MS..=CLIENT_TTL_MAX_MS).contains(&ttl_ms) {
            return Ok(());
        }
        let text = format!(
            "ttl_ms {ttl_ms}: write {CLIENT_TTL_MIN_MS} to {CLIENT_TTL_MAX_MS}, or 0 to end the watch"
        );
        Err(Refusal::new(RefusalCode::Invalid, text))
    }
}
