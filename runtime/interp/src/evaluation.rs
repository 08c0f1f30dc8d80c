//! The value of expressions and conditions (manual 4-1; D07 to D10).

use std::cell::Cell;

use tandem_model::AXES_MAX;
use tandem_model::lost::is_lost;
use tandem_model::variables::{LOCAL_VARIABLES, Variables};
use tandem_syntax::{Expression, ExpressionId, NcProgram, Operator, Variable, VariableKind};

use crate::arithmetic::{binary, call, compare};
use crate::text_values::Values;

/// L0 to L255 of one call.
pub(crate) type Locals = [f64; LOCAL_VARIABLES];

/// The variables that a block reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scope<'a> {
    pub(crate) locals: &'a Locals,
    pub(crate) variables: &'a Variables,
    /// `None` while a G31 is unfinished: no block reads them in this time (D15).
    pub(crate) captured: Option<&'a [f64; AXES_MAX]>,
    /// Receives a variable that was read and has a lost value: results calculated with it are invalid.
    pub(crate) lost: &'a Cell<Option<Variable>>,
}

/// The variables of indirections.
#[derive(Clone, Copy)]
pub(crate) enum VariableSource<'a> {
    /// The variables of a run.
    Run(Scope<'a>),
    /// Values that the text shows.
    Text { values: &'a Values, trust: Trust },
}

/// Values of variables that are trusted, among those that the text shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Trust {
    /// None.
    None,
    /// Values that no other writer can have changed.
    Own,
    /// All.
    Believed,
}

impl Scope<'_> {
    /// Returns the value of a variable; NaN if it does not exist, which the parser rejects.
    pub(crate) fn variable(&self, variable: Variable) -> f64 {
        let index = usize::from(variable.index);
        let value = match variable.kind {
            VariableKind::Local => self.locals.get(index).copied(),
            VariableKind::CoordinateSystem => self.variables.coordinate_system.get(index),
            VariableKind::Global => self.variables.global.get(index),
            VariableKind::CapturedPosition => self.captured.and_then(|all| all.get(index)).copied(),
        };
        if value.is_some_and(is_lost) {
            self.lost.set(Some(variable));
        }
        value.unwrap_or(f64::NAN)
    }

    /// Returns the value of an expression. It may be infinite or not a number (D07). Its depth is bounded by
    /// the length of a block.
    pub(crate) fn number(&self, program: &NcProgram, id: ExpressionId) -> f64 {
        match program.expression(id).copied() {
            Some(Expression::Number(value)) => value,
            Some(Expression::Variable(variable)) => self.variable(variable),
            Some(Expression::Negation(operand)) => -self.number(program, operand),
            Some(Expression::Binary {
                operator,
                left,
                right,
            }) => binary(operator, self.number(program, left), self.number(program, right)),
            Some(Expression::Call {
                function,
                first,
                second,
            }) => {
                let second = second.map_or(f64::NAN, |second| self.number(program, second));
                call(function, self.number(program, first), second)
            }
            Some(Expression::Not(_)) | None => f64::NAN,
        }
    }

    /// Returns whether a condition is true. A comparison with a NaN is false, except `!=`.
    pub(crate) fn condition(&self, program: &NcProgram, id: ExpressionId) -> bool {
        let isnan = || compare(Operator::Equal, self.number(program, id), 1.0) == Some(true);
        match program.expression(id).copied() {
            Some(Expression::Not(condition)) => !self.condition(program, condition),
            Some(Expression::Binary {
                operator,
                left,
                right,
            }) => match operator {
                Operator::And => self.condition(program, left) && self.condition(program, right),
                Operator::Or => self.condition(program, left) || self.condition(program, right),
                _ if operator.compares() => {
                    let (left, right) = (self.number(program, left), self.number(program, right));
                    compare(operator, left, right) == Some(true)
                }
                _ => isnan(),
            },
            _ => isnan(),
        }
    }
}

/// Returns true if an expression reads a variable of such a kind.
pub(crate) fn reads(program: &NcProgram, id: ExpressionId, is_such: fn(VariableKind) -> bool) -> bool {
    let reads = |id| reads(program, id, is_such);
    match program.expression(id).copied() {
        Some(Expression::Variable(variable)) => is_such(variable.kind),
        Some(Expression::Negation(operand) | Expression::Not(operand)) => reads(operand),
        Some(Expression::Binary { left, right, .. }) => reads(left) || reads(right),
        Some(Expression::Call { first, second, .. }) => reads(first) || second.is_some_and(reads),
        Some(Expression::Number(_)) | None => false,
    }
}
