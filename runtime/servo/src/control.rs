//! Messages from the coordinator to a channel, and from the channel to the coordinator.

use tandem_model::alarm::{
    Alarm, DRIVE_BUS_LOST, DRIVE_FAULT, DRIVE_NOT_ENABLED, IN_POSITION_TIMEOUT, MOTION_RAN_OUT,
    MOTOR_NOT_HOMED, POSITION_JUMP, SPINDLE_MISSING, SPINDLE_TURNS,
};
use tandem_model::profile::{PathPlace, TimeBase};
use tandem_model::{Axis, AxisSet, MachinePosition, Origin};

/// A command to one channel. Taken at the start of a servo cycle, in the order given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Control {
    /// Feed hold: the time base decreases to 0 with `hold_slew_ms`, then [`Event::Held`]. No profile starts
    /// until [`Control::Resume`]. While the tool is in a thread, the hold waits until the pass out is
    /// finished, unless [`Control::HoldInPhase`] follows. A block that reaches its end point is still
    /// finished. Ignored during a stop or an abort.
    Hold,
    /// Feed hold that also acts while the tool is in a thread: the motion and its spindle decelerate to rest in phase,
    /// and continue in phase after [`Control::Resume`].
    HoldInPhase,
    /// Ends feed hold: the time base changes to the override with `override_slew_ms`.
    Resume,
    /// Single block. `true` acts like [`Control::Hold`] at the end of the running block, or of the next one when none
    /// runs: before the following block starts, or in a chain from the joint on, along the path. Consecutive profiles
    /// of the same origin are one block. `false` cancels this if the hold has not begun yet.
    HoldAfterBlock(bool),
    /// Decelerates on the path as feed hold does, discards everything older than `epoch`, then emits
    /// [`Event::Stopped`]. Ends feed hold and clears a fault. Send it before the first profile of that epoch.
    Stop {
        /// The oldest epoch that may still run.
        epoch: u32,
    },
    /// Each motor brakes at its `max_acceleration` from its current velocity, leaving the path; otherwise like
    /// [`Control::Stop`]. It overrides a stop in progress; both are then answered by one [`Event::Stopped`].
    Abort {
        /// The oldest epoch that may still run.
        epoch: u32,
    },
    /// Overrides as factors, 1.0 is 100 percent. `feed` is limited to 0 to 2, `rapid` to 0 to 1; a value that is
    /// not a number changes nothing. The time base follows with `override_slew_ms`.
    Override {
        /// Feed override.
        feed: f64,
        /// Rapid override.
        rapid: f64,
    },
    /// After a fault of a drive or of the bus: the [`Control::Stop`] that follows clears the faults of the drives, enables
    /// them at the position where the motors are, and reports it. Otherwise it does nothing.
    ResetDrives,
    /// The next [`Splice`](crate::Splice) is available: its profiles run from its place on. [`Event::Spliced`] reports the
    /// result; a stop or an abort before that place rejects it.
    Splice,
    /// Sets a motor's skip input, which keeps the value: on has the effect of its simulated skip input. G31 captures
    /// the actual position of the cycle that takes this, so it is not exact; an input that is on at its start captures
    /// there.
    SkipInput {
        /// CNC motor number; a number without an axis has no effect.
        motor: u16,
        /// On or off.
        on: bool,
    },
    /// Commands the spindle. Not affected by hold, stop and abort. While a thread is cut the last command waits until the
    /// tool is out.
    Spindle {
        /// Its function.
        direction: SpindleDirection,
        /// Speed for `Cw` and `Ccw`, r/min, limited to the motor's maximum.
        rpm: f64,
    },
    /// Requests [`Event::SpindleReached`] for the last command: when the spindle has reached its speed within this
    /// share of it, standstill, or its orientation; immediately while a thread is cut. A newer request replaces it.
    AwaitSpindle {
        /// Id that the event contains.
        id: u64,
        /// Greatest difference from the commanded speed as a share of it, 0 to 1.
        within: f64,
    },
}

/// Function of a spindle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SpindleDirection {
    /// M03: turn clockwise, counted as positive speed.
    Cw,
    /// M04: turn counterclockwise.
    Ccw,
    /// M05: come to rest.
    #[default]
    Stop,
    /// M19: come to rest at the orientation position.
    Orient,
}

/// Event of a channel in one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// A profile gave its first sample, its start point.
    Started {
        /// Segment number of the profile.
        segment: u64,
        /// Its origin.
        origin: Origin,
        /// Which override scales its time.
        base: TimeBase,
        /// Time of the cycle, s.
        time_s: f64,
    },
    /// A profile gave its end point; with an exact stop, all motors are in position too, and the next profile starts in the
    /// next cycle. A block of a chain is finished when the ramp to the next one is over.
    Finished {
        /// Its segment number.
        segment: u64,
        /// Time of the cycle, s.
        time_s: f64,
    },
    /// A G31 block is at its end; its [`Event::Finished`] follows (D41).
    Captured {
        /// Its segment number.
        segment: u64,
        /// Positions at which the motors rest: the captured one, or else their target.
        position: MachinePosition,
        /// The axes whose motors captured a position.
        captured: AxisSet,
    },
    /// The command is at rest under feed hold. Once for each [`Control::Hold`] that took effect.
    Held {
        /// The place; between two blocks at the end of the one that was passed, backward at its start.
        at: PathPlace,
    },
    /// The motion is held as by [`Control::HoldInPhase`], because the servo was late while its set points moved, were about to, or
    /// had moved shortly before; [`Event::Held`] follows. Under a hold, a stop or a fault, which bring it to rest anyway, nothing
    /// else happens.
    Late {
        /// Cycles that were left out.
        cycles: u64,
    },
    /// A [`Splice`](crate::Splice) was executed or rejected.
    Spliced {
        /// True if its profiles run. False if the previous plan continues: the place was passed, the machine did not
        /// rest, or the new plan was slower at the place.
        taken: bool,
    },
    /// The command is at rest after [`Control::Stop`] or [`Control::Abort`]. The running segment is abandoned, without
    /// [`Event::Finished`].
    Stopped {
        /// Epoch of the command; older profiles never run.
        epoch: u32,
        /// Commanded position at rest.
        position: MachinePosition,
    },
    /// The spindle is at rest at its orientation position.
    Oriented,
    /// The spindle has reached the last command.
    SpindleReached {
        /// Id of the [`Control::AwaitSpindle`].
        id: u64,
    },
    /// The channel has a fault. It starts nothing until [`Control::Stop`] or [`Control::Abort`].
    Fault(Fault),
}

