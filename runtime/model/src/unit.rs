//! The unit of programmed lengths.

/// The unit of programmed lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unit {
    /// G21.
    #[default]
    Millimetre,
    /// G20.
    Inch,
}

impl Unit {
    /// Returns the millimetres of a programmed length of 1.
    pub const fn mm(self) -> f64 {
        match self {
            Unit::Millimetre => 1.0,
            Unit::Inch => 25.4,
        }
    }
}
