//! Tests of channels through the public interface. Time is counted in cycles, without waiting.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking")]

mod back_trace;
mod chains;
mod controls;
mod drives;
mod faults;
mod jerk;
mod late;
mod look_ahead;
mod passing;
mod planned;
mod properties;
mod rapid;
mod rig;
mod running;
mod short_ring;
mod skip;
mod spindle;
mod splice;
mod tapping;
mod trace;
