//! Commands: their order, validation and execution.

pub(super) mod command_execution;
pub(super) mod pending_commands;
pub(super) mod validation;
