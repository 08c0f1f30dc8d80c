//! Converts programs of other dialects to dialect nj, block by block, with the comments. A part without an
//! equivalent in nj becomes a comment and is reported, so that nothing is dropped silently.
//!
//! In the result, each motion names its code, motions replace fixed cycles, and an M code has a block of its
//! own. The result is checked as an nj program, and its faulty blocks are reported.

mod assumptions;
mod block;
mod coordinates;
mod cycles;
mod fanuc;
mod left;
mod state;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use tandem_model::settings::{Calculator, CoordinateSystemSettings, NcOptions, Unit};
use tandem_model::{AxisVector, Diagnostic};
use tandem_syntax::{Grammar, LineIndex, NcProgram, Token, TokenKind, parse, tokens};

use self::assumptions::Assumptions;
pub use self::assumptions::ConversionAssumption;
use self::state::ConversionState;
pub use self::state::Source;
use crate::check::{CheckContext, check, check_source};
use crate::dialects;

/// Returns the first block of a converted program: it sets the start-up state of the source dialect where nj
/// differs.
fn start(unit: Unit) -> String {
    let unit = match unit {
        Unit::Millimetre => "G21",
        Unit::Inch => "G20",
    };
    format!("G00 G17 {unit} G40 G49 G80 G90 G98 G54 G500 ta0 td0 ts0")
}

/// Settings of the machine that a program was written for.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// NC options of that machine.
    pub options: NcOptions,
    /// Unit at the start of a program.
    pub unit: Unit,
}

impl From<&CoordinateSystemSettings> for Settings {
    /// Creates the settings of a machine. As on that machine, its spindle motor limits the spindle speed, too.
    fn from(settings: &CoordinateSystemSettings) -> Self {
        let mut options = settings.nc;
        if let Some(spindle) = &settings.spindle {
            let configured = options.max_spindle_speed_r_min;
            let motor = spindle.max_velocity;
            options.max_spindle_speed_r_min = if configured > 0.0 {
                configured.min(motor)
            } else {
                motor
            };
        }
        Self {
            options,
            unit: settings.unit,
        }
    }
}

impl From<&NcOptions> for Settings {
    /// Creates settings from these options, for programs that start in mm.
    fn from(options: &NcOptions) -> Self {
        Self {
            options: *options,
            unit: Unit::Millimetre,
        }
    }
}

/// A converted program in dialect nj, and the lines that could not be converted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConvertedProgram {
    /// Text of the program in dialect nj.
    pub text: String,
    /// Lines of the source that could not be converted, ascending.
    pub left: Vec<UnconvertedLine>,
    /// Assumptions about the control of the source, ascending by line. Empty for source dgshape.
    pub assumptions: Vec<ConversionAssumption>,
}

/// A line of the source that could not be converted, or whose blocks dialect nj rejects.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnconvertedLine {
    /// Number of the line in the source, from 1.
    pub line: u32,
    /// True if the converted text contains the blocks of this line. The text does not load until they are
    /// corrected.
    pub is_written: bool,
    /// Text of the line in the source.
    pub text: String,
    /// Reason why the line could not be converted, and how to replace it.
    pub reason: String,
}

/// Converts a program to dialect nj. Every word of the source is in the converted text, or its line is in
/// `left`.
pub fn convert(source: &str, from: Source, settings: impl Into<Settings>) -> ConvertedProgram {
    let Settings { mut options, unit } = settings.into();
    if from == Source::Fanuc {
        options.calculator = Calculator::All;
    }
    let (grammar, read) = match from {
        Source::Dgshape => (Grammar::dgshape(), Cow::Borrowed(source)),
        Source::Fanuc => (
            Grammar::fanuc(),
            Cow::Owned(fanuc::comments_in_parentheses(source)),
        ),
    };
    let all = read.as_ref();
    let (read, others) = all.split_at(fanuc::second_program(all, grammar, from).unwrap_or(all.len()));
    let (program, mut found) = parse(read, grammar);
    if from == Source::Dgshape {
        let context = CheckContext {
            options,
            ..CheckContext::default()
        };
        found.extend(check(&program, dialects::dgshape(), &context).diagnostics);
    }
    let mut state = ConversionState::new(from, options, unit);
    let mut lines = vec![(0, start(unit))];
    if from == Source::Fanuc && fanuc::is_subprogram(&program) {
        // a subprogram begins in the modal state of the calling program
        state.lose_modal_state();
        lines.clear();
    }
    let mut writer = Writer {
        grammar,
        source: read,
        shown: source.lines().map(str::trim).collect(),
        program: &program,
        wrong: wrong_lines(read, &found, from),
        state,
        lines,
        left: Vec::new(),
        assumptions: Assumptions::default(),
        at: 0,
    };
    let mut line = Vec::new();
    let mut number = 1;
    for token in tokens(read, grammar) {
        if token.kind == TokenKind::LineEnd {
            writer.line(number, &line);
            line.clear();
            number += 1;
        } else {
            line.push(token);
        }
    }
    if !line.is_empty() {
        writer.line(number, &line);
    }
    if from == Source::Fanuc && !fanuc::has_end(&program) {
        writer.lines.push((number, "M30 // the text ends".to_owned()));
    }
    writer.leave_settings();
    if !others.is_empty() {
        let first = u32::try_from(read.lines().count())
            .unwrap_or(u32::MAX)
            .saturating_add(1);
        writer.leave_lines(first, others.lines().count(), SECOND_PROGRAM);
    }
    writer.finish()
}

