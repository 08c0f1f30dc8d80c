//! Evaluation of the operators and functions of the NC language (manual 4-1; D07 to D10).

use tandem_syntax::{Function, Operator};

/// Returns the result of an arithmetic operator, or NaN if `operator` is not arithmetic.
pub(crate) fn binary(operator: Operator, left: f64, right: f64) -> f64 {
    match operator {
        Operator::Add => left + right,
        Operator::Subtract => left - right,
        Operator::Multiply => left * right,
        Operator::Divide => left / right,
        Operator::Modulo => left % right,
        // an operator of conditions; the parser rejects a condition that is used as a number
        _ => f64::NAN,
    }
}

/// Returns the result of a comparison, or `None` if `operator` does not compare.
#[expect(clippy::float_cmp, reason = "the language compares exactly")]
pub(crate) fn compare(operator: Operator, left: f64, right: f64) -> Option<bool> {
    Some(match operator {
        Operator::Equal => left == right,
        Operator::NotEqual => left != right,
        Operator::Less => left < right,
        Operator::Greater => left > right,
        Operator::LessOrEqual => left <= right,
        Operator::GreaterOrEqual => left >= right,
        _ => return None,
    })
}

/// Returns the `case` label that a `switch` selects: `value` truncated toward zero (D10). Returns `None` if
/// `value` is NaN or its magnitude exceeds 2^53.
#[expect(clippy::cast_possible_truncation, reason = "the range is tested")]
pub(crate) fn label(value: f64) -> Option<i64> {
    const LARGEST: f64 = 9_007_199_254_740_992.0;
    (value.abs() <= LARGEST).then_some(value as i64)
}

/// Returns the value of a function. Outside the domain of the function (manual 4-1-3), the value is NaN;
/// log(0) is minus infinity.
pub(crate) fn call(function: Function, x: f64, y: f64) -> f64 {
    match function {
        Function::Abs => x.abs(),
        Function::Acos => x.acos(),
        Function::Acosd => x.acos().to_degrees(),
        Function::Acosh => x.acosh(),
        Function::Asin => x.asin(),
        Function::Asind => x.asin().to_degrees(),
        Function::Asinh => x.asinh(),
        Function::Atan => x.atan(),
        Function::Atan2 => arc_tangent(x, y),
        Function::Atan2d => arc_tangent(x, y).to_degrees(),
        Function::Atand => x.atan().to_degrees(),
        Function::Atanh => x.atanh(),
        Function::Cbrt => x.cbrt(),
        Function::Ceil => x.ceil(),
        Function::Cos => x.cos(),
        Function::Cosd => sine_of_degrees(x + 90.0, x.to_radians().cos()),
        Function::Cosh => x.cosh(),
        Function::Exp => x.exp(),
        Function::Exp2 => x.exp2(),
        Function::Floor | Function::Int => x.floor(),
        Function::Isnan => f64::from(u8::from(x.is_nan())),
        Function::Log => x.ln(),
        Function::Log10 => x.log10(),
        Function::Log2 => x.log2(),
        Function::Pow => x.powf(y),
        Function::Qnrt => x.abs().powf(0.2).copysign(x),
        Function::Qrrt => x.sqrt().sqrt(),
        Function::Rint => x.round_ties_even(),
        Function::Sin => x.sin(),
        Function::Sind => sine_of_degrees(x, x.to_radians().sin()),
        Function::Sinh => x.sinh(),
        Function::Sgn => sign(x),
        Function::Sqrt => x.sqrt(),
        Function::Tan => x.tan(),
        Function::Tand => tangent_of_degrees(x),
        Function::Tanh => x.tanh(),
    }
}

/// Returns the sine of an angle in degrees: exact at multiples of 90 degrees, `otherwise` at all other
/// angles.
fn sine_of_degrees(degrees: f64, otherwise: f64) -> f64 {
    let turn = degrees.rem_euclid(360.0);
    if turn.rem_euclid(180.0).abs() <= 0.0 {
        0.0
    } else if (turn - 90.0).abs() <= 0.0 {
        1.0
    } else if (turn - 270.0).abs() <= 0.0 {
        -1.0
    } else {
        otherwise
    }
}

/// Returns the tangent of an angle in degrees: exactly 0 at multiples of 180 degrees, and NaN at odd
/// multiples of 90 degrees, which are outside the domain.
fn tangent_of_degrees(degrees: f64) -> f64 {
    let half_turn = degrees.rem_euclid(180.0);
    if half_turn.abs() <= 0.0 {
        0.0
    } else if (half_turn - 90.0).abs() <= 0.0 {
        f64::NAN
    } else {
        degrees.to_radians().tan()
    }
}

/// Returns the angle of the point (x, y) in radians, or NaN if both are zero, which is outside the domain of
/// `atan2(y, x)`.
fn arc_tangent(y: f64, x: f64) -> f64 {
    if x.abs() <= 0.0 && y.abs() <= 0.0 {
        f64::NAN
    } else {
        y.atan2(x)
    }
}

