//! Motion profiles to setpoints: servo cycle, simulated drives, in-position check.
//!
//! One [`Servo`] cycles all coordinate systems in lock-step. Each has a [`Channel`] in it and a [`ChannelHandle`] outside;
//! between them are bounded lock-free rings (profiles and controls in, events out) and a lock-free snapshot, [`Readings`]. A
//! cycle never allocates, locks, waits or calls the system. It reads no clock either: time is the number of cycles times the
//! servo period, so simulated time and real time run the same code.
//!
//! The rules of motion (M1a to M1i, in the book) define a cycle; where they leave something open, the documentation of
//! the item defines it.

mod brake;
mod bus;
mod channel;
mod control;
mod cycle;
mod drives;
mod hardware;
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
