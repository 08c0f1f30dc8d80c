//! Checks a program before anything moves.

use std::collections::BTreeSet;
use std::sync::Arc;

use tandem_model::limits::{BLOCK_BYTES_MAX, PROGRAM_BYTES_MAX};
use tandem_model::settings::{
    ARC_RADIUS_TOLERANCE_MM, CompensationRules, CoordinateSystemSettings, NcOptions, Unit,
};
use tandem_model::{AxisSet, Diagnostic, Severity, Span};
use tandem_syntax::{
    Address, AddressSet, Block, Content, DIAGNOSTICS_MAX, Grammar, NcProgram, ProgramCode, Statement, Word,
    block_bytes, diagnostics, parse,
};

use crate::block_words::{BlockWords, Reading};
use crate::codes::{Code, ModalGroup, tenths};
use crate::dialect::{Dialect, OtherMCodes, SpindleWord};
use crate::execution::axis_of;
use crate::meaning::{ModalValue, Role};
use crate::modal::Modal;
use crate::restrictions;
use crate::text_position::TextPosition;

/// A shorter block cannot be too long in the intermediate code: there each word of two bytes or more has a blank, and
/// numbers and operators of expressions have two.
const LONG_BYTES: u32 = 300;

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
    /// The unit in force at the head of the program.
    pub unit: Unit,
    /// F above it is clipped with a warning, mm/min.
    pub max_feedrate_mm_min: Option<f64>,
    /// Whether the coordinate system has a spindle: fixed cycles put out other M codes without one.
    pub has_spindle: Option<bool>,
    /// S above it is an error, r/min.
    pub max_spindle_speed_r_min: Option<f64>,
    /// A radius may be smaller than half the chord by so much, mm (D26); `None`: the usual one.
    pub arc_radius_tolerance_mm: Option<f64>,
    /// What the dialect leaves to the machine.
    pub options: NcOptions,
    /// What is in force at the head is not that of the start-up: manual data input that goes on.
    pub goes_on: bool,
    /// Manual data input, which has no marks around it.
    pub manual: bool,
}

impl CheckContext<'_> {
    /// What the settings of a coordinate system tell.
    pub fn of(settings: &CoordinateSystemSettings) -> Self {
        Self {
            axes: Some(settings.axes()),
            unit: settings.unit,
            max_feedrate_mm_min: Some(settings.max_feedrate_mm_min),
            has_spindle: Some(settings.spindle.is_some()),
            max_spindle_speed_r_min: settings.spindle.as_ref().map(|spindle| spindle.max_velocity),
            arc_radius_tolerance_mm: Some(settings.motion.arc_radius_tolerance_mm),
            options: settings.nc,
            ..Self::default()
        }
    }
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

/// Parses and checks a text; the findings of both come in the order of the text.
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
    let mut checker = Checker {
        program,
        dialect,
        context,
        findings: Findings {
            grammar: (dialect.grammar)(),
            list: Vec::new(),
            errors: 0,
            warnings: 0,
        },
        m_codes: BTreeSet::new(),
        programs: BTreeSet::new(),
        ending: Ending::Open,
        modal: Modal::of_text(dialect, context.unit),
        position: TextPosition::unknown(),
        branches: false,
        at_rest: 0,
    };
    if context.goes_on {
        checker.modal.forget();
    }
    if !context.manual {
        checker.mark();
    }
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
struct Findings {
    grammar: &'static Grammar,
    list: Vec<Diagnostic>,
    errors: usize,
    warnings: usize,
}

impl Findings {
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
    /// What is in force as far as the text shows.
    modal: Modal,
    /// Where the programmed point is as far as the text shows.
    position: TextPosition,
    /// The program has branches: which blocks are executed is not known.
    branches: bool,
    /// Blocks in a row that do not move in the plane of cutter compensation.
    at_rest: u32,
}

