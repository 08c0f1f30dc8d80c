//! Messages from the coordinator to a channel, and from the channel to the coordinator.

use tandem_model::alarm::{
    Alarm, DRIVE_BUS_LOST, DRIVE_FAULT, DRIVE_NOT_ENABLED, IN_POSITION_TIMEOUT, MOTION_RAN_OUT,
    MOTOR_NOT_HOMED, POSITION_JUMP, SPINDLE_MISSING, SPINDLE_TURNS,
};
use tandem_model::profile::{PathPlace, TimeBase};
use tandem_model::{Axis, AxisSet, MachinePosition, Origin};

/// A command to one channel. The channel takes commands at the start of a servo cycle, in the order sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Control {
    /// Feed hold: the time base decreases to 0 with `hold_slew_ms`, then [`Event::Held`] follows. No profile
    /// starts until [`Control::Resume`]. While the tool is in a thread, the hold waits until the move out of
    /// the hole is finished, unless [`Control::HoldInPhase`] follows. A block that reaches its end point is
    /// finished. The channel ignores this command during a stop or an abort.
    Hold,
    /// Feed hold that also acts while the tool is in a thread: the motion and its spindle decelerate to rest in phase,
    /// and continue in phase after [`Control::Resume`].
    HoldInPhase,
    /// Ends feed hold. The time base changes to the override with `override_slew_ms`.
    Resume,
    /// Single block. `true` acts like [`Control::Hold`] at the end of the running block, or of the next block
    /// if no block runs. The hold begins before the following block starts, or in a chain from the joint on,
    /// along the path. Consecutive profiles of one origin are one block. `false` cancels the command if the
    /// hold has not begun.
    HoldAfterBlock(bool),
    /// Decelerates on the path as feed hold does, discards all profiles older than `epoch`, then emits
    /// [`Event::Stopped`]. It also ends feed hold and clears a fault. The sender must send it before the
    /// first profile of that epoch.
    Stop {
        /// Oldest epoch whose profiles may still run.
        epoch: u32,
    },
    /// Abort: each motor brakes at its `max_acceleration` from its current velocity, and leaves the path.
    /// Otherwise it acts like [`Control::Stop`]. It replaces a stop in progress; one [`Event::Stopped`] then
    /// answers both.
    Abort {
        /// Oldest epoch whose profiles may still run.
        epoch: u32,
    },
    /// Overrides as factors; 1.0 is 100 percent. `feed` is limited to 0 to 2, `rapid` to 0 to 1. A value that
    /// is not a number changes nothing. The time base follows with `override_slew_ms`.
    Override {
        /// Feed override.
        feed: f64,
        /// Rapid override.
        rapid: f64,
    },
    /// Prepares a reset of the drives after a fault of a drive or of the bus. The next [`Control::Stop`] then
    /// clears the faults of the drives, enables them at the actual positions of the motors, and reports these
    /// positions. Without a fault it does nothing.
    ResetDrives,
    /// The next [`Splice`](crate::Splice) is available; its profiles run from its position on.
    /// [`Event::Spliced`] reports the result. A stop or an abort before that position rejects the splice.
    Splice,
    /// Sets the skip input of a motor, which keeps this value until the next command. An input that is on
    /// acts like the simulated skip input. G31 captures the actual position of the cycle that takes the
    /// command, so the position is not exact. If the input is on at the start of G31, G31 captures the start
    /// position.
    SkipInput {
        /// CNC motor number. A number without an axis has no effect.
        motor: u16,
        /// True to switch the input on.
        on: bool,
    },
    /// Commands the spindle. Hold, stop and abort do not affect the spindle. While a thread is cut, the last
    /// command waits until the tool is out.
    Spindle {
        /// Function of the spindle.
        direction: SpindleDirection,
        /// Speed for `Cw` and `Ccw`, r/min, limited to the motor's maximum.
        rpm: f64,
    },
    /// Requests [`Event::SpindleReached`] for the last spindle command. The event follows when the spindle
    /// has reached standstill, its orientation, or its speed within `within`. While a thread is cut, the
    /// event follows at once. A newer request replaces this request.
    AwaitSpindle {
        /// Id that the event repeats.
        id: u64,
        /// Largest deviation from the commanded speed, as a share of that speed, 0 to 1.
        within: f64,
    },
}

