//! Locks of motion from outside: the control lease, start conditions, a lost broker, and lost clients.

pub(super) mod bus;
pub(super) mod lease;
pub(super) mod start_conditions;
pub(super) mod watched_clients;
