//! What happens to an output whose handler was lost.

use serde::{Deserialize, Serialize};

/// What a handler does with an output that it may already have worked on. The later is the stricter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Redelivery {
    /// Run the handler again from its start.
    Redo,
    /// Run the handler with `output.redelivered()` true: it looks at the machine first.
    Verify,
    /// Nothing: an operator decides by `redeliver` or by a reset by hand.
    #[default]
    Ask,
}
