//! Parses branches and loops to a flat list: each part is a block, with the index of the block to which it
//! jumps (manual 4-2).

use tandem_model::Span;

use super::expression::Kind;
use super::{LineKind, NESTING_MAX, Parser, index};
use crate::cursor::Cursor;
use crate::diagnostics;
use crate::program_code::{CaseLabel, ExpressionId, Keyword, ProgramCode, Statement};
use crate::tree::{Block, Content};

/// Branches and loops that are open at the cursor of the parser.
#[derive(Debug, Default)]
pub(super) struct OpenConstructs {
    /// Depth of nested commands.
    pub(super) depth: usize,
    /// Number of open braces.
    pub(super) braces: usize,
    /// Number of open constructs that `break` can leave.
    leavable: usize,
    /// Indices of the program codes of `break` whose target is not yet known.
    breaks: Vec<usize>,
    switches: Vec<OpenSwitch>,
    /// State of the braces of a statement of another language; the parser has already reported the statement.
    pub(super) foreign: ForeignBraces,
}

/// State of the braces of statements of another language.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) enum ForeignBraces {
    /// No such statement has been read, or its braces are closed.
    #[default]
    None,
    /// Such a statement has been read; its opening brace follows.
    Begun,
    /// The statement has this number of open braces.
    Open(u32),
}

impl ForeignBraces {
    /// Returns true for a brace that belongs to such a statement, and updates the number of open braces.
    pub(super) fn passes(&mut self, byte: u8) -> bool {
        let (passes, then) = match (*self, byte) {
            (ForeignBraces::Begun, b'{') => (true, ForeignBraces::Open(1)),
            (ForeignBraces::Open(open), b'{') => (true, ForeignBraces::Open(open + 1)),
            (ForeignBraces::Open(1), _) => (true, ForeignBraces::None),
            (ForeignBraces::Open(open), _) => (true, ForeignBraces::Open(open - 1)),
            (other, _) => (false, other),
        };
        *self = then;
        passes
    }
}

/// A `switch` that is being parsed.
#[derive(Debug)]
struct OpenSwitch {
    /// Nesting depth of the commands in the braces of the `switch`.
    depth: usize,
    cases: Vec<CaseLabel>,
    default: Option<u32>,
}

