//! Sequence-control API of the Tandem runtime.

pub mod alarm;
mod error;
pub mod handshake;
pub mod hub;
pub mod port;
mod text;
pub mod types;

pub use alarm::Alarm;
pub use error::{Error, Result};
