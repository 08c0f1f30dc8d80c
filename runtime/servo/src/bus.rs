//! The seam to the drives: what each motor is to do and what it reports, exchanged for all motors at once.

use std::fmt;

/// What a motor is to do in one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Command {
    /// Position at the end of this cycle, mm or degrees from the machine's zero. Never NaN or infinite.
    pub position: f64,
}

/// What a motor reports in one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Feedback {
    /// Actual position, mm or degrees from the machine's zero.
    pub position: f64,
}

/// How the exchange of one servo cycle went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CycleResult {
    /// Each motor has its command, and all feedback is of this cycle.
    OnTime,
    /// As on time, but the exchange ended later than the bus allows.
    Late,
    /// The commands may not have reached their motors; the feedback is that of an earlier cycle.
    Lost,
}

/// How many exchanges did not go as they should, since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BusCounts {
    /// Cycles that ended late.
    pub late: u64,
    /// Frames lost.
    pub lost: u64,
}

/// The bus to the drives of all motors. A motor's place is its place among all motors of the machine: in the order of the
/// coordinate systems, and in each in the order of its axes.
pub trait DriveBus: fmt::Debug + Send {
    /// Exchanges the process data of one servo cycle, once in each cycle; both slices have a place for each motor. Must
    /// not allocate, lock, wait or panic.
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult;

    /// True when the feedback of the motor at this place is always the command of the same cycle, whatever came before:
    /// simulated time may leave out cycles in which such a motor moves. Asked once, before the first cycle.
    fn is_ideal(&self, place: usize) -> bool {
        let _ = place;
        false
    }
}
