//! Standard functions: IEC 61131-3, standard functions.

use crate::types::Elementary;
use crate::value::{Fault, Value, int_of, real_of};

/// Types that a parameter accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Class {
    Bool,
    Int,
    Text,
    /// Any ordered elementary type; all parameters of this class are converted to one type.
    Any,
    /// `ANY_NUM`; all parameters of this class are converted to one type.
    Num,
    /// `ANY_REAL`; all parameters of this class are converted to one type.
    Real,
    /// `BYTE` to `LWORD`.
    Bits,
}

/// Type of the result of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ResultType {
    /// The type to which the parameters of `Any`, `Num`, `Real` or `Bits` were converted.
    Common,
    Of(Elementary),
}

/// Values of a call, and types.
pub(crate) struct Call<'a> {
    pub values: &'a [Value],
    /// The type of the result.
    pub of: Elementary,
}

pub(crate) type FunctionBody = fn(&Call) -> Result<Value, Fault>;

/// A standard function.
pub(crate) struct Function {
    pub name: &'static str,
    /// Names of parameters; with `is_extensible`, the last one may be repeated with increasing numbers.
    pub parameters: &'static [(&'static str, Class)],
    pub is_extensible: bool,
    pub gives: ResultType,
    pub run: FunctionBody,
}

macro_rules! functions {
    ($($name:literal ($($parameter:ident: $class:ident),*) $(($more:ident))? -> $gives:expr, $run:expr;)*) => {
        /// All standard functions except conversions and operators.
        pub(crate) static FUNCTIONS: &[Function] = &[$(Function {
            name: $name,
            parameters: &[$((stringify!($parameter), Class::$class)),*],
            is_extensible: functions!(@more $($more)?),
            gives: $gives,
            run: $run,
        }),*];
    };
    (@more) => { false };
    (@more $more:ident) => { true };
}

const COMMON: ResultType = ResultType::Common;
const TEXT: ResultType = ResultType::Of(Elementary::String);
const INT: ResultType = ResultType::Of(Elementary::Int);

