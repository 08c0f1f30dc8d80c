//! Motion profiles to setpoints: servo cycle, simulated drives, in-position check.
//!
//! One [`Servo`] cycles all coordinate systems in lock-step. Each has a [`Channel`] in it and a
//! [`ChannelHandle`] outside; between them are three bounded lock-free rings (profiles and controls in, events
//! out) and a lock-free snapshot, [`Readings`]. A cycle never allocates, locks, waits or calls the system; it
//! reads no clock either: time is the number of cycles times the servo period, so simulated time and real time
//! run the same code.

mod channel;
mod control;
mod readings;
mod servo;

pub use channel::{CONTROLS_MAX, Channel, ChannelHandle, EVENTS_MAX, channel};
pub use control::{Control, Event, Fault, SpindleDirection};
pub use readings::{Reading, Readings};
pub use servo::Servo;
