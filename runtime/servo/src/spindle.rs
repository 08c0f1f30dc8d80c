//! The seam to the spindle: what it is to do, and what it reports in each servo cycle.

use std::fmt;

use crate::control::SpindleDirection;

/// What a spindle reports.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpindleState {
    /// Actual speed, r/min, clockwise positive.
    pub rpm: f64,
    /// Angle, degrees, 0 to below 360, clockwise positive.
    pub angle_deg: f64,
    /// Whether it is oriented.
    pub orientation: Orientation,
    /// It neither turns nor is about to, but for a thread.
    pub rests: bool,
    /// Without a command further cycles change nothing but its angle, and at speed 0 nothing: then it may not be cycled.
    pub is_steady: bool,
}

/// Whether a spindle is oriented.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Orientation {
    /// It is not, or a thread turns it.
    #[default]
    Open,
    /// Commanded, and not ended yet.
    Pending,
    /// It rests at its orientation position.
    Reached,
}

/// A step of a thread, in which the spindle follows the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ThreadStep {
    /// A way in the thread begins at the angle of now. Commands that come from here on wait for the end of the thread.
    Begin,
    /// How far it has turned at the end of this cycle since the way began, revolutions, clockwise positive; `None`: it
    /// stays where it is.
    Turn(Option<f64>),
    /// The thread is over or given up: the spindle rests, or with `brakes` comes to rest from its speed. Then the command
    /// that has waited counts.
    End {
        /// The thread was broken off while it turned.
        brakes: bool,
    },
}

/// The spindle of a coordinate system. It must not allocate, lock, wait or panic.
pub trait Spindle: fmt::Debug + Send {
    /// Turn at this speed, stop, or orient. `rpm` counts for `Cw` and `Ccw` only, by its magnitude, up to the maximum of
    /// the spindle; what is not a number is 0.
    fn command(&mut self, direction: SpindleDirection, rpm: f64);

    /// A step of a thread.
    fn follow(&mut self, step: ThreadStep);

    /// The end of a servo cycle, after commands and feedback of the motors were exchanged: what it reports in it.
    fn cycle(&mut self) -> SpindleState;

    /// What it reports at any other time, the commands given since included.
    fn state(&self) -> SpindleState;
}

/// A channel's spindle, with what it reported last.
#[derive(Debug)]
pub(crate) struct SpindleLink {
    device: Box<dyn Spindle>,
    state: SpindleState,
    /// r/min per second; infinite: at once.
    acceleration: f64,
}

impl SpindleLink {
    /// An acceleration that is not above 0 counts as infinite.
    pub(crate) fn new(device: Box<dyn Spindle>, max_acceleration: f64) -> Self {
        Self {
            state: device.state(),
            device,
            acceleration: if max_acceleration > 0.0 {
                max_acceleration
            } else {
                f64::INFINITY
            },
        }
    }

    pub(crate) fn state(&self) -> SpindleState {
        self.state
    }

    pub(crate) fn command(&mut self, direction: SpindleDirection, rpm: f64) {
        self.device.command(direction, rpm);
        self.state = self.device.state();
    }

    pub(crate) fn follow(&mut self, step: ThreadStep) {
        self.device.follow(step);
        self.state = self.device.state();
    }

    /// One cycle; true when a commanded orientation has ended.
    pub(crate) fn cycle(&mut self) -> bool {
        if self.state.is_steady && self.state.rpm == 0.0 {
            return false;
        }
        let before = self.state.orientation;
        self.state = self.device.cycle();
        before == Orientation::Pending && self.state.orientation == Orientation::Reached
    }

    /// The greatest change of a time base per second at which a motion that turns the spindle at this speed at 100
    /// percent keeps its acceleration.
    pub(crate) fn steepest_slope(&self, rpm: f64) -> f64 {
        self.acceleration / rpm.abs()
    }
}
