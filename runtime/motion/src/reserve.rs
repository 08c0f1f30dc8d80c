//! The part of the maximum acceleration that the plan leaves free.

/// Share of the maximum acceleration that is left to feed hold and to rounding, so that a hold acts wherever it comes. It
/// costs a thousandth of the time.
pub(crate) const ACCELERATION_RESERVE: f64 = 2e-3;
