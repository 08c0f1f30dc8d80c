//! How a sequence program reaches a machine.
//!
//! In the runtime's own process it is given the coordinator's port as it is
//! ([`Plc::in_process`](crate::Plc::in_process)). Any other transport is a [`Port`](crate::port::Port) in a file here.

pub mod backoff;
#[cfg(feature = "mqtt")]
pub mod mqtt;
#[cfg(feature = "rest")]
pub mod rest;
#[cfg(feature = "mqtt")]
pub mod tls;
