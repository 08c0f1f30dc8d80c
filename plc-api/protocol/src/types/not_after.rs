//! The age limit of a request: the moment after which the machine rejects it.

use serde::{Deserialize, Serialize};

use super::BootId;

/// Age limit that the HMI and the clients set for a request of a person, ms.
pub const NOT_AFTER_MS: u64 = 1000;

/// Largest `within_ms`. Reason: the machine remembers the times of its heartbeats for this long.
pub const NOT_AFTER_MAX_MS: u64 = 60_000;

/// Age limit of a request. The machine compares the age with its own real time when the request is about to
/// take effect, and rejects an older request as `expired`. Hold, stop, abort and the end of a jog ignore the
/// limit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct NotAfter {
    /// The boot that published the heartbeat.
    pub boot_id: BootId,
    /// `cycle` of the newest heartbeat that the sender had received when it made the request.
    pub heartbeat: u64,
    /// Time after that heartbeat within which the request must take effect, ms.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = NOT_AFTER_MAX_MS)))]
    pub within_ms: u64,
}

impl NotAfter {
    /// Validates the time limit.
    ///
    /// # Errors
    /// Fails if `within_ms` is not 1 to 60,000.
    pub fn check(&self) -> Result<(), String> {
        if (1..=NOT_AFTER_MAX_MS).contains(&self.within_ms) {
            return Ok(());
        }
        let within_ms = self.within_ms;
        Err(format!(
            "not_after has within_ms {within_ms}; write 1 to {NOT_AFTER_MAX_MS}"
        ))
    }
}
