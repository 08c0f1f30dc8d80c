//! Range of the values that a number can have in a run, calculated before the run.

use tandem_syntax::{Function, Operator};

use crate::arithmetic::{binary, call};

/// Range of the values that a number can have.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Range {
    /// Smallest possible number; above `high` if the value is certainly NaN.
    pub low: f64,
    /// Largest possible number.
    pub high: f64,
    /// True if the value can be NaN.
    pub nan: bool,
    /// True if only the program can have written the variables from which the value is calculated, or if no
    /// time has passed since it wrote them.
    pub own: bool,
}

impl PartialEq for Range {
    fn eq(&self, other: &Self) -> bool {
        let bits = |range: &Self| (range.low.to_bits(), range.high.to_bits(), range.nan, range.own);
        bits(self) == bits(other)
    }
}

impl Range {
    /// The range of an unknown value.
    pub const ANY: Self = Self {
        low: f64::NEG_INFINITY,
        high: f64::INFINITY,
        nan: true,
        own: true,
    };

    /// Returns the range that contains only `value`, which may be NaN.
    pub fn from_value(value: f64) -> Self {
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

    /// Returns the value if the range contains only one value.
    pub fn value(self) -> Option<f64> {
        if self.low > self.high {
            return Some(f64::NAN);
        }
        (!self.nan && self.low.to_bits() == self.high.to_bits()).then_some(self.low)
    }

    /// Returns a range that contains both ranges. A bound that moves becomes infinite, so that the analysis
    /// of loops ends.
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

    /// Returns the range of an operator's results.
    pub fn binary(operator: Operator, left: Self, right: Self) -> Self {
        let own = left.own && right.own;
        if let (Some(left), Some(right)) = (left.value(), right.value()) {
            return Self::from_value(binary(operator, left, right)).and_own(own);
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

    /// Returns the range of a function's results.
    pub fn call(function: Function, x: Self, y: Option<Self>) -> Self {
        let own = x.own && y.is_none_or(|y| y.own);
        let second = y.map_or(Some(f64::NAN), Self::value);
        if let (Some(x), Some(y)) = (x.value(), second) {
            return Self::from_value(call(function, x, y)).and_own(own);
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
}
