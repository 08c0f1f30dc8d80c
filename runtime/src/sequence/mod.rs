//! Sequence programs that come with the runtime.

pub mod demo;
pub mod stock;
