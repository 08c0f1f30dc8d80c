//! The interface to the drives: commands to the motors and their reports, exchanged for all motors at once.

use std::fmt;

/// Command to one motor in one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Command {
    /// Position at the end of this cycle, mm or degrees from the machine's zero. Never NaN or infinite.
    pub position: f64,
    /// True if the drive must have power and follow `position`. If false, `position` is the expected position
    /// of the motor, and the drive must not move to it.
    pub enable: bool,
    /// True if the drive must clear its fault. This lasts from a reset until the drive reports no fault, or
    /// until a time limit.
    pub clear_fault: bool,
}

/// Report of one motor in one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Feedback {
    /// Actual position, mm or degrees from the machine's zero; finite. It has no meaning while the motor is
    /// not homed.
    pub position: f64,
    /// True if the drive has power and follows its command.
    pub is_enabled: bool,
    /// True if the position refers to the machine's zero: the encoder is absolute, or the drive was homed.
    pub is_homed: bool,
    /// Fault code of the drive, 0 for none. With a fault the drive does not follow.
    pub fault: u16,
}

impl Feedback {
    /// Returns the report of a homed motor that follows its command, at this position.
    pub fn following(position: f64) -> Self {
        Self {
            position,
            is_enabled: true,
            is_homed: true,
            fault: 0,
        }
    }

    #[expect(
        clippy::needless_bitwise_bool,
        reason = "of many motors, without a jump for each"
    )]
    pub(crate) fn is_operational(self) -> bool {
        self.is_enabled & self.is_homed & (self.fault == 0)
    }
}

/// Result of the exchange of one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CycleResult {
    /// Each motor has received its command, and all feedback is from this cycle.
    OnTime,
    /// As [`CycleResult::OnTime`], but the exchange ended later than the bus allows.
    Late,
    /// The commands may not have reached their motors. The feedback is unchanged.
    Lost,
}

/// Number of failed exchanges since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BusCounts {
    /// Number of cycles that ended late.
    pub late: u64,
    /// Number of lost frames.
    pub lost: u64,
}

/// Function that cuts the power of all drives without the bus, for example by an output of the computer.
pub type Cutoff = Box<dyn Fn() + Send>;

/// The bus to the drives of all motors. A motor's place is its index among all motors of the machine: in the
/// order of the coordinate systems, and within each of them in the order of its axes.
pub trait DriveBus: fmt::Debug + Send {
    /// Exchanges the process data of one servo cycle; the servo calls it once in each cycle. Both slices have
    /// an entry for each motor. It must not allocate, lock, wait or panic.
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult;

    /// Signals that the servo is running. The servo calls it once in each cycle, before the exchange, with a
    /// number that has grown since the last call. It serves an output that a drive or a safety relay watches.
    /// If the output does not change for longer than the device allows, the device itself brakes. It must not
    /// allocate, lock, wait or panic.
    fn heartbeat(&mut self, cycle: u64) {
        let _ = cycle;
    }

    /// Returns true if motors keep their speed while no commands arrive, because their time is counted in
    /// exchanges (simulated motors). If false, a motor without commands stops at its last commanded position.
    /// After a delay the servo then does not resume at speed. The servo calls it once, before the first
    /// cycle.
    fn keeps_speed(&self) -> bool {
        false
    }

    /// Returns a function that cuts the power of all drives without the bus. Another thread calls this
    /// function once, after the servo has failed: a call of the bus or of a spindle panicked, or did not
    /// return for 60 ms. With `None`, the drives themselves must detect that the heartbeat has stopped. The
    /// runtime calls it once, before the first cycle.
    fn cutoff(&mut self) -> Option<Cutoff> {
        None
    }

    /// Returns the permitted number of consecutive lost frames. One more is a fault: all motors brake and
    /// lose power. The number is at most that which the drives themselves allow before they stop, and at most
    /// the frames of 90 ms. The servo calls it once, before the first cycle.
    fn lost_in_a_row_max(&self) -> u32 {
        2
    }

    /// Returns true if the feedback of the motor at this place is always the command of the same cycle.
    /// Simulated time may then skip cycles in which the motor moves. The servo calls it once, before the
    /// first cycle.
    fn is_ideal(&self, place: usize) -> bool {
        let _ = place;
        false
    }
}