/// Fault of a servo cycle. Only a number, so that a cycle need not build a text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A motor was outside its in-position window when `in_position_timeout_ms` had passed.
    InPositionTimeout {
        /// CNC motor number.
        motor: u16,
        /// Its axis.
        axis: Axis,
        /// Command minus actual position, mm or degrees.
        following_error: f64,
    },
    /// A profile does not begin at the position of the machine, or has a position that is not a number. Not
    /// started.
    PositionJump {
        /// CNC motor number; 0 for an axis without a motor.
        motor: u16,
        /// Its axis.
        axis: Axis,
        /// Distance that the motor would have jumped, mm or degrees.
        jump: f64,
    },
    /// A chain's next profile was missing when its joint was passed: the motors brake off the path.
    RanOut {
        /// Segment number of the last profile.
        segment: u64,
    },
    /// A spindle was commanded in a coordinate system without one.
    SpindleMissing,
    /// A drive reports a fault.
    DriveFault {
        /// CNC motor number.
        motor: u16,
        /// The faulty axis. `None` for the spindle.
        axis: Option<Axis>,
        /// The drive's own code.
        code: u16,
    },
    /// More frames of the bus were lost in a row than it allows.
    BusLost {
        /// Number of cycles.
        cycles: u32,
    },
    /// A drive has no power: it lost it, or was not enabled in time.
    NotEnabled {
        /// CNC motor number.
        motor: u16,
        /// The faulty axis. `None` for the spindle.
        axis: Option<Axis>,
    },
    /// A motor must move, but its position does not refer to the machine's zero.
    NotHomed {
        /// CNC motor number.
        motor: u16,
        /// Its axis.
        axis: Axis,
    },
    /// The spindle turns, or is about to turn, at the start of a thread. The thread was not started.
    SpindleTurns {
        /// Its speed, r/min, clockwise positive.
        rpm: f64,
    },
}

impl Fault {
    /// Returns the reason why a drive cannot follow: a fault, or no power.
    pub(crate) fn from_drive(motor: u16, axis: Option<Axis>, is_enabled: bool, code: u16) -> Option<Fault> {
        if code != 0 {
            Some(Fault::DriveFault { motor, axis, code })
        } else if !is_enabled {
            Some(Fault::NotEnabled { motor, axis })
        } else {
            None
        }
    }

    /// Returns the alarm of this fault. Allocates its text, so a servo cycle must not call it.
    pub fn alarm(self) -> Alarm {
        let named = |motor: u16, axis: Option<Axis>| match axis {
            Some(axis) => format!("motor {motor} (axis {})", axis.letter()),
            None => format!("motor {motor} (spindle)"),
        };
        let of_axis = |motor: u16, axis: Axis| format!("Motor {motor} (axis {})", axis.letter());
        let (entry, text) = match self {
            Fault::InPositionTimeout {
                motor,
                axis,
                following_error,
            } => {
                let motor = of_axis(motor, axis);
                let text = format!("{motor} is {following_error:.6} away from its commanded position");
                (&IN_POSITION_TIMEOUT, text)
            }
            Fault::PositionJump { motor, axis, jump } => {
                let motor = of_axis(motor, axis);
                let text = format!("{motor} would jump by {jump:.6}; the profile was not started");
                (&POSITION_JUMP, text)
            }
            Fault::RanOut { segment } => (
                &MOTION_RAN_OUT,
                format!("No motion followed segment {segment} in time; the motors brake and leave the path"),
            ),
            Fault::SpindleMissing => (
                &SPINDLE_MISSING,
                "A spindle command reached a coordinate system without a spindle".to_owned(),
            ),
            Fault::DriveFault { motor, axis, code } => {
                let motor = named(motor, axis);
                let text = format!("The drive of {motor} reports fault {code} (16#{code:04X})");
                (&DRIVE_FAULT, text)
            }
            Fault::BusLost { cycles } => (
                &DRIVE_BUS_LOST,
                format!(
                    "The bus to the drives has lost {cycles} frames in a row; the motors brake and leave the path"
                ),
            ),
            Fault::NotEnabled { motor, axis } => {
                let motor = named(motor, axis);
                (&DRIVE_NOT_ENABLED, format!("The drive of {motor} has no power"))
            }
            Fault::NotHomed { motor, axis } => {
                let motor = of_axis(motor, axis);
                (&MOTOR_NOT_HOMED, format!("The position of {motor} is unknown"))
            }
            Fault::SpindleTurns { rpm } => (
                &SPINDLE_TURNS,
                format!(
                    "The spindle turns at {rpm:.3} r/min, or is about to turn; the thread was not started"
                ),
            ),
        };
        Alarm::new(entry, text)
    }
}