functions! {
    "ABS" (IN: Num) -> COMMON, |call| match &call.values[0] {
        Value::Real(value) => Ok(Value::Real(value.abs())),
        value => int_of(value.int().abs(), call.of),
    };
    "SQRT" (IN: Real) -> COMMON, |call| real(call, "SQRT", f64::sqrt);
    "LN" (IN: Real) -> COMMON, |call| real(call, "LN", f64::ln);
    "LOG" (IN: Real) -> COMMON, |call| real(call, "LOG", f64::log10);
    "EXP" (IN: Real) -> COMMON, |call| real(call, "EXP", f64::exp);
    "SIN" (IN: Real) -> COMMON, |call| real(call, "SIN", f64::sin);
    "COS" (IN: Real) -> COMMON, |call| real(call, "COS", f64::cos);
    "TAN" (IN: Real) -> COMMON, |call| real(call, "TAN", f64::tan);
    "ASIN" (IN: Real) -> COMMON, |call| real(call, "ASIN", f64::asin);
    "ACOS" (IN: Real) -> COMMON, |call| real(call, "ACOS", f64::acos);
    "ATAN" (IN: Real) -> COMMON, |call| real(call, "ATAN", f64::atan);
    "ATAN2" (Y: Real, X: Real) -> COMMON, |call| {
        real_of(call.values[0].real().atan2(call.values[1].real()), call.of, "ATAN2")
    };
    "EXPT" (IN1: Real, IN2: Real) -> COMMON, |call| power(call.values[0].real(), call.values[1].real(), call.of);
    "MOVE" (IN: Any) -> COMMON, |call| Ok(call.values[0].clone());
    "MIN" (IN1: Any, IN2: Any) (more) -> COMMON, |call| Ok(extreme(call.values, std::cmp::Ordering::Less));
    "MAX" (IN1: Any, IN2: Any) (more) -> COMMON, |call| Ok(extreme(call.values, std::cmp::Ordering::Greater));
    "LIMIT" (MN: Any, IN: Any, MX: Any) -> COMMON, |call| {
        let at_most = extreme(&call.values[1..], std::cmp::Ordering::Less);
        Ok(extreme(&[call.values[0].clone(), at_most], std::cmp::Ordering::Greater))
    };
    "SEL" (G: Bool, IN0: Any, IN1: Any) -> COMMON, |call| {
        Ok(call.values[1 + usize::from(call.values[0].bool())].clone())
    };
    "MUX" (K: Int, IN0: Any, IN1: Any) (more) -> COMMON, |call| {
        let choice = call.values[0].int();
        let chosen = usize::try_from(choice).ok().and_then(|choice| call.values[1..].get(choice));
        chosen.cloned().ok_or(Fault::Mux(choice, call.values.len() - 1))
    };
    "SHL" (IN: Bits, N: Int) -> COMMON, |call| shift(call, |value, n, _| value.checked_shl(n).unwrap_or(0));
    "SHR" (IN: Bits, N: Int) -> COMMON, |call| shift(call, |value, n, _| value.checked_shr(n).unwrap_or(0));
    "ROL" (IN: Bits, N: Int) -> COMMON, |call| shift(call, |value, n, bits| rotate(value, n % bits, bits));
    "ROR" (IN: Bits, N: Int) -> COMMON, |call| shift(call, |value, n, bits| rotate(value, bits - n % bits, bits));
    "LEN" (IN: Text) -> INT, |call| Ok(number(call.values[0].text().chars().count()));
    "LEFT" (IN: Text, L: Int) -> TEXT, |call| {
        let length = count("LEFT", &call.values[1], 0)?;
        Ok(Value::Text(call.values[0].text().chars().take(length).collect()))
    };
    "RIGHT" (IN: Text, L: Int) -> TEXT, |call| {
        let (text, length) = (call.values[0].text(), count("RIGHT", &call.values[1], 0)?);
        let left = text.chars().count().saturating_sub(length);
        Ok(Value::Text(text.chars().skip(left).collect()))
    };
    "MID" (IN: Text, L: Int, P: Int) -> TEXT, |call| {
        let (length, place) = (count("MID", &call.values[1], 0)?, count("MID", &call.values[2], 1)?);
        Ok(Value::Text(call.values[0].text().chars().skip(place - 1).take(length).collect()))
    };
    "CONCAT" (IN1: Text, IN2: Text) (more) -> TEXT, |call| text(call.values.iter().map(Value::text).collect());
    "INSERT" (IN1: Text, IN2: Text, P: Int) -> TEXT, |call| {
        replaced("INSERT", &call.values[0], call.values[1].text(), 0, count("INSERT", &call.values[2], 0)?)
    };
    "DELETE" (IN: Text, L: Int, P: Int) -> TEXT, |call| {
        let (length, place) = (count("DELETE", &call.values[1], 0)?, count("DELETE", &call.values[2], 1)?);
        replaced("DELETE", &call.values[0], "", length, place - 1)
    };
    "REPLACE" (IN1: Text, IN2: Text, L: Int, P: Int) -> TEXT, |call| {
        let (length, place) = (count("REPLACE", &call.values[2], 0)?, count("REPLACE", &call.values[3], 1)?);
        replaced("REPLACE", &call.values[0], call.values[1].text(), length, place - 1)
    };
    "FIND" (IN1: Text, IN2: Text) -> INT, |call| {
        let (text, wanted) = (call.values[0].text(), call.values[1].text());
        let found = text.find(wanted).filter(|_| !wanted.is_empty());
        Ok(number(found.map_or(0, |byte| text[..byte].chars().count() + 1)))
    };
}

/// Returns the function of a name in upper case.
pub(crate) fn function(name: &str) -> Option<&'static Function> {
    FUNCTIONS.iter().find(|function| function.name == name)
}

/// Functions that are operators by name, and the operators.
pub(crate) const OPERATORS: [(&str, &str); 16] = [
    ("ADD", "+"),
    ("MUL", "*"),
    ("SUB", "-"),
    ("DIV", "/"),
    ("MOD", "MOD"),
    ("AND", "AND"),
    ("OR", "OR"),
    ("XOR", "XOR"),
    ("GT", ">"),
    ("GE", ">="),
    ("EQ", "="),
    ("LE", "<="),
    ("LT", "<"),
    ("NE", "<>"),
    ("ADD_TIME", "+"),
    ("SUB_TIME", "-"),
];

/// A conversion by its name: `INT_TO_REAL`, `TO_REAL`, `REAL_TRUNC_INT`, `TRUNC_INT`, `TRUNC`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Conversion {
    /// The source type; `None` selects the type of the parameter.
    pub from: Option<Elementary>,
    pub to: Elementary,
    pub truncates: bool,
}

