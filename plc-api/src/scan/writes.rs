//! The writes of one scan.

use std::collections::BTreeMap;
use std::mem::discriminant;

use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::types::CoordinateSystemNumber;
use crate::types::command::Command;
use crate::types::data::VariableArea;
use crate::types::request::{Input, Request, SpindleCommand};

/// A flag of the machine: what is written stays until something else is written there.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Level {
    Input(CoordinateSystemNumber, Input),
    Spindle(CoordinateSystemNumber, SpindleCommand),
    Tool(CoordinateSystemNumber, u16),
    SkipInput(u16, bool),
}

impl Level {
    /// True when both are written to the same flag.
    fn is_same_flag(&self, other: &Level) -> bool {
        match (self, other) {
            (Level::Input(cs, input), Level::Input(other_cs, other)) => {
                cs == other_cs
                    && match (input, other) {
                        (Input::OptionalSkip(one), Input::OptionalSkip(other)) => one.keys().eq(other.keys()),
                        _ => discriminant(input) == discriminant(other),
                    }
            }
            (Level::Spindle(cs, _), Level::Spindle(other, _))
            | (Level::Tool(cs, _), Level::Tool(other, _)) => cs == other,
            (Level::SkipInput(motor, _), Level::SkipInput(other, _)) => motor == other,
            _ => false,
        }
    }

    pub(super) fn request(&self) -> Request {
        match self.clone() {
            Level::Input(cs, input) => Request::Input(cs, input),
            Level::Spindle(cs, command) => Request::Spindle(cs, command),
            Level::Tool(cs, id) => Request::Tool(cs, id),
            Level::SkipInput(motor, value) => Request::SkipInput(motor, value),
        }
    }
}

/// What one scan has written.
#[derive(Debug, Default)]
pub(super) struct Writes {
    pub(super) levels: Vec<Level>,
    pub(super) variables: BTreeMap<(VariableArea, u32), f64>,
    pub(super) commands: Vec<(CoordinateSystemNumber, Command)>,
    pub(super) progress: Vec<(AuxOutput, String, Option<f64>)>,
    pub(super) answers: BTreeMap<(CoordinateSystemNumber, u16), (AuxOutput, Result<(), Alarm>)>,
}

impl Writes {
    /// Writes a flag; of several values in one scan the last counts.
    pub(super) fn set(&mut self, level: Level) {
        put(&mut self.levels, level);
    }
}

pub(super) fn put(levels: &mut Vec<Level>, level: Level) {
    match levels.iter_mut().find(|known| known.is_same_flag(&level)) {
        Some(known) => *known = level,
        None => levels.push(level),
    }
}
