//! `[alarm.N]`: texts and remedies for alarms of sequence programs.

use std::collections::BTreeMap;

use plc_api::types::alarm_text::AlarmWords;
use schemars::JsonSchema;
use serde::Deserialize;

/// `[alarm.N]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AlarmConfig {
    /// Text of the alarm for lists of alarms, 1 to 1000 characters. A raised alarm shows the text given by the program
    /// that raised it.
    pub text: String,
    /// Remedy, shown with the alarm, 1 to 1000 characters.
    pub remedy: Option<String>,
    /// `text` and `remedy` in other languages, by language tag, such as `language.de = { text = ".." }`; up to 8. A
    /// panel shows those of its own language.
    pub language: BTreeMap<String, AlarmWords>,
}