impl Parser<'_> {
    /// Reads a branch, a loop, or a part of a `switch`; the cursor is at the keyword.
    pub(super) fn control(&mut self, keyword: Keyword, line: u32) {
        let start = self.cursor.at();
        let keyword_span = Span::new(index(start), index(start + keyword.text().len()));
        if self.kind == LineKind::Words {
            self.report(
                &diagnostics::ASSIGNMENT_PLACE,
                keyword_span,
                format!("`{}` is in a block of words", keyword.text()),
                "Write the program code on a line of its own.",
            );
            self.end_words(line);
        }
        self.begin_program_code(start);
        let flags = self.flags;
        self.begin_line();
        self.flags = flags;
        self.cursor.advance(keyword.text().len());
        match keyword {
            Keyword::If => self.branch(start),
            Keyword::While => self.while_loop(start),
            Keyword::Do => self.do_loop(start, keyword_span),
            Keyword::Switch => self.switch(start),
            Keyword::Case | Keyword::Default => self.case(keyword, start, keyword_span),
            Keyword::Break if self.nesting.leavable > 0 => {
                let code = self.push_program_code(start, Statement::Break, None);
                self.nesting.breaks.push(code);
            }
            Keyword::Else | Keyword::Break => self.out_of_place(keyword, start, keyword_span),
        }
    }

    fn out_of_place(&mut self, keyword: Keyword, start: usize, span: Span) {
        self.report(
            &diagnostics::KEYWORD_PLACE,
            span,
            format!("`{}` belongs to no other program code", keyword.text()),
            "Write it inside the if, switch, while or do that it belongs to.",
        );
        self.push_failed(start);
    }

    fn branch(&mut self, mut start: usize) {
        let mut ends = Vec::new();
        loop {
            let branch = self.with_value(start, Kind::Condition, Statement::If);
            self.body(start);
            let Some(at) = self.take_keyword(Keyword::Else) else {
                self.jump(branch, self.here());
                break;
            };
            ends.push(self.push_program_code(at, Statement::Else, None));
            self.jump(branch, self.here());
            let Some(next) = self.take_keyword(Keyword::If) else {
                self.body(at);
                break;
            };
            start = next;
        }
        self.jump(ends, self.here());
    }

    fn while_loop(&mut self, start: usize) {
        let head = self.here();
        let condition = self.with_value(start, Kind::Condition, Statement::While);
        let breaks = self.enter();
        self.body(start);
        self.begin_line();
        let repeat = self.push_program_code(self.cursor.at(), Statement::Repeat, None);
        self.jump(Some(repeat), head);
        self.jump(condition, self.here());
        self.leave(breaks);
    }

    fn do_loop(&mut self, start: usize, keyword_span: Span) {
        self.push_program_code(start, Statement::Do, None);
        let head = self.here();
        let breaks = self.enter();
        self.body(start);
        if let Some(at) = self.take_keyword(Keyword::While) {
            let condition = self.with_value(at, Kind::Condition, Statement::DoWhile);
            self.jump(condition, head);
        } else if self.tree.complete {
            self.report(
                &diagnostics::COMMAND_MISSING,
                keyword_span,
                "`do` has no `while` after its commands",
                "Write while and a condition in parentheses.",
            );
            self.push_failed(start);
        }
        self.leave(breaks);
    }

    fn switch(&mut self, start: usize) {
        let code = self.with_value(start, Kind::Number, Statement::Switch { first: 0, count: 0 });
        let breaks = self.enter();
        self.nesting.switches.push(OpenSwitch {
            depth: self.nesting.depth + 1,
            cases: Vec::new(),
            default: None,
        });
        self.code_line = self.cursor.line();
        self.blank_lines();
        if self.cursor.peek() == Some(b'{') {
            self.braces();
        } else {
            self.command_missing(start);
        }
        let end = self.here();
        if let Some(mut open) = self.nesting.switches.pop() {
            open.cases.sort_unstable();
            self.repeated_labels(&open.cases);
            let (first, count) = (index(self.tree.cases.len()), index(open.cases.len()));
            self.tree.cases.append(&mut open.cases);
            if let Some(code) = code.and_then(|code| self.tree.program_codes.get_mut(code)) {
                code.statement = Statement::Switch { first, count };
            }
            self.jump(code, open.default.unwrap_or(end));
        }
        self.leave(breaks);
    }

    fn case(&mut self, keyword: Keyword, start: usize, span: Span) {
        let depth = self.nesting.depth;
        let switch = self.nesting.switches.last();
        if switch.is_none_or(|open| open.depth != depth) {
            self.out_of_place(keyword, start, span);
            return;
        }
        let label = (keyword == Keyword::Case).then(|| self.case_label());
        self.blanks();
        let complete = label != Some(None) && self.cursor.skip_byte(b':');
        let block = self.here();
        let mut repeated = false;
        if let Some(open) = self.nesting.switches.last_mut().filter(|_| complete) {
            match label.flatten() {
                Some(label) => open.cases.push(CaseLabel { label, block }),
                None => repeated = open.default.replace(block).is_some(),
            }
        }
        if complete && !repeated {
            let label = label.flatten();
            let statement = label.map_or(Statement::Default, |label| Statement::Case { label });
            self.push_program_code(start, statement, None);
            return;
        }
        if repeated {
            self.label_twice(self.cursor.span_from(start));
        } else {
            self.report_from(
                start,
                &diagnostics::CASE_LABEL,
                "the label is malformed",
                "Write case, a whole number and a colon, or default and a colon.",
            );
        }
        self.push_failed(start);
    }

    /// Reports labels that occur twice in a `switch`; `cases` must be sorted by label and position.
    fn repeated_labels(&mut self, cases: &[CaseLabel]) {
        for pair in cases.windows(2).filter(|pair| pair[0].label == pair[1].label) {
            let Some(block) = self.tree.blocks.get_mut(pair[1].block as usize) else {
                continue;
            };
            block.flags |= Block::HAS_ERRORS;
            let start = block.start;
            self.label_twice(Span::new(start, start + index(Keyword::Case.text().len())));
        }
    }

    fn label_twice(&mut self, span: Span) {
        self.report(
            &diagnostics::CASE_LABEL,
            span,
            "the label appears twice in the switch",
            "Keep one of them.",
        );
    }

    /// Reads a whole number with an optional sign; `None` if the number is missing or too large.
    fn case_label(&mut self) -> Option<i64> {
        self.blanks();
        let negative = self.cursor.skip_byte(b'-');
        if !negative {
            self.cursor.skip_byte(b'+');
        }
        let digits = self.cursor.digits();
        self.cursor.advance(digits.len());
        let label: i64 = digits.parse().ok()?;
        Some(if negative { -label } else { label })
    }

    /// Enters a construct that `break` can leave. Returns the number of breaks before it that still have no
    /// target.
    fn enter(&mut self) -> usize {
        self.nesting.leavable += 1;
        self.nesting.breaks.len()
    }

    /// Ends a construct that `break` can leave: the breaks in the construct jump to the next block.
    fn leave(&mut self, breaks: usize) {
        self.nesting.leavable -= 1;
        let breaks = self.nesting.breaks.split_off(breaks);
        self.jump(breaks, self.here());
    }

    /// Returns the index of the block that is added next.
    fn here(&self) -> u32 {
        index(self.tree.blocks.len())
    }

    /// Sets the block to which these program codes jump.
    fn jump(&mut self, codes: impl IntoIterator<Item = usize>, to: u32) {
        for code in codes {
            if let Some(code) = self.tree.program_codes.get_mut(code) {
                code.to = Some(to);
            }
        }
    }

    /// Records that a line of the intermediate code begins at the cursor (D03).
    fn begin_line(&mut self) {
        self.flags = 0;
        self.line_start = self.cursor.at();
        self.text_bytes_before = self.cursor.text_bytes();
    }

    /// Reads a value or condition in parentheses, and adds the program code that depends on it. If the value
    /// or condition is faulty, skips it and adds a block with an error.
    fn with_value(&mut self, start: usize, kind: Kind, statement: Statement) -> Option<usize> {
        let at = self.cursor;
        let value = self.in_parentheses(kind, 0);
        if value.is_none() {
            self.pass_parentheses(at);
            self.push_failed(start);
        }
        value.map(|value| self.push_program_code(start, statement, Some(value)))
    }

    /// Moves the cursor after the parentheses that begin at `from`, if they are closed on their line.
    /// Otherwise the cursor stays after the text that was read.
    fn pass_parentheses(&mut self, from: Cursor<'_>) {
        if self.cursor.peek().is_none() {
            return;
        }
        let mut ahead = from;
        let mut depth = 0_usize;
        while let Some(byte) = ahead.peek() {
            match byte {
                b'(' => depth += 1,
                b')' if depth <= 1 => {
                    let passed = (ahead.at() + 1).saturating_sub(self.cursor.at());
                    self.cursor.advance(passed);
                    return;
                }
                b')' => depth -= 1,
                b'\n' | b'{' | b'}' => return,
                _ => {}
            }
            ahead.pass_character();
        }
    }

    /// Skips a keyword if it comes next, also after blank lines. Returns the position of its first byte.
    fn take_keyword(&mut self, expected: Keyword) -> Option<usize> {
        let mut ahead = self.cursor;
        ahead.blank_lines(self.grammar).ok()?;
        if Keyword::find(ahead.letters()) != Some(expected) {
            return None;
        }
        self.cursor = ahead;
        self.begin_line();
        self.cursor.advance(expected.text().len());
        Some(ahead.at())
    }

    /// Reads one command, or commands in braces.
    fn body(&mut self, start: usize) {
        self.code_line = self.cursor.line();
        self.blank_lines();
        match self.cursor.peek() {
            Some(b'{') => self.braces(),
            None | Some(b'}') => self.command_missing(start),
            Some(_) => {
                if self.deeper() {
                    self.line(true);
                    self.nesting.depth -= 1;
                }
            }
        }
    }

    fn command_missing(&mut self, start: usize) {
        if !self.tree.complete {
            return;
        }
        self.report(
            &diagnostics::COMMAND_MISSING,
            Span::new(index(start), index(start + 1)),
            "the commands are missing",
            "Write a command, or commands in braces.",
        );
        self.push_failed(start);
    }

    /// Increases the nesting depth. If the depth is too large, reports an error, ends the parsing, and
    /// returns `false`.
    fn deeper(&mut self) -> bool {
        if self.nesting.depth >= NESTING_MAX {
            let at = self.cursor.at();
            self.report_from(
                at,
                &diagnostics::NESTING_TOO_DEEP,
                format!("branches and repetitions are nested deeper than {NESTING_MAX}"),
                "Move commands to a subprogram.",
            );
            self.tree.complete = false;
            self.push_failed(at);
            self.cursor.finish();
            return false;
        }
        self.nesting.depth += 1;
        true
    }

    /// Reads commands in braces; the cursor is at the opening brace.
    fn braces(&mut self) {
        if !self.deeper() {
            return;
        }
        let start = self.brace(Statement::Open);
        self.nesting.braces += 1;
        loop {
            self.code_line = self.cursor.line();
            self.blank_lines();
            match self.cursor.peek() {
                Some(b'}') => {
                    self.brace(Statement::Close);
                    break;
                }
                Some(_) => self.line(true),
                None => {
                    if self.tree.complete {
                        self.report(
                            &diagnostics::BRACE_UNMATCHED,
                            Span::new(index(start), index(start + 1)),
                            "`{` is not closed",
                            "Write `}` after the last command.",
                        );
                        self.push_failed(start);
                    }
                    self.tree.complete = false;
                    break;
                }
            }
        }
        self.nesting.braces -= 1;
        self.nesting.depth -= 1;
    }

    /// Skips a brace, and adds its block. Returns the position of the brace.
    fn brace(&mut self, statement: Statement) -> usize {
        let start = self.cursor.at();
        self.begin_line();
        self.cursor.advance(1);
        self.push_program_code(start, statement, None);
        start
    }

    /// Adds a program code that ends at the cursor, as a block. Returns its index in the list of program
    /// codes.
    pub(super) fn push_program_code(
        &mut self,
        start: usize,
        statement: Statement,
        expression: Option<ExpressionId>,
    ) -> usize {
        let code = self.tree.program_codes.len();
        self.tree.program_codes.push(ProgramCode {
            statement,
            expression,
            to: None,
            span: self.cursor.span_from(start),
        });
        self.push_block(start, self.flags, Content::ProgramCode(index(code)));
        code
    }
}