/// Function of a spindle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SpindleDirection {
    /// M03: turn clockwise; the speed is positive.
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
    /// A profile gave its first setpoint, its start point.
    Started {
        /// Segment number of the profile.
        segment: u64,
        /// Block from which the profile comes.
        origin: Origin,
        /// Override that scales the time of the profile.
        base: TimeBase,
        /// Time of the cycle, s.
        time_s: f64,
    },
    /// A profile gave its end point. With an exact stop, all motors are also in position, and the next
    /// profile starts in the next cycle. A block of a chain is finished at the end of the ramp to the next
    /// block.
    Finished {
        /// Segment number of the profile.
        segment: u64,
        /// Time of the cycle, s.
        time_s: f64,
    },
    /// A G31 block has reached its end; its [`Event::Finished`] follows (D41).
    Captured {
        /// Segment number of the G31 block.
        segment: u64,
        /// Positions at which the motors rest: the captured position, or else the target of the motor.
        position: MachinePosition,
        /// The axes whose motors captured a position.
        captured: AxisSet,
    },
    /// The commanded motion is at rest under feed hold. Emitted once for each [`Control::Hold`] that took
    /// effect.
    Held {
        /// Position on the path. Between two blocks it is the end of the passed block, in backward motion its
        /// start.
        at: PathPlace,
    },
    /// The servo was late while its setpoints moved, were about to move, or had moved shortly before. The
    /// motion is held as by [`Control::HoldInPhase`]; [`Event::Held`] follows. If a hold, a stop or a fault
    /// brings the motion to rest anyway, the event has no other effect.
    Late {
        /// Number of missed cycles.
        cycles: u64,
    },
    /// A [`Splice`](crate::Splice) was executed or rejected.
    Spliced {
        /// True if the new profiles run. False if the previous plan continues: the motion had passed the
        /// position, the machine was not at rest, or the new plan was slower at the position.
        taken: bool,
    },
    /// The commanded motion is at rest after [`Control::Stop`] or [`Control::Abort`]. The running segment is
    /// abandoned, without [`Event::Finished`].
    Stopped {
        /// Epoch of the command. Profiles of older epochs never run.
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
    /// The channel has a fault. The channel starts no profile until [`Control::Stop`] or [`Control::Abort`].
    Fault(Fault),
}

/// Fault of a servo cycle. It contains only numbers, so that a cycle need not create a text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A motor was outside its in-position window after `in_position_timeout_ms`.
    InPositionTimeout {
        /// CNC motor number.
        motor: u16,
        /// Axis of the motor.
        axis: Axis,
        /// Commanded minus actual position, mm or degrees.
        following_error: f64,
    },
    /// A profile does not begin at the position of the machine, or contains a position that is not a number.
    /// The profile was not started.
    PositionJump {
        /// CNC motor number; 0 for an axis without a motor.
        motor: u16,
        /// Axis of the motor.
        axis: Axis,
        /// Distance that the motor would have jumped, mm or degrees.
        jump: f64,
    },
    /// The next profile of a chain was missing when the motion passed the joint. The motors brake and leave
    /// the path.
    RanOut {
        /// Segment number of the last profile.
        segment: u64,
    },
    /// A spindle was commanded in a coordinate system without a spindle.
    SpindleMissing,
    /// A drive reports a fault.
    DriveFault {
        /// CNC motor number.
        motor: u16,
        /// The faulty axis. `None` for the spindle.
        axis: Option<Axis>,
        /// Fault code of the drive.
        code: u16,
    },
    /// More consecutive frames of the bus were lost than the bus allows.
    BusLost {
        /// Number of consecutive lost frames.
        cycles: u32,
    },
    /// A drive has no power: it lost power, or was not enabled within the time limit.
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
        /// Axis of the motor.
        axis: Axis,
    },
    /// The spindle turns, or is about to turn, at the start of a thread. The thread was not started.
    SpindleTurns {
        /// Speed of the spindle, r/min, clockwise positive.
        rpm: f64,
    },
}

impl Fault {
    /// Returns the fault that prevents a drive from following: a fault of the drive, or missing power.
    /// Returns `None` if the drive follows.
    pub(crate) fn from_drive(motor: u16, axis: Option<Axis>, is_enabled: bool, code: u16) -> Option<Fault> {
        if code != 0 {
            Some(Fault::DriveFault { motor, axis, code })
        } else if !is_enabled {
            Some(Fault::NotEnabled { motor, axis })
        } else {
            None
        }
    }

    /// Returns the alarm of this fault. It allocates the alarm text, so a servo cycle must not call it.
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
