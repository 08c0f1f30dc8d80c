//! Units of parameters, as types with bounds: `KiloNewton<1, 20>` accepts 1 to 20 kN, `KiloNewton` any force.
//!
//! The bounds are whole numbers; for other bounds write a struct with
//! [`#[derive(Params)]`](derive@crate::Params). To define a further unit see [`unit`](crate::unit).

use plc_protocol::types::m_code::ParamDeclaration;

use crate::extract::ParamValue;

/// Returns a bound of a unit, or `None` for the constant that means "no bound".
#[doc(hidden)]
pub const fn bound(bound: i64) -> Option<f64> {
    match bound {
        i64::MIN | i64::MAX => None,
        #[allow(clippy::cast_precision_loss, reason = "bounds are small")]
        bound => Some(bound as f64),
    }
}

/// Defines a type for a further unit of parameters.
///
/// ```
/// plc_api::unit!(
///     /// A flow.
///     pub struct LitrePerMinute, "l/min"
/// );
///
/// let flow = LitrePerMinute::<0, 40>(12.5);
/// assert_eq!(flow.to_string(), "12.5 l/min");
/// ```
#[macro_export]
macro_rules! unit {
    ($(#[$doc:meta])* $pub:vis struct $name:ident, $unit:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
        $pub struct $name<const MIN: i64 = { i64::MIN }, const MAX: i64 = { i64::MAX }>(pub f64);

        impl<const MIN: i64, const MAX: i64> $crate::extract::ParamValue for $name<MIN, MAX> {
            fn declaration() -> $crate::types::m_code::ParamDeclaration {
                let declaration = $crate::types::m_code::ParamDeclaration::in_unit($unit);
                declaration.within($crate::units::bound(MIN), $crate::units::bound(MAX))
            }

            fn from_number(number: Option<f64>) -> Option<Self> {
                number.map(Self)
            }
        }

        impl<const MIN: i64, const MAX: i64> std::fmt::Display for $name<MIN, MAX> {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, "{} {}", self.0, $unit)
            }
        }
    };
}

unit!(
    /// A force, kN.
    pub struct KiloNewton, "kN"
);
unit!(
    /// A force, N.
    pub struct Newton, "N"
);
unit!(
    /// A torque, Nm.
    pub struct NewtonMetre, "Nm"
);
unit!(
    /// A pressure, bar.
    pub struct Bar, "bar"
);
unit!(
    /// A length, mm.
    pub struct Millimetre, "mm"
);
unit!(
    /// An angle, deg.
    pub struct Degree, "deg"
);
unit!(
    /// A time, s.
    pub struct Second, "s"
);
unit!(
    /// A time, ms.
    pub struct Millisecond, "ms"
);
unit!(
    /// A rotational speed, r/min.
    pub struct RevolutionPerMinute, "r/min"
);
unit!(
    /// A temperature, °C.
    pub struct Celsius, "°C"
);
unit!(
    /// A percentage, %.
    pub struct Percent, "%"
);

/// A number without a unit.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Number<const MIN: i64 = { i64::MIN }, const MAX: i64 = { i64::MAX }>(pub f64);

/// A whole number without a unit, such as a tool or a pocket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Whole<const MIN: i64 = { i64::MIN }, const MAX: i64 = { i64::MAX }>(pub i64);

impl<const MIN: i64, const MAX: i64> ParamValue for Number<MIN, MAX> {
    fn declaration() -> ParamDeclaration {
        ParamDeclaration::default().within(bound(MIN), bound(MAX))
    }

    fn from_number(number: Option<f64>) -> Option<Self> {
        number.map(Self)
    }
}

impl<const MIN: i64, const MAX: i64> std::fmt::Display for Number<MIN, MAX> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl<const MIN: i64, const MAX: i64> ParamValue for Whole<MIN, MAX> {
    fn declaration() -> ParamDeclaration {
        ParamDeclaration {
            whole: true,
            ..ParamDeclaration::default().within(bound(MIN), bound(MAX))
        }
    }

    #[allow(clippy::cast_possible_truncation, reason = "the number is whole")]
    fn from_number(number: Option<f64>) -> Option<Self> {
        number.map(|number| Self(number.round() as i64))
    }
}

impl<const MIN: i64, const MAX: i64> std::fmt::Display for Whole<MIN, MAX> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}
