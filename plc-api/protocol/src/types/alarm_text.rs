//! Texts of a machine builder's own alarms: text, remedy, languages.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::refusal::{Refusal, RefusalCode};

/// Highest code of a handler's alarm.
pub const USER_CODE_MAX: u16 = 9_999;

/// Largest number of characters of an alarm's text; [`Alarm::user`](crate::alarm::Alarm::user) cuts a longer text.
/// Reason: panels show the text, and alarm histories store it.
pub const ALARM_TEXT_MAX: usize = 1_000;

/// Largest number of alarm texts of one handler or configuration.
pub const ALARM_TEXTS_MAX: usize = 256;

/// Largest number of translations of one alarm, in addition to its own text.
pub const LANGUAGES_MAX: usize = 8;

/// Number of characters of a language tag, such as `de` or `pt-BR`.
const LANGUAGE_CHARS: std::ops::RangeInclusive<usize> = 2..=16;

/// Text and remedy of an alarm in one language.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmWords {
    /// Description of the event, 1 to 1000 characters.
    pub text: String,
    /// Remedy, 1 to 1000 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

/// Texts of an alarm of a sequence program. When the alarm is raised, the machine adds the remedy and the
/// translations; each panel shows the text in its language.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmText {
    /// 0 to 9999; the alarm number is 10000 + this code.
    pub code: u16,
    /// Description of the event, 1 to 1000 characters.
    pub text: String,
    /// Remedy, 1 to 1000 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// Text and remedy in other languages, by language tag such as `de`; at most 8.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub languages: BTreeMap<String, AlarmWords>,
}

impl AlarmText {
    /// Validates the texts of this alarm.
    ///
    /// # Errors
    /// Fails if the code is above 9999, a text is empty or has more than 1000 characters, a language tag is
    /// malformed, or there are more than 8 languages.
    pub fn mistake(&self) -> Result<(), String> {
        if self.code > USER_CODE_MAX {
            return Err(format!("{}: write 0 to {USER_CODE_MAX}", self.code));
        }
        if self.languages.len() > LANGUAGES_MAX {
            return Err(format!(
                "{} languages: write up to {LANGUAGES_MAX}",
                self.languages.len()
            ));
        }
        let is_tag = |tag: &str| {
            LANGUAGE_CHARS.contains(&tag.len())
                && tag
                    .bytes()
                    .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-')
        };
        if let Some(wrong) = self.languages.keys().find(|tag| !is_tag(tag)) {
            return Err(format!("language {wrong:?}: write a tag such as `de` or `pt-BR`"));
        }
        let others = self.languages.values();
        let others = others.flat_map(|words| std::iter::once(&words.text).chain(&words.remedy));
        let mut all = std::iter::once(&self.text).chain(&self.remedy).chain(others);
        let is_wrong = |text: &String| text.is_empty() || text.chars().nth(ALARM_TEXT_MAX).is_some();
        match all.find(|text| is_wrong(text)) {
            Some(_) => Err(format!("text and remedy: write 1 to {ALARM_TEXT_MAX} characters")),
            None => Ok(()),
        }
    }
}

/// Validates the alarm texts of one handler.
///
/// # Errors
/// Fails with `too_large` if there are more than 256 texts, and with `invalid` if a text is not allowed. The
/// error text gives the correct form.
pub(super) fn check_all(texts: &[AlarmText]) -> Result<(), Refusal> {
    if texts.len() > ALARM_TEXTS_MAX {
        let text = format!("alarms: {} of them, write up to {ALARM_TEXTS_MAX}", texts.len());
        return Err(Refusal::new(RefusalCode::TooLarge, text));
    }
    for text in texts {
        let said = text.mistake();
        said.map_err(|why| Refusal::new(RefusalCode::Invalid, format!("alarms: code {}: {why}", text.code)))?;
    }
    Ok(())
}
