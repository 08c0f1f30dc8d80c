//! One program of the store, parsed and checked.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use parking_lot::Mutex;
use plc_protocol::types::program::{
    DiagnosticSeverity, ProgramCheck, ProgramDiagnostic, ProgramInfo, SignatureState,
};
use tandem_interp::{CheckContext, Dialect, Programs, check};
use tandem_model::limits::SUBPROGRAM_MIN;
use tandem_model::settings::{CoordinateSystemSettings, NcOptions};
use tandem_model::{Diagnostic, Severity};
use tandem_syntax::{Header, LineIndex, NcProgram, parse};

use super::file::text_of;
use super::signing::{Signature, Signers};
use crate::disk::checksum_hex;

/// Number of checksum digits that texts for a person contain.
const SUM_SHOWN: usize = 12;

/// Text size in bytes from which a separate thread computes the checksum. Reason: for such a text the
/// computation takes longer than starting a thread.
const SUM_BESIDE_BYTES: usize = 1 << 20;

/// Number of lines at the beginning of a program in which a title is searched.
const TITLE_LINES: usize = 4;

/// Maximum characters of a title.
const TITLE_MAX: usize = 80;

/// Returns the first part of the intermediate code of a program with this number.
pub fn header(number: u16) -> Header {
    if number >= SUBPROGRAM_MIN {
        Header::Subprogram(number)
    } else {
        Header::Program(number)
    }
}

/// The rules for checking a program that do not depend on a coordinate system.
#[derive(Debug, Clone, Copy)]
pub struct TextRules {
    /// NC dialect.
    pub dialect: &'static Dialect,
    /// Maximum amount by which a radius may fall short of half the chord, mm (D26): the largest value that a coordinate
    /// system allows.
    pub arc_radius_tolerance_mm: f64,
    /// Options that the dialect leaves to the machine.
    pub options: NcOptions,
}

/// One program of the store.
#[derive(Debug)]
pub struct StoredProgram {
    /// Number of the program.
    pub number: u16,
    /// Syntax tree.
    pub tree: Arc<NcProgram>,
    /// Diagnostics that the parser has reported.
    pub parsed: Vec<Diagnostic>,
    /// Result of checking the program alone, without called programs.
    pub check: ProgramCheck,
    /// True if the program calls programs whose numbers are not in the text; it may then call any program.
    pub calls_any: bool,
    /// NC dialect of the program.
    pub dialect: &'static Dialect,
    /// True if the program begins in the current modal state; otherwise it begins in the start-up state.
    goes_on: bool,
    /// Result of the check in each coordinate system, by number; computed at the first request.
    here: Mutex<BTreeMap<u8, Arc<CheckHere>>>,
    title: String,
    /// Checksum of the bytes from which the program was read.
    sum: String,
    /// Signature stored with the program.
    signature: Option<Signature>,
    /// True if the program was changed outside while the runtime was running.
    pub is_from_outside: bool,
    /// Byte offset of the beginning of each line.
    line_starts: Vec<u32>,
    /// True if the program may name variables; determined at the first request.
    mentions_variables: OnceLock<bool>,
}

/// The programs of the store that can be called.
#[derive(Debug)]
struct CallablePrograms<'a>(&'a BTreeMap<u16, Arc<StoredProgram>>);

impl Programs for CallablePrograms<'_> {
    fn find(&self, number: u16) -> Option<Arc<NcProgram>> {
        self.0.get(&number).map(|program| Arc::clone(&program.tree))
    }
}

/// Result of checking a program in a coordinate system.
#[derive(Debug)]
pub struct CheckHere {
    /// Errors that prevent the program from running there; each error is listed once.
    pub errors: Vec<ProgramDiagnostic>,
    /// M codes that the program issues there, in ascending order; each code is listed once.
    pub m_codes: Vec<u16>,
}

impl StoredProgram {
    /// Parses and checks the text of a program.
    pub fn new(number: u16, text: &str, rules: TextRules) -> Self {
        Self::checked(number, text, rules, false)
    }

    /// Parses and checks a program from the bytes of its file.
    pub(super) fn of_file(
        number: u16,
        bytes: Vec<u8>,
        signature: Option<Signature>,
        rules: TextRules,
        signers: &Signers,
    ) -> Self {
        let (sum, state) = (
            checksum_hex(&bytes),
            signers.verify_signature(&bytes, signature.as_ref()),
        );
        let mut program = Self::new(number, &text_of(bytes), rules);
        program.check.hash.clone_from(&sum);
        program.check.signature = state;
        Self {
            sum,
            signature,
            ..program
        }
    }

    /// Sets the signature of the program, and checks it against the signers.
    #[must_use]
    pub fn signed(mut self, signature: Option<Signature>, signers: &Signers) -> Self {
        self.check.signature = signers.verify_signature(self.text().as_bytes(), signature.as_ref());
        self.signature = signature;
        self
    }

