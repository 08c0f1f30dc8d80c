//! The machine for function blocks and functions: the image of the scan, and the data that outlast a scan.

use std::collections::{BTreeMap, BTreeSet};

use plc_api::Alarm;
use plc_api::scan::Image;
use plc_protocol::types::CoordinateSystemNumber;

use crate::types::Elementary;
use crate::value::Value;

/// A P variable, or a Q variable of a coordinate system.
pub(crate) type VariableNumber = (Option<CoordinateSystemNumber>, u32);

/// Needs of a program on the machine, known before the program runs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct MachineNeeds {
    pub m_codes: BTreeSet<(CoordinateSystemNumber, u16)>,
    pub positions: BTreeSet<CoordinateSystemNumber>,
    pub variables: BTreeSet<VariableNumber>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LockKind {
    Interlock,
    StartLock,
}

/// The level of a function block for one source of a lock.
#[derive(Debug)]
pub(crate) struct Lock {
    pub is_on: bool,
    pub text: String,
    /// Name of the source; an empty name selects `default`.
    pub source: String,
}

/// Levels of function blocks. An instance that is not called keeps its level, like each output of a function
/// block. An input with several instances is on while any of them is on.
#[derive(Debug, Default)]
pub(crate) struct Levels {
    /// Locks by the address of the instance.
    locks: BTreeMap<(LockKind, CoordinateSystemNumber, usize), Lock>,
    alarms: BTreeMap<(Option<CoordinateSystemNumber>, u16, usize), (bool, String)>,
}

impl Levels {
    pub fn lock(&mut self, kind: LockKind, cs: CoordinateSystemNumber, instance: usize, level: Lock) {
        self.locks.insert((kind, cs, instance), level);
    }

    pub fn alarm(
        &mut self,
        cs: Option<CoordinateSystemNumber>,
        code: u16,
        instance: usize,
        level: (bool, String),
    ) {
        self.alarms.insert((cs, code, instance), level);
    }

    /// Writes all levels.
    pub fn write(&self, image: &mut Image) {
        let mut locks: BTreeMap<(LockKind, CoordinateSystemNumber, &str), (bool, Vec<&str>)> =
            BTreeMap::new();
        for ((kind, cs, _), level) in &self.locks {
            let lock = locks.entry((*kind, *cs, &level.source)).or_default();
            if level.is_on {
                lock.0 = true;
                lock.1.push(&level.text);
            }
        }
        for ((kind, cs, source), (is_on, texts)) in locks {
            let mut text = texts.join("; ");
            if let Some((end, _)) = text.char_indices().nth(plc_protocol::types::lock::LOCK_TEXT_MAX) {
                text.truncate(end);
            }
            match (kind, source) {
                (LockKind::Interlock, "") => image.set_interlock(cs, is_on, text),
                (LockKind::Interlock, _) => image.set_interlock_source(cs, source, is_on, text),
                (LockKind::StartLock, "") => image.set_start_lock(cs, is_on, text),
                (LockKind::StartLock, _) => image.set_start_lock_source(cs, source, is_on, text),
            }
        }
        let mut alarms: BTreeMap<(Option<CoordinateSystemNumber>, u16), Option<&str>> = BTreeMap::new();
        for ((cs, code, _), (is_on, text)) in &self.alarms {
            let alarm = alarms.entry((*cs, *code)).or_default();
            if *is_on && alarm.is_none() {
                *alarm = Some(text);
            }
        }
        for ((cs, code), text) in alarms {
            image.set_alarm(cs, text.is_some(), Alarm::user(code, text.unwrap_or_default()));
        }
    }
}

/// The machine for one scan.
pub(crate) struct Machine<'a> {
    pub image: &'a mut Image,
    pub levels: &'a mut Levels,
    /// The last values of the variables that are read.
    pub variables: &'a BTreeMap<VariableNumber, f64>,
}

/// A function that reads or writes the machine.
#[derive(Debug)]
pub(crate) struct MachineFunction {
    pub name: &'static str,
    /// Names and types; the first ones, up to `constants`, are known before the program runs.
    pub parameters: &'static [(&'static str, Elementary)],
    pub constants: usize,
    pub gives: Option<Elementary>,
    pub about: &'static str,
    pub run: fn(&mut Machine, &[Value]) -> Value,
}

/// Functions that read or write the machine.
pub(crate) static MACHINE_FUNCTIONS: [MachineFunction; 4] = [
    MachineFunction {
        name: "P",
        parameters: &[("NUMBER", Elementary::Udint)],
        constants: 1,
        gives: Some(Elementary::Lreal),
        about: "the P variable `Number` before the scan; while the machine does not answer, the last known value, initially 0",
        run: |machine, values| {
            let number = (None, number(&values[0]));
            Value::Real(machine.variables.get(&number).copied().unwrap_or(0.0))
        },
    },
    MachineFunction {
        name: "Q",
        parameters: &[("CS", Elementary::Usint), ("NUMBER", Elementary::Udint)],
        constants: 2,
        gives: Some(Elementary::Lreal),
        about: "the Q variable `Number` of coordinate system `CS`, like `P`",
        run: |machine, values| {
            let number = (Some(system(&values[0])), number(&values[1]));
            Value::Real(machine.variables.get(&number).copied().unwrap_or(0.0))
        },
    },
    MachineFunction {
        name: "SET_P",
        parameters: &[("NUMBER", Elementary::Udint), ("IN", Elementary::Lreal)],
        constants: 0,
        gives: None,
        about: "sets a P variable after the scan; `P` returns the value in a later scan",
        run: |machine, values| {
            machine.image.set_p(number(&values[0]), values[1].real());
            Value::Bool(true)
        },
    },
    MachineFunction {
        name: "SET_Q",
        parameters: &[
            ("CS", Elementary::Usint),
            ("NUMBER", Elementary::Udint),
            ("IN", Elementary::Lreal),
        ],
        constants: 1,
        gives: None,
        about: "sets a Q variable of coordinate system `CS`, like `SET_P`",
        run: |machine, values| {
            machine
                .image
                .set_q(system(&values[0]), number(&values[1]), values[2].real());
            Value::Bool(true)
        },
    },
];

/// Returns the function of a name in upper case.
pub(crate) fn machine_function(name: &str) -> Option<&'static MachineFunction> {
    MACHINE_FUNCTIONS.iter().find(|function| function.name == name)
}

/// Returns a number of the machine, which has the range of its type.
fn number(value: &Value) -> u32 {
    u32::try_from(value.int()).unwrap_or(u32::MAX)
}

/// Returns a coordinate system; the machine rejects one that does not exist.
pub(crate) fn system(value: &Value) -> CoordinateSystemNumber {
    CoordinateSystemNumber::try_from(value.int()).unwrap_or(CoordinateSystemNumber::MAX)
}