impl Conversion {
    /// Returns the conversion of a name in upper case.
    pub fn named(name: &str) -> Option<Self> {
        if name == "TRUNC" {
            return Some(Self {
                from: None,
                to: Elementary::Dint,
                truncates: true,
            });
        }
        let (from, to, truncates) = if let Some(to) = name.strip_prefix("TO_") {
            (None, to, false)
        } else if let Some(to) = name.strip_prefix("TRUNC_") {
            (None, to, true)
        } else if let Some((from, to)) = name.split_once("_TO_") {
            (Some(from), to, false)
        } else {
            let (from, to) = name.split_once("_TRUNC_")?;
            (Some(from), to, true)
        };
        let from = match from {
            Some(from) => Some(Elementary::named(from)?),
            None => None,
        };
        Some(Self {
            from,
            to: Elementary::named(to)?,
            truncates,
        })
    }
}

/// Returns `IN1 ** IN2`.
///
/// # Errors
/// Fails if the result does not exist, or is too large.
pub(crate) fn power(base: f64, exponent: f64, of: Elementary) -> Result<Value, Fault> {
    if base == 0.0 && exponent < 0.0 {
        return Err(Fault::DivisionByZero);
    }
    real_of(base.powf(exponent), of, "**")
}

/// Returns the order of two values of one type.
pub(crate) fn order(one: &Value, other: &Value) -> std::cmp::Ordering {
    match (one, other) {
        (Value::Text(one), Value::Text(other)) => one.cmp(other),
        (Value::Real(one), Value::Real(other)) => one.partial_cmp(other).unwrap_or(std::cmp::Ordering::Equal),
        (one, other) => one.int().cmp(&other.int()),
    }
}

fn extreme(values: &[Value], wanted: std::cmp::Ordering) -> Value {
    let mut best = &values[0];
    for value in values {
        if order(value, best) == wanted {
            best = value;
        }
    }
    best.clone()
}

fn real(call: &Call, name: &'static str, calculate: fn(f64) -> f64) -> Result<Value, Fault> {
    let value = call.values[0].real();
    if (name == "LN" || name == "LOG") && value <= 0.0 {
        return Err(Fault::NoResult(name));
    }
    real_of(calculate(value), call.of, name)
}

/// Shifts a value without sign by N bits.
fn shift(call: &Call, shifted: fn(u64, u32, u32) -> u64) -> Result<Value, Fault> {
    let name = "a shift";
    let value = u64::try_from(call.values[0].int()).map_err(|_| Fault::NoResult(name))?;
    let n = call.values[1].int();
    let n =
        u32::try_from(n.min(u32::MAX.into())).map_err(|_| Fault::NoResult("a shift by less than 0 bits"))?;
    let bits = call.of.bits();
    Ok(Value::Int(
        i128::from(shifted(value, n, bits)) & ((1_i128 << bits) - 1),
    ))
}

fn rotate(value: u64, left: u32, bits: u32) -> u64 {
    let left = left % bits;
    value.checked_shl(left).unwrap_or(0) | value.checked_shr(bits - left).unwrap_or(0)
}

fn number(count: usize) -> Value {
    // a string is far shorter than the largest INT
    Value::Int(i128::try_from(count).unwrap_or(i128::MAX))
}

/// Returns a number of characters, or the position of a character.
fn count(name: &'static str, value: &Value, least: usize) -> Result<usize, Fault> {
    let count = usize::try_from(value.int().min(1 << 20))
        .ok()
        .filter(|count| *count >= least);
    count.ok_or(Fault::NoResult(name))
}

/// Returns a string; fails if it is longer than any variable.
fn text(text: String) -> Result<Value, Fault> {
    let length = text.chars().count();
    if length > crate::limits::STRING_MAX {
        return Err(Fault::TooLong(length, crate::limits::STRING_MAX));
    }
    Ok(Value::Text(text))
}

/// Returns a string in which `length` characters after the first `before` ones are replaced.
fn replaced(name: &'static str, of: &Value, by: &str, length: usize, before: usize) -> Result<Value, Fault> {
    let of = of.text();
    if before > of.chars().count() {
        return Err(Fault::NoResult(name));
    }
    let head = of.chars().take(before);
    let tail = of.chars().skip(before + length);
    text(head.chain(by.chars()).chain(tail).collect())
}
