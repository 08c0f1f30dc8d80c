//! Tests of the path stage through its public interface.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking")]

mod arcs;
mod compensation;
mod compensation_random;
mod compensation_rules;
mod compensation_way;
mod contour;
mod reference;
mod rig;
mod stage;
mod tapping;
mod transforms;
