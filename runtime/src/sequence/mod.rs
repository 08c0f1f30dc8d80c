//! Sequence programs that are part of the runtime.

pub mod demo;
pub mod stock;
