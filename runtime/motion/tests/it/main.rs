//! Tests of the planner through its public interface.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking")]

mod chain;
mod look_ahead;
mod look_ahead_random;
mod look_ahead_rig;
mod look_ahead_shapes;
mod look_ahead_text;
mod planner;
mod programmed_jerk;
mod rig;
mod smooth;
mod smooth_jerk;
mod tapping;
