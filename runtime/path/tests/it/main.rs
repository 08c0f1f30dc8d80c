//! The path stage from outside: blocks in, segments out.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking")]

mod arcs;
mod reference;
mod rig;
mod stage;
mod transforms;
