//! The interface to the spindle: its commands, and its report in each servo cycle.

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
    /// True if the spindle neither turns nor is about to turn, except for a thread.
    pub rests: bool,
    /// True if, without a command, further cycles change only its angle, and at speed 0 nothing: cycles may
    /// then be skipped. Always false for a drive that may report a fault at any time.
    pub is_steady: bool,
    /// True if the drive has power and follows commands.
    pub is_enabled: bool,
    /// The drive's own fault code; 0 for none. With a fault it does not follow.
    pub fault: u16,
}

/// Progress of an orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Orientation {
    /// The spindle is not oriented, or a thread turns it.
    #[default]
    Open,
    /// The orientation is commanded, and not finished.
    Pending,
    /// The spindle rests at its orientation position.
    Reached,
}

/// A step of a thread, in which the spindle follows the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ThreadStep {
    /// A pass in the thread, in or out, begins at the current angle. No command arrives until the thread ends.
    Begin,
    /// Revolutions turned since the pass began, at the end of this cycle, clockwise positive. `None` keeps the
    /// position.
    Turn(Option<f64>),
    /// The thread has ended or was abandoned: the spindle rests, or with `brakes` decelerates to rest.
    End {
        /// True if the thread was aborted while the spindle turned.
        brakes: bool,
    },
}

/// The spindle of a coordinate system. It must not allocate, lock, wait or panic.
pub trait Spindle: fmt::Debug + Send {
    /// Commands whether the drive must have power from now on, and clear its fault. The drive is enabled
    /// before the first command that turns it; without power it must not turn.
    fn power(&mut self, enable: bool, clear_fault: bool);

    /// Turns at this speed, stops, or orients. `rpm` applies to `Cw` and `Ccw` only, by its magnitude, up to the
    /// maximum of the spindle; NaN is replaced by 0.
    fn command(&mut self, direction: SpindleDirection, rpm: f64);

    /// Executes a step of a thread.
    fn follow(&mut self, step: ThreadStep);

    /// Ends a servo cycle, after commands and feedback of the motors were exchanged, and returns its report.
    fn cycle(&mut self) -> SpindleState;

    /// Returns its state at any other time, including commands given since.
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
    /// r/min per second; infinite: at once.
    acceleration: f64,
    /// r/min.
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
    /// Id of a wait that has ended.
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

    /// Returns true if the spindle neither turns nor is about to turn, except for a thread.
    pub(crate) fn rests(&self) -> bool {
        self.state.rests && self.pending.is_none()
    }

    /// Returns true if further cycles change at most its angle.
    pub(crate) fn is_steady(&self) -> bool {
        self.state.is_steady && !self.power.is_enabling() && self.awaited.is_none()
    }

    /// Returns true if further cycles change nothing.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.is_steady() && self.state.rpm == 0.0
    }

    /// Returns true while its drive is being enabled, an orientation is unfinished, or a wait for the command
    /// is pending.
    pub(crate) fn is_busy(&self) -> bool {
        self.power.is_enabling() || self.state.orientation == Orientation::Pending || self.awaited.is_some()
    }

    /// Commands the spindle. In a thread, the command waits for its end; a command that turns the spindle
    /// waits for power.
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

    /// Requests one report when the last command is reached.
    pub(crate) fn await_target(&mut self, id: u64, within: f64) {
        self.awaited = Some(SpindleWait { id, within });
    }

    /// Returns true if the spindle has reached the last command. A command that waits for the end of a thread
    /// is treated as reached, because the thread may need the answer to end.
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

    /// Runs one cycle, and returns what it has completed. After an error the spindle has no power.
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

    /// Returns true if its drive follows; otherwise it is being enabled.
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

    /// Executes a requested reset at rest: clears the fault of the spindle, and enables it.
    pub(crate) fn reset(&mut self) {
        if self.power.reset() {
            self.apply_power();
        }
    }

    /// Switches the power off after a failure of the servo. A device that panics is not called again.
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

    /// Returns the greatest change of a time base per second at which a motion that turns the spindle at this
    /// speed at 100 percent keeps its acceleration.
    pub(crate) fn steepest_slope(&self, rpm: f64) -> f64 {
        self.acceleration / rpm.abs()
    }
}
