//! The values of literals.

use super::Literal;
use crate::types::Elementary;

/// Fault of a literal, as a text that follows the literal, and the help.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct LiteralFault {
    pub what: &'static str,
    pub help: &'static str,
}

impl LiteralFault {
    pub const fn new(what: &'static str, help: &'static str) -> Self {
        Self { what, help }
    }
}

const NO_NUMBER: LiteralFault =
    LiteralFault::new("is not a number", "write 5, 1_000, 16#FF, 2#1010, 1.5 or 1.0E-3");

/// Returns digits without their underscores, which are allowed between digits.
fn digits(text: &str, base: u32) -> Option<String> {
    let is_wrong = text.is_empty() || text.starts_with('_') || text.ends_with('_') || text.contains("__");
    let digits: String = text.chars().filter(|letter| *letter != '_').collect();
    (!is_wrong && digits.chars().all(|digit| digit.is_digit(base))).then_some(digits)
}

/// Returns a number with or without a type.
pub(super) fn number(text: &str, is_negative: bool, of: Option<Elementary>) -> Result<Literal, LiteralFault> {
    let unsigned = match of {
        Some(Elementary::Bool) => return bool_value(text, is_negative),
        Some(Elementary::String) => return Err(LiteralFault::new("is not a string", "write STRING#'...'")),
        _ => unsigned(text)?,
    };
    Ok(match unsigned {
        Literal::Integer(value) if is_negative => Literal::Integer(-value),
        Literal::Real(value) if is_negative => Literal::Real(-value),
        unsigned => unsigned,
    })
}

fn bool_value(text: &str, is_negative: bool) -> Result<Literal, LiteralFault> {
    match text.to_ascii_uppercase().as_str() {
        "1" | "TRUE" if !is_negative => Ok(Literal::Bool(true)),
        "0" | "FALSE" if !is_negative => Ok(Literal::Bool(false)),
        _ => Err(LiteralFault::new(
            "is not a BOOL",
            "write BOOL#0, BOOL#1, FALSE or TRUE",
        )),
    }
}

fn unsigned(text: &str) -> Result<Literal, LiteralFault> {
    if let Some((base, value)) = text.split_once('#') {
        let base = match base {
            "2" => 2,
            "8" => 8,
            "16" => 16,
            _ => return Err(LiteralFault::new("has an invalid base", "write 2#, 8# or 16#")),
        };
        return integer(&digits(value, base).ok_or(NO_NUMBER)?, base);
    }
    if !text.contains(['.', 'e', 'E']) {
        return integer(&digits(text, 10).ok_or(NO_NUMBER)?, 10);
    }
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').ok_or(LiteralFault::new(
        "is not a number: an exponent is allowed only after a fraction",
        "write 1.0E-3",
    ))?;
    let sign = if exponent.starts_with('-') { "-" } else { "" };
    let exponent = digits(exponent.strip_prefix(['+', '-']).unwrap_or(exponent), 10);
    let parts = (digits(whole, 10), digits(fraction, 10), exponent);
    let (Some(whole), Some(fraction), Some(exponent)) = parts else {
        return Err(NO_NUMBER);
    };
    let value: f64 = format!("{whole}.{fraction}e{sign}{exponent}")
        .parse()
        .map_err(|_| NO_NUMBER)?;
    if value.is_finite() {
        Ok(Literal::Real(value))
    } else {
        Err(LiteralFault::new("is too large", "an LREAL is at most 1.797E308"))
    }
}

fn integer(digits: &str, base: u32) -> Result<Literal, LiteralFault> {
    match u64::from_str_radix(digits, base) {
        Ok(value) => Ok(Literal::Integer(value.into())),
        Err(_) => Err(LiteralFault::new(
            "is too large",
            "an integer has at most 64 bits",
        )),
    }
}

