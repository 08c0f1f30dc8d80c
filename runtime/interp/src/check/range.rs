//! What is known of a number before a program runs: the numbers that it may be.

use tandem_syntax::{Expression, ExpressionId, Function, NcProgram, Operator, Variable, VariableKind};

use super::values::Values;
use crate::evaluation::{binary, call, compare};

/// The numbers that a value may be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Range {
    /// The smallest; above `high` where it is no number for sure.
    pub low: f64,
    /// The largest.
    pub high: f64,
    /// It may be no number.
    pub nan: bool,
    /// Only the program itself can have written what it was calculated from, or no time has passed since.
    pub own: bool,
}

impl PartialEq for Range {
    fn eq(&self, other: &Self) -> bool {
        let bits = |range: &Self| (range.low.to_bits(), range.high.to_bits(), range.nan, range.own);
        bits(self) == bits(other)
    }
}

impl Range {
    /// Nothing is known.
    pub const ANY: Self = Self {
        low: f64::NEG_INFINITY,
        high: f64::INFINITY,
        nan: true,
        own: true,
    };

    /// One value; it may be no number.
    pub fn of(value: f64) -> Self {
        if value.is_nan() {
            return Self {
                low: f64::INFINITY,
                high: f64::NEG_INFINITY,
                nan: true,
                own: true,
            };
        }
        Self::between(value, value)
    }

    fn between(low: f64, high: f64) -> Self {
        if low.is_nan() || high.is_nan() {
            return Self::ANY;
        }
        Self {
            low,
            high,
            nan: false,
            own: true,
        }
    }

    /// The value where there is one only.
    pub fn value(self) -> Option<f64> {
        if self.low > self.high {
            return Some(f64::NAN);
        }
        (!self.nan && self.low.to_bits() == self.high.to_bits()).then_some(self.low)
    }

    /// What both may be. What grows is not bounded any more, so that repetitions come to an end.
    pub fn widened(self, other: Self) -> Self {
        let low = if other.low < self.low {
            f64::NEG_INFINITY
        } else {
            self.low
        };
        let high = if other.high > self.high {
            f64::INFINITY
        } else {
            self.high
        };
        Self {
            low,
            high,
            nan: self.nan || other.nan,
            own: self.own && other.own,
        }
    }

    fn and_own(self, own: bool) -> Self {
        Self {
            own: self.own && own,
            ..self
        }
    }

    fn binary(operator: Operator, left: Self, right: Self) -> Self {
        let own = left.own && right.own;
        if let (Some(left), Some(right)) = (left.value(), right.value()) {
            return Self::of(binary(operator, left, right)).and_own(own);
        }
        let ends = |all: [f64; 4]| {
            if all.iter().any(|value| value.is_nan()) {
                return Self::ANY;
            }
            let low = all.into_iter().fold(f64::INFINITY, f64::min);
            Self::between(low, all.into_iter().fold(f64::NEG_INFINITY, f64::max))
        };
        let by = |operation: fn(f64, f64) -> f64| {
            ends([
                operation(left.low, right.low),
                operation(left.low, right.high),
                operation(left.high, right.low),
                operation(left.high, right.high),
            ])
        };
        let has_zero = right.low <= 0.0 && right.high >= 0.0;
        let range = match operator {
            Operator::Add => by(|a, b| a + b),
            Operator::Subtract => by(|a, b| a - b),
            Operator::Multiply => by(|a, b| a * b),
            Operator::Divide if !has_zero => by(|a, b| a / b),
            _ => Self::ANY,
        };
        Self {
            nan: range.nan || left.nan || right.nan,
            ..range
        }
        .and_own(own)
    }

    fn call(function: Function, x: Self, y: Option<Self>) -> Self {
        let own = x.own && y.is_none_or(|y| y.own);
        let second = y.map_or(Some(f64::NAN), Self::value);
        if let (Some(x), Some(y)) = (x.value(), second) {
            return Self::of(call(function, x, y)).and_own(own);
        }
        let rising = |x: Self| Self {
            nan: x.nan,
            ..Self::between(call(function, x.low, f64::NAN), call(function, x.high, f64::NAN))
        };
        let range = match function {
            Function::Floor | Function::Int | Function::Ceil | Function::Rint | Function::Sgn => rising(x),
            Function::Sqrt if x.low >= 0.0 => rising(x),
            Function::Abs if x.low >= 0.0 => x,
            Function::Abs => Self {
                low: 0.0,
                high: x.low.abs().max(x.high.abs()),
                ..x
            },
            Function::Sin | Function::Sind | Function::Cos | Function::Cosd => Self {
                nan: true,
                ..Self::between(-1.0, 1.0)
            },
            Function::Isnan => Self::between(0.0, f64::from(u8::from(x.nan))),
            _ => Self::ANY,
        };
        range.and_own(own)
    }

    /// The value of an expression.
    pub fn of_expression(program: &NcProgram, id: ExpressionId, values: &Values) -> Self {
        let of = |id| Self::of_expression(program, id, values);
        match program.expression(id).copied() {
            Some(Expression::Number(value)) => Self::of(value),
            Some(Expression::Variable(variable)) => values.get(variable),
            Some(Expression::Negation(operand)) => {
                let Self { low, high, nan, own } = of(operand);
                Self {
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
            }) => Self::binary(operator, of(left), of(right)),
            Some(Expression::Call {
                function,
                first,
                second,
            }) => Self::call(function, of(first), second.map(of)),
            Some(Expression::Not(_)) | None => Self::ANY,
        }
    }
}

/// Whether a condition holds; `None`: that is not known. What is not the program's own alone decides nothing.
pub(crate) fn holds(program: &NcProgram, id: ExpressionId, values: &Values) -> Option<bool> {
    let of = |id| holds(program, id, values);
    let is_one = || {
        let range = Range::of_expression(program, id, values);
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
            let left = Range::of_expression(program, left, values);
            let right = Range::of_expression(program, right, values);
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

/// What two ranges say of a comparison.
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

/// Takes over what a condition says of the variables that it compares, where it is known to hold or not.
pub(crate) fn suppose(program: &NcProgram, id: ExpressionId, is_so: bool, values: &mut Values) {
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
            let (of_left, of_right) = (
                Range::of_expression(program, left, values),
                Range::of_expression(program, right, values),
            );
            if let Some(Expression::Variable(variable)) = program.expression(left) {
                bound(values, *variable, operator, is_so, of_right);
            }
            if let Some(Expression::Variable(variable)) = program.expression(right) {
                bound(values, *variable, turned(operator), is_so, of_left);
            }
        }
        _ => {}
    }
}

/// The operator that says the same with its sides exchanged.
fn turned(operator: Operator) -> Operator {
    match operator {
        Operator::Less => Operator::Greater,
        Operator::Greater => Operator::Less,
        Operator::LessOrEqual => Operator::GreaterOrEqual,
        Operator::GreaterOrEqual => Operator::LessOrEqual,
        same => same,
    }
}

/// Bounds a variable by a comparison with a range. A comparison that does not hold says nothing where one side may be no
/// number.
fn bound(values: &mut Values, variable: Variable, operator: Operator, is_so: bool, other: Range) {
    let before = values.get(variable);
    if before.value().is_some() && before.own {
        return;
    }
    // what somebody else may have written is what the condition says, and nothing more
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
