//! Everything that crosses a wire: the same types in process, over MQTT and over REST.

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
pub mod output;
pub mod params;
pub mod planned;
pub mod program;
pub mod question;
pub mod redelivery;
pub mod refusal;
pub mod request;
pub mod run;
pub mod state;
pub mod topic;
pub mod trace;
pub mod upload;
pub mod verb;
pub mod words;

use serde::{Deserialize, Serialize};

/// Number of a CNC coordinate system, from 1.
pub type CoordinateSystemNumber = u8;

/// Names one start of the runtime. Outputs, claims and resets of another boot are stale.
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
    /// The text form of a system time, to the microsecond.
    pub fn from_system_time(time: std::time::SystemTime) -> Self {
        Self(humantime::format_rfc3339_micros(time).to_string())
    }

    /// For people: without fractions of a second.
    pub fn to_the_second(&self) -> String {
        let second = self.to_system_time();
        second.map_or_else(
            || self.0.clone(),
            |at| humantime::format_rfc3339_seconds(at).to_string(),
        )
    }

    /// The system time of the text; `None` when it is not RFC 3339 in UTC.
    pub fn to_system_time(&self) -> Option<std::time::SystemTime> {
        humantime::parse_rfc3339(&self.0).ok()
    }
}