impl Checker<'_> {
    fn run(&mut self) {
        let mut words = BlockWords::new(self.dialect);
        if may_be_called(self.program, self.dialect) {
            self.forget();
        }
        let joins = joins(self.program);
        let mut joins = joins.iter().copied().peekable();
        for (index, block) in self.program.blocks().iter().enumerate() {
            if joins.next_if_eq(&index).is_some() {
                self.forget();
            }
            if self.ending == Ending::Ended && !self.branches {
                self.ending = Ending::Warned;
                self.findings.push(diagnostics::UNREACHABLE.at(
                    self.program.span(block),
                    "this block and what follows are never executed",
                    "Remove them, or move the end of the program below them.",
                ));
            }
            self.length(block);
            match block.content {
                Content::ProgramCode(_) => self.program_code(block),
                Content::Words { .. } => self.block(block, &mut words),
            }
        }
        self.end();
    }

    /// Tells when the program does not begin with the mark of the dialect (manual dgshape, 1-1).
    fn mark(&mut self) {
        let mark = (self.dialect.grammar)().program_form.mark.map(char::from);
        if let Some(mark) = mark.filter(|_| !self.program.is_marked()) {
            self.findings.push(diagnostics::MARK_MISSING.at(
                Span::default(),
                format!("the program does not begin with {mark}, and is not executed"),
                format!("Write a line of {mark} alone before it."),
            ));
        }
    }

    /// Tells when the block's line in the intermediate code is too long (D03).
    fn length(&mut self, block: &Block) {
        let span = self.program.span(block);
        if span.end - span.start <= LONG_BYTES || block.has_errors() {
            return;
        }
        let cycle = self.modal.fixed_cycle();
        let code = cycle.and_then(|_| self.modal.code(ModalGroup::FixedCycle));
        let code = code.map(|code| code.code);
        if block_bytes(self.program, block, code, self.dialect) > BLOCK_BYTES_MAX {
            self.findings.push(diagnostics::BLOCK_TOO_LONG.at(
                span,
                format!("the block's line in the intermediate code is longer than {BLOCK_BYTES_MAX} bytes"),
                "Write the words in several blocks.",
            ));
        }
    }

    fn program_code(&mut self, block: &Block) {
        let statement = self.program.program_code(block).map(|code| code.statement);
        if !matches!(statement, Some(Statement::Assignment { .. })) {
            self.branches = true;
        }
    }

    /// Lets go what is in force and where the tool is: the text alone does not show it from here on.
    fn forget(&mut self) {
        self.modal.forget();
        self.position = TextPosition::unknown();
    }

    fn block(&mut self, block: &Block, words: &mut BlockWords) {
        let reading = Reading {
            dialect: self.dialect,
            modal: &self.modal,
            scope: None,
            position: &self.position,
            arc_radius_tolerance_mm: self
                .context
                .arc_radius_tolerance_mm
                .unwrap_or(ARC_RADIUS_TOLERANCE_MM),
            options: &self.context.options,
        };
        let findings = &mut self.findings;
        words.read(self.program, block, &reading, &mut |finding| {
            findings.push(finding);
        });
        self.follow(block, words);
        self.rest_in_offset(block, words);
        if let Some(code) = words.m_code() {
            match code.role {
                Role::Auxiliary => self.auxiliary(block, words.m_number(), *code == *self.dialect.auxiliary),
                Role::Call => self.call(block, words, code),
                _ if block.skip_numbers() == 0 && self.ending == Ending::Open && code.ends() => {
                    self.ending = Ending::Ended;
                }
                _ => {}
            }
        }
        self.cycle_outputs(block, words);
        self.context_of_words(block, words);
    }

    /// Warns of two blocks in a row that do not move in the plane, in tool-diameter offset whose overcuts nobody looks for.
    fn rest_in_offset(&mut self, block: &Block, words: &BlockWords) {
        let unchecked = self.dialect.path.compensation == CompensationRules::Unchecked;
        let within = unchecked && self.modal.compensates() && !self.modal.lead_pending;
        let moves = restrictions::moves_in_plane(words, &self.modal);
        self.at_rest = if within && !moves { self.at_rest + 1 } else { 0 };
        if self.at_rest == 2 {
            self.findings.push(diagnostics::BLOCKS_AT_REST.at(
                self.program.span(block),
                "the second block in a row without a motion along X or Y in tool-diameter offset",
                "Write one of them elsewhere.",
            ));
        }
    }

    /// Notes the M codes that a fixed cycle puts out.
    fn cycle_outputs(&mut self, block: &Block, words: &BlockWords) {
        let Some(taker) = words.taker else { return };
        let Some(ModalValue::Cycle(Some(cycle))) = taker.sets else {
            return;
        };
        let starts = words.codes().any(|code| code == taker);
        if starts || !words.taken.is_empty() {
            for m in cycle.outputs(self.context.has_spindle) {
                self.auxiliary(block, m, true);
            }
        }
    }

    /// Follows what is in force: a skipped block and a subprogram leave open what follows.
    fn follow(&mut self, block: &Block, words: &BlockWords) {
        restrictions::follow(words, &mut self.modal);
        for code in words.codes() {
            match code.group {
                ModalGroup::NonModal => {}
                ModalGroup::Motion if code.motion.is_some() => {
                    self.modal.end_cycle(self.dialect);
                    self.modal.remember(code);
                }
                _ => self.modal.remember(code),
            }
        }
        self.position.follow(words, &self.modal);
        let may_be_skipped = block.skip_numbers() != 0;
        if may_be_skipped {
            self.position.lose(words.axis_words);
        }
        let leaves_open = may_be_skipped && !words.g_codes().is_empty();
        if leaves_open || block.has_errors() || words.m_code().is_some_and(|code| code.role == Role::Call) {
            self.forget();
        }
    }

    fn auxiliary(&mut self, block: &Block, number: u16, needs_settings: bool) {
        let first = self.m_codes.insert(number);
        let known = self.context.m_codes_with_settings;
        let warns = self.dialect.policy.other_m_codes == OtherMCodes::Output;
        if first && needs_settings && warns && known.is_some_and(|known| !known.contains(&number)) {
            self.findings.push(diagnostics::M_WITHOUT_SETTINGS.at(
                self.program.span_of(block, Address::M),
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
    fn call(&mut self, block: &Block, words: &BlockWords, code: &Code) {
        let Some(number) = words
            .get(Address::P)
            .filter(|number| code.word(Address::P).is_some_and(|p| p.holds(*number)))
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
                self.program.span_of(block, Address::P),
                format!("program {number} is not there"),
                "Load it before the program starts, or correct the number.",
            ));
        }
    }

    /// Checks words against what is known of the coordinate system.
    fn context_of_words(&mut self, block: &Block, words: &BlockWords) {
        if let Some(axes) = self.context.axes {
            let dwells = words.codes().any(|code| code.role == Role::Dwell);
            let own = if dwells {
                AddressSet::EMPTY
            } else {
                words.own.intersection(words.present)
            };
            for address in words.axis_words.union(own).iter() {
                if axis_of(address).is_some_and(|axis| !axes.contains(axis)) {
                    self.findings.push(diagnostics::AXIS_UNKNOWN.at(
                        self.program.span_of(block, address),
                        format!("the coordinate system has no axis {}", address.text()),
                        "Remove the word, or assign a motor to the axis.",
                    ));
                }
            }
        }
        let free = |address| words.get(address).filter(|_| !words.own.contains(address));
        if let (Some(feedrate), Some(max)) = (free(Address::F), self.context.max_feedrate_mm_min)
            && feedrate * self.modal.unit() > max
        {
            self.findings.push(diagnostics::FEEDRATE_CLIPPED.at(
                self.program.span_of(block, Address::F),
                format!("F{feedrate} is above the maximum feedrate of {max} mm/min, which will be used"),
                format!(
                    "Write F{} or less, or raise max_feedrate.",
                    max / self.modal.unit()
                ),
            ));
        }
        let is_bounded = self.dialect.policy.spindle_word == SpindleWord::Speed;
        if let (Some(speed), Some(max)) = (free(Address::S), self.context.max_spindle_speed_r_min)
            && is_bounded
            && speed > max
        {
            self.findings.push(diagnostics::OUT_OF_RANGE.at(
                self.program.span_of(block, Address::S),
                format!("S{speed} is above the spindle's maximum of {max} r/min"),
                format!("Write S{max} or less."),
            ));
        }
    }

    /// Tells when the program runs past its last block (D06), and with branches which blocks are never executed.
    fn end(&mut self) {
        let blocks = self.program.blocks();
        let last = blocks.last();
        let unclear = !self.program.is_complete() || last.is_some_and(Block::has_errors);
        if unclear || (self.ending != Ending::Open && !self.branches) {
            return;
        }
        if self.branches {
            let reached = reachable(self.program, self.dialect);
            let dead = blocks
                .iter()
                .zip(&reached)
                .find(|(block, reached)| !**reached && !is_mark(self.program, block));
            if let Some((block, _)) = dead
                && self.ending != Ending::Warned
            {
                self.findings.push(diagnostics::UNREACHABLE.at(
                    self.program.span(block),
                    "this block is never executed",
                    "Remove it, or move the end of the program below it.",
                ));
            }
            if !reached.last().is_some_and(|past_the_end| *past_the_end) {
                return;
            }
        }
        let span = last.map_or_else(Span::default, |block| self.program.span(block));
        let name = |role| self.dialect.m_code(role).map_or("", |code| code.code);
        let (end, back) = (name(Role::End), name(Role::Return));
        self.findings.push(diagnostics::END_MISSING.at(
            span,
            "the program goes past this block and has no end",
            format!("Write {end} in the last block of a main program, {back} in that of a subprogram, without block skip."),
        ));
    }
}

