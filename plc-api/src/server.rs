//! Messages between a server end and the machine that it serves, beyond the interface. No client sends any of them.

use crate::port::Port;

/// The port of a machine that server ends serve.
pub trait ServedPort: Port {
    /// Hears of what happened at a server end. It does not wait.
    fn notice(&self, notice: ServerNotice);

    /// How punctual the servo thread is; `None` in simulated time, which has none.
    fn servo_timing(&self) -> Option<ServoTiming>;
}

/// What happened at a server end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ServerNotice {
    /// Whether it has its connection to the MQTT broker. True is taken for granted until it says otherwise.
    BusLink {
        /// It has.
        connected: bool,
    },
    /// It has connected again, and notices may be lost: outputs that nobody has claimed are published again.
    Reconnected,
    /// It refused something that an operator should know; raised as a warning. At most 500 characters.
    Warning(String),
}

/// How punctual the servo thread and the bus to the drives have been since their start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ServoTiming {
    /// Servo period, s.
    pub period_s: f64,
    /// Servo cycles that were not finished when the next one was due.
    pub overruns: u64,
    /// Exchanges with the drives that ended late.
    pub late_exchanges: u64,
    /// Frames to the drives that were lost.
    pub lost_frames: u64,
    /// How late after its time each cycle began.
    pub lateness: Durations,
    /// How long each cycle took.
    pub computing: Durations,
}

/// Durations that were measured, by size.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Durations {
    /// Upper bound of each bucket, s, ascending, and how many are in it and not in one before. The last bound is
    /// infinite.
    pub buckets: Vec<(f64, u64)>,
    /// Sum of all, s.
    pub sum_s: f64,
    /// The longest, s.
    pub max_s: f64,
}
