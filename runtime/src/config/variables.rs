//! `[variables]`: settings of variables.

use plc_api::types::CoordinateSystemNumber;
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
    /// The first variable that is published on the topic `variables` or `cs/{cs}/variables` whenever it changes, at most 10 times a second:
    /// `P0` to `P32767`, or `Q0` to `Q4095`.
    pub from: String,
    /// How many are published from it on. Of P, and of the Q of a coordinate system, up to 1024 in all.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 1024))]
    pub count: u32,
    /// Whose Q variables; default those of each.
    pub coordinate_system: Option<CoordinateSystemNumber>,
}

fn one() -> u32 {
    1
}
