//! Variables and their parts.

use super::Checker;
use crate::blocks::built_in;
use crate::code::{Expr, ExprKind, IndexOf, Root, VariableLocation};
use crate::finding::{BOUNDS, NOT_ASSIGNABLE, TYPE, UNKNOWN};
use crate::tree::{Expression, ExpressionKind, Name, Section};
use crate::types::{ArrayType, Elementary, Type};

/// A variable or a part of one.
#[derive(Debug)]
pub(super) struct VariablePart {
    pub place: VariableLocation,
    pub of: Type,
    /// Reason why it cannot be assigned.
    pub fixed: Option<&'static str>,
}

impl Checker<'_> {
    /// Returns the place that an expression names; `None` after a finding.
    pub(super) fn variable_part(&mut self, expression: &Expression) -> Option<VariablePart> {
        match &expression.kind {
            ExpressionKind::Name(name) => self.named(name, expression),
            ExpressionKind::Field(of, field) => {
                let of = self.variable_part(of)?;
                self.field(of, field, expression)
            }
            ExpressionKind::Index(of, indices) => {
                let of = self.variable_part(of)?;
                self.element(of, indices, expression)
            }
            ExpressionKind::Parenthesized(inner) => self.variable_part(inner),
            _ => {
                let help = "write the name of a variable, with fields and indices";
                self.found(&NOT_ASSIGNABLE, expression.span, "this is not a variable", help);
                None
            }
        }
    }

    fn named(&mut self, name: &str, expression: &Expression) -> Option<VariablePart> {
        let Some(variable) = self.variable(name) else {
            if !self.is_refused(name) {
                let what = format!("the variable {name} is unknown");
                self.found(&UNKNOWN, expression.span, what, "declare it in VAR ... END_VAR");
            }
            return None;
        };
        let root = if variable.section == Section::InOut {
            Root::Reference(variable.offset)
        } else {
            Root::Frame
        };
        let offset = if root == Root::Frame { variable.offset } else { 0 };
        let fixed = if variable.is_constant {
            Some("it is a constant")
        } else if variable.section == Section::Input {
            Some("an input cannot be changed within its unit")
        } else {
            None
        };
        let of = variable.of.clone();
        let fixed = if self.running.iter().any(|running| running == name) {
            Some("it is the variable of a running FOR")
        } else {
            fixed
        };
        Some(VariablePart {
            place: VariableLocation {
                root,
                offset,
                indices: Vec::new(),
                span: expression.span,
            },
            of,
            fixed,
        })
    }

    fn field(&mut self, mut of: VariablePart, field: &Name, expression: &Expression) -> Option<VariablePart> {
        let found = match &of.of {
            Type::Struct(number, _) => {
                let mut fields = self.types[*number].fields.iter();
                let found = fields.find(|known| known.name == field.text);
                found.map(|found| (found.of.clone(), found.offset, of.fixed))
            }
            Type::Block(number, _) => {
                let mut variables = self.frames[*number].variables.iter();
                let found = variables.find(|variable| variable.name == field.text);
                found.and_then(|found| {
                    let fixed = match found.section {
                        Section::Input if found.is_constant => Some("it is a constant"),
                        Section::Input => None,
                        Section::Output => Some("it is an output of a function block"),
                        _ => return None,
                    };
                    Some((found.of.clone(), found.offset, fixed))
                })
            }
            Type::BuiltIn(block) => {
                built_in(block)
                    .and_then(|block| block.port(&field.text))
                    .map(|(slot, port)| {
                        let fixed = if port.is_constant() {
                            Some("it is set in the call or the declaration")
                        } else if port.is_input() {
                            None
                        } else {
                            Some("it is an output of a function block")
                        };
                        (port.of.into(), slot, fixed)
                    })
            }
            _ => None,
        };
        let Some((part, offset, fixed)) = found else {
            let what = format!("{} has no accessible {}", of.of, field.text);
            self.found(
                &UNKNOWN,
                field.span,
                what,
                "write a field of a structure, or an input or output of a function block",
            );
            return None;
        };
        of.place.offset += offset;
        of.place.span = expression.span;
        Some(VariablePart {
            place: of.place,
            of: part,
            fixed,
        })
    }

    fn element(
        &mut self,
        mut of: VariablePart,
        indices: &[Expression],
        expression: &Expression,
    ) -> Option<VariablePart> {
        let Type::Array(array) = of.of.clone() else {
            let what = format!("{} is not an array", of.of);
            self.found(&TYPE, expression.span, what, "remove the index");
            return None;
        };
        if indices.len() != array.bounds.len() {
            let what = format!(
                "the array has {} dimensions, not {}",
                array.bounds.len(),
                indices.len()
            );
            self.found(
                &BOUNDS,
                expression.span,
                what,
                "write an index for each dimension",
            );
            return None;
        }
        let mut stride = self.size(&array.element);
        for (index, (low, high)) in indices.iter().zip(&array.bounds).rev() {
            self.index(&mut of.place, index, (*low, *high), stride)?;
            stride *= usize::try_from(high - low + 1).unwrap_or(usize::MAX);
        }
        of.place.span = expression.span;
        Some(VariablePart {
            place: of.place,
            of: element_type(&array),
            fixed: of.fixed,
        })
    }

    fn index(
        &mut self,
        place: &mut VariableLocation,
        index: &Expression,
        (low, high): (i64, i64),
        stride: usize,
    ) -> Option<()> {
        let typed = self.expression(index)?;
        if !typed.is_int() {
            self.found(
                &TYPE,
                index.span,
                "an index must be an integer",
                "write an integer",
            );
            return None;
        }
        let value = if typed.elementary().is_some() {
            typed.expr
        } else {
            self.become_type(typed, &Type::Elementary(Elementary::Lint))?
        };
        if let ExprKind::Constant(constant) = &value.kind {
            let constant = constant.int();
            if constant < low.into() || constant > high.into() {
                let what = format!("the index {constant} is not in {low} to {high}");
                self.found(&BOUNDS, index.span, what, "write an index within the bounds");
                return None;
            }
            place.offset += usize::try_from(constant - i128::from(low)).unwrap_or(0) * stride;
            return Some(());
        }
        place.indices.push(IndexOf {
            value: Expr {
                span: index.span,
                ..value
            },
            low,
            high,
            stride,
        });
        Some(())
    }

    /// Returns a place that may be assigned; `None` after a finding.
    pub(super) fn assignable(&mut self, expression: &Expression) -> Option<VariablePart> {
        let found = self.variable_part(expression)?;
        if let Some(why) = found.fixed {
            let what = format!("this cannot be assigned: {why}");
            self.found(&NOT_ASSIGNABLE, expression.span, what, "assign another variable");
            return None;
        }
        if found.of.is_block() {
            let help = "call the instance with its inputs, or assign one of its inputs";
            self.found(
                &NOT_ASSIGNABLE,
                expression.span,
                "an instance of a function block cannot be assigned",
                help,
            );
            return None;
        }
        Some(found)
    }
}

fn element_type(array: &ArrayType) -> Type {
    array.element.clone()
}
