//! Types to which the numbers of M code parameters are converted.

use plc_protocol::alarm::Alarm;
use plc_protocol::types::m_code::{ParamDeclaration, ParamLetter};

use super::{FromOutput, Takes};
use crate::aux_output::AuxOutput;
use crate::plc::Plc;

/// A type to which the number of an M code parameter is converted.
///
/// ```
/// use plc_api::extract::ParamValue;
/// use plc_api::types::m_code::ParamDeclaration;
///
/// /// VA1 means left, VA2 means right.
/// #[derive(Debug, PartialEq)]
/// enum Side { Left, Right }
///
/// impl ParamValue for Side {
///     fn declaration() -> ParamDeclaration {
///         ParamDeclaration { whole: true, ..ParamDeclaration::default().within(Some(1.0), Some(2.0)) }
///     }
///
///     fn from_number(number: Option<f64>) -> Option<Self> {
///         Some(if number? < 2.0 { Side::Left } else { Side::Right })
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no type of a parameter",
    label = "no type of a parameter",
    note = "write `f64`, `u16` or another integer of up to 32 bits, `bool`, a unit such as `KiloNewton<1, 20>`, or an `Option` of one"
)]
pub trait ParamValue: Sized + Send + 'static {
    /// Returns the declaration of the parameter: its unit and its bounds.
    fn declaration() -> ParamDeclaration;

    /// Converts a number that matches the declaration to a value. `number` is `None` if the NC program omits
    /// the parameter. If the result is `None`, the handler is not started, and an alarm names the parameter.
    fn from_number(number: Option<f64>) -> Option<Self>;
}

impl<T: ParamValue> ParamValue for Option<T> {
    fn declaration() -> ParamDeclaration {
        ParamDeclaration {
            optional: true,
            ..T::declaration()
        }
    }

    fn from_number(number: Option<f64>) -> Option<Self> {
        match number {
            None => Some(None),
            number => T::from_number(number).map(Some),
        }
    }
}

impl ParamValue for f64 {
    fn declaration() -> ParamDeclaration {
        ParamDeclaration::default()
    }

    fn from_number(number: Option<f64>) -> Option<Self> {
        number
    }
}

impl ParamValue for bool {
    fn declaration() -> ParamDeclaration {
        ParamDeclaration {
            whole: true,
            ..ParamDeclaration::default().within(Some(0.0), Some(1.0))
        }
    }

    fn from_number(number: Option<f64>) -> Option<Self> {
        number.map(|number| number > 0.5)
    }
}

macro_rules! whole {
    ($($type:ident)*) => {$(
        impl ParamValue for $type {
            fn declaration() -> ParamDeclaration {
                ParamDeclaration {
                    whole: true,
                    ..ParamDeclaration::default().within(Some(f64::from($type::MIN)), Some(f64::from($type::MAX)))
                }
            }

            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the number is tested")]
            fn from_number(number: Option<f64>) -> Option<Self> {
                number.filter(|number| Self::declaration().takes(*number)).map(|number| number.round() as $type)
            }
        }
    )*};
}

whole!(u8 u16 u32 i8 i16 i32);

/// Returns the parameter `letter` of an output, converted to the type `T`.
///
/// # Errors
/// Returns an alarm if `T` does not accept the number, or if `T` requires a number that the NC program omits.
pub fn param<T: ParamValue>(output: &AuxOutput, letter: ParamLetter) -> Result<T, Alarm> {
    let number = letter.value_in(output.params());
    T::from_number(number).ok_or_else(|| {
        let m = output.m();
        let text = match number {
            None => format!("M{m:02} needs {letter}"),
            Some(number) => format!("M{m:02}: {letter} is {number}, which is not allowed"),
        };
        Alarm::user(Alarm::CODE_OF_PARAMS, text)
    })
}

macro_rules! letters {
    ($($name:ident $letter:ident $text:literal;)*) => {$(
        #[doc = concat!($text, " of an output, as an argument of a handler.")]
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub struct $name<T>(pub T);

        impl<T: ParamValue> FromOutput for $name<T> {
            fn takes(takes: &mut Takes) {
                takes.param(ParamLetter::$letter, T::declaration());
            }

            fn from_output(output: &AuxOutput, _plc: &Plc) -> Result<Self, Alarm> {
                param(output, ParamLetter::$letter).map(Self)
            }
        }
    )*};
}

letters! {
    Va A "VA"; Vb B "VB"; Vc C "VC"; Vd D "VD"; Ve E "VE"; Vf F "VF"; Vg G "VG"; Vh H "VH";
}
