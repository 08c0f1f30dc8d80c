//! `[alarm.N]`: what the machine says of alarms of its sequence programs.

use std::collections::BTreeMap;

use plc_api::types::alarm_text::AlarmWords;
use schemars::JsonSchema;
use serde::Deserialize;

/// `[alarm.N]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AlarmConfig {
    /// What happened, 1 to 1000 characters, for lists of alarms. An alarm that is raised has the text of whoever raised it.
    pub text: String,
    /// What to do, 1 to 1000 characters: shown with the alarm.
    pub remedy: Option<String>,
    /// `text` and `remedy` in other languages, by their tags, such as `language.de = { text = ".." }`; up to 8. Panels show that of
    /// their language.
    pub language: BTreeMap<String, AlarmWords>,
}
