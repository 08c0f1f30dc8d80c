//! Connections between a sequence program and a machine.
//!
//! In the runtime's process a program uses the port of the runtime ([`Plc::in_process`](crate::Plc::in_process)). Each
//! other transport implements [`Port`](crate::port::Port).

use std::time::Duration;

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

/// A broker that acknowledges nothing for this long, while something waits for it, is left for the next one. Reason: a node of a
/// cluster that has lost the others may take messages and never acknowledge them, also when it has found them again.
pub const BROKER_SILENCE_MAX: Duration = Duration::from_secs(10);
