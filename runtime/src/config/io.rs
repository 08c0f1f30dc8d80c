//! `[io]`: inputs and outputs of the plant.

use std::collections::BTreeMap;

use plc_api::types::io::{IoKind, IoValue};
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
    /// Kind of its value.
    pub kind: IoKind,
    /// The safe value: from every start until a handler writes it, and while its owner is absent; default `false`, or 0.
    #[schemars(with = "IoValue")]
    pub on_loss: Option<IoValue>,
    /// Its description, up to 100 characters; default its name.
    pub text: String,
    /// Unit of a number, up to 16 characters.
    pub unit: Option<String>,
    /// Lowest number that may be written.
    pub min: Option<f64>,
    /// Highest number that may be written.
    pub max: Option<f64>,
}
