//! Evaluation of expressions and conditions (manual 4-1; D07 to D10).

use std::cell::Cell;

use tandem_model::AXES_MAX;
use tandem_model::lost::is_lost;
use tandem_model::variables::{LOCAL_VARIABLES, Variables};
use tandem_syntax::{Expression, ExpressionId, NcProgram, Operator, Variable, VariableKind};

use crate::arithmetic::{binary, call, compare};
use crate::text_values::Values;

/// Values of L0 to L255 in one call.
pub(crate) type Locals = [f64; LOCAL_VARIABLES];

/// Variables that a block can read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scope<'a> {
    pub(crate) locals: &'a Locals,
    pub(crate) variables: &'a Variables,
    /// Captured positions; `None` while a G31 is unfinished. No block reads captured positions in this time
    /// (D15).
    pub(crate) captured: Option<&'a [f64; AXES_MAX]>,
    /// The last variable that was read and has lost its value. Results calculated with such a variable are
    /// invalid.
    pub(crate) lost: &'a Cell<Option<Variable>>,
}

/// Source of the values of variables in words.
#[derive(Clone, Copy)]
pub(crate) enum VariableSource<'a> {
    /// The variables of a running program.
    Run(Scope<'a>),
    /// The values that the text shows, and the trust in these values.
    Text { values: &'a Values, trust: Trust },
}

/// Trust in the values of variables that the text shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Trust {
    /// No value is trusted.
    None,
    /// Only values that no other writer can have changed are trusted.
    Own,
    /// All values are trusted.
    Believed,
}

impl Scope<'_> {
    /// Returns the value of a variable, or NaN if the variable does not exist; the parser rejects such
    /// variables.
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

    /// Returns the value of an expression, which may be infinite or NaN (D07). The length of a block limits
    /// the depth of the recursion.
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

    /// Returns whether a condition is true. A comparison with NaN is false, except `!=`, which is true.
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

/// Returns true if an expression reads a variable for whose kind `is_such` returns true.
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
