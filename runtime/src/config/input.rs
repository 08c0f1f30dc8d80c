//! `[input]`: inputs of which a program outside says the value.

use std::collections::BTreeMap;

use plc_api::types::lock::OnLoss;
use schemars::JsonSchema;
use serde::Deserialize;

/// `[input]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InputConfig {
    /// `[input.interlock]`
    pub interlock: LockConfig,
    /// `[input.start_lock]`
    pub start_lock: LockConfig,
}

/// `[input.interlock]` and `[input.start_lock]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LockConfig {
    /// Value of a source while the handler that owns it is not there; default `keep`, and `on` for sources that are declared.
    /// Sources of clients without presence have no owner, and stay as they are.
    pub on_loss: Option<OnLoss>,
    /// `[input.interlock.source.NAME]`
    pub source: BTreeMap<String, LockSourceConfig>,
}

/// `[input.interlock.source.NAME]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LockSourceConfig {
    /// Value of this source at every start, until its handler has set it, and while that is not there; default that of the
    /// input, else `on`.
    pub on_loss: Option<OnLoss>,
    /// Coordinate systems that have this source; default all.
    pub coordinate_systems: Vec<u8>,
}
