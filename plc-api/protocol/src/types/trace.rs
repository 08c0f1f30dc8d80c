//! The recent motion of a coordinate system's axes, as the servo recorded it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{CoordinateSystemNumber, Timestamp};

/// Number of stored samples, and largest number of samples of one answer.
pub const TRACE_SAMPLES_MAX: u32 = 6000;

/// Requested samples: query of `GET /cs/{n}/trace`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TraceQuery {
    /// Number of the first sample; if this sample is no longer stored, the answer starts at the oldest
    /// sample.
    pub from: u32,
    /// Number of samples, 1 to 6000.
    pub count: u32,
    /// Letters of the axes, such as `XZ`; empty for all axes.
    pub axes: String,
}

/// Response of `GET /cs/{n}/trace`: samples of the last minute, in time order.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Trace {
    /// The coordinate system.
    pub cs: CoordinateSystemNumber,
    /// Time between two samples, s: a whole number of servo periods.
    pub interval_s: f64,
    /// Number of the first sample in this answer; samples are numbered from 0 since the start of the runtime.
    pub first: u32,
    /// Number of the sample after the last one in this answer: the next `from`.
    pub next: u32,
    /// Current time of day.
    pub now: Timestamp,
    /// Current time on the clock of the samples, s since the start of the runtime.
    pub now_s: f64,
    /// Time of each sample, s since the start of the runtime.
    pub time_s: Vec<f64>,
    /// Commanded speed on the path of each sample, mm/min.
    pub feedrate: Vec<f64>,
    /// Actual spindle speed of each sample, r/min; negative counter-clockwise.
    pub spindle_rpm: Vec<f64>,
    /// Motion of each axis, by letter.
    pub axes: BTreeMap<String, TraceAxis>,
}

/// Motion of one axis: a value for each sample; positions in mm or degrees.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TraceAxis {
    /// Commanded machine position.
    pub position: Vec<f64>,
    /// Commanded velocity in the servo cycle of the sample, mm/s or degrees/s.
    pub velocity: Vec<f64>,
    /// Change of the commanded velocity in this servo cycle, mm/s² or degrees/s².
    pub acceleration: Vec<f64>,
    /// Commanded minus actual position, mm or degrees.
    pub following_error: Vec<f64>,
}
