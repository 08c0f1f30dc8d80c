//! An alarm that follows a level. Pure; for scans and for sequence programs.
//!
//! It is raised when the level turns on, and raised again if somebody clears it while the level is still on: no reset silences an
//! alarm whose cause persists.

use std::time::Duration;

use crate::types::CoordinateSystemNumber;
use crate::types::machine::{AlarmRecord, AlarmSeverity};

/// Time in which an alarm that was raised shows among those that are active, else it is raised again: it may have been cleared
/// before it was seen.
pub(crate) const SHOWN_WITHIN: Duration = Duration::from_secs(1);

/// What has become of the alarm of a level.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) enum AlarmLevel {
    /// It has not been raised since the level came on.
    #[default]
    Off,
    /// It was raised then, and has not been seen.
    Raised { at_s: f64 },
    /// It was seen.
    Seen,
}

impl AlarmLevel {
    /// True when the alarm must be raised now; then [`AlarmLevel::raised`].
    pub(crate) fn must_raise(&mut self, level: bool, is_active: bool, now_s: f64) -> bool {
        *self = match *self {
            _ if !level => Self::Off,
            _ if is_active => Self::Seen,
            Self::Raised { at_s } if now_s - at_s < SHOWN_WITHIN.as_secs_f64() => return false,
            _ => return true,
        };
        false
    }

    /// The machine has accepted it, or may have.
    pub(crate) fn raised(&mut self, now_s: f64) {
        *self = Self::Raised { at_s: now_s };
    }
}

/// True if an alarm is among those that are active.
pub(crate) fn is_active(alarms: &[AlarmRecord], cs: Option<CoordinateSystemNumber>, number: u16) -> bool {
    let mut alarms = alarms.iter();
    alarms.any(|alarm| alarm.severity == AlarmSeverity::Alarm && alarm.number == number && alarm.cs == cs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_raised_once_when_the_level_comes_on() {
        let mut alarm = AlarmLevel::default();
        assert!(!alarm.must_raise(false, false, 0.0));
        assert!(alarm.must_raise(true, false, 0.1));
        alarm.raised(0.1);
        assert!(!alarm.must_raise(true, false, 0.2), "it is not seen yet");
        assert!(!alarm.must_raise(true, true, 0.3));
        assert!(!alarm.must_raise(false, true, 0.4), "it stays until a reset");
    }

    #[test]
    fn what_is_cleared_while_the_level_is_on_is_raised_again() {
        let mut alarm = AlarmLevel::Seen;
        assert!(alarm.must_raise(true, false, 0.0));
        assert!(alarm.must_raise(true, false, 0.1), "the machine has refused it");
    }

    #[test]
    fn what_is_not_seen_within_a_second_is_raised_again() {
        let mut alarm = AlarmLevel::default();
        alarm.raised(0.0);
        assert!(!alarm.must_raise(true, false, 0.99));
        assert!(alarm.must_raise(true, false, 1.0));
    }
}