/// Returns the errors of the source by line number. For FANUC programs, errors in the form of the program are
/// ignored.
fn wrong_lines(source: &str, found: &[Diagnostic], from: Source) -> BTreeMap<u32, String> {
    let index = LineIndex::new(source);
    let is_told = |one: &&Diagnostic| {
        let is_form = matches!(one.code, "E0024" | "E0026" | "E0115");
        one.is_error() && !(from == Source::Fanuc && is_form)
    };
    let line = |one: &Diagnostic| {
        (
            index.locate(one.span.start).0,
            format!("{}. {}", one.message, one.help),
        )
    };
    let told = found.iter().filter(is_told).map(line);
    // for a line with several errors, the first error is kept
    told.rev().collect()
}

/// Reason for the lines of a further program in the same text.
const SECOND_PROGRAM: &str = "a second program begins here. Convert each program as a separate file. The lines of the second program follow as comments.";

/// Reason for the lines after the mark that ends the program.
const AFTER_PROGRAM: &str = "the program ends at the mark % before this text. Convert a further program as a separate file. The text follows as comments.";

struct Writer<'a> {
    grammar: &'static Grammar,
    /// Text that is converted.
    source: &'a str,
    /// Lines of the source, for reports.
    shown: Vec<&'a str>,
    program: &'a NcProgram,
    wrong: BTreeMap<u32, String>,
    state: ConversionState,
    /// Lines of the nj program, each with the line number of its source.
    lines: Vec<(u32, String)>,
    left: Vec<UnconvertedLine>,
    assumptions: Assumptions,
    /// Index of the next block of the source program.
    at: usize,
}

