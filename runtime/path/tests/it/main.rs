//! The path stage from outside: blocks in, segments out.

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
