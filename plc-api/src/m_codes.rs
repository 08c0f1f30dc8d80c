//! The M codes that a sequence program can serve, by number and by name.

use std::ops::{Range, RangeInclusive};

use plc_protocol::types::m_code::{M_CODE_MAX, RUNTIME_M_CODES};

/// Marker of M codes that a program gives by number. Their handlers take an output, or an output and the
/// machine.
#[derive(Debug, Clone, Copy)]
pub struct ByNumber;

/// Marker of M codes that a program gives by name ([`MCode`]). Their handlers take
/// [extractors](crate::extract).
#[derive(Debug, Clone, Copy)]
pub struct ByName;

/// An M code with a name. Alarms, `birth` and panels show the name.
///
/// ```
/// use plc_api::MCode;
///
/// const CLAMP: MCode = MCode::new(12, "clamp");
/// assert_eq!(CLAMP.to_string(), "M12 clamp");
/// ```
///
/// A constant with a number that no handler can serve does not compile:
/// ```compile_fail
/// # use plc_api::MCode;
/// const CLAMP: MCode = MCode::new(192, "clamp");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MCode {
    m: u16,
    name: &'static str,
}

impl MCode {
    /// Creates an M code, 0 to 191, with a name of 1 to 40 characters.
    ///
    /// # Panics
    /// Panics if the number is above 191, or if the runtime handles the M code itself: M00, M01, M02, M30,
    /// M98, M99.
    pub const fn new(m: u16, name: &'static str) -> Self {
        assert!(m <= M_CODE_MAX, "M codes are 0 to 191");
        let mut index = 0;
        while index < RUNTIME_M_CODES.len() {
            assert!(
                RUNTIME_M_CODES[index] != m,
                "the runtime handles M00, M01, M02, M30, M98 and M99 itself"
            );
            index += 1;
        }
        Self { m, name }
    }

    /// Returns the number of the M code.
    pub const fn m(self) -> u16 {
        self.m
    }

    /// Returns the name of the M code.
    pub const fn name(self) -> &'static str {
        self.name
    }
}

impl std::fmt::Display for MCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "M{:02} {}", self.m, self.name)
    }
}

impl From<MCode> for u16 {
    fn from(code: MCode) -> Self {
        code.m
    }
}

/// M codes that a handler serves: one M code, a range, or several M codes.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no M code",
    label = "not an M code",
    note = "write a number such as `12`, a range such as `10..=13`, several such as `[10, 12]`, or a name: `const CLAMP: MCode = MCode::new(12, \"clamp\");`"
)]
pub trait MCodes<By = ByNumber>: Sized {
    /// Returns the M codes as ranges. A sequence program refuses an empty range.
    fn m_codes(self) -> Vec<RangeInclusive<u16>>;

    /// Returns those of the M codes that have a name.
    fn names(&self) -> Vec<MCode> {
        Vec::new()
    }
}

impl MCodes for u16 {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        vec![self..=self]
    }
}

impl MCodes for RangeInclusive<u16> {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        vec![self]
    }
}

impl MCodes for Range<u16> {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        if self.is_empty() {
            return Vec::new();
        }
        vec![self.start..=self.end - 1]
    }
}

impl<const N: usize> MCodes for [u16; N] {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        self.map(|m| m..=m).to_vec()
    }
}

impl MCodes<ByName> for MCode {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        self.m.m_codes()
    }

    fn names(&self) -> Vec<MCode> {
        vec![*self]
    }
}

impl<const N: usize> MCodes<ByName> for [MCode; N] {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        self.map(MCode::m).m_codes()
    }

    fn names(&self) -> Vec<MCode> {
        self.to_vec()
    }
}