/// Returns the sign of `x`: -1, 0 or 1 (D08); NaN for NaN.
fn sign(x: f64) -> f64 {
    if x.abs() > 0.0 { x.signum() } else { x.abs() }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;

    fn close(function: Function, arguments: (f64, f64), expected: f64) {
        let value = call(function, arguments.0, arguments.1);
        assert!(
            (value - expected).abs() < 1e-12,
            "{function:?} {arguments:?} = {value}"
        );
    }

    #[test]
    fn functions_have_their_degree_and_radian_forms() {
        use Function as F;
        for (function, x, expected) in [
            (F::Abs, -2.5, 2.5),
            (F::Acos, -1.0, PI),
            (F::Acosd, 0.5, 60.0),
            (F::Acosh, 1.0_f64.cosh(), 1.0),
            (F::Asin, 1.0, FRAC_PI_2),
            (F::Asind, -0.5, -30.0),
            (F::Asinh, 1.0_f64.sinh(), 1.0),
            (F::Atan, 1.0, PI / 4.0),
            (F::Atand, 1.0, 45.0),
            (F::Atanh, 0.5_f64.tanh(), 0.5),
            (F::Cbrt, -27.0, -3.0),
            (F::Ceil, -1.5, -1.0),
            (F::Cos, PI, -1.0),
            (F::Cosd, 60.0, 0.5),
            (F::Exp, 1.0, std::f64::consts::E),
            (F::Exp2, -2.0, 0.25),
            (F::Log, std::f64::consts::E, 1.0),
            (F::Log10, 1000.0, 3.0),
            (F::Log2, 8.0, 3.0),
            (F::Qnrt, -32.0, -2.0),
            (F::Qrrt, 81.0, 3.0),
            (F::Sin, FRAC_PI_2, 1.0),
            (F::Sind, 30.0, 0.5),
            (F::Sqrt, 2.25, 1.5),
            (F::Tan, PI / 4.0, 1.0),
            (F::Tand, 45.0, 1.0),
            (F::Cosh, 0.0, 1.0),
            (F::Sinh, 0.0, 0.0),
            (F::Tanh, 0.0, 0.0),
        ] {
            close(function, (x, f64::NAN), expected);
        }
        close(F::Atan2, (-1.0, 0.0), -FRAC_PI_2);
        close(F::Atan2d, (1.0, -1.0), 135.0);
        close(F::Pow, (2.0, 10.0), 1024.0);
    }

    #[test]
    fn degrees_are_exact_at_quarter_turns() {
        for (function, x, expected) in [
            (Function::Sind, 180.0, 0.0),
            (Function::Sind, -90.0, -1.0),
            (Function::Cosd, 90.0, 0.0),
            (Function::Cosd, 180.0, -1.0),
            (Function::Tand, 180.0, 0.0),
        ] {
            assert!(
                (call(function, x, 0.0) - expected).abs() <= 0.0,
                "{function:?} {x}"
            );
        }
    }

    #[test]
    fn outside_its_domain_a_function_is_not_a_number() {
        for (function, x, y) in [
            (Function::Acos, 1.5, 0.0),
            (Function::Asind, -1.5, 0.0),
            (Function::Acosh, 0.5, 0.0),
            (Function::Atanh, 1.5, 0.0),
            (Function::Atan2, 0.0, 0.0),
            (Function::Atan2d, 0.0, 0.0),
            (Function::Log, -1.0, 0.0),
            (Function::Qrrt, -1.0, 0.0),
            (Function::Sqrt, -1.0, 0.0),
            (Function::Tand, 90.0, 0.0),
        ] {
            assert!(call(function, x, y).is_nan(), "{function:?} {x}");
        }
    }

    #[test]
    fn d08_rounding_and_sign() {
        for (function, x, expected) in [
            (Function::Int, -1.5, -2.0),
            (Function::Floor, 1.5, 1.0),
            (Function::Rint, 2.5, 2.0),
            (Function::Rint, 3.5, 4.0),
            (Function::Sgn, 0.0, 0.0),
            (Function::Sgn, -0.1, -1.0),
            (Function::Sgn, 7.0, 1.0),
            (Function::Isnan, f64::NAN, 1.0),
            (Function::Isnan, f64::INFINITY, 0.0),
        ] {
            assert!(
                (call(function, x, 0.0) - expected).abs() <= 0.0,
                "{function:?} {x}"
            );
        }
    }

    #[test]
    fn d10_a_switch_truncates_toward_zero() {
        assert_eq!(label(-1.9), Some(-1));
        assert_eq!(label(2.9), Some(2));
        assert_eq!(label(f64::NAN), None);
        assert_eq!(label(1e300), None);
    }
}
