//! Checks a program before any motion. Each block is checked in every state in which a run can reach the
//! block.
//!
//! A state consists of the modal state, the programmed point and the values of variables, as far as the text
//! shows them. The checker follows states through branches, loops and calls until it finds no new state
//! ([`explore`]). A fault in all states of a block is an error. A fault in only some of them is a warning
//! that names the path ([`verdict`]).

mod block;
mod codes;
mod explore;
mod expressions;
mod graph;
mod machine;
mod state;
mod structure;
mod verdict;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tandem_model::settings::{CoordinateSystemSettings, NcOptions, Unit};
use tandem_model::{AxisSet, Diagnostic, Severity};
use tandem_syntax::{DIAGNOSTICS_MAX, Grammar, NcProgram, diagnostics, parse};

use crate::dialect::Dialect;
use explore::Explorer;

/// The programs that a call (M98) can find.
pub trait Programs: std::fmt::Debug {
    /// Returns the program with this number, or `None` if it does not exist.
    fn find(&self, number: u16) -> Option<Arc<NcProgram>>;
}

impl Programs for BTreeMap<u16, Arc<NcProgram>> {
    fn find(&self, number: u16) -> Option<Arc<NcProgram>> {
        self.get(&number).cloned()
    }
}

/// Machine data for the checker. If a field is `None`, the checker skips the checks that need this field.
///
/// Build a context with `..CheckContext::default()`, because later versions add fields.
#[derive(Debug, Clone, Copy, Default)]
pub struct CheckContext<'a> {
    /// Axes of the coordinate system.
    pub axes: Option<AxisSet>,
    /// The existing programs. The checker also checks called programs, in the states of their calls.
    pub programs: Option<&'a dyn Programs>,
    /// M codes for which the configuration has settings.
    pub m_codes_with_settings: Option<&'a BTreeSet<u16>>,
    /// Unit of lengths at the start of the program.
    pub unit: Unit,
    /// Maximum feedrate, mm/min; a larger F is clipped with a warning.
    pub max_feedrate_mm_min: Option<f64>,
    /// Feedrate before the first F, mm/min; 0 for no default. If this field is `None`, a missing F is a
    /// warning.
    pub default_feedrate_mm_min: Option<f64>,
    /// True if the coordinate system has a spindle. Without a spindle, fixed cycles output other M codes.
    pub has_spindle: Option<bool>,
    /// Maximum spindle speed, r/min; a larger S is an error.
    pub max_spindle_speed_r_min: Option<f64>,
    /// Amount by which the radius R of an arc may be smaller than half the chord, mm (D26). `None` selects
    /// the default.
    pub arc_radius_tolerance_mm: Option<f64>,
    /// NC options that the dialect leaves to the machine.
    pub options: NcOptions,
    /// True if the program continues manual data input: its initial modal state is not the start-up state.
    pub goes_on: bool,
    /// True for manual data input, whose text does not begin with the mark of the dialect (`%`).
    pub manual: bool,
    /// True to report each fault that would be an alarm in a run as an error. Such faults are wrong
    /// calculated values (D11), a wrong modal state after branches and calls, and a missing feedrate or
    /// spindle speed. If false, these faults are warnings or are not reported.
    pub calculates: bool,
}

impl CheckContext<'_> {
    /// Returns the context given by the settings of a coordinate system.
    pub fn from_settings(settings: &CoordinateSystemSettings) -> Self {
        Self {
            axes: Some(settings.axes()),
            unit: settings.unit,
            max_feedrate_mm_min: Some(settings.max_feedrate_mm_min),
            default_feedrate_mm_min: Some(settings.default_feedrate_mm_min),
            has_spindle: Some(settings.spindle.is_some()),
            max_spindle_speed_r_min: settings.spindle.as_ref().map(|spindle| spindle.max_velocity),
            arc_radius_tolerance_mm: Some(settings.motion.arc_radius_tolerance_mm),
            options: settings.nc,
            ..Self::default()
        }
    }
}

/// Result of checking a program.
///
/// The findings exclude everything that depends on external events and unknown data: resets of M codes,
/// values that sequence programs and operators write, and captured positions. They also exclude machine
/// properties (limits, offsets, tools, drives) that the context does not contain.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Check {
    /// All findings, in the order of the text.
    pub diagnostics: Vec<Diagnostic>,
    /// M codes that the program outputs to the sequence program, ascending and without duplicates.
    pub m_codes: Vec<u16>,
    /// Numbers of the programs that the program calls, ascending and without duplicates.
    pub programs: Vec<u16>,
    /// True if the program has a call whose program number the text does not show.
    pub calls_any: bool,
    /// Results of the programs that are called directly or indirectly, by program number.
    pub called: BTreeMap<u16, Check>,
}

impl Check {
    /// Returns true if the program has an error and therefore cannot run.
    pub fn has_errors(&self) -> bool {
        self.diagnostics.iter().any(Diagnostic::is_error)
    }
}

/// Parses and checks a text. The result lists the findings of the parser and of the checker in the order of
/// the text.
pub fn check_source(
    source: impl Into<Arc<str>>,
    dialect: &'static Dialect,
    context: &CheckContext<'_>,
) -> (NcProgram, Check) {
    let (program, mut findings) = parse(source, (dialect.grammar)());
    let mut check = check(&program, dialect, context);
    findings.append(&mut check.diagnostics);
    findings.sort_by_key(|finding| finding.span.start);
    check.diagnostics = findings;
    (program, check)
}

/// Checks a parsed program. The findings of the parser are not repeated.
pub fn check(program: &NcProgram, dialect: &'static Dialect, context: &CheckContext<'_>) -> Check {
    let mut explorer = Explorer::new(program, dialect, context);
    explorer.explore();
    explorer.finish()
}

/// A list of findings with at most [`DIAGNOSTICS_MAX`] errors and as many warnings.
struct Findings {
    grammar: &'static Grammar,
    list: Vec<Diagnostic>,
    errors: usize,
    warnings: usize,
}

impl Findings {
    fn new(dialect: &Dialect) -> Self {
        Self {
            grammar: (dialect.grammar)(),
            list: Vec::new(),
            errors: 0,
            warnings: 0,
        }
    }

    fn push(&mut self, mut finding: Diagnostic) {
        finding.help = self.grammar.cite(finding.code, std::mem::take(&mut finding.help));
        let (count, last) = match finding.severity {
            Severity::Error => (&mut self.errors, &diagnostics::TOO_MANY),
            Severity::Warning => (&mut self.warnings, &diagnostics::TOO_MANY_WARNINGS),
        };
        *count += 1;
        if *count <= DIAGNOSTICS_MAX {
            self.list.push(finding);
        } else if *count == DIAGNOSTICS_MAX + 1 {
            let message = format!("more than {DIAGNOSTICS_MAX} findings; the rest is not listed");
            self.list.push(last.at(
                finding.span,
                message,
                "Correct the findings above, then check again.",
            ));
        }
    }
}