    /// Creates a program without a number. With `goes_on` it begins in the current modal state, otherwise in
    /// the start-up state.
    pub fn manual(text: &str, rules: TextRules, goes_on: bool) -> Self {
        Self::checked(0, text, rules, goes_on)
    }

    fn checked(number: u16, text: &str, rules: TextRules, goes_on: bool) -> Self {
        let dialect = rules.dialect;
        let context = CheckContext {
            goes_on,
            manual: number == 0,
            arc_radius_tolerance_mm: Some(rules.arc_radius_tolerance_mm),
            options: rules.options,
            ..CheckContext::default()
        };
        let (sum, (tree, parsed, checked)) = run_with_checksum(text, || {
            let (tree, parsed) = parse(text, (dialect.grammar)());
            let checked = check(&tree, dialect, &context);
            (tree, parsed, checked)
        });
        let mut diagnostics = parsed.clone();
        diagnostics.extend(checked.diagnostics);
        diagnostics.sort_by_key(|diagnostic| (diagnostic.span.start, diagnostic.span.end));
        let check = ProgramCheck {
            diagnostics: locate(text, &diagnostics),
            m_codes: checked.m_codes,
            programs: checked.programs,
            hash: sum.clone(),
            dialect: dialect.name.to_owned(),
            o_number: tree.number(),
            ..ProgramCheck::default()
        };
        Self {
            number,
            tree: Arc::new(tree),
            parsed,
            check,
            calls_any: checked.calls_any,
            dialect,
            goes_on,
            here: Mutex::default(),
            title: title(text, dialect),
            sum,
            signature: None,
            is_from_outside: false,
            line_starts: line_starts(text),
            mentions_variables: OnceLock::new(),
        }
    }

    /// Checks the program in a coordinate system. The result is cached, because text and settings do not
    /// change.
    pub fn check_in(&self, settings: &CoordinateSystemSettings) -> Arc<CheckHere> {
        let mut here = self.here.lock();
        let check = here
            .entry(settings.number)
            .or_insert_with(|| Arc::new(self.check_with(settings)));
        Arc::clone(check)
    }

    fn check_with(&self, settings: &CoordinateSystemSettings) -> CheckHere {
        let context = CheckContext {
            goes_on: self.goes_on,
            manual: self.number == 0,
            ..CheckContext::from_settings(settings)
        };
        let check = check(&self.tree, self.dialect, &context);
        let of_check = locate(self.text(), &check.diagnostics);
        let mut errors: Vec<ProgramDiagnostic> = Vec::new();
        for found in self.check.diagnostics.iter().cloned().chain(of_check) {
            if found.severity == DiagnosticSeverity::Error && !errors.contains(&found) {
                errors.push(found);
            }
        }
        CheckHere {
            errors,
            m_codes: check.m_codes,
        }
    }

    /// Returns the errors of called programs in a coordinate system. Each called program is checked in the
    /// modal states in which it is called.
    pub fn check_called(
        &self,
        settings: &CoordinateSystemSettings,
        all: &BTreeMap<u16, Arc<StoredProgram>>,
    ) -> Vec<(u16, ProgramDiagnostic)> {
        let stored = CallablePrograms(all);
        let context = CheckContext {
            goes_on: self.goes_on,
            manual: self.number == 0,
            programs: Some(&stored),
            ..CheckContext::from_settings(settings)
        };
        let called = check(&self.tree, self.dialect, &context).called;
        let mut errors = Vec::new();
        for (number, check) in called {
            let text = all.get(&number).map_or("", |program| program.text());
            let found = locate(text, &check.diagnostics).into_iter();
            let found = found.filter(|found| found.severity == DiagnosticSeverity::Error);
            errors.extend(found.map(|found| (number, found)));
        }
        errors
    }

    /// Returns the text of the program.
    pub fn text(&self) -> &str {
        self.tree.source()
    }

    /// Returns true if the check of the program alone has found errors.
    pub fn has_errors(&self) -> bool {
        self.check
            .diagnostics
            .iter()
            .any(|found| found.severity == DiagnosticSeverity::Error)
    }

    /// Returns the intermediate code of a program without errors (D43).
    pub fn intermediate_code(&self) -> String {
        tandem_syntax::compile(&self.tree, header(self.number), self.dialect)
    }

    /// Returns true if the program text may name P or Q variables, or values of the machine.
    pub fn mentions_variables(&self) -> bool {
        *self
            .mentions_variables
            .get_or_init(|| mentions_variables(self.text()))
    }

