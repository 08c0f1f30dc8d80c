//! Checks and converts `[alarm.N]`.

use std::collections::BTreeMap;

use plc_protocol::types::alarm_text::{ALARM_TEXTS_MAX, AlarmText};

use super::super::AlarmConfig;
use super::super::text::Problems;

/// Returns the alarm texts of a configuration by their codes.
pub(super) fn alarm_texts(
    config: &BTreeMap<String, AlarmConfig>,
    problems: &mut Problems<'_>,
) -> BTreeMap<u16, AlarmText> {
    let mut texts = BTreeMap::new();
    if config.len() > ALARM_TEXTS_MAX {
        let text = format!(
            "[alarm]: there are {} alarms; write at most {ALARM_TEXTS_MAX}",
            config.len()
        );
        problems.add("alarm", text);
    }
    for (key, config) in config {
        let mut of_table = problems.check_table(format!("alarm.{key}"), format!("[alarm.{key}] "));
        let Ok(code) = key.parse::<u16>() else {
            of_table.problem("", "name the table by the code of the alarm, 0 to 9999");
            continue;
        };
        let text = AlarmText {
            code,
            text: config.text.clone(),
            remedy: config.remedy.clone(),
            languages: config.language.clone(),
        };
        if let Err(why) = text.mistake() {
            of_table.problem("", why);
        }
        texts.insert(code, text);
    }
    texts
}
