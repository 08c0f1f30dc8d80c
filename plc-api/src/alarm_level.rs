//! An alarm that follows a level, which is on or off. Pure, without I/O; used by scans and by sequence
//! programs.
//!
//! The alarm is raised when the level turns on. If a reset clears the alarm while the level is still on, the
//! alarm is raised again, because its cause persists.

use std::time::Duration;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};

/// Time within which a raised alarm must appear among the active alarms; otherwise this program raises the
/// alarm again, because a reset may have cleared it before this program received it.
pub(crate) const SHOWN_WITHIN: Duration = Duration::from_secs(1);

/// State of the alarm of a level.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) enum AlarmLevel {
    /// The level is off, or the alarm has not been raised since the level turned on.
    #[default]
    Off,
    /// The alarm was raised at `at_s`, and has not appeared among the active alarms yet.
    Raised { at_s: f64 },
    /// The alarm has appeared among the active alarms.
    Seen,
}

impl AlarmLevel {
    /// Returns true if the caller must raise the alarm now, and call [`AlarmLevel::raised`] after that.
    pub(crate) fn must_raise(&mut self, level: bool, is_active: bool, now_s: f64) -> bool {
        *self = match *self {
            _ if !level => Self::Off,
            _ if is_active => Self::Seen,
            Self::Raised { at_s } if now_s - at_s < SHOWN_WITHIN.as_secs_f64() => return false,
            _ => return true,
        };
        false
    }

    /// Records that the machine has accepted the alarm, or may have accepted it.
    pub(crate) fn raised(&mut self, now_s: f64) {
        *self = Self::Raised { at_s: now_s };
    }
}

/// Returns true if an alarm is among the active alarms.
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
        assert!(!alarm.must_raise(true, false, 0.2), "the alarm is not active yet");
        assert!(!alarm.must_raise(true, true, 0.3));
        assert!(!alarm.must_raise(false, true, 0.4), "active until a reset");
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
