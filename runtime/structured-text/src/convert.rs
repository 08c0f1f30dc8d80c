//! Conversions between elementary types: IEC 61131-3, data type conversion functions.

use std::fmt::Write;

use crate::types::Elementary;
use crate::value::{Fault, Value, int_of, real_of};

/// Nanoseconds of a millisecond, in which times are converted to numbers.
const MS: i128 = 1_000_000;

/// Returns true if a function `FROM_TO_TO` exists.
pub(crate) fn is_conversion(from: Elementary, to: Elementary) -> bool {
    use Elementary::{Bool, String, Time};
    match (from, to) {
        (Bool, to) => to != Time,
        (String, to) => to != Time && !to.is_bits(),
        (Time, to) => to.is_num() || matches!(to, Time | String),
        (from, Bool) => from.is_int() || from.is_bits(),
        (_, String) => true,
        (from, Time) => from.is_num(),
        (from, to) => !(from.is_bits() && to.is_real() || from.is_real() && to.is_bits()),
    }
}

/// Returns the value converted to another type.
///
/// # Errors
/// Fails if the value does not fit the type.
pub(crate) fn convert(value: &Value, from: Elementary, to: Elementary) -> Result<Value, Fault> {
    match to {
        Elementary::Bool if from == Elementary::String => match value.text() {
            "TRUE" => Ok(Value::Bool(true)),
            "FALSE" => Ok(Value::Bool(false)),
            text => Err(Fault::NotANumber(text.to_owned())),
        },
        Elementary::Bool => Ok(Value::Bool(value.int() != 0)),
        Elementary::String => Ok(Value::Text(text_of(value, from))),
        Elementary::Real | Elementary::Lreal => {
            let number = match from {
                Elementary::String => number_in(value.text())?,

                Elementary::Time => value.int() as f64 / MS as f64,
                _ => value.real(),
            };
            real_of(number, to, "the conversion")
        }
        _ if from.is_real() => {
            let scale = if to == Elementary::Time { 1e6 } else { 1.0 };
            whole(value.real() * scale, to, f64::round_ties_even)
        }
        _ if from == Elementary::String => {
            let text = value.text().trim();
            let parsed = text
                .parse::<i128>()
                .map_err(|_| Fault::NotANumber(text.to_owned()))?;
            int_of(parsed, to)
        }
        Elementary::Time => int_of(value.int() * if from == Elementary::Time { 1 } else { MS }, to),
        _ if from == Elementary::Time => int_of(value.int() / MS, to),
        _ if from.is_bits() || to.is_bits() => Ok(Value::Int(transferred(value.int(), from, to))),
        _ => int_of(value.int(), to),
    }
}

/// Truncates towards zero, as `TRUNC`.
///
/// # Errors
/// Fails if the value does not fit the type.
pub(crate) fn truncate(value: f64, to: Elementary) -> Result<Value, Fault> {
    whole(value, to, f64::trunc)
}

fn whole(value: f64, to: Elementary, round: fn(f64) -> f64) -> Result<Value, Fault> {
    // an i128 holds the whole part of what fits 64 bits exactly; beyond, the conversion saturates
    #[expect(
        clippy::cast_possible_truncation,
        reason = "it saturates, and the range is checked"
    )]
    let whole = round(value) as i128;
    int_of(whole, to).map_err(|_| Fault::Range(value.to_string(), to))
}

/// Returns the bits unchanged, aligned at the rightmost bit; missing bits are 0.
fn transferred(value: i128, from: Elementary, to: Elementary) -> i128 {
    let mask = |kind: Elementary| (1_i128 << kind.bits()) - 1;
    let bits = value & mask(from) & mask(to);
    let is_negative = to.is_signed() && bits >> (to.bits() - 1) == 1;
    if is_negative {
        bits - (1_i128 << to.bits())
    } else {
        bits
    }
}

fn number_in(text: &str) -> Result<f64, Fault> {
    let number = text
        .trim()
        .parse::<f64>()
        .ok()
        .filter(|number| number.is_finite());
    number.ok_or_else(|| Fault::NotANumber(text.to_owned()))
}

fn text_of(value: &Value, from: Elementary) -> String {
    match (from, value) {
        (Elementary::Bool, value) => if value.bool() { "TRUE" } else { "FALSE" }.to_owned(),
        #[expect(clippy::cast_possible_truncation, reason = "a REAL has 32 bits")]
        (Elementary::Real, value) => format!("{:?}", value.real() as f32),
        (Elementary::Lreal, value) => format!("{:?}", value.real()),
        (Elementary::Time, value) => time_text(value.int()),
        (Elementary::String, value) => value.text().to_owned(),
        (_, value) => value.int().to_string(),
    }
}

/// Returns a time as text: `T#1m30s500ms`.
pub(crate) fn time_text(ns: i128) -> String {
    const UNITS: [(&str, i128); 7] = [
        ("d", 86_400_000_000_000),
        ("h", 3_600_000_000_000),
        ("m", 60_000_000_000),
        ("s", 1_000_000_000),
        ("ms", 1_000_000),
        ("us", 1_000),
        ("ns", 1),
    ];
    let mut text = format!("T#{}", if ns < 0 { "-" } else { "" });
    let mut left = ns.abs();
    for (name, unit) in UNITS {
        if left >= unit {
            let _ = write!(text, "{}{name}", left / unit);
            left %= unit;
        }
    }
    if ns == 0 { "T#0s".to_owned() } else { text }
}
