//! Limits of numbers in the configuration.

/// Minimum of rates and of the position window. Reason: with smaller values no axis would move.
pub(crate) const RATE_MIN: f64 = 1e-9;

/// Maximum velocity, acceleration and jerk, units per s, s² and s³. Reason: their squares are still finite.
pub(crate) const RATE_MAX: f64 = 1e12;

/// Maximum position, length or offset, units. Reason: above it, a 64-bit number has no digits left for the
/// path.
pub(crate) const POSITION_MAX: f64 = 1e9;

/// Maximum time, ms (one day).
pub(crate) const TIME_MAX_MS: f64 = 86_400_000.0;
