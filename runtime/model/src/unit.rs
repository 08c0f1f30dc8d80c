//! The unit of programmed lengths.

/// The unit of programmed lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unit {
    /// Millimetres, G21.
    #[default]
    Millimetre,
    /// Inches, G20.
    Inch,
}

impl Unit {
    /// Returns the length in millimetres of one programmed unit.
    pub const fn mm(self) -> f64 {
        match self {
            Unit::Millimetre => 1.0,
            Unit::Inch => 25.4,
        }
    }
}
