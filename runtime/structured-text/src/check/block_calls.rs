//! Calls of function blocks.

use tandem_model::Span;

use super::variable_parts::VariablePart;
use super::{Checker, Section};
use crate::blocks::{BuiltIn, Direction, built_in};
use crate::code::{BlockCall, BlockOf, ExprKind, Stmt, VariableLocation};
use crate::finding::{NOT_CALLABLE, NOT_CONSTANT, NUMBER_RANGE};
use crate::tree::{Argument, Expression};
use crate::types::Type;

/// Returns a place within an instance.
fn within(instance: &VariableLocation, offset: usize) -> VariableLocation {
    let mut place = instance.clone();
    place.offset += offset;
    place
}

impl Checker<'_> {
    pub(super) fn block_call(
        &mut self,
        callee: &Expression,
        arguments: &[Argument],
        span: Span,
    ) -> Option<Stmt> {
        let instance = self.variable_part(callee)?;
        match instance.of.clone() {
            Type::Block(unit, _) => self.own_block(unit, &instance, arguments, span),
            Type::BuiltIn(name) => self.built_in_block(built_in(name)?, &instance, arguments, span),
            of => {
                let what = format!("a variable of {of} cannot be called");
                self.found(
                    &NOT_CALLABLE,
                    callee.span,
                    what,
                    "call an instance of a function block",
                );
                None
            }
        }
    }

    fn own_block(
        &mut self,
        unit: usize,
        instance: &VariablePart,
        arguments: &[Argument],
        span: Span,
    ) -> Option<Stmt> {
        self.calls(unit, span);
        let name = &self.file.units[unit].name.text;
        let parameters = self.parameters(unit);
        let named: Vec<_> = parameters
            .iter()
            .map(|(_, name, is_output)| (name.clone(), *is_output))
            .collect();
        let arranged = self.arranged(name, &named, arguments, span)?;
        let mut call = BlockCall {
            instance: instance.place.clone(),
            inputs: Vec::new(),
            block: BlockOf::Unit(unit),
            references: Vec::new(),
            outputs: Vec::new(),
            span,
        };
        for ((number, ..), argument) in parameters.iter().zip(arranged) {
            let variable = self.frames[unit].variables[*number].clone();
            let place = within(&instance.place, variable.offset);
            match (variable.section, argument) {
                (Section::InOut, None) => {
                    self.missing(name, &variable.name, span);
                    return None;
                }
                (_, None) => {}
                (Section::InOut, Some(argument)) => {
                    let passed = self.passed(argument, &variable.of)?;
                    call.references.push((variable.offset, passed));
                }
                (Section::Input, Some(argument)) => {
                    let input = self.assignment(place, &variable.of, &argument.value)?;
                    call.inputs.push(input);
                }
                (_, Some(argument)) => {
                    let output = self.output(place, &variable.of, &argument.value)?;
                    call.outputs.push(output);
                }
            }
        }
        Some(Stmt::Block(Box::new(call)))
    }

    fn built_in_block(
        &mut self,
        block: &'static BuiltIn,
        instance: &VariablePart,
        arguments: &[Argument],
        span: Span,
    ) -> Option<Stmt> {
        let named: Vec<_> = block
            .ports
            .iter()
            .map(|port| (port.name.to_owned(), !port.is_input()))
            .collect();
        let arranged = self.arranged(block.name, &named, arguments, span)?;
        let mut call = BlockCall {
            instance: instance.place.clone(),
            inputs: Vec::new(),
            block: BlockOf::BuiltIn(block),
            references: Vec::new(),
            outputs: Vec::new(),
            span,
        };
        let mut constants = Vec::new();
        for (slot, (port, argument)) in block.ports.iter().zip(arranged).enumerate() {
            let place = within(&instance.place, slot);
            let of = Type::from(port.of);
            let mut given = None;
            if let Some(argument) = argument {
                if !port.is_input() {
                    let output = self.output(place, &of, &argument.value)?;
                    call.outputs.push(output);
                    continue;
                }
                let input = self.assignment(place, &of, &argument.value)?;
                if let Stmt::Assign { value, .. } = &input
                    && let ExprKind::Constant(value) = &value.kind
                {
                    given = Some(value.int());
                } else if port.is_constant() {
                    let what = format!("{} of {} must be a constant", port.name, block.name);
                    let help = "write a number or a VAR CONSTANT, which is known before the program runs";
                    self.found(&NOT_CONSTANT, argument.value.span, what, help);
                    return None;
                }
                call.inputs.push(input);
            }
            if let Direction::Constant(low, high, _) = port.direction {
                let value = given.or_else(|| self.declared(instance, slot)).unwrap_or(0);
                if value == 0 && low > 0 {
                    self.missing(block.name, port.name, span);
                    return None;
                }
                self.number_in(
                    value,
                    (low, high),
                    port.name,
                    argument.map_or(span, |argument| argument.value.span),
                )?;
                constants.push(value);
            }
        }
        self.needed(block, &constants, span)?;
        Some(Stmt::Block(Box::new(call)))
    }

    /// Returns the value that the declaration of an instance gives to a port.
    fn declared(&self, instance: &VariablePart, slot: usize) -> Option<i128> {
        let place = &instance.place;
        if place.root != crate::code::Root::Frame || !place.indices.is_empty() {
            return built_in_default(&instance.of, slot);
        }
        let value = self.frame()?.initial.get(place.offset + slot)?;
        Some(value.int())
    }

    /// Records the needs of a function block on the machine.
    fn needed(&mut self, block: &BuiltIn, constants: &[i128], span: Span) -> Option<()> {
        let cs = |value: i128| u8::try_from(value).unwrap_or_default();
        match (block.name, constants) {
            ("MCODE", &[m, system]) => {
                // both are in their ranges
                let m = u16::try_from(m).unwrap_or_default();
                if plc_protocol::types::m_code::RUNTIME_M_CODES.contains(&m) {
                    let what = format!("M{m:02} is handled by the runtime itself");
                    self.found(&NUMBER_RANGE, span, what, "write another M code");
                    return None;
                }
                self.needs.m_codes.insert((cs(system), m));
            }
            ("QUESTION", &[m, system]) => {
                let m = u16::try_from(m).unwrap_or_default();
                self.asked.entry((cs(system), m)).or_insert(span);
            }
            ("POSITION", &[system]) => {
                self.needs.positions.insert(cs(system));
            }
            _ => {}
        }
        Some(())
    }
}

fn built_in_default(of: &Type, slot: usize) -> Option<i128> {
    let Type::BuiltIn(name) = of else {
        return None;
    };
    let port = built_in(name)?.ports.get(slot)?;
    Some(port.initial().int())
}
