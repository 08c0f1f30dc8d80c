//! What is wrong with a program, told before anything moves.

use std::collections::BTreeSet;
use std::sync::Arc;

use tandem_model::limits::PROGRAM_BYTES_MAX;
use tandem_model::{AxisSet, Diagnostic, Severity, Span};
use tandem_syntax::{
    Address, Block, Content, DIAGNOSTICS_MAX, NcProgram, ProgramCode, Word, diagnostics, parse,
};

use crate::block_words::BlockWords;
use crate::codes::{ModalGroup, m_auxiliary::AUXILIARY, m98_call::M98};
use crate::dialects::{self, Dialect};
use crate::execution::axis_of;

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

impl Check {
    /// True when the program cannot run.
    pub fn has_errors(&self) -> bool {
        self.diagnostics.iter().any(Diagnostic::is_error)
    }
}

/// Parses and checks a text of dialect nj; the findings of both come in the order of the text.
pub fn check_source(source: impl Into<Arc<str>>, context: &CheckContext<'_>) -> (NcProgram, Check) {
    let dialect = dialects::nj();
    let (program, mut findings) = parse(source, (dialect.grammar)());
    let mut check = check_dialect(&program, dialect, context);
    findings.append(&mut check.diagnostics);
    findings.sort_by_key(|finding| finding.span.start);
    check.diagnostics = findings;
    (program, check)
}

/// Checks a parsed program of dialect nj. The findings of the parser are not repeated.
pub fn check(program: &NcProgram, context: &CheckContext<'_>) -> Check {
    check_dialect(program, dialects::nj(), context)
}

/// The same for another dialect.
pub fn check_dialect(program: &NcProgram, dialect: &'static Dialect, context: &CheckContext<'_>) -> Check {
    let mut checker = Checker {
        program,
        dialect,
        context,
        findings: Findings::default(),
        m_codes: BTreeSet::new(),
        programs: BTreeSet::new(),
        ending: Ending::Open,
        lenient: false,
        branches: false,
    };
    if program.source().len() <= PROGRAM_BYTES_MAX {
        checker.run();
    }
    let Checker {
        mut findings,
        m_codes,
        programs,
        ..
    } = checker;
    findings.list.sort_by_key(|finding| finding.span.start);
    Check {
        diagnostics: findings.list,
        m_codes: m_codes.into_iter().collect(),
        programs: programs.into_iter().collect(),
    }
}

/// A bounded list of findings.
#[derive(Default)]
struct Findings {
    list: Vec<Diagnostic>,
    errors: usize,
    warnings: usize,
}

impl Findings {
    fn push(&mut self, finding: Diagnostic) {
        let (count, last) = match finding.severity {
            Severity::Error => (&mut self.errors, &diagnostics::TOO_MANY),
            Severity::Warning => (&mut self.warnings, &diagnostics::TOO_MANY_WARNINGS),
        };
        *count += 1;
        if *count <= DIAGNOSTICS_MAX {
            self.list.push(finding);
        } else if *count == DIAGNOSTICS_MAX + 1 {
            let message = format!("more than {DIAGNOSTICS_MAX} findings; the rest is not listed");
            self.list
                .push(last.at(finding.span, message, "Correct those above, then check again."));
        }
    }
}

/// Whether the program has been ended by a block that is never skipped.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// Not so far.
    Open,
    /// It has.
    Ended,
    /// It has, and blocks after it have been warned of.
    Warned,
}

struct Checker<'a> {
    program: &'a NcProgram,
    dialect: &'static Dialect,
    context: &'a CheckContext<'a>,
    findings: Findings,
    m_codes: BTreeSet<u16>,
    programs: BTreeSet<u16>,
    ending: Ending,
    /// A code that is not supported may take words of later blocks.
    lenient: bool,
    /// The program has branches that are not taken apart.
    branches: bool,
}

