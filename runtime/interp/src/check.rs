//! What is wrong with a program, told before anything moves.

use std::collections::BTreeSet;

use tandem_model::{AxisSet, Diagnostic};
use tandem_syntax::NcProgram;

/// What the checker may know of the machine; what is `None` is not checked.
///
/// Build it with `..CheckContext::default()`: fields come with the language.
#[derive(Debug, Clone, Copy, Default)]
pub struct CheckContext<'a> {
    /// The axes of the coordinate system.
    pub axes: Option<AxisSet>,
    /// The programs that exist.
    pub programs: Option<&'a BTreeSet<u16>>,
    /// M codes that have settings.
    pub m_codes_with_settings: Option<&'a BTreeSet<u16>>,
    /// F above it is clipped with a warning, mm/min.
    pub max_feedrate_mm_min: Option<f64>,
    /// S above it is an error, r/min.
    pub max_spindle_speed_r_min: Option<f64>,
}

/// What checking a program gives.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Check {
    /// All findings in the order of the text.
    pub diagnostics: Vec<Diagnostic>,
    /// M codes that are output to the sequence program, ascending, each once.
    pub m_codes: Vec<u16>,
    /// Programs that it calls, ascending, each once.
    pub programs: Vec<u16>,
}

/// Checks a parsed program. The findings of the parser are not repeated.
pub fn check(program: &NcProgram, context: &CheckContext<'_>) -> Check {
    let _ = (program, context);
    Check::default()
}
