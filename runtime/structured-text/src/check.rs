//! Converts the tree to a checked program: looks up names, checks types, calculates constants.

mod arguments;
mod block_calls;
mod calls;
mod expressions;
mod frames;
mod links;
mod operators;
mod statements;
mod types;
mod variable_parts;

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use tandem_model::Span;

use crate::blocks::built_in;
use crate::code::{Code, CodeUnit};
use crate::finding::{FindingEntry, Findings, PROGRAM_COUNT, RESERVED, TOO_LARGE, TWICE};
use crate::functions::{Conversion, OPERATORS, function};
use crate::limits::MEMORY_MAX;
use crate::machine::{MachineNeeds, machine_function};
use crate::tree::{Definition, File, Name, Section, UnitKind};
use crate::types::{Elementary, Type};
use crate::value::Value;

/// Checks a text. Mistakes become findings; with findings, the result is `None`.
pub(crate) fn check(file: &File, findings: &mut Findings) -> Option<(Code, MachineNeeds)> {
    let mut checker = Checker {
        file,
        findings,
        names: HashMap::new(),
        enumerators: HashMap::new(),
        types: file.types.iter().map(|_| TypeInfo::default()).collect(),
        frames: file.units.iter().map(|_| Frame::default()).collect(),
        calls: BTreeMap::new(),
        needs: MachineNeeds::default(),
        asked: BTreeMap::new(),
        memory: 0,
        unit: None,
        loops: 0,
        running: Vec::new(),
        wanted: None,
    };
    checker.declare();
    for number in 0..file.types.len() {
        checker.resolve_type(number);
    }
    for number in 0..file.units.len() {
        checker.resolve_frame(number);
    }
    let program = checker.program()?;
    let bodies: Vec<_> = (0..file.units.len()).map(|number| checker.body(number)).collect();
    checker.link(program, bodies)
}

/// Meaning of a name of the text.
#[derive(Debug, Clone, Copy)]
enum Global {
    Type(usize),
    Unit(usize),
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Progress {
    #[default]
    Open,
    Resolving,
    Done,
    /// The name was rejected with a finding.
    Refused,
}

/// A declared type.
#[derive(Debug, Default)]
struct TypeInfo {
    progress: Progress,
    of: Option<Type>,
    fields: Vec<Field>,
    /// Initial values of the fields of a structure.
    initial: Vec<Value>,
}

#[derive(Debug)]
struct Field {
    name: String,
    of: Type,
    offset: usize,
}

/// The variables of a unit.
#[derive(Debug, Default)]
struct Frame {
    progress: Progress,
    variables: Vec<VariableInfo>,
    by_name: HashMap<String, usize>,
    /// Names with wrong declarations, for which no further findings are reported.
    refused: HashSet<String>,
    initial: Vec<Value>,
    /// Slot and type of the result of a function.
    result: Option<(usize, Type)>,
}

#[derive(Debug, Clone)]
struct VariableInfo {
    name: String,
    section: Section,
    is_constant: bool,
    of: Type,
    offset: usize,
    /// The value of a constant that has a single value.
    constant: Option<Value>,
}

struct Checker<'a> {
    file: &'a File,
    findings: &'a mut Findings,
    names: HashMap<&'a str, Global>,
    /// Values of enumerations: the types that have them, with their numbers.
    enumerators: HashMap<&'a str, Vec<(usize, i128)>>,
    types: Vec<TypeInfo>,
    frames: Vec<Frame>,
    /// Units that each unit calls, with the positions of the calls.
    calls: BTreeMap<usize, BTreeMap<usize, Span>>,
    needs: MachineNeeds,
    /// M codes that a QUESTION asks about, with their positions.
    asked: BTreeMap<(u8, u16), Span>,
    /// Number of values of all variables.
    memory: usize,
    /// The unit that is being checked.
    unit: Option<usize>,
    /// Number of loops around the statement that is being checked.
    loops: usize,
    /// Variables of the FOR loops around it.
    running: Vec<String>,
    /// The type of the variable that the next expression is assigned to.
    wanted: Option<Elementary>,
}