/// Which blocks a run may come to, whatever conditions say; the last entry is the place past the last block.
fn reachable(program: &NcProgram, dialect: &Dialect) -> Vec<bool> {
    let blocks = program.blocks();
    let mut reached = vec![false; blocks.len() + 1];
    let mut open = vec![0];
    while let Some(at) = open.pop() {
        let Some(seen) = reached.get_mut(at) else { continue };
        if std::mem::replace(seen, true) {
            continue;
        }
        let Some(block) = blocks.get(at) else { continue };
        let code = program.program_code(block);
        open.extend(code.iter().flat_map(|code| targets(program, code)));
        let goes_on = match code.map(|code| code.statement) {
            Some(Statement::Else | Statement::Break | Statement::Repeat | Statement::Switch { .. }) => false,
            Some(_) => true,
            None => !ends(program, block, dialect),
        };
        if goes_on {
            open.push(at + 1);
        }
    }
    reached
}

/// The blocks that a program code may jump to.
fn targets(program: &NcProgram, code: &ProgramCode) -> impl Iterator<Item = usize> {
    let cases = match code.statement {
        Statement::Switch { first, count } => Some(program.case_blocks(first, count)),
        _ => None,
    };
    let blocks = code.to.into_iter().chain(cases.into_iter().flatten());
    blocks.map(|block| block as usize)
}

