//! Sequence-control API of the Tandem runtime.

pub mod hub;
pub mod port;
pub mod types;
