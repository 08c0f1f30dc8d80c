//! Conversion of motion profiles to setpoints: servo cycle, simulated drives, in-position check.
//!
//! One [`Servo`] cycles all coordinate systems in lock-step. Each coordinate system has a [`Channel`] in the
//! servo and a [`ChannelHandle`] for the coordinator. Bounded lock-free rings connect both (profiles and
//! controls in, events out), and [`Readings`], a lock-free snapshot. A cycle never allocates, locks, waits or
//! calls the system, and reads no clock. Time is the number of cycles times the servo period, so simulated
//! time and real time run the same code.
//!
//! The rules of motion (M1a to M1i, in the book) define a cycle. Where the rules leave a choice, the
//! documentation of the item defines the behaviour.

mod brake;
mod bus;
mod channel;
mod control;
mod cycle;
mod drives;
mod hardware;
mod jerk_slew;
mod late;
mod look_ahead;
mod motors;
mod passing;
mod path_time;
mod power;
mod profile_queue;
mod readings;
mod rest;
mod servo;
mod setpoint_history;
mod simulated_bus;
mod simulated_spindle;
mod skip;
mod spindle;
mod splice;
mod splicing;
#[cfg(test)]
mod testing;
mod trace;

pub use bus::{BusCounts, Command, Cutoff, CycleResult, DriveBus, Feedback};
pub use channel::{CONTROLS_MAX, Channel, ChannelHandle, EVENTS_MAX};
pub use control::{Control, Event, Fault, SpindleDirection};
pub use hardware::{Hardware, HardwareFactory};
pub use profile_queue::{ProfileConsumer, ProfileProducer, profile_queue};
pub use readings::{Reading, Readings};
pub use servo::Servo;
pub use simulated_bus::SimulatedBus;
pub use simulated_spindle::SimulatedSpindle;
pub use spindle::{Orientation, Spindle, SpindleState, ThreadStep};
pub use splice::Splice;
pub use trace::{TRACE_SAMPLES, Trace, TraceMotion, TraceSample};
