//! How a sequence program reaches a machine. In its own process it is given the coordinator's port as it is
//! ([`Plc::in_process`](crate::Plc::in_process)); everything else is a [`Port`](crate::port::Port) here.

#[cfg(feature = "mqtt")]
pub mod mqtt;
