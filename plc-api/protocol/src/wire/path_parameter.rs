//! Parameters in the paths of routes.

use super::parameter::Values;

/// A level of a path for which the caller gives a value.
#[derive(Debug, Clone, Copy)]
pub struct PathParameter {
    /// Name in the pattern of the route.
    pub name: &'static str,
    /// Allowed values.
    pub values: Values,
}

impl PathParameter {
    const fn new(name: &'static str, values: Values) -> Self {
        Self { name, values }
    }
}

/// Number of a coordinate system.
pub const CS: PathParameter = PathParameter::new("cs", Values::Integer(1, Some(255)));

/// Sequence number of an output.
pub(super) const SEQ: PathParameter = PathParameter::new("seq", Values::Integer(0, None));

/// Number of a program.
pub(super) const PROGRAM: PathParameter = PathParameter::new("number", Values::Integer(1, Some(9999)));

/// Number of an optional block skip.
pub(super) const SKIP: PathParameter = PathParameter::new("number", Values::Integer(1, Some(31)));

/// Number of a motor.
pub(super) const MOTOR: PathParameter = PathParameter::new("number", Values::Integer(1, Some(9999)));

/// Name of an input or output of the plant.
pub(super) const IO_NAME: PathParameter = PathParameter::new("name", Values::Text(1, 64));

/// Number that identifies an alarm.
pub(super) const ALARM_ID: PathParameter = PathParameter::new("id", Values::Integer(0, None));

/// Id of a handler, client, command or run.
pub(super) const ID: PathParameter = PathParameter::new("id", Values::Text(1, 128));

/// A name to explain.
pub(super) const WHAT: PathParameter = PathParameter::new("what", Values::Text(1, 128));
