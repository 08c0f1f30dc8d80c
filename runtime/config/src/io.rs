//! `[io]`: inputs and outputs of the plant.

use std::collections::BTreeMap;

use plc_protocol::types::io::{IoKind, IoLoss, IoStart};
use schemars::JsonSchema;
use serde::Deserialize;

/// `[io]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct IoConfig {
    /// `[io.in.NAME]`
    #[serde(rename = "in")]
    pub inputs: BTreeMap<String, IoPointConfig>,
    /// `[io.out.NAME]`
    #[serde(rename = "out")]
    pub outputs: BTreeMap<String, IoPointConfig>,
}

/// `[io.in.NAME]` and `[io.out.NAME]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct IoPointConfig {
    /// Kind of the value.
    pub kind: IoKind,
    /// Safe value: applies from every start until a handler writes the point, and after its owner is lost; default
    /// `false`, or 0. For an output, `"keep"` retains the value that its owner wrote last.
    #[schemars(with = "IoLoss")]
    pub on_loss: Option<IoLoss>,
    /// With `on_loss = "keep"`: the value at a start, or `"last"` for the value that was written last before the start.
    /// Each write of an output with `"last"` is on disk before it takes effect.
    #[schemars(with = "IoStart")]
    pub at_start: Option<IoStart>,
    /// Description, up to 100 characters; default: the name of the input or output.
    pub text: String,
    /// Unit of a number, up to 16 characters.
    pub unit: Option<String>,
    /// Lowest number that may be written.
    pub min: Option<f64>,
    /// Highest number that may be written.
    pub max: Option<f64>,
}
