//! Treatment of an output after the loss of its handler.

use serde::{Deserialize, Serialize};

/// Treatment of an output on which a lost handler may already have worked. Later variants are stricter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Redelivery {
    /// Runs the handler again from its start.
    Redo,
    /// Runs the handler with `output.redelivered()` true: the handler must inspect the machine first.
    Verify,
    /// Does nothing: an operator decides by `redeliver` or by a manual reset.
    #[default]
    Ask,
}