impl Writer<'_> {
    fn token_text(&self, token: &Token) -> &str {
        let range = token.span.start as usize..token.span.end as usize;
        self.source.get(range).unwrap_or_default()
    }

    fn line(&mut self, number: u32, line: &[Token]) {
        let is_comment = |token: &&Token| token.kind == TokenKind::Comment;
        let mut comments: Vec<String> = line
            .iter()
            .filter(is_comment)
            .map(|token| comment(self.token_text(token)))
            .collect();
        let Some(code) = line.iter().find(|token| !is_comment(token)) else {
            let text = with_comments("", &comments);
            self.lines.push((number, text));
            return;
        };
        let wrong = self.wrong.get(&number).cloned();
        let written = match (wrong, code.kind) {
            (Some(why), _) => Err(why),
            // nj has no program marks
            (None, TokenKind::Mark) => Ok(Vec::new()),
            (None, TokenKind::ProgramNumber) => self.program_number(code, line),
            (None, _) => self.block(number),
        };
        comments.extend(self.state.note.take());
        match written {
            Ok(mut blocks) => {
                let last = blocks.pop().unwrap_or_default();
                let lines = blocks.into_iter().map(|block| (number, block));
                self.lines.extend(lines);
                self.lines.push((number, with_comments(&last, &comments)));
            }
            Err(why) => {
                let kept = self.keep(line).into_iter();
                self.lines.extend(kept.map(|block| (number, block)));
                self.state.lose_position();
                self.leave(number, &why);
                let raw = self.raw(number).to_owned();
                self.lines.push((number, format!("// not converted: {raw}")));
            }
        }
        if let Some(rest) = line.iter().find(|token| token.kind == TokenKind::Rest) {
            self.leave_rest(number, rest);
        }
    }

    /// Keeps the text after the program as comments, and reports the line at which it begins.
    fn leave_rest(&mut self, number: u32, rest: &Token) {
        let text = self.token_text(rest);
        let words = text.trim();
        if words.is_empty() {
            return;
        }
        let before = text.len() - text.trim_start().len();
        let ends_before = text[..before].matches('\n').count();
        let first = number.saturating_add(u32::try_from(ends_before).unwrap_or(u32::MAX));
        let lines = words.lines().count();
        // the line of the mark may have been reported as a whole
        let is_reported = self.left.last().is_some_and(|left| left.line == first);
        let (first, lines) = if is_reported {
            (first.saturating_add(1), lines - 1)
        } else {
            (first, lines)
        };
        if lines > 0 {
            self.leave_lines(first, lines, AFTER_PROGRAM);
        }
    }

    /// Converts a line with a program number to a comment. Rejects a line with other words, which would be
    /// lost.
    fn program_number(&self, number: &Token, line: &[Token]) -> Result<Vec<String>, String> {
        let is_alone = line.iter().all(|token| {
            token == number || token.kind == TokenKind::Comment || self.token_text(token).trim().is_empty()
        });
        let text = self.token_text(number);
        let digits = text.get(1..).unwrap_or_default();
        if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err("O is not followed by a program number. Calls by name and O-words of other controls have no equivalent in nj: write M98 with the number of a subprogram, or the blocks themselves.".to_owned());
        }
        if !is_alone {
            return Err(format!(
                "{text} is not alone on its line. Write the words after it on the next line."
            ));
        }
        Ok(vec![format!("// {text}")])
    }

    /// Reports settings of the source machine that shift every program and that nj does not have.
    fn leave_settings(&mut self) {
        let offset = self.state.options.external_offset;
        if self.state.from == Source::Dgshape && offset != AxisVector::ZERO {
            self.leave(
                1,
                "the external offset of the configuration shifts all work coordinates, and dialect nj has no external offset. Add it to the work offsets of the machine that runs the program.",
            );
        }
    }

    /// Keeps lines as comments, and reports the first of them with this reason.
    fn leave_lines(&mut self, first: u32, lines: usize, reason: &str) {
        for line in (first..).take(lines) {
            let raw = self.raw(line);
            if !matches!(raw, "" | "%") {
                let kept = format!("// not converted: {raw}");
                self.lines.push((line, kept));
            }
        }
        self.leave(first, reason);
    }

    fn raw(&self, number: u32) -> &str {
        let line = self.shown.get(number.saturating_sub(1) as usize);
        line.copied().unwrap_or_default()
    }

    fn leave(&mut self, line: u32, reason: &str) {
        self.report(line, false, reason.to_owned());
    }

    fn report(&mut self, line: u32, is_written: bool, reason: String) {
        let text = self.raw(line).to_owned();
        self.left.push(UnconvertedLine {
            line,
            is_written,
            text,
            reason,
        });
    }

    /// Returns the blocks of nj for the block on this line of the source.
    fn block(&mut self, number: u32) -> Result<Vec<String>, String> {
        let blocks = self.program.blocks();
        while blocks.get(self.at).is_some_and(|block| block.line < number) {
            self.at += 1;
        }
        let block = blocks.get(self.at).filter(|block| block.line == number);
        let block = block.ok_or("the line cannot be read")?;
        let before = self.state.clone();
        let written = self.state.block(self.program, block);
        match &written {
            Ok(blocks) if self.state.from == Source::Fanuc => {
                (self.assumptions).add_line(number, self.program.words(block), blocks);
            }
            Ok(_) => {}
            Err(_) => self.state = before,
        }
        written
    }

    /// Returns the nj blocks that set the modal state of an unconverted line for later lines.
    fn keep(&mut self, line: &[Token]) -> Vec<String> {
        let mut state = self.state.clone();
        let written = left::in_force(line, |token| self.token_text(token)).and_then(|text| {
            let (program, _) = parse(text, self.grammar);
            state.block(&program, program.blocks().first()?).ok()
        });
        if let Some(lines) = written {
            self.state = state;
            return lines;
        }
        let codes: Vec<u32> = left::codes(line, |token| self.token_text(token)).collect();
        for code in codes {
            self.state.activate_code(code);
        }
        Vec::new()
    }

    /// Returns the converted program. Checks it as an nj program, and reports the lines of faulty blocks.
    fn finish(mut self) -> ConvertedProgram {
        let text: String = self
            .lines
            .iter()
            .flat_map(|(_, line)| [line.as_str(), "\n"])
            .collect();
        let (_, found) = check_source(text.as_str(), dialects::nj(), &CheckContext::default());
        let index = LineIndex::new(&text);
        let mut told: BTreeSet<u32> = self.left.iter().map(|left| left.line).collect();
        for one in found.diagnostics.iter().filter(|one| one.is_error()) {
            let (written, _) = index.locate(one.span.start);
            let line = self
                .lines
                .get(written.saturating_sub(1) as usize)
                .map_or(0, |(line, _)| *line);
            if told.insert(line) {
                self.report(line, true, format!("{}. {}", one.message, one.help));
            }
        }
        self.left.sort_by_key(|left| left.line);
        ConvertedProgram {
            text,
            left: self.left,
            assumptions: self.assumptions.report(),
        }
    }
}

/// Joins a block, or a comment, with the comments of the same line.
fn with_comments(block: &str, comments: &[String]) -> String {
    let comments = comments.join(" ");
    let begin = if comments.is_empty() || block.starts_with("//") {
        ""
    } else {
        "// "
    };
    format!("{block} {begin}{comments}").trim().to_owned()
}

/// Returns the text of a comment without its parentheses; the closing parenthesis may be missing.
fn comment(text: &str) -> String {
    let inside = text.strip_prefix('(').unwrap_or(text);
    inside.strip_suffix(')').unwrap_or(inside).trim().to_owned()
}
