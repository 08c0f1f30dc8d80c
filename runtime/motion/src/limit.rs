//! Limits of motors.

use std::fmt::Display;

use tandem_model::alarm::LIMIT_ZERO;
use tandem_model::{Alarm, Axis};

/// Share of the maximum acceleration that is reserved for feed hold and rounding, so that a feed hold can act
/// at any time. The reserve increases the motion time by a thousandth.
pub(crate) const ACCELERATION_RESERVE: f64 = 2e-3;

/// Part of the limits that a plan within the jerk uses, apart from the reserves; the rest covers deviations between the points
/// at which it keeps them.
pub(crate) const USED_WITHIN_JERK: f64 = 0.997;

/// Returns a limit of the motor of an axis.
///
/// # Errors
/// Returns `LIMIT_ZERO` if the limit is not a number above zero.
pub(crate) fn check_axis_limit(axis: Axis, name: &str, limit: f64) -> Result<f64, Alarm> {
    check_limit(format_args!("axis {}", axis.letter()), name, limit)
}

/// Returns a limit of a motor.
///
/// # Errors
/// Returns `LIMIT_ZERO` if the limit is not a number above zero.
pub(crate) fn check_limit(motor: impl Display, name: &str, limit: f64) -> Result<f64, Alarm> {
    if is_valid(limit) {
        return Ok(limit);
    }
    let text = format!("{name} of {motor} is {limit}");
    Err(Alarm::new(&LIMIT_ZERO, text))
}

/// Returns true for a finite number above zero.
pub(crate) fn is_valid(limit: f64) -> bool {
    limit > 0.0 && limit.is_finite()
}
