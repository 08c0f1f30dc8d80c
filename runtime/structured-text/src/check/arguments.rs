//! Assigns the arguments of a call to its parameters.

use tandem_model::Span;

use super::{Checker, Section};
use crate::code::{Stmt, VariableLocation};
use crate::finding::{NOT_IN_SUBSET, PARAMETERS, TYPE};
use crate::tree::{Argument, Expression};
use crate::types::Type;

impl Checker<'_> {
    /// Returns the argument of each parameter, by order or by name. Each parameter has its name, and true for
    /// an output.
    pub(super) fn arranged<'t>(
        &mut self,
        of: &str,
        parameters: &[(String, bool)],
        arguments: &'t [Argument],
        span: Span,
    ) -> Option<Vec<Option<&'t Argument>>> {
        if arguments.iter().all(|argument| argument.name.is_none()) {
            return self.in_order(of, parameters, arguments, span);
        }
        let mut arranged = vec![None; parameters.len()];
        for argument in arguments {
            let place = self.by_name(of, parameters, argument)?;
            if arranged[place].replace(argument).is_some() {
                let what = format!("the parameter {} is given twice", parameters[place].0);
                self.found(&PARAMETERS, argument.value.span, what, "write it once");
                return None;
            }
        }
        Some(arranged)
    }

    /// Returns arguments in the order of the parameters that are not outputs.
    fn in_order<'t>(
        &mut self,
        of: &str,
        parameters: &[(String, bool)],
        arguments: &'t [Argument],
        span: Span,
    ) -> Option<Vec<Option<&'t Argument>>> {
        let inputs = parameters.iter().filter(|(_, is_output)| !is_output).count();
        if !arguments.is_empty() && arguments.len() != inputs {
            let what = format!("{of} takes {inputs} parameters by order, not {}", arguments.len());
            let help = format!("write {of}({})", shown(parameters));
            self.found(&PARAMETERS, span, what, help);
            return None;
        }
        let mut arguments = arguments.iter();
        let arranged = parameters.iter();
        Some(
            arranged
                .map(|(_, is_output)| if *is_output { None } else { arguments.next() })
                .collect(),
        )
    }

    /// Returns the index of the parameter that an argument names.
    fn by_name(&mut self, of: &str, parameters: &[(String, bool)], argument: &Argument) -> Option<usize> {
        let Some(name) = &argument.name else {
            let what = "parameters with and without names are mixed";
            let help = "write all of them by name, or all by order";
            self.found(&PARAMETERS, argument.value.span, what, help);
            return None;
        };
        if name.text == "EN" || name.text == "ENO" {
            let what = format!("{} is not part of this subset", name.text);
            self.found(&NOT_IN_SUBSET, name.span, what, "call it within an IF");
            return None;
        }
        let mut known = parameters.iter();
        let Some(place) = known.position(|(known, _)| known.eq_ignore_ascii_case(&name.text)) else {
            let what = format!("{of} has no parameter {}", name.text);
            let help = format!("its parameters are {}", shown(parameters));
            self.found(&PARAMETERS, name.span, what, help);
            return None;
        };
        if parameters[place].1 != argument.is_output {
            let (what, help) = if argument.is_output {
                ("=> is for outputs, but this is an input", "write :=")
            } else {
                (":= is for inputs, but this is an output", "write =>")
            };
            self.found(&PARAMETERS, name.span, what, help);
            return None;
        }
        Some(place)
    }

    /// Returns the variable that is passed as a `VAR_IN_OUT`.
    pub(super) fn passed(&mut self, argument: &Argument, of: &Type) -> Option<VariableLocation> {
        let found = self.variable_part(&argument.value)?;
        if let Some(why) = found.fixed {
            let what = format!("a VAR_IN_OUT may be assigned, but this cannot be assigned: {why}");
            self.found(
                &crate::finding::NOT_ASSIGNABLE,
                argument.value.span,
                what,
                "pass another variable",
            );
            return None;
        }
        if found.of != *of {
            let what = format!("a variable of {of} is passed here, not of {}", found.of);
            self.found(&TYPE, argument.value.span, what, "pass a variable of this type");
            return None;
        }
        Some(found.place)
    }

    /// Returns the assignment of an expression to a place.
    pub(super) fn assignment(&mut self, to: VariableLocation, of: &Type, value: &Expression) -> Option<Stmt> {
        self.wanted = of.elementary();
        let typed = self.valued(value)?;
        let mut value = self.become_type(typed, of)?;
        if of.is_single() {
            if let crate::code::ExprKind::Constant(constant) = &value.kind {
                self.fits_text(&constant.clone(), of, value.span)?;
            }
            let text_max = match of {
                Type::Text(max) => Some(*max),
                _ => None,
            };
            return Some(Stmt::Assign { to, value, text_max });
        }
        let size = self.size(of);
        match std::mem::replace(
            &mut value.kind,
            crate::code::ExprKind::Constant(crate::value::Value::Bool(false)),
        ) {
            crate::code::ExprKind::Load(from) => Some(Stmt::Copy {
                to,
                from: *from,
                size,
            }),
            _ => None,
        }
    }

    /// Returns the assignment of an output to a variable.
    pub(super) fn output(&mut self, from: VariableLocation, of: &Type, to: &Expression) -> Option<Stmt> {
        let target = self.assignable(to)?;
        let span = from.span;
        let typed = super::expressions::TypedExpr::with_type(
            crate::code::ExprKind::Load(Box::new(from)),
            of.clone(),
            span,
        );
        let value = self.become_type(typed, &target.of)?;
        if let crate::code::ExprKind::Load(from) = &value.kind
            && !of.is_single()
        {
            let (from, size) = ((**from).clone(), self.size(of));
            return Some(Stmt::Copy {
                to: target.place,
                from,
                size,
            });
        }
        let text_max = match target.of {
            Type::Text(max) => Some(max),
            _ => None,
        };
        Some(Stmt::Assign {
            to: target.place,
            value,
            text_max,
        })
    }

    /// Returns a constant parameter if it is in its range; otherwise reports a finding.
    pub(super) fn number_in(
        &mut self,
        value: i128,
        (low, high): (i128, i128),
        name: &str,
        span: Span,
    ) -> Option<()> {
        if (low..=high).contains(&value) {
            return Some(());
        }
        let what = format!("{name} must be {low} to {high}, not {value}");
        self.found(
            &crate::finding::NUMBER_RANGE,
            span,
            what,
            format!("write {name} := {low} to {high}"),
        );
        None
    }

    /// Reports a missing parameter.
    pub(super) fn missing(&mut self, of: &str, name: &str, span: Span) {
        let what = format!("{of} needs its parameter {name}");
        self.found(&PARAMETERS, span, what, format!("write {name} := ..."));
    }
}

/// Returns parameters as a call writes them.
fn shown(parameters: &[(String, bool)]) -> String {
    let parameters = parameters
        .iter()
        .map(|(name, is_output)| format!("{name} {} ...", if *is_output { "=>" } else { ":=" }));
    parameters.collect::<Vec<_>>().join(", ")
}

/// Returns true for the section of outputs, without `VAR_IN_OUT`.
pub(super) fn is_output(section: Section) -> bool {
    section == Section::Output
}
