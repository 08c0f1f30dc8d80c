//! Values of variables, and the faults of calculations.

use std::fmt;

use crate::state::State;
use crate::types::Elementary;

/// Content of one slot of the memory.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Bool(bool),
    /// An integer, a bit string, an enumeration, or a time in nanoseconds.
    Int(i128),
    /// A number, always finite.
    Real(f64),
    Text(String),
    /// Address of the variable of a `VAR_IN_OUT`.
    Address(usize),
    /// State of a built-in function block.
    State(Box<State>),
}

/// Reason why a program stops.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Fault {
    DivisionByZero,
    /// The index, and the bounds.
    Index(i128, i64, i64),
    /// A value, and the type that it does not fit.
    Range(String, Elementary),
    /// The result is not a number, such as the root of -1.
    NoResult(&'static str),
    NotANumber(String),
    /// A string has more characters than its variable.
    TooLong(usize, usize),
    /// `FOR ... BY 0`.
    StepOfZero,
    /// The first parameter of `MUX`, and the number of the others.
    Mux(i128, usize),
    Steps,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DivisionByZero => f.write_str("a division by zero"),
            Self::Index(index, low, high) => write!(f, "the index {index} is not in {low} to {high}"),
            Self::Range(value, of) => write!(f, "{value} does not fit {}", of.text()),
            Self::NoResult(function) => write!(f, "{function} has no result for this value"),
            Self::NotANumber(text) => write!(f, "'{text}' is not a number"),
            Self::TooLong(length, max) => {
                write!(f, "a string of {length} characters does not fit STRING[{max}]")
            }
            Self::StepOfZero => f.write_str("a FOR with a step of 0 does not end"),
            Self::Mux(choice, count) => write!(
                f,
                "MUX has no input {choice}; the last is {}",
                count.saturating_sub(1)
            ),
            Self::Steps => write!(
                f,
                "the scan does not end: more than {} steps",
                crate::limits::STEPS_MAX
            ),
        }
    }
}

impl Value {
    /// Returns a `BOOL`; false for any other value, which the check excludes.
    pub fn bool(&self) -> bool {
        matches!(self, Value::Bool(true))
    }

    pub fn int(&self) -> i128 {
        match self {
            Value::Int(value) => *value,
            Value::Bool(value) => i128::from(*value),
            _ => 0,
        }
    }

    pub fn real(&self) -> f64 {
        match self {
            Value::Real(value) => *value,
            // only integers of at most 32 bits are converted implicitly
            value => value.int() as f64,
        }
    }

    pub fn text(&self) -> &str {
        match self {
            Value::Text(text) => text,
            _ => "",
        }
    }
}

/// Returns an integer of a type.
///
/// # Errors
/// Fails if the value does not fit the type.
pub(crate) fn int_of(value: i128, of: Elementary) -> Result<Value, Fault> {
    match of.range() {
        Some((low, high)) if value < low || value > high => Err(Fault::Range(value.to_string(), of)),
        _ => Ok(Value::Int(value)),
    }
}

/// Returns a number rounded to a type.
///
/// # Errors
/// Fails if the number is not finite; `name` is the function that calculated it.
pub(crate) fn real_of(value: f64, of: Elementary, name: &'static str) -> Result<Value, Fault> {
    #[expect(clippy::cast_possible_truncation, reason = "a REAL has 32 bits")]
    let rounded = if of == Elementary::Real {
        f64::from(value as f32)
    } else {
        value
    };
    if rounded.is_nan() {
        Err(Fault::NoResult(name))
    } else if rounded.is_infinite() {
        Err(Fault::Range(value.to_string(), of))
    } else {
        Ok(Value::Real(rounded))
    }
}
