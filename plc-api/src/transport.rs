//! Connections between a sequence program and a machine.
//!
//! In the runtime's process a program uses the port of the runtime ([`Plc::in_process`](crate::Plc::in_process)). Each
//! other transport implements [`Port`](crate::port::Port).

pub mod backoff;
#[cfg(any(feature = "mqtt", feature = "rest"))]
mod client;
#[cfg(feature = "mqtt")]
pub mod mqtt;
#[cfg(any(feature = "mqtt", feature = "rest"))]
pub mod options;
#[cfg(feature = "rest")]
pub mod rest;
#[cfg(any(feature = "mqtt", feature = "rest"))]
pub mod tls;
