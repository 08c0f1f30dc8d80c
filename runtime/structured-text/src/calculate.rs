//! Operators: IEC 61131-3, operators of the ST language.

use std::cmp::Ordering;

use crate::functions::{order, power};
use crate::tree::Binary;
use crate::types::Elementary;
use crate::value::{Fault, Value, int_of, real_of};

/// Returns the result of an operator, except a comparison, on two values of one type.
///
/// # Errors
/// Fails if the operator has no result, or the result does not fit the type.
pub(crate) fn calculate(
    operator: Binary,
    of: Elementary,
    left: &Value,
    right: &Value,
) -> Result<Value, Fault> {
    match operator {
        Binary::And | Binary::Or | Binary::Xor => return Ok(logic(operator, of, left, right)),
        Binary::Power => return power(left.real(), right.real(), of),
        _ => {}
    }
    if of.is_real() {
        let (left, right) = (left.real(), right.real());
        let value = match operator {
            Binary::Add => left + right,
            Binary::Subtract => left - right,
            Binary::Multiply => left * right,
            _ if right == 0.0 => return Err(Fault::DivisionByZero),
            _ => left / right,
        };
        return real_of(value, of, operator.text());
    }
    let (left, right) = (left.int(), right.int());
    // 64 bits by 64 bits are less than 128
    let value = match operator {
        Binary::Add => left + right,
        Binary::Subtract => left - right,
        Binary::Multiply => left.checked_mul(right).unwrap_or(i128::MAX),
        // the standard: IN1 MOD 0 is 0
        Binary::Modulo if right == 0 => 0,
        Binary::Modulo => left % right,
        _ if right == 0 => return Err(Fault::DivisionByZero),
        _ => left / right,
    };
    int_of(value, of)
}

fn logic(operator: Binary, of: Elementary, left: &Value, right: &Value) -> Value {
    let (left, right) = (left.int(), right.int());
    let value = match operator {
        Binary::And => left & right,
        Binary::Or => left | right,
        _ => left ^ right,
    };
    if of == Elementary::Bool {
        Value::Bool(value != 0)
    } else {
        Value::Int(value)
    }
}

/// Compares two values of one type.
pub(crate) fn compare(operator: Binary, left: &Value, right: &Value) -> Value {
    let order = order(left, right);
    Value::Bool(match operator {
        Binary::Less => order == Ordering::Less,
        Binary::Greater => order == Ordering::Greater,
        Binary::LessOrEqual => order != Ordering::Greater,
        Binary::GreaterOrEqual => order != Ordering::Less,
        Binary::NotEqual => order != Ordering::Equal,
        _ => order == Ordering::Equal,
    })
}

pub(crate) fn not(value: &Value, of: Elementary) -> Value {
    if of == Elementary::Bool {
        return Value::Bool(!value.bool());
    }
    Value::Int(!value.int() & ((1_i128 << of.bits()) - 1))
}

/// Returns the negative value.
///
/// # Errors
/// Fails if the result does not fit the type.
pub(crate) fn minus(value: &Value, of: Elementary) -> Result<Value, Fault> {
    match value {
        Value::Real(value) => Ok(Value::Real(-value)),
        value => int_of(-value.int(), of),
    }
}

/// Multiplies or divides a time by a number: `TIME * ANY_NUM` and `TIME / ANY_NUM`.
///
/// # Errors
/// Fails if the operator has no result, or the result is not a time.
pub(crate) fn scale_time(operator: Binary, time: &Value, by: &Value) -> Result<Value, Fault> {
    let (ns, is_product) = (time.int(), operator == Binary::Multiply);
    if let Value::Real(by) = by {
        if !is_product && *by == 0.0 {
            return Err(Fault::DivisionByZero);
        }
        let ns = Value::Int(ns).real();
        let scaled = if is_product { ns * by } else { ns / by };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "it saturates, and the range is checked"
        )]
        return int_of(scaled.round_ties_even() as i128, Elementary::Time);
    }
    let by = by.int();
    if is_product {
        int_of(ns * by, Elementary::Time)
    } else if by == 0 {
        Err(Fault::DivisionByZero)
    } else {
        int_of(ns / by, Elementary::Time)
    }
}
