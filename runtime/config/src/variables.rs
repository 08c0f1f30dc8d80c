//! `[variables]`: settings of variables.

use plc_protocol::types::CoordinateSystemNumber;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[variables]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VariablesConfig {
    /// `[[variables.published]]`
    pub published: Vec<PublishedConfig>,
}

/// `[[variables.published]]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PublishedConfig {
    /// First variable of the range, `P0` to `P32767` or `Q0` to `Q4095`. Variables are published on the topic
    /// `variables` or `cs/{cs}/variables` when they change, at most 10 times a second.
    pub from: String,
    /// Number of variables in the range. In total up to 1024 P variables, and up to 1024 Q variables of each coordinate
    /// system.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 1024))]
    pub count: u32,
    /// Coordinate system of the Q variables; default: every coordinate system.
    pub coordinate_system: Option<CoordinateSystemNumber>,
}

fn one() -> u32 {
    1
}
