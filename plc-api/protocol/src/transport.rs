//! Connections between a sequence program and a machine.
//!
//! In the process of the runtime, a program uses the port of the runtime (`Plc::in_process` of `plc-api`). Each
//! other transport implements
//! [`Port`](crate::port::Port).

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

/// Time limit for acknowledgements of a broker. If messages wait and the broker acknowledges none of them
/// within this time, the client connects to the next node. Reason: a node that has lost the other nodes of
/// its cluster may accept messages and never acknowledge them, even after it has found the other nodes again.
pub const BROKER_SILENCE_MAX: Duration = Duration::from_secs(10);
