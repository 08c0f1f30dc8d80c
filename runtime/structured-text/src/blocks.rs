//! Function blocks that are built in: those of IEC 61131-3, and those of the machine.

mod machine;
mod standard;
mod states;

use crate::machine::Machine;
use crate::state::State;
use crate::types::Elementary;
use crate::value::Value;

/// An input or an output.
#[derive(Debug)]
pub(crate) struct Port {
    pub name: &'static str,
    pub of: Elementary,
    pub direction: Direction,
    pub about: &'static str,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Direction {
    Input,
    /// An input with its default value.
    InputOr(f64),
    /// An input that is known before the program runs: its least and largest value, and its default.
    Constant(i128, i128, Option<i128>),
    Output,
    /// An output that is on before the first call.
    OutputOn,
}

impl Port {
    pub fn is_input(&self) -> bool {
        !matches!(self.direction, Direction::Output | Direction::OutputOn)
    }

    pub fn is_constant(&self) -> bool {
        matches!(self.direction, Direction::Constant(..))
    }

    /// Returns its value at the start.
    pub fn initial(&self) -> Value {
        match (self.direction, self.of) {
            (Direction::OutputOn, _) => Value::Bool(true),
            (Direction::Constant(_, _, default), _) => Value::Int(default.unwrap_or(0)),
            (Direction::InputOr(value), _) => Value::Real(value),
            (_, of) => initial(of),
        }
    }
}

/// Returns the default value of a type: IEC 61131-3, default initial values.
pub(crate) fn initial(of: Elementary) -> Value {
    match of {
        Elementary::Bool => Value::Bool(false),
        Elementary::Real | Elementary::Lreal => Value::Real(0.0),
        Elementary::String => Value::Text(String::new()),
        _ => Value::Int(0),
    }
}

/// A function block that is built in.
pub(crate) struct BuiltIn {
    pub name: &'static str,
    pub about: &'static str,
    pub ports: &'static [Port],
    pub state: fn() -> State,
    pub run: fn(&mut Ports, &mut Machine),
}

impl std::fmt::Debug for BuiltIn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl BuiltIn {
    /// Returns the number of slots of an instance: its ports, and its state.
    pub fn size(&self) -> usize {
        self.ports.len() + 1
    }

    /// Returns an instance before its first call.
    pub fn instance(&self) -> Vec<Value> {
        let ports = self.ports.iter().map(Port::initial);
        ports.chain([Value::State(Box::new((self.state)()))]).collect()
    }

    pub fn port(&self, name: &str) -> Option<(usize, &'static Port)> {
        self.ports
            .iter()
            .enumerate()
            .find(|(_, port)| port.name.eq_ignore_ascii_case(name))
    }
}

/// Returns the function block of a name in upper case.
pub(crate) fn built_in(name: &str) -> Option<&'static BuiltIn> {
    all().find(|block| block.name == name)
}

/// Returns all function blocks that are built in: those of the standard, then those of the machine.
pub(crate) fn all() -> impl Iterator<Item = &'static BuiltIn> {
    standard().chain(machine_blocks())
}

pub(crate) fn standard() -> impl Iterator<Item = &'static BuiltIn> {
    standard::BLOCKS.iter()
}

pub(crate) fn machine_blocks() -> impl Iterator<Item = &'static BuiltIn> {
    machine::BLOCKS.iter().chain(states::BLOCKS)
}

/// An instance during a call. Its slots are those of its ports, then that of its state.
pub(crate) struct Ports<'a> {
    pub slots: &'a mut [Value],
    /// Address of the instance, unique in the program.
    pub instance: usize,
}

impl Ports<'_> {
    fn bool(&self, port: usize) -> bool {
        self.slots[port].bool()
    }

    fn int(&self, port: usize) -> i128 {
        self.slots[port].int()
    }

    fn real(&self, port: usize) -> f64 {
        self.slots[port].real()
    }

    fn text(&self, port: usize) -> &str {
        self.slots[port].text()
    }

    fn set(&mut self, port: usize, value: Value) {
        self.slots[port] = value;
    }

    fn set_bool(&mut self, port: usize, value: bool) {
        self.set(port, Value::Bool(value));
    }

    fn set_int(&mut self, port: usize, value: impl Into<i128>) {
        self.set(port, Value::Int(value.into()));
    }

    /// Sets a REAL port. A value that is not finite becomes 0, because no variable may hold it.
    fn set_real(&mut self, port: usize, value: f64) {
        self.set(port, Value::Real(if value.is_finite() { value } else { 0.0 }));
    }

    fn set_text(&mut self, port: usize, value: &str) {
        let longest = value.char_indices().nth(crate::limits::STRING_DEFAULT);
        let end = longest.map_or(value.len(), |(end, _)| end);
        self.set(port, Value::Text(value[..end].to_owned()));
    }

    fn state(&mut self) -> Option<&mut State> {
        match self.slots.last_mut() {
            Some(Value::State(state)) => Some(state),
            _ => None,
        }
    }
}

/// Ports of a block: direction, name, type, and meaning.
macro_rules! ports {
    ($($direction:expr, $name:literal: $of:ident, $about:literal;)*) => {
        &[$($crate::blocks::Port {
            name: $name,
            of: $crate::types::Elementary::$of,
            direction: $direction,
            about: $about,
        }),*]
    };
}
use ports;