impl Checker<'_> {
    fn found(
        &mut self,
        entry: &'static FindingEntry,
        span: Span,
        what: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.findings.push(entry, span, what, help);
    }

    /// Takes the names of types, units and values of enumerations.
    fn declare(&mut self) {
        let file = self.file;
        let types = file
            .types
            .iter()
            .enumerate()
            .map(|(number, of)| (&of.name, Global::Type(number)));
        let units = file
            .units
            .iter()
            .enumerate()
            .map(|(number, of)| (&of.name, Global::Unit(number)));
        for (name, global) in types.chain(units) {
            self.is_free(name);
            if self.names.insert(&name.text, global).is_some() {
                let what = format!("{} is declared twice in this text", name.text);
                self.found(&TWICE, name.span, what, "use another name");
            }
        }
        for (number, of) in file.types.iter().enumerate() {
            let Definition::Enumeration(values) = &of.definition else {
                continue;
            };
            let mut seen = HashSet::new();
            for (value, name) in values.iter().enumerate() {
                self.is_free(name);
                if !seen.insert(&name.text) {
                    let what = format!("{} appears twice", name.text);
                    self.found(&TWICE, name.span, what, "use another name");
                }
                let value = i128::try_from(value).unwrap_or(i128::MAX);
                self.enumerators
                    .entry(&name.text)
                    .or_default()
                    .push((number, value));
            }
        }
    }

    /// Returns true if the name is not that of a standard element; otherwise reports a finding.
    fn is_free(&mut self, name: &Name) -> bool {
        let text = name.text.as_str();
        let is_standard = Elementary::named(text).is_some()
            || built_in(text).is_some()
            || function(text).is_some()
            || Conversion::named(text).is_some()
            || OPERATORS.iter().any(|(operator, _)| *operator == text)
            || (machine_function(text).is_some() && text.len() > 1);
        if is_standard {
            let what = format!("{text} is the name of a standard type, function or function block");
            self.found(&RESERVED, name.span, what, "use another name");
        }
        !is_standard
    }

    /// Returns the unit that is called in each scan.
    fn program(&mut self) -> Option<usize> {
        let file = self.file;
        let programs = file
            .units
            .iter()
            .enumerate()
            .filter(|(_, unit)| unit.kind == UnitKind::Program);
        let programs: Vec<usize> = programs.map(|(number, _)| number).collect();
        if programs.is_empty() && self.findings.is_empty() {
            let help = "write PROGRAM name ... END_PROGRAM";
            self.found(&PROGRAM_COUNT, Span::default(), "the text has no PROGRAM", help);
        }
        for number in programs.iter().skip(1) {
            let (span, help) = (
                file.units[*number].name.span,
                "write each PROGRAM in a file of its own",
            );
            self.found(&PROGRAM_COUNT, span, "a text must have only one PROGRAM", help);
        }
        programs.first().copied()
    }

    /// Counts values of variables; reports a finding if the limit is exceeded.
    fn reserve_memory(&mut self, values: usize, span: Span) -> bool {
        self.memory = self.memory.saturating_add(values);
        if self.memory <= MEMORY_MAX {
            return true;
        }
        let what = format!("all variables have more than {MEMORY_MAX} values");
        self.found(&TOO_LARGE, span, what, "write smaller arrays, or shorter strings");
        false
    }

    /// Returns the unit that is being checked.
    fn frame(&self) -> Option<&Frame> {
        self.frames.get(self.unit?)
    }

    fn variable(&self, name: &str) -> Option<&VariableInfo> {
        let frame = self.frame()?;
        frame.variables.get(*frame.by_name.get(name)?)
    }

    fn is_refused(&self, name: &str) -> bool {
        self.frame().is_some_and(|frame| frame.refused.contains(name))
    }

    /// Records that the unit calls another unit.
    fn calls(&mut self, called: usize, span: Span) {
        if let Some(unit) = self.unit {
            self.calls.entry(unit).or_default().entry(called).or_insert(span);
        }
    }
}
