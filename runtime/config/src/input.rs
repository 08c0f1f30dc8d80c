//! `[input]`: inputs whose values are set by external programs.

use std::collections::BTreeMap;

use plc_protocol::types::lock::OnLoss;
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
    /// Value of a source while the handler that owns it is offline; default `keep`, and `on` for declared sources.
    /// Sources set by clients without a presence have no owner, and keep their values.
    pub on_loss: Option<OnLoss>,
    /// `[input.interlock.source.NAME]`
    pub source: BTreeMap<String, LockSourceConfig>,
}

/// `[input.interlock.source.NAME]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LockSourceConfig {
    /// Value of this source from every start until its handler sets the source, and while the handler is
    /// offline. Default: `on_loss` of the input, otherwise `on`.
    pub on_loss: Option<OnLoss>,
    /// Coordinate systems that have this source; default all.
    pub coordinate_systems: Vec<u8>,
}
