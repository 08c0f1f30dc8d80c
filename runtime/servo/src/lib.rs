//! Motion profiles to setpoints: servo cycle, simulated drives, in-position check.
//!
//! One [`Servo`] cycles all coordinate systems in lock-step. Each has a [`Channel`] in it and a
//! [`ChannelHandle`] outside; between them are three bounded lock-free rings (profiles and controls in, events
//! out) and a lock-free snapshot, [`Readings`]. A cycle never allocates, locks, waits or calls the system; it
//! reads no clock either: time is the number of cycles times the servo period, so simulated time and real time
//! run the same code.
//!
//! Decisions of ours, where the manual is silent (M1c, M1i):
//! - In-position is checked in the cycle that gives the end point, and each cycle after it; the next profile gives its
//!   start point in the cycle after it is found.
//! - The time base is slewed only while something moves: from rest a profile starts at the override, and feed hold
//!   stops a dwell at once. A dwell under hold loses no time.
//! - In a thread (tapping) the spindle follows Z in phase, and feed hold waits for the end of the way out. A stop
//!   decelerates on the path, the spindle in phase, with the slew of feed hold or the one that the spindle's acceleration
//!   allows; the tool may rest in the thread then. An abort breaks the phase: each motor brakes on its own, the spindle too.
//! - A spindle command that comes while a thread is cut waits until the tool is out.
//! - A stop and an abort end feed hold. After a stop the spindle goes on turning.
//! - A blended chain begins when two of its profiles are there. Where the next one is late, the motion slows on its path
//!   with the slew of feed hold and goes on when it comes; a joint that is passed with nothing behind it is a fault.
//! - With G500 the override factor is that of the plan, at most 1: a plan for an override above 100 percent is a plan
//!   of its own, which takes the place of the one that runs (`splice`). The factor changes no faster than the motors' maximum accelerations leave room for
//!   (hold, stop and resume, too), and the motion goes on only as far as it could still come to rest on its path.
//! - A block of a chain counts as finished when the ramp to the next one is over.
//! - After a skip input a motor brakes at `rapid_acceleration` without a jerk limit; motors that G31 does not move
//!   capture nothing.
//! - A skip input set from outside captures where the motor is when the servo hears of it: late by what the way there
//!   takes. It keeps its value, so one that is on at the start of G31 captures there.
//! - Feed hold does not keep a block that comes to its end point from being finished.

mod brake;
mod bus;
mod channel;
mod control;
mod cycle;
mod drives;
mod hardware;
mod look_ahead;
mod motors;
mod passing;
mod path_time;
mod power;
mod readings;
mod rest;
mod servo;
mod simulated_bus;
mod simulated_spindle;
mod skip;
mod spindle;
mod splice;
#[cfg(test)]
mod testing;

pub use bus::{BusCounts, Command, CycleResult, DriveBus, Feedback};
pub use channel::{CONTROLS_MAX, Channel, ChannelHandle, EVENTS_MAX};
pub use control::{Control, Event, Fault, SpindleDirection};
pub use hardware::{Hardware, HardwareFactory};
pub use readings::{Reading, Readings};
pub use servo::Servo;
pub use simulated_bus::SimulatedBus;
pub use simulated_spindle::SimulatedSpindle;
pub use spindle::{Orientation, Spindle, SpindleState, ThreadStep};
pub use splice::Splice;
