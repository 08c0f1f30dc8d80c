//! Messages and requests: the same types in process, over MQTT and over REST.

pub mod alarm_text;
pub mod command;
pub mod data;
pub mod execution;
pub mod explained;
pub mod form;
pub mod handler;
pub mod heartbeat;
pub mod ids;
pub mod io;
pub mod lease;
pub mod line_start;
pub mod lock;
pub mod m_code;
pub mod machine;
pub mod message;
pub mod not_after;
pub mod output;
pub mod params;
pub mod planned;
pub mod program;
pub mod question;
pub mod redelivery;
pub mod refusal;
pub mod request;
pub mod run;
pub mod start;
pub mod state;
pub mod stored_data;
pub mod topic;
pub mod trace;
pub mod upload;
pub mod verb;
pub mod words;

use std::cell::RefCell;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// Last second of the year 9999, in seconds since 1970. Reason: the format cannot represent later times.
const SECOND_MAX: u64 = 253_402_300_799;

/// Number of a CNC coordinate system, from 1.
pub type CoordinateSystemNumber = u8;

/// Identifies one start of the runtime. Outputs, claims and resets of another boot are stale.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct BootId(pub String);

impl std::fmt::Display for BootId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// A time as RFC 3339 in UTC, such as `2026-01-31T12:00:00.250000Z`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct Timestamp(pub String);

impl Timestamp {
    /// Returns the text of a system time, to the microsecond; a time before 1970 becomes the beginning of
    /// 1970.
    pub fn from_system_time(time: SystemTime) -> Self {
        Self(rfc3339_micros(time))
    }

    /// Returns the time as text for people, without fractions of a second.
    pub fn to_the_second(&self) -> String {
        let second = self.to_system_time();
        second.map_or_else(
            || self.0.clone(),
            |at| humantime::format_rfc3339_seconds(at).to_string(),
        )
    }

    /// Returns the system time of the text, or `None` if it is not RFC 3339 in UTC.
    pub fn to_system_time(&self) -> Option<SystemTime> {
        humantime::parse_rfc3339(&self.0).ok()
    }
}

/// Formats a time to the microsecond. The text up to the second is cached, because most consecutive messages
/// have the same second. This takes one allocation; `format!` takes three.
fn rfc3339_micros(time: SystemTime) -> String {
    thread_local! {
        static SECOND: RefCell<(u64, String)> = const { RefCell::new((0, String::new())) };
    }
    let since_epoch = time.duration_since(UNIX_EPOCH).unwrap_or_default();
    let second = since_epoch.as_secs().min(SECOND_MAX);
    SECOND.with_borrow_mut(|(of, text)| {
        if *of != second || text.is_empty() {
            *of = second;
            *text = humantime::format_rfc3339_seconds(UNIX_EPOCH + Duration::from_secs(second)).to_string();
            text.pop();
        }
        let mut whole = String::with_capacity(text.len() + ".000000Z".len());
        whole.push_str(text);
        whole.push('.');
        let micros = since_epoch.subsec_micros();
        let digits = [100_000, 10_000, 1000, 100, 10, 1].map(|place| micros / place % 10);
        whole.extend(digits.iter().filter_map(|digit| char::from_digit(*digit, 10)));
        whole.push('Z');
        whole
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_timestamp_is_its_time_to_the_microsecond_whichever_was_before(
            times in prop::collection::vec((prop_oneof![0_u64..3, 0..=SECOND_MAX], 0_u32..1_000_000_000), 1..20),
        ) {
            for (second, nanos) in times {
                let time = UNIX_EPOCH + Duration::new(second, nanos);
                let text = Timestamp::from_system_time(time).0;
                prop_assert_eq!(text, humantime::format_rfc3339_micros(time).to_string());
            }
        }
    }

    #[test]
    fn times_that_cannot_be_written_are_the_nearest_that_can() {
        let text = |time| Timestamp::from_system_time(time).0;
        assert_eq!(
            text(UNIX_EPOCH - Duration::from_secs(1)),
            "1970-01-01T00:00:00.000000Z"
        );
        let late = UNIX_EPOCH + Duration::from_secs(SECOND_MAX + 1);
        assert_eq!(text(late), "9999-12-31T23:59:59.000000Z");
    }
}