    /// Returns the text of a line, counted from 1; empty if the line does not exist.
    pub fn line(&self, line: u32) -> &str {
        let index = (line as usize).checked_sub(1);
        let start = index.and_then(|index| self.line_starts.get(index));
        let rest = start.and_then(|start| self.text().get(*start as usize..));
        rest.and_then(|rest| rest.lines().next()).unwrap_or_default()
    }

    /// Returns the checksum of the program's bytes, which clients see as its hash.
    pub fn checksum(&self) -> &str {
        &self.sum
    }

    /// Returns the signature stored with the program.
    pub(super) fn signature(&self) -> Option<&Signature> {
        self.signature.as_ref()
    }

    /// Returns true if storing `new` in place of this program would change nothing.
    pub(super) fn is_same(&self, new: &Self) -> bool {
        let is_signed_so = new.signature.is_none() || new.signature == self.signature;
        self.sum == new.sum && self.dialect.name == new.dialect.name && is_signed_so && !self.is_from_outside
    }

    /// Returns the reason why the machine refuses to run the program; `None` if it does not refuse.
    pub fn refusal(&self) -> Option<String> {
        let number = self.number;
        match self.check.signature {
            None | Some(SignatureState::Valid) => None,
            Some(SignatureState::Missing) => Some(format!(
                "program {number} is not signed, and the machine runs only programs signed by a key in \
                 [programs] \
                 signed_by; sign the program, and store it with its signature"
            )),
            Some(SignatureState::Wrong) => Some(format!(
                "the signature of program {number} belongs to no key in [programs] signed_by, or to another \
                 text; \
                 sign the present text, and store it with its signature"
            )),
        }
    }

    /// Returns the first digits of the checksum, for texts for a person.
    pub(super) fn short_checksum(&self) -> &str {
        self.sum.get(..SUM_SHOWN).unwrap_or(&self.sum)
    }

    pub(super) fn info(&self) -> ProgramInfo {
        let count = |severity| {
            let found = self.check.diagnostics.iter();
            let count = found.filter(|found| found.severity == severity).count();
            u32::try_from(count).unwrap_or(u32::MAX)
        };
        ProgramInfo {
            number: self.number,
            title: self.title.clone(),
            bytes: self.text().len() as u64,
            errors: count(DiagnosticSeverity::Error),
            warnings: count(DiagnosticSeverity::Warning),
            hash: self.sum.clone(),
            signature: self.check.signature,
            dialect: self.dialect.name.to_owned(),
            o_number: self.tree.number(),
            folder: String::new(),
        }
    }
}

/// Returns true if a program text may name P or Q variables, or values of the machine.
pub fn mentions_variables(text: &str) -> bool {
    let bytes = text.as_bytes();
    // `before` is the previous character, `last` the last character that is not a space.
    let (mut before, mut last) = (b' ', b' ');
    for (at, &byte) in bytes.iter().enumerate() {
        let next = bytes.get(at + 1).copied().unwrap_or(b' ');
        let is_name = matches!(byte, b'P' | b'p' | b'Q' | b'q') && (next.is_ascii_digit() || next == b'[');
        let is_named = is_name && !before.is_ascii_alphanumeric();
        if byte == b'_' || is_named && !is_word(last, &bytes[at + 1..]) {
            return true;
        }
        before = byte;
        if !matches!(byte, b' ' | b'\t') {
            last = byte;
        }
    }
    false
}

/// Returns true if P or Q is an address, as in `M98 P1001`: it follows the value of another word, and no
/// value is assigned to it. Text in brackets after it is examined separately.
fn is_word(last: u8, rest: &[u8]) -> bool {
    let follows_value = last.is_ascii_digit() || matches!(last, b'.' | b']');
    let mut behind = rest
        .iter()
        .skip_while(|byte| byte.is_ascii_digit() || **byte == b' ');
    follows_value && behind.next() != Some(&b'=')
}

/// Converts diagnostics from byte offsets to lines and columns.
pub fn locate(text: &str, diagnostics: &[Diagnostic]) -> Vec<ProgramDiagnostic> {
    if diagnostics.is_empty() {
        return Vec::new();
    }
    let index = LineIndex::new(text);
    let place = |diagnostic: &Diagnostic| {
        let (line, column) = index.locate(diagnostic.span.start);
        let (end_line, end_column) = index.locate(diagnostic.span.end);
        ProgramDiagnostic {
            code: diagnostic.code.to_owned(),
            severity: match diagnostic.severity {
                Severity::Error => DiagnosticSeverity::Error,
                Severity::Warning => DiagnosticSeverity::Warning,
            },
            line,
            column,
            end_line,
            end_column,
            message: diagnostic.message.clone(),
            help: diagnostic.help.clone(),
        }
    };
    diagnostics.iter().map(place).collect()
}