/// The blocks that a run may come to by a jump, ascending: what is in force there depends on the way.
fn joins(program: &NcProgram) -> Vec<usize> {
    let blocks = if program.has_program_codes() {
        program.blocks()
    } else {
        &[]
    };
    let codes = blocks.iter().filter_map(|block| program.program_code(block));
    let mut joins: Vec<usize> = codes.flat_map(|code| targets(program, code)).collect();
    joins.sort_unstable();
    joins.dedup();
    joins
}

/// True for a block that always ends the program.
fn ends(program: &NcProgram, block: &Block, dialect: &Dialect) -> bool {
    let ends = |word: &Word| m_code(word, dialect).is_some_and(Code::ends);
    block.skip_numbers() == 0 && program.words(block).iter().any(ends)
}

/// True for a program that returns: what is in force at its head may be what its caller left.
fn may_be_called(program: &NcProgram, dialect: &Dialect) -> bool {
    let returns = |word: &Word| m_code(word, dialect).is_some_and(|code| code.role == Role::Return);
    if !program.all_words().iter().any(returns) {
        return false;
    }
    let mut blocks = program.blocks().iter();
    blocks.any(|block| program.words(block).iter().any(returns))
}

/// The M code of a word that the runtime handles itself.
fn m_code(word: &Word, dialect: &Dialect) -> Option<&'static Code> {
    let number = word.number().filter(|_| word.address == Address::M)?;
    dialect.m_codes.find(tenths(number)?)
}

/// True for parts of branches that need not be reached: the way on from commands that end.
fn is_mark(program: &NcProgram, block: &Block) -> bool {
    program
        .program_code(block)
        .is_some_and(|code| !matches!(code.statement, Statement::Assignment { .. }))
}