impl Checker<'_> {
    fn run(&mut self) {
        let mut words = BlockWords::new(self.dialect);
        for block in self.program.blocks() {
            if self.ending == Ending::Ended && !self.branches {
                self.ending = Ending::Warned;
                self.findings.push(diagnostics::UNREACHABLE.at(
                    self.program.span(block),
                    "this block and what follows are never executed",
                    "Remove them, or move the end of the program below them.",
                ));
            }
            match block.content {
                Content::ProgramCode(_) => self.program_code(block),
                Content::Words { .. } => self.block(block, &mut words),
            }
        }
        self.end();
    }

    fn program_code(&mut self, block: &Block) {
        let Some(code) = self.program.program_code(block) else {
            return;
        };
        let (what, span) = match code {
            ProgramCode::Assignment { span, .. } => ("assignments", *span),
            ProgramCode::Control { keyword, span } => {
                self.branches = true;
                let length = u32::try_from(keyword.text().len()).unwrap_or_default();
                (keyword.text(), Span::new(span.start, span.start + length))
            }
        };
        if block.has_errors() {
            return;
        }
        let verb = if what == "assignments" { "are" } else { "is" };
        self.findings.push(diagnostics::PROGRAM_CODE_NOT_SUPPORTED.at(
            span,
            format!("{what} {verb} not supported yet"),
            "Write the blocks with numbers, and call subprograms with M98 and L to repeat.",
        ));
    }

    fn block(&mut self, block: &Block, words: &mut BlockWords) {
        let findings = &mut self.findings;
        words.read(self.program, block, self.dialect, self.lenient, |finding| {
            findings.push(finding);
        });
        if words.has_foreign_motion() {
            self.lenient = true;
        } else if words.g_codes().iter().any(|(code, _)| ends_leniency(code.group)) {
            self.lenient = false;
        }
        if let Some(code) = words.m_code() {
            if *code == AUXILIARY {
                self.auxiliary(block, words.m_number());
            } else if *code == M98 {
                self.call(block, words);
            } else if block.skip_numbers() == 0 && self.ending == Ending::Open && is_end(code.code) {
                self.ending = Ending::Ended;
            }
        }
        self.context_of_words(block, words);
    }

    fn auxiliary(&mut self, block: &Block, number: u16) {
        let first = self.m_codes.insert(number);
        let known = self.context.m_codes_with_settings;
        if first && known.is_some_and(|known| !known.contains(&number)) {
            self.findings.push(diagnostics::M_WITHOUT_SETTINGS.at(
                self.span_of(block, Address::M),
                format!("M{number:02} has no settings"),
                format!("Add [m_code.{number}] to the configuration, or correct the number."),
            ));
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range is tested, and a cast saturates"
    )]
    fn call(&mut self, block: &Block, words: &BlockWords) {
        let Some(number) = words
            .get(Address::P)
            .filter(|number| M98.word(Address::P).is_some_and(|p| p.holds(*number)))
        else {
            return;
        };
        let number = number as u16;
        let first = self.programs.insert(number);
        let missing = self
            .context
            .programs
            .is_some_and(|known| !known.contains(&number));
        let called = words.get(Address::L).is_none_or(|times| times > 0.0);
        if first && missing && called {
            self.findings.push(diagnostics::PROGRAM_MISSING.at(
                self.span_of(block, Address::P),
                format!("program {number} is not there"),
                "Load it before the program starts, or correct the number.",
            ));
        }
    }

    /// Checks words against what is known of the coordinate system.
    fn context_of_words(&mut self, block: &Block, words: &BlockWords) {
        if let Some(axes) = self.context.axes {
            for address in words.axis_words().iter() {
                if axis_of(address).is_some_and(|axis| !axes.contains(axis)) {
                    self.findings.push(diagnostics::AXIS_UNKNOWN.at(
                        self.span_of(block, address),
                        format!("the coordinate system has no axis {}", address.text()),
                        "Remove the word, or assign a motor to the axis.",
                    ));
                }
            }
        }
        let free = |address| words.get(address).filter(|_| !words.own().contains(address));
        if let (Some(feedrate), Some(max)) = (free(Address::F), self.context.max_feedrate_mm_min)
            && feedrate > max
        {
            self.findings.push(diagnostics::FEEDRATE_CLIPPED.at(
                self.span_of(block, Address::F),
                format!("F{feedrate} is above the maximum feedrate of {max} mm/min, which will be used"),
                format!("Write F{max} or less, or raise max_feedrate."),
            ));
        }
        if let (Some(speed), Some(max)) = (free(Address::S), self.context.max_spindle_speed_r_min)
            && speed > max
        {
            self.findings.push(diagnostics::OUT_OF_RANGE.at(
                self.span_of(block, Address::S),
                format!("S{speed} is above the spindle's maximum of {max} r/min"),
                format!("Write S{max} or less."),
            ));
        }
    }

    /// Tells when the program runs past its last block (D06).
    fn end(&mut self) {
        let last = self.program.blocks().last();
        let unclear = self.branches || !self.program.is_complete() || last.is_some_and(Block::has_errors);
        if self.ending != Ending::Open || unclear {
            return;
        }
        let span = last.map_or_else(Span::default, |block| self.program.span(block));
        self.findings.push(diagnostics::END_MISSING.at(
            span,
            "the program goes past this block and has no end",
            "Write M30 in the last block of a main program, M99 in that of a subprogram, without block skip.",
        ));
    }

    fn span_of(&self, block: &Block, address: Address) -> Span {
        self.program
            .words(block)
            .iter()
            .find(|word| word.address == address)
            .map_or_else(|| self.program.span(block), Word::span)
    }
}

/// True for groups whose codes take words from blocks that do not name them.
fn ends_leniency(group: ModalGroup) -> bool {
    matches!(group, ModalGroup::Motion | ModalGroup::FixedCycle)
}

fn is_end(code: &str) -> bool {
    matches!(code, "M02" | "M30" | "M99")
}
