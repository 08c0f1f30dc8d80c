//! Sequence programs that come with the runtime.


pub mod stock;
