//! The interface to a spindle: its commands, and its report in each servo cycle.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};

use tandem_model::settings::MotorSettings;

use crate::brake::or_unlimited;
use crate::control::{Fault, SpindleDirection};
use crate::power::Power;

/// State that a spindle reports.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpindleState {
    /// Actual speed, r/min, clockwise positive.
    pub rpm: f64,
    /// Angle, degrees, 0 to below 360, clockwise positive.
    pub angle_deg: f64,
    /// Progress of an orientation.
    pub orientation: Orientation,
    /// True if the spindle neither turns nor is about to turn. The motion of a thread is not considered.
    pub rests: bool,
    /// True if, without a command, further cycles change only the angle, and at speed 0 nothing. Simulated
    /// time may then skip cycles; in real time each cycle is executed.
    pub is_steady: bool,
    /// True if the drive has power and follows commands.
    pub is_enabled: bool,
    /// Fault code of the drive, 0 for none. With a fault the drive does not follow.
    pub fault: u16,
}

/// Progress of an orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Orientation {
    /// The spindle is not oriented, or follows a thread.
    #[default]
    Open,
    /// The orientation is commanded, but not finished.
    Pending,
    /// The spindle rests at its orientation position.
    Reached,
}

/// A step of a thread, in which the spindle follows the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ThreadStep {
    /// A move in the thread, in or out, begins at the current angle. No command arrives until the thread
    /// ends.
    Begin,
    /// Revolutions since the move began, at the end of this cycle, clockwise positive. With `None` the
    /// spindle keeps its position.
    Turn(Option<f64>),
    /// The thread has ended or was abandoned. The spindle is at rest, or with `brakes` decelerates to rest.
    End {
        /// True if the thread was aborted while the spindle turned.
        brakes: bool,
    },
}

/// The spindle of a coordinate system. Its methods must not allocate, lock, wait or panic.
pub trait Spindle: fmt::Debug + Send {
    /// Commands whether the drive must have power from now on, and whether it must clear its fault. The servo
    /// enables the drive before the first command that turns the spindle. Without power the spindle must not
    /// turn.
    fn power(&mut self, enable: bool, clear_fault: bool);

    /// Turns at this speed, stops, or orients the spindle. The magnitude of `rpm` applies to `Cw` and `Ccw`
    /// only, up to the maximum of the spindle; NaN is replaced by 0.
    fn command(&mut self, direction: SpindleDirection, rpm: f64);

    /// Executes a step of a thread.
    fn follow(&mut self, step: ThreadStep);

    /// Ends a servo cycle after the exchange with the motors, and returns the report of the spindle. In real
    /// time the servo calls it in each cycle, also at rest and before the first command.
    fn cycle(&mut self) -> SpindleState;

    /// Returns the state between two cycles, including the effect of commands since the last cycle.
    fn state(&self) -> SpindleState;
}

/// A channel's spindle, with its last report.
#[derive(Debug)]
pub(crate) struct SpindleLink {
    device: Box<dyn Spindle>,
    state: SpindleState,
    power: Power,
    /// A command that waits for power, or for the end of a thread.
    pending: Option<(SpindleDirection, f64)>,
    in_thread: bool,
    motor: u16,
    /// Maximum acceleration, r/min per second; infinite for an immediate change of speed.
    acceleration: f64,
    /// Maximum speed, r/min.
    max_rpm: f64,
    /// The last command.
    target: (SpindleDirection, f64),
    awaited: Option<SpindleWait>,
    /// True if a call of the device has panicked after a failure of the servo.
    has_failed: bool,
}

/// A pending [`Control::AwaitSpindle`](crate::Control).
#[derive(Debug, Clone, Copy)]
struct SpindleWait {
    id: u64,
    within: f64,
}

/// Waits and commands that a cycle of the spindle has completed.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SpindleEnds {
    /// True if a commanded orientation has ended.
    pub(crate) orientation: bool,
    /// Id of the wait that has ended.
    pub(crate) reached: Option<u64>,
}

impl SpindleLink {
    /// Creates the link. An acceleration that is not above 0 is replaced by infinity.
    pub(crate) fn new(device: Box<dyn Spindle>, motor: &MotorSettings) -> Self {
        Self {
            state: device.state(),
            device,
            power: Power::Off,
            pending: None,
            in_thread: false,
            motor: motor.number,
            acceleration: or_unlimited(motor.max_acceleration),
            max_rpm: motor.max_velocity.max(0.0),
            target: (SpindleDirection::Stop, 0.0),
            awaited: None,
            has_failed: false,
        }
    }

    pub(crate) fn state(&self) -> SpindleState {
        self.state
    }

    /// Returns true if the spindle neither turns nor is about to turn. The motion of a thread is not
    /// considered.
    pub(crate) fn rests(&self) -> bool {
        self.state.rests && self.pending.is_none()
    }

    /// Returns true if further cycles change at most the angle.
    pub(crate) fn is_steady(&self) -> bool {
        self.state.is_steady && !self.power.is_enabling() && self.awaited.is_none()
    }

