//! Possible values of expressions and conditions, from the known values of variables.

use tandem_syntax::{Expression, ExpressionId, NcProgram, Operator, Variable, VariableKind};

use crate::arithmetic::compare;
use crate::range::Range;
use crate::text_values::Values;

/// Returns the range of the values of an expression.
pub(super) fn number(program: &NcProgram, id: ExpressionId, values: &Values) -> Range {
    let of = |id| number(program, id, values);
    match program.expression(id).copied() {
        Some(Expression::Number(value)) => Range::from_value(value),
        Some(Expression::Variable(variable)) => values.get(variable),
        Some(Expression::Negation(operand)) => {
            let Range { low, high, nan, own } = of(operand);
            Range {
                low: -high,
                high: -low,
                nan,
                own,
            }
        }
        Some(Expression::Binary {
            operator,
            left,
            right,
        }) => Range::binary(operator, of(left), of(right)),
        Some(Expression::Call {
            function,
            first,
            second,
        }) => Range::call(function, of(first), second.map(of)),
        Some(Expression::Not(_)) | None => Range::ANY,
    }
}

/// Returns whether a condition is true, or `None` if this is unknown or depends on values that another writer
/// may have changed.
pub(super) fn holds(program: &NcProgram, id: ExpressionId, values: &Values) -> Option<bool> {
    let of = |id| holds(program, id, values);
    let is_one = || {
        let range = number(program, id, values);
        compare(Operator::Equal, range.value().filter(|_| range.own)?, 1.0)
    };
    match program.expression(id).copied() {
        Some(Expression::Not(condition)) => of(condition).map(|holds| !holds),
        Some(Expression::Binary {
            operator: operator @ (Operator::And | Operator::Or),
            left,
            right,
        }) => {
            let decides = operator == Operator::Or;
            match (of(left), of(right)) {
                (Some(one), _) | (_, Some(one)) if one == decides => Some(decides),
                (Some(_), Some(_)) => Some(!decides),
                _ => None,
            }
        }
        Some(Expression::Binary {
            operator,
            left,
            right,
        }) if operator.compares() => {
            let left = number(program, left, values);
            let right = number(program, right, values);
            if !(left.own && right.own) {
                return None;
            }
            if let (Some(left), Some(right)) = (left.value(), right.value()) {
                return compare(operator, left, right);
            }
            apart(operator, left, right)
        }
        _ => is_one(),
    }
}

/// Returns the result of a comparison if the ranges of both sides decide it, otherwise `None`.
fn apart(operator: Operator, left: Range, right: Range) -> Option<bool> {
    let numbers = !left.nan && !right.nan;
    let below = left.high < right.low;
    let above = left.low > right.high;
    match operator {
        Operator::Less if below && numbers => Some(true),
        Operator::Less if left.low >= right.high => Some(false),
        Operator::LessOrEqual if left.high <= right.low && numbers => Some(true),
        Operator::LessOrEqual if above => Some(false),
        Operator::Greater if above && numbers => Some(true),
        Operator::Greater if left.high <= right.low => Some(false),
        Operator::GreaterOrEqual if left.low >= right.high && numbers => Some(true),
        Operator::GreaterOrEqual if below => Some(false),
        Operator::Equal if below || above => Some(false),
        Operator::NotEqual if below || above => Some(true),
        _ => None,
    }
}

/// Limits the ranges of the variables in a condition whose result is `is_so`.
pub(super) fn suppose(program: &NcProgram, id: ExpressionId, is_so: bool, values: &mut Values) {
    match program.expression(id).copied() {
        Some(Expression::Not(condition)) => suppose(program, condition, !is_so, values),
        Some(Expression::Binary {
            operator: operator @ (Operator::And | Operator::Or),
            left,
            right,
        }) if is_so == (operator == Operator::And) => {
            suppose(program, left, is_so, values);
            suppose(program, right, is_so, values);
        }
        Some(Expression::Binary {
            operator,
            left,
            right,
        }) if operator.compares() => {
            let (of_left, of_right) = (number(program, left, values), number(program, right, values));
            if let Some(Expression::Variable(variable)) = program.expression(left) {
                bound(values, *variable, operator, is_so, of_right);
            }
            if let Some(Expression::Variable(variable)) = program.expression(right) {
                bound(values, *variable, mirrored(operator), is_so, of_left);
            }
        }
        _ => {}
    }
}

/// Returns the operator of the same comparison with exchanged sides.
fn mirrored(operator: Operator) -> Operator {
    match operator {
        Operator::Less => Operator::Greater,
        Operator::Greater => Operator::Less,
        Operator::LessOrEqual => Operator::GreaterOrEqual,
        Operator::GreaterOrEqual => Operator::LessOrEqual,
        same => same,
    }
}

/// Limits the range of a variable by its comparison with another range. A comparison whose result is false
/// gives no limit if one side may be NaN.
fn bound(values: &mut Values, variable: Variable, operator: Operator, is_so: bool, other: Range) {
    let before = values.get(variable);
    if before.value().is_some() && before.own {
        return;
    }
    // if another writer may have changed the value, only the condition limits its range
    let mut range = if before.own { before } else { Range::ANY };
    let numbers = !range.nan && !other.nan;
    let (above, below) = match (operator, is_so) {
        (Operator::Less | Operator::LessOrEqual, true) => (None, Some(other.high)),
        (Operator::Greater | Operator::GreaterOrEqual, true) => (Some(other.low), None),
        (Operator::Less | Operator::LessOrEqual, false) if numbers => (Some(other.low), None),
        (Operator::Greater | Operator::GreaterOrEqual, false) if numbers => (None, Some(other.high)),
        (Operator::Equal, true) | (Operator::NotEqual, false) => (Some(other.low), Some(other.high)),
        _ => (None, None),
    };
    range.nan &= above.is_none() && below.is_none();
    range.low = above.map_or(range.low, |above| range.low.max(above));
    range.high = below.map_or(range.high, |below| range.high.min(below));
    range.own = matches!(variable.kind, VariableKind::Local) && other.own;
    if range.low > range.high && !range.nan {
        range = Range::ANY;
    }
    values.set(variable, range);
}
