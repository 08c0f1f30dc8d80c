//! `[alarm.N]`: texts and remedies for the alarms of sequence programs.

use std::collections::BTreeMap;

use plc_protocol::types::alarm_text::AlarmWords;
use schemars::JsonSchema;
use serde::Deserialize;

/// `[alarm.N]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AlarmConfig {
    /// Text of the alarm in lists of alarms, 1 to 1000 characters. A raised alarm shows the text from the
    /// program that raised it.
    pub text: String,
    /// Remedy, shown with the alarm, 1 to 1000 characters.
    pub remedy: Option<String>,
    /// `text` and `remedy` in other languages, by language tag, such as `language.de = { text = ".." }`; at
    /// most 8 languages. Each panel shows the texts in its own language.
    pub language: BTreeMap<String, AlarmWords>,
}