    /// Returns true if further cycles change nothing.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.is_steady() && self.state.rpm == 0.0
    }

    /// Returns true while the drive is being enabled, an orientation is unfinished, or a wait for the last
    /// command is pending.
    pub(crate) fn is_busy(&self) -> bool {
        self.power.is_enabling() || self.state.orientation == Orientation::Pending || self.awaited.is_some()
    }

    /// Commands the spindle. In a thread, the command waits for the end of the thread. A command that turns
    /// the spindle waits for power.
    pub(crate) fn command(&mut self, direction: SpindleDirection, rpm: f64) {
        self.target = (direction, rpm);
        let waits = self.in_thread || (direction != SpindleDirection::Stop && !self.has_power());
        self.pending = waits.then_some((direction, rpm));
        if !waits {
            self.device.command(direction, rpm);
        }
        self.state = self.device.state();
    }

    pub(crate) fn follow(&mut self, step: ThreadStep) {
        self.device.follow(step);
        self.state = self.device.state();
        self.in_thread = !matches!(step, ThreadStep::End { .. });
        if !self.in_thread {
            self.obey_pending();
        }
    }

    fn obey_pending(&mut self) {
        if let Some((direction, rpm)) = self.pending.take() {
            self.command(direction, rpm);
        }
    }

    /// Requests one report with this id when the spindle has reached the last command.
    pub(crate) fn await_target(&mut self, id: u64, within: f64) {
        self.awaited = Some(SpindleWait { id, within });
    }

    /// Returns true if the spindle has reached the last command. A command that waits for the end of a thread
    /// is treated as reached: the thread may not end before the caller has the answer.
    fn has_reached(&self, within: f64) -> bool {
        if self.in_thread {
            return true;
        }
        let (direction, rpm) = self.target;
        let speed = if rpm.is_finite() {
            rpm.abs().min(self.max_rpm)
        } else {
            0.0
        };
        let target = match direction {
            SpindleDirection::Orient => {
                return self.state.orientation == Orientation::Reached && self.pending.is_none();
            }
            SpindleDirection::Cw => speed,
            SpindleDirection::Ccw => -speed,
            SpindleDirection::Stop => 0.0,
        };
        if target == 0.0 {
            return self.rests();
        }
        self.pending.is_none() && (self.state.rpm - target).abs() <= within * speed
    }

    /// Executes one cycle, and returns the waits and commands that it has completed. After an error the
    /// spindle has no power.
    pub(crate) fn cycle(&mut self, period_s: f64) -> Result<SpindleEnds, Fault> {
        let before = self.state.orientation;
        self.state = self.device.cycle();
        let has_ended = before == Orientation::Pending && self.state.orientation == Orientation::Reached;
        let power = self.power;
        let watched = self.power.watch(self.trouble(), period_s);
        if power != self.power {
            if watched.is_err() {
                self.command(SpindleDirection::Stop, 0.0);
            }
            self.apply_power();
            if self.power == Power::On {
                self.obey_pending();
            }
        }
        watched?;
        let reached = self.awaited.filter(|awaited| self.has_reached(awaited.within));
        if reached.is_some() {
            self.awaited = None;
        }
        Ok(SpindleEnds {
            orientation: has_ended,
            reached: reached.map(|awaited| awaited.id),
        })
    }

    /// Returns true if the drive follows. If the drive has no power, requests power and returns false.
    pub(crate) fn has_power(&mut self) -> bool {
        if !self.power.is_commanded() {
            self.power.ask(self.trouble().is_none());
            self.apply_power();
        }
        self.power == Power::On
    }

    /// Requests a reset, which takes effect when the channel is at rest.
    pub(crate) fn ask_for_reset(&mut self) {
        self.power.ask_for_reset();
    }

    /// Executes a requested reset at rest: clears the fault of the spindle's drive, and enables the drive.
    pub(crate) fn reset(&mut self) {
        if self.power.reset() {
            self.apply_power();
        }
    }

    /// Switches the power off after a failure of the servo. If the device panics, it is not called again.
    pub(crate) fn power_off(&mut self) {
        self.pending = None;
        self.power = Power::Tripped { resets: false };
        if !self.has_failed {
            let commanded = catch_unwind(AssertUnwindSafe(|| self.device.power(false, false)));
            self.has_failed = commanded.is_err();
        }
        self.state = SpindleState {
            rests: true,
            is_steady: true,
            ..SpindleState::default()
        };
    }

    fn apply_power(&mut self) {
        let power = self.power;
        self.device.power(power.is_commanded(), power.clears_faults());
        self.state = self.device.state();
    }

    fn trouble(&self) -> Option<Fault> {
        Fault::from_drive(self.motor, None, self.state.is_enabled, self.state.fault)
    }

    /// Returns the largest change per second of the speed factor (1 at 100 percent) of a motion that turns the
    /// spindle, at which the spindle keeps within its acceleration. `rpm` is its speed at 100 percent.
    pub(crate) fn steepest_slope(&self, rpm: f64) -> f64 {
        self.acceleration / rpm.abs()
    }
}