/// Units of a time, the longest first, with their nanoseconds.
const UNITS: [(&str, i128); 7] = [
    ("D", 86_400_000_000_000),
    ("H", 3_600_000_000_000),
    ("M", 60_000_000_000),
    ("S", 1_000_000_000),
    ("MS", 1_000_000),
    ("US", 1_000),
    ("NS", 1),
];

/// Maximum number of digits of one part of a time. Reason: no calculation with them exceeds 128 bits.
const TIME_DIGITS_MAX: usize = 18;

/// Returns the nanoseconds of a time without sign and prefix: `1h30m`, `1.5s`, `1s_500ms`.
pub(super) fn time(text: &str) -> Result<i128, LiteralFault> {
    const NO_TIME: LiteralFault = LiteralFault::new(
        "is not a time",
        "write d, h, m, s, ms, us and ns in this order, with a fraction only in the last: T#1h30m, T#1.5s, T#1s500ms",
    );
    let text = text.to_ascii_uppercase();
    let mut rest = text.as_str();
    let (mut total, mut last_unit, mut has_fraction) = (0_i128, None, false);
    while !rest.is_empty() {
        let end = rest
            .find(|letter: char| letter.is_ascii_alphabetic())
            .ok_or(NO_TIME)?;
        let (value, unit_and_rest) = rest.split_at(end);
        let end = unit_and_rest
            .find(|letter: char| !letter.is_ascii_alphabetic())
            .unwrap_or(unit_and_rest.len());
        let (unit, after) = unit_and_rest.split_at(end);
        let place = UNITS.iter().position(|(name, _)| *name == unit).ok_or(NO_TIME)?;
        if has_fraction || last_unit.is_some_and(|last| place <= last) {
            return Err(NO_TIME);
        }
        last_unit = Some(place);
        let (whole, fraction) = value.split_once('.').unwrap_or((value, "0"));
        has_fraction = value.contains('.');
        let (whole, fraction) = (
            digits(whole, 10).ok_or(NO_TIME)?,
            digits(fraction, 10).ok_or(NO_TIME)?,
        );
        if whole.len().max(fraction.len()) > TIME_DIGITS_MAX {
            return Err(NO_TIME);
        }
        let unit_ns = UNITS[place].1;
        let parsed = |digits: &str| digits.parse::<i128>().map_err(|_| NO_TIME);
        let scale: i128 = fraction.chars().fold(1, |scale, _| scale * 10);
        total += parsed(&whole)? * unit_ns + parsed(&fraction)? * unit_ns / scale;
        rest = after
            .strip_prefix('_')
            .filter(|rest| !rest.is_empty())
            .unwrap_or(after);
    }
    if last_unit.is_none() {
        return Err(NO_TIME);
    }
    if total > i64::MAX.into() {
        return Err(LiteralFault::new("is too long", "a TIME is at most 292 years"));
    }
    Ok(total)
}

/// Returns a string with its `$` sequences replaced.
pub(super) fn text(written: &str) -> Result<String, LiteralFault> {
    let mut text = String::with_capacity(written.len());
    let mut letters = written.chars();
    while let Some(letter) = letters.next() {
        if letter != '$' {
            text.push(letter);
            continue;
        }
        let escaped = letters.next().map(|letter| letter.to_ascii_uppercase());
        text.push(match escaped {
            Some('$') => '$',
            Some('\'') => '\'',
            Some('"') => '"',
            Some('L' | 'N') => '\n',
            Some('P') => '\u{c}',
            Some('R') => '\r',
            Some('T') => '\t',
            Some(high) => {
                let low = letters.next().and_then(|low| low.to_digit(16));
                let code = high.to_digit(16).zip(low).map(|(high, low)| high * 16 + low);
                code.and_then(char::from_u32).ok_or(NO_SEQUENCE)?
            }
            None => return Err(NO_SEQUENCE),
        });
    }
    Ok(text)
}

const NO_SEQUENCE: LiteralFault = LiteralFault::new(
    "has an invalid $ sequence",
    "write $$ for $, $' for ', $L, $N, $P, $R, $T, or two hexadecimal digits",
);
