//! Alarms of handlers.

use crate::types::machine::AlarmRaise;
use crate::types::refusal::{Refusal, RefusalCode};

/// First alarm number of handlers (H6): the number is this plus the handler's code.
pub const USER_ALARM_BASE: u16 = 10_000;

/// Highest code of a handler's alarm.
pub const USER_CODE_MAX: u16 = 9_999;

/// Characters of an alarm's text. A longer text is cut there: it is shown on a panel, and kept in every history.
pub const ALARM_TEXT_MAX: usize = 1_000;

/// Why an output failed: number and text of the alarm that stops the NC program.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("alarm {number}: {text}")]
pub struct Alarm {
    /// 1 to 9999: the runtime's own table; 10000 + code: a handler's.
    pub number: u16,
    /// What happened, in the words of the machine builder.
    pub text: String,
}

impl Alarm {
    /// Code of an alarm made of an [`Error`](crate::Error) or a refusal by `?` in a handler.
    pub const CODE_OF_ERROR: u16 = 9_999;
    /// Code of the alarm of a handler that panicked.
    pub const CODE_OF_PANIC: u16 = 9_998;

    /// A handler's alarm. It appears with number 10000 + `code` and this text, unchanged.
    ///
    /// `code` is 0 to 9999; a larger one counts as 9999. Of the text the first [`ALARM_TEXT_MAX`] characters count.
    pub fn user(code: u16, text: impl Into<String>) -> Self {
        let mut text = text.into();
        crate::text::cut(&mut text, ALARM_TEXT_MAX);
        Self {
            number: USER_ALARM_BASE + code.min(USER_CODE_MAX),
            text,
        }
    }

    /// The code of a handler's alarm; `None` for one of the runtime's own table.
    pub fn user_code(&self) -> Option<u16> {
        self.number.checked_sub(USER_ALARM_BASE)
    }
}

impl From<Refusal> for Alarm {
    fn from(refusal: Refusal) -> Self {
        Alarm::user(Alarm::CODE_OF_ERROR, refusal.to_string())
    }
}

impl AlarmRaise {
    /// The alarm that it raises.
    ///
    /// # Errors
    /// Code or text is out of its limits.
    pub fn alarm(&self) -> Result<Alarm, Refusal> {
        let is_text = (1..=ALARM_TEXT_MAX).contains(&self.text.chars().count());
        if self.code > USER_CODE_MAX || !is_text {
            let text = format!(
                "alarm: write code 0 to {USER_CODE_MAX} and a text of 1 to {ALARM_TEXT_MAX} characters"
            );
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        Ok(Alarm::user(self.code, self.text.as_str()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_handlers_alarm_has_number_10000_plus_code_and_its_text_unchanged() {
        let alarm = Alarm::user(17, "no tool in pocket 3");
        assert_eq!(
            (alarm.number, alarm.text.as_str()),
            (10_017, "no tool in pocket 3")
        );
        assert_eq!(alarm.user_code(), Some(17));
    }

    #[test]
    fn a_code_above_9999_counts_as_9999_and_a_long_text_is_cut() {
        let alarm = Alarm::user(u16::MAX, "é".repeat(ALARM_TEXT_MAX + 5));
        assert_eq!(alarm.number, 19_999);
        assert_eq!(alarm.text.chars().count(), ALARM_TEXT_MAX);
    }
}
