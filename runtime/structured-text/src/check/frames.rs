//! Variables of units, with their values at the start.

use tandem_model::Span;

use super::types::elements;
use super::{Checker, Progress, Section, VariableInfo};
use crate::blocks::built_in;
use crate::code::ExprKind;
use crate::finding::{BOUNDS, NOT_CONSTANT, NOT_IN_SUBSET, RECURSION, TWICE, TYPE, UNKNOWN};
use crate::limits::MEMORY_MAX;
use crate::tree::{Initial, Name, UnitKind, Variable};
use crate::types::{ArrayType, Type};
use crate::value::Value;

impl Checker<'_> {
    pub(super) fn resolve_frame(&mut self, number: usize) {
        let file = self.file;
        let Some(unit) = file.units.get(number) else {
            return;
        };
        match self.frames[number].progress {
            Progress::Open => {}
            Progress::Resolving => {
                let what = format!("{} contains itself", unit.name.text);
                self.found(&RECURSION, unit.name.span, what, "remove that variable");
                self.frames[number].progress = Progress::Refused;
                return;
            }
            Progress::Done | Progress::Refused => return,
        }
        self.frames[number].progress = Progress::Resolving;
        let outer = self.unit.replace(number);
        if let Some(result) = &unit.result
            && let Some(of) = self.type_of(result)
        {
            if of.is_single() {
                let slot = self.frames[number].initial.len();
                self.frames[number].result = Some((slot, of.clone()));
                self.add(number, &unit.name, Section::Output, (false, None), of);
            } else {
                let help = "return a single value, and the others by VAR_OUTPUT or VAR_IN_OUT";
                self.found(
                    &NOT_IN_SUBSET,
                    unit.name.span,
                    "a function cannot return an array or a structure",
                    help,
                );
            }
        }
        for variable in &unit.variables {
            if self.declare_variable(number, unit.kind, variable).is_none() {
                self.frames[number].refused.insert(variable.name.text.clone());
            }
        }
        self.unit = outer;
        let progress = &mut self.frames[number].progress;
        if *progress == Progress::Resolving {
            *progress = Progress::Done;
        }
    }

    /// Declares a variable; returns `None` after a finding.
    fn declare_variable(&mut self, unit: usize, kind: UnitKind, variable: &Variable) -> Option<()> {
        let name = &variable.name;
        if self.frames[unit].by_name.contains_key(&name.text) {
            let what = format!("{} is declared twice", name.text);
            self.found(
                &TWICE,
                name.span,
                what,
                "use another name; upper and lower case are equal",
            );
            // the first declaration is used
            return Some(());
        }
        // too many values were already reported
        (self.memory <= MEMORY_MAX && self.is_free(name)).then_some(())?;
        let of = self.type_of(&variable.of)?;
        if let Some((what, help)) = misplaced(kind, variable, &of) {
            self.found(&NOT_IN_SUBSET, name.span, what, help);
            return None;
        }
        let is_reference = variable.section == Section::InOut;
        let weight = if is_reference { 1 } else { self.weight(&of) };
        self.reserve_memory(weight, name.span).then_some(())?;
        let mut values = self.default(&of);
        if let Some(initial) = &variable.initial {
            self.set_initial(&of, initial, &mut values)?;
        } else if variable.is_constant {
            let what = format!("the constant {} has no value", name.text);
            self.found(&NOT_CONSTANT, name.span, what, "write := and its value");
            return None;
        }
        let constant = values
            .first()
            .filter(|_| variable.is_constant && of.is_single())
            .cloned();
        let how = (variable.is_constant, constant);
        if is_reference {
            values = vec![Value::Address(0)];
        }
        self.add_with(unit, name, variable.section, how, of, values);
        Some(())
    }

    fn add(&mut self, unit: usize, name: &Name, section: Section, how: (bool, Option<Value>), of: Type) {
        let values = self.default(&of);
        self.add_with(unit, name, section, how, of, values);
    }

    fn add_with(
        &mut self,
        unit: usize,
        name: &Name,
        section: Section,
        (is_constant, constant): (bool, Option<Value>),
        of: Type,
        mut values: Vec<Value>,
    ) {
        let frame = &mut self.frames[unit];
        frame.by_name.insert(name.text.clone(), frame.variables.len());
        frame.variables.push(VariableInfo {
            name: name.text.clone(),
            section,
            is_constant,
            of,
            offset: frame.initial.len(),
            constant,
        });
        frame.initial.append(&mut values);
    }

    /// Writes values at the start over those of the type.
    pub(super) fn set_initial(&mut self, of: &Type, initial: &Initial, values: &mut [Value]) -> Option<()> {
        match (initial, of) {
            (Initial::Value(expression), of) if of.is_single() => {
                let typed = self.expression(expression)?;
                let value = self.become_type(typed, of)?;
                let ExprKind::Constant(value) = value.kind else {
                    let help = "write a literal, or assign the value in the program";
                    self.found(
                        &NOT_CONSTANT,
                        expression.span,
                        "a value at the start must be constant",
                        help,
                    );
                    return None;
                };
                self.fits_text(&value, of, expression.span)?;
                *values.first_mut()? = value;
                Some(())
            }
            (Initial::List(list, span), Type::Array(array)) => {
                self.set_elements(array, (list, *span), values)
            }
            (Initial::Fields(fields, _), Type::Struct(..) | Type::Block(..) | Type::BuiltIn(_)) => {
                for (name, initial) in fields {
                    let (part, offset) = self.part_for_initial(of, name)?;
                    let size = self.size(&part);
                    let place = values.get_mut(offset..offset + size)?;
                    self.set_initial(&part, initial, place)?;
                }
                Some(())
            }
            (Initial::Value(expression), of) => {
                let what = format!("a single value is not a value of {of}");
                let help = "write [1, 2] for an array, (A := 1, B := 2) for a structure or a function block";
                self.found(&TYPE, expression.span, what, help);
                None
            }
            (Initial::List(_, span) | Initial::Fields(_, span), of) => {
                let what = format!("this is not a value of {of}");
                self.found(
                    &TYPE,
                    *span,
                    what,
                    "write [1, 2] for an array, (A := 1, B := 2) for a structure",
                );
                None
            }
            (Initial::Repeated(count, _), _) => {
                self.found(
                    &TYPE,
                    count.span,
                    "only elements of an array can be repeated",
                    "write [3(0)]",
                );
                None
            }
        }
    }

    fn set_elements(
        &mut self,
        array: &ArrayType,
        (list, span): (&[Initial], Span),
        values: &mut [Value],
    ) -> Option<()> {
        let (mut written, stride) = (0, self.size(&array.element));
        for element in list {
            let (count, element) = match element {
                Initial::Repeated(count, element) => {
                    let count = self.constant_int(count)?;
                    (usize::try_from(count).unwrap_or(usize::MAX), element.as_ref())
                }
                element => (1, element),
            };
            if count > elements(array) - written {
                let what = format!("the array has {} elements", elements(array));
                self.found(&BOUNDS, span, what, "write fewer values");
                return None;
            }
            for _ in 0..count {
                let place = values.get_mut(written * stride..(written + 1) * stride)?;
                self.set_initial(&array.element, element, place)?;
                written += 1;
            }
        }
        Some(())
    }

    /// Returns a field of a structure, or an input of a function block.
    fn part_for_initial(&mut self, of: &Type, name: &Name) -> Option<(Type, usize)> {
        let found = match of {
            Type::Struct(number, _) => {
                let mut fields = self.types[*number].fields.iter();
                fields
                    .find(|field| field.name == name.text)
                    .map(|field| (field.of.clone(), field.offset))
            }
            Type::Block(number, _) => {
                let mut variables = self.frames[*number].variables.iter();
                let variable = variables.find(|variable| variable.name == name.text);
                let input = variable.filter(|variable| variable.section == Section::Input);
                input.map(|variable| (variable.of.clone(), variable.offset))
            }
            Type::BuiltIn(block) => {
                let port = built_in(block).and_then(|block| block.port(&name.text));
                let input = port.filter(|(_, port)| port.is_input());
                input.map(|(slot, port)| (port.of.into(), slot))
            }
            _ => None,
        };
        if found.is_none() {
            let what = format!("{of} has no field or input {}", name.text);
            self.found(&UNKNOWN, name.span, what, "write one of its fields or inputs");
        }
        found
    }
}

/// Returns why a variable cannot be declared in its section, with the remedy.
fn misplaced(kind: UnitKind, variable: &Variable, of: &Type) -> Option<(&'static str, &'static str)> {
    let section = variable.section;
    let is_value = matches!(section, Section::Input | Section::Output | Section::Temporary);
    if section == Section::InOut {
        if variable.initial.is_some() {
            let what = "a VAR_IN_OUT has the value of the passed variable";
            return Some((what, "remove the value"));
        }
        return (kind == UnitKind::Program).then_some((
            "a PROGRAM has no caller that could pass a VAR_IN_OUT",
            "write VAR",
        ));
    }
    if kind == UnitKind::Function && of.is_block() {
        let what = "a function keeps no values, so it cannot contain function blocks";
        return Some((what, "write a FUNCTION_BLOCK, or pass the instance by VAR_IN_OUT"));
    }
    let help = "declare it by VAR, or pass it by VAR_IN_OUT";
    (of.is_block() && is_value).then_some(("an instance of a function block is not a value", help))
}
