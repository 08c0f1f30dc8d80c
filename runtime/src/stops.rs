//! Causes and kinds of stops. The book and the tests use this table, with one cell for each cause and each kind of
//! motion.

/// Event that stops motion, or that must not stop it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopCause {
    /// An interlock source is set.
    Interlock,
    /// The owner of an interlock source with `on_loss = "on"` is lost.
    SourceLost,
    /// `SERVO_LATE`: servo cycles were omitted for `servo_late_ms` or longer.
    ServoLate,
    /// `CLIENT_LOST`: a client that asked to be watched has sent no heartbeat within its interval.
    ClientLost,
    /// `BUS_LOST`: the connection to the MQTT broker is lost, with `on_bus_loss = "hold_at_wait"`.
    BusLost,
    /// A sequence program raises an alarm.
    Alarm,
    /// The command hold.
    Hold,
    /// The command stop.
    Stop,
    /// The command abort.
    Abort,
}

/// Kind of motion that a stop interrupts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StoppedMotion {
    /// A rapid motion.
    Rapid,
    /// A line at a feedrate.
    Line,
    /// An arc.
    Arc,
    /// The tool is in a thread (tapping).
    Thread,
    /// A dwell.
    Dwell,
    /// A jog.
    Jog,
    /// Homing.
    Home,
    /// A line with cutter compensation.
    Compensation,
    /// An axis reverses its direction between two blocks.
    Reversal,
}

/// Reaction of a motion to a stop cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReaction {
    /// The motion stops on its path; a resume continues.
    Holds,
    /// Motion and spindle stop in phase; a resume continues both in phase.
    HoldsInPhase,
    /// The tool finishes the thread first; then the motion is held.
    HoldsAfterThread,
    /// The jog ends on its path.
    EndsJog,
    /// The motion stops on its path (in a thread in phase with the spindle), and the run ends.
    Stops,
    /// Each motor brakes at its maximum acceleration, and the run ends.
    Brakes,
    /// The motion continues.
    Continues,
}

impl StopCause {
    /// All causes, in the order of the table.
    pub const ALL: [Self; 9] = [
        Self::Interlock,
        Self::SourceLost,
        Self::ServoLate,
        Self::ClientLost,
        Self::BusLost,
        Self::Alarm,
        Self::Hold,
        Self::Stop,
        Self::Abort,
    ];

    /// Returns the name of the cause in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Interlock => "interlock",
            Self::SourceLost => "lost source",
            Self::ServoLate => "`SERVO_LATE`",
            Self::ClientLost => "`CLIENT_LOST`",
            Self::BusLost => "`BUS_LOST`",
            Self::Alarm => "alarm of a handler",
            Self::Hold => "hold",
            Self::Stop => "stop",
            Self::Abort => "abort",
        }
    }

    /// Returns the reaction of a kind of motion to this cause.
    pub fn reaction(self, motion: StoppedMotion) -> StopReaction {
        use StopReaction::{Brakes, Continues, EndsJog, Holds, HoldsAfterThread, HoldsInPhase, Stops};
        match (self, motion) {
            (Self::BusLost, _) | (Self::ServoLate, StoppedMotion::Dwell) => Continues,
            (Self::Abort, _) => Brakes,
            (Self::Stop | Self::Alarm, _) => Stops,
            (_, StoppedMotion::Jog) => EndsJog,
            (Self::Hold, StoppedMotion::Thread) => HoldsAfterThread,
            (_, StoppedMotion::Thread) => HoldsInPhase,
            _ => Holds,
        }
    }
}

impl StoppedMotion {
    /// All kinds of motion, in the order of the table.
    pub const ALL: [Self; 9] = [
        Self::Rapid,
        Self::Line,
        Self::Arc,
        Self::Thread,
        Self::Dwell,
        Self::Jog,
        Self::Home,
        Self::Compensation,
        Self::Reversal,
    ];

    /// Returns the name of the kind of motion in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rapid => "rapid",
            Self::Line => "line",
            Self::Arc => "arc",
            Self::Thread => "thread",
            Self::Dwell => "dwell",
            Self::Jog => "jog",
            Self::Home => "home",
            Self::Compensation => "compensation",
            Self::Reversal => "reversal",
        }
    }
}

impl StopReaction {
    /// All reactions.
    pub const ALL: [Self; 7] = [
        Self::Holds,
        Self::HoldsInPhase,
        Self::HoldsAfterThread,
        Self::EndsJog,
        Self::Stops,
        Self::Brakes,
        Self::Continues,
    ];

    /// Returns the name of the reaction in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::HoldsInPhase => "holds in phase",
            Self::HoldsAfterThread => "holds after the thread",
            Self::EndsJog => "ends",
            Self::Stops => "stops",
            Self::Brakes => "brakes",
            Self::Continues => "continues",
        }
    }

    /// Returns the description of the reaction, with its time limit.
    pub fn text(self) -> &'static str {
        match self {
            Self::Holds => {
                "Stops on its path within `hold_slew_ms`, or within the time that the limits of the motors \
                 require if that \
                 is longer; a dwell stops at once. `resume` continues."
            }
            Self::HoldsInPhase => {
                "Motion and spindle stop in phase within `hold_slew_ms`, or within the time that the \
                 acceleration of the \
                 spindle requires if that is longer. `resume` continues in phase."
            }
            Self::HoldsAfterThread => {
                "As the manual demands, the thread is finished first. The duration of the thread is the \
                 only time limit."
            }
            Self::EndsJog => {
                "Stops within `hold_slew_ms`, or at the maximum acceleration of the motor; READY, at the \
                 latest 200 ms after \
                 the last refresh. A later refresh does not start the jog again."
            }
            Self::Stops => {
                "Stops on its path, in a thread in phase, with the limits of `holds`; outputs are \
                 cancelled, STOPPED."
            }
            Self::Brakes => {
                "Each motor brakes at its `max_acceleration`; the time is its speed divided by this value. \
                 Outputs are cancelled, STOPPED."
            }
            Self::Continues => "Nothing changes for the motion.",
        }
    }

    /// Returns the maximum time in s until a motion of this kind rests. `hold_slew_ms` is that of the configuration, and
    /// applies to motors whose own limits require no longer time. `braking_s` is the longest time of a motor: its speed
    /// divided by its `max_acceleration`. Returns `None` if the reaction has no time limit.
    pub fn limit_s(self, motion: StoppedMotion, hold_slew_ms: f64, braking_s: f64) -> Option<f64> {
        match (self, motion) {
            (Self::HoldsAfterThread | Self::Continues, _) => None,
            (_, StoppedMotion::Dwell) => Some(0.0),
            (Self::Brakes, _) => Some(braking_s),
            (Self::Holds | Self::HoldsInPhase | Self::EndsJog | Self::Stops, _) => {
                Some(hold_slew_ms / 1000.0)
            }
        }
    }
}

#[cfg(test)]
mod tests;
