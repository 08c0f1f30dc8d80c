//! `[handlers]`: settings for all handlers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[handlers]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HandlersConfig {
    /// Time in which a handler may return after it was lost without an announcement: its connection, its process or its
    /// presence ended. Until then, outputs of the plant keep their values, and no M code causes an alarm or
    /// `HANDLER_LOST`. Sources of interlock and start lock with `on_loss = "on"` do not wait.
    #[schemars(range(min = 0, max = 60_000), extend("x-unit" = "ms"))]
    pub grace_ms: u64,
}

impl Default for HandlersConfig {
    fn default() -> Self {
        Self { grace_ms: 2000 }
    }
}
