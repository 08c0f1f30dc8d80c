//! Alarms of handlers.

pub use crate::types::alarm_text::{ALARM_TEXT_MAX, USER_CODE_MAX};
use crate::types::alarm_text::{AlarmText, AlarmWords, LANGUAGES_MAX};
use crate::types::machine::AlarmRaise;
use crate::types::refusal::{Refusal, RefusalCode};

/// First alarm number of handlers (H6): the number of an alarm is this base plus the code of the handler.
pub const USER_ALARM_BASE: u16 = 10_000;

/// An alarm that stops the NC program, with number and text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("alarm {number}: {text}")]
pub struct Alarm {
    /// Number of the alarm: 1 to 9999 for an alarm of the runtime; 10000 + code for an alarm of a handler.
    pub number: u16,
    /// Description of the fault, written by the machine builder.
    pub text: String,
}

impl Alarm {
    /// Code of the alarm that the operator `?` in a handler creates from an [`Error`](crate::error::Error) or from a
    /// refusal.
    pub const CODE_OF_ERROR: u16 = 9_999;
    /// Code of the alarm that a panic in a handler causes.
    pub const CODE_OF_PANIC: u16 = 9_998;

    /// Code of the alarm for an M code whose parameters do not match the declaration of its handler.
    pub const CODE_OF_PARAMS: u16 = 9_997;

    /// Creates an alarm of a handler. The number of the alarm is 10000 + `code`; the machine shows `text`
    /// unchanged.
    ///
    /// `code` is 0 to 9999; a larger code becomes 9999. The text is cut after [`ALARM_TEXT_MAX`] characters.
    pub fn user(code: u16, text: impl Into<String>) -> Self {
        let mut text = text.into();
        crate::text::cut(&mut text, ALARM_TEXT_MAX);
        Self {
            number: USER_ALARM_BASE + code.min(USER_CODE_MAX),
            text,
        }
    }

    /// Returns the code of an alarm of a handler; `None` for an alarm of the runtime.
    pub fn user_code(&self) -> Option<u16> {
        self.number.checked_sub(USER_ALARM_BASE)
    }
}

/// An alarm of a sequence program, defined as a constant: text, remedy, and translations into up to 8 other
/// languages.
///
/// ```
/// use plc_api::{Alarm, AuxOutput, SequenceProgram, UserAlarm};
///
/// const NO_AIR: UserAlarm = UserAlarm::new(12, "the air pressure is low")
///     .remedy("Open the main valve, and look at the pressure gauge.")
///     .in_language("de", "der Luftdruck ist zu niedrig", "Hauptventil öffnen, Druckanzeige prüfen.");
///
/// async fn clamp(_output: AuxOutput) -> Result<(), Alarm> {
///     # fn pressure_bar() -> f64 { 2.1 }
///     let bar = pressure_bar();
///     if bar < 4.0 {
///         return Err(NO_AIR.with(format!("{bar} bar"))); // without a detail: NO_AIR.into()
///     }
///     Ok(())
/// }
///
/// let program = SequenceProgram::new().on(10, clamp).alarms([NO_AIR]);
/// assert_eq!(program.check(), Ok(()));
/// assert_eq!(NO_AIR.with("2.1 bar"), Alarm::user(12, "the air pressure is low: 2.1 bar"));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UserAlarm {
    code: u16,
    text: &'static str,
    remedy: Option<&'static str>,
    languages: [Option<(&'static str, &'static str, &'static str)>; LANGUAGES_MAX],
}

impl UserAlarm {
    /// Creates an alarm from its code, 0 to 9999, and a text that describes the fault.
    pub const fn new(code: u16, text: &'static str) -> Self {
        Self {
            code,
            text,
            remedy: None,
            languages: [None; LANGUAGES_MAX],
        }
    }

    /// Sets the remedy: the instruction for the operator.
    #[must_use]
    pub const fn remedy(mut self, remedy: &'static str) -> Self {
        self.remedy = Some(remedy);
        self
    }

    /// Adds text and remedy in another language, given by its tag, such as `de`. An empty `remedy` means that
    /// this language has no remedy.
    ///
    /// # Panics
    /// Panics at the ninth language; in a constant the panic is a compile error.
    #[must_use]
    pub const fn in_language(
        mut self,
        language: &'static str,
        text: &'static str,
        remedy: &'static str,
    ) -> Self {
        let mut free = 0;
        while free < LANGUAGES_MAX && self.languages[free].is_some() {
            free += 1;
        }
        assert!(free < LANGUAGES_MAX, "an alarm has up to 8 other languages");
        self.languages[free] = Some((language, text, remedy));
        self
    }

    /// Creates the alarm with `detail` appended to its text.
    pub fn with(self, detail: impl std::fmt::Display) -> Alarm {
        Alarm::user(self.code, format!("{}: {detail}", self.text))
    }
}

impl From<UserAlarm> for Alarm {
    fn from(alarm: UserAlarm) -> Self {
        Alarm::user(alarm.code, alarm.text)
    }
}

impl From<UserAlarm> for AlarmText {
    fn from(alarm: UserAlarm) -> Self {
        let words = |(language, text, remedy): (&str, &str, &str)| {
            let remedy = Some(remedy.to_owned()).filter(|remedy| !remedy.is_empty());
            let text = text.to_owned();
            (language.to_owned(), AlarmWords { text, remedy })
        };
        Self {
            code: alarm.code,
            text: alarm.text.to_owned(),
            remedy: alarm.remedy.map(str::to_owned),
            languages: alarm.languages.into_iter().flatten().map(words).collect(),
        }
    }
}

impl From<Refusal> for Alarm {
    fn from(refusal: Refusal) -> Self {
        Alarm::user(Alarm::CODE_OF_ERROR, refusal.to_string())
    }
}

impl AlarmRaise {
    /// Returns the alarm that this request raises.
    ///
    /// # Errors
    /// Fails if code or text is out of range.
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