/// Computes the checksum of a text while `work` runs.
fn run_with_checksum<T>(text: &str, work: impl FnOnce() -> T) -> (String, T) {
    let sum = || checksum_hex(text.as_bytes());
    if text.len() < SUM_BESIDE_BYTES {
        return (sum(), work());
    }
    std::thread::scope(|scope| {
        let beside = std::thread::Builder::new()
            .name("sum".to_owned())
            .spawn_scoped(scope, sum);
        let done = work();
        let made = beside.ok().and_then(|thread| thread.join().ok());
        (made.unwrap_or_else(sum), done)
    })
}

/// Returns the byte offset of each line. It is computed when the program is stored, so that a run does not
/// wait for it.
fn line_starts(text: &str) -> Vec<u32> {
    let ends = memchr::memchr_iter(b'\n', text.as_bytes());
    let after = ends.filter_map(|index| u32::try_from(index + 1).ok());
    std::iter::once(0).chain(after).collect()
}

/// Returns the first comment of a program as its title, if only start marks precede that comment.
fn title(text: &str, dialect: &Dialect) -> String {
    let grammar = (dialect.grammar)();
    let form = grammar.program_form;
    let is_mark = |line: &str| {
        let first = line.bytes().next().map(|first| first.to_ascii_uppercase());
        first.is_none() || first == form.mark || first == form.number_letter
    };
    let comment = |line: &str| {
        let behind = |open: &str| line.split_once(open).map(|(_, rest)| rest.to_owned());
        let of_line = grammar.line_comment.and_then(behind);
        of_line.or_else(|| {
            let (open, close) = grammar.block_comment?;
            let rest = behind(open)?;
            Some(rest.split(close).next().unwrap_or_default().to_owned())
        })
    };
    for line in text.trim_start().lines().take(TITLE_LINES).map(str::trim) {
        let begins = [grammar.line_comment, grammar.block_comment.map(|(open, _)| open)];
        let is_comment = begins.into_iter().flatten().any(|open| line.starts_with(open));
        if !is_comment && !is_mark(line) {
            return String::new();
        }
        if let Some(title) = comment(line) {
            return shortened(title.trim());
        }
    }
    String::new()
}

/// Shortens a title that is longer than [`TITLE_MAX`], and appends an ellipsis.
fn shortened(title: &str) -> String {
    if title.chars().count() <= TITLE_MAX {
        return title.to_owned();
    }
    let kept: String = title.chars().take(TITLE_MAX - 1).collect();
    format!("{}…", kept.trim_end())
}

#[cfg(test)]
mod tests {
    use tandem_interp::dialects::{dgshape, nj};

    use super::*;
    use crate::program_store::tests::rules;

    #[test]
    fn texts_with_p_and_q_may_read_variables_and_others_do_not() {
        for text in [
            "X P1",
            "P[P2] = 3",
            "(Q17)",
            "if (q3 > 1) {",
            "X_CNC_CapturedPosition[1]",
            "N40 P1 = 3",
            "G01 X P1",
            "M98 P[Q1]",
        ] {
            assert!(mentions_variables(text), "{text}");
        }
        for text in [
            "G01 X10 F100",
            "L1 = 3",
            "// POCKET",
            "STOP 1",
            "N40 M98 P1001",
            "G84 X[L2] Z-8. R3 P100 Q2",
        ] {
            assert!(!mentions_variables(text), "{text}");
        }
    }

    #[test]
    fn the_title_is_the_first_comment_behind_the_marks_of_the_beginning() {
        for (text, title) in [
            ("// Seven\nG90\n", "Seven"),
            ("\n /* Seven */ G90\n", "Seven"),
            ("G90 // no title\n", ""),
        ] {
            assert_eq!(super::title(text, nj()), title, "{text}");
        }
        for (text, title) in [
            ("%\nO12345678 (FLANGE)\nG90\n", "FLANGE"),
            ("%\nO1\n(FLANGE)\n", "FLANGE"),
            ("(FLANGE\n", "FLANGE"),
            ("G90 (NO TITLE)\n", ""),
        ] {
            assert_eq!(super::title(text, dgshape()), title, "{text}");
        }
    }

    #[test]
    fn a_title_that_is_cut_says_so() {
        let of = |length: usize| super::title(&format!("// {}", "x".repeat(length)), nj());
        assert_eq!(of(TITLE_MAX), "x".repeat(TITLE_MAX));
        assert_eq!(of(TITLE_MAX + 1), format!("{}…", "x".repeat(TITLE_MAX - 1)));
    }

    #[test]
    fn lines_are_found_by_number() {
        let program = StoredProgram::new(1, "G90\r\nG01 X1\nM30", rules());
        assert_eq!(
            [program.line(1), program.line(2), program.line(3), program.line(4)],
            ["G90", "G01 X1", "M30", ""]
        );
    }
}
