//! Alarms of handlers.

use crate::types::machine::AlarmRaise;
use crate::types::refusal::{Refusal, RefusalCode};

/// First alarm number of handlers (H6): a number is this plus the handler's code.
pub const USER_ALARM_BASE: u16 = 10_000;

/// Highest code of a handler's alarm.
pub const USER_CODE_MAX: u16 = 9_999;

/// Characters of an alarm's text; a longer one is cut. Reason: panels show it, and histories keep it.
pub const ALARM_TEXT_MAX: usize = 1_000;

/// An alarm that stops the NC program: number and text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("alarm {number}: {text}")]
pub struct Alarm {
    /// 1 to 9999: an alarm of the runtime; 10000 + code: one of a handler.
    pub number: u16,
    /// What happened, in the machine builder's words.
    pub text: String,
}

impl Alarm {
    /// Code of an alarm that `?` in a handler makes of an [`Error`](crate::Error) or a refusal.
    pub const CODE_OF_ERROR: u16 = 9_999;
    /// Code of the alarm of a handler that panicked.
    pub const CODE_OF_PANIC: u16 = 9_998;

    /// Code of the alarm of an M code whose parameters are not as its handler has declared them.
    pub const CODE_OF_PARAMS: u16 = 9_997;

    /// A handler's alarm. It appears with number 10000 + `code` and this text, unchanged.
    ///
    /// `code` is 0 to 9999; a larger one becomes 9999. The text is cut after [`ALARM_TEXT_MAX`] characters.
    pub fn user(code: u16, text: impl Into<String>) -> Self {
        let mut text = text.into();
        crate::text::cut(&mut text, ALARM_TEXT_MAX);
        Self {
            number: USER_ALARM_BASE + code.min(USER_CODE_MAX),
            text,
        }
    }

    /// The code of a handler's alarm; `None` for one of the runtime.
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
    /// Code or text is out of range.
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
