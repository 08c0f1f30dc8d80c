//! Branches and loops, flattened: each part is a block that says where the program continues (manual 4-2).

use tandem_model::Span;

use super::word::keyword;
use super::{LineKind, NESTING_MAX, Parser, index};
use crate::cursor::Cursor;
use crate::diagnostics;
use crate::program_code::{CaseLabel, ExpressionId, Keyword, ProgramCode, Statement};
use crate::tree::{Block, Content};

/// Branches and repetitions that are open where the parser reads.
#[derive(Debug, Default)]
pub(super) struct Nesting {
    /// How deep commands stand in commands.
    pub(super) depth: usize,
    /// How many braces are open.
    pub(super) braces: usize,
    /// The structures that `break` leaves.
    leavable: usize,
    /// Program codes of `break` whose end is not known yet.
    breaks: Vec<usize>,
    switches: Vec<OpenSwitch>,
}

/// A `switch` that is read.
#[derive(Debug)]
struct OpenSwitch {
    /// Depth of its own braces.
    depth: usize,
    cases: Vec<CaseLabel>,
    default: Option<u32>,
}

impl Parser<'_> {
    /// Reads a branch, a repetition, or a part of a switch; the cursor stands at its keyword.
    pub(super) fn control(&mut self, keyword: Keyword, line: u32) {
        let start = self.cursor.at();
        let keyword_span = Span::new(index(start), index(start + keyword.text().len()));
        if self.kind == LineKind::Words {
            self.report(
                &diagnostics::ASSIGNMENT_PLACE,
                keyword_span,
                format!("`{}` stands in a block of words", keyword.text()),
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
            Keyword::While => self.while_repetition(start),
            Keyword::Do => self.do_repetition(start, keyword_span),
            Keyword::Switch => self.switch(start),
            Keyword::Case | Keyword::Default => self.case(keyword, start, keyword_span),
            Keyword::Break if self.nesting.leavable > 0 => {
                let code = self.push_program_code(start, Statement::Break { end: 0 });
                self.nesting.breaks.push(code);
            }
            Keyword::Else | Keyword::Break => self.out_of_place(keyword, start, keyword_span),
        }
    }

    fn out_of_place(&mut self, keyword: Keyword, start: usize, span: Span) {
        self.report(
            &diagnostics::KEYWORD_PLACE,
            span,
            format!("`{}` stands alone", keyword.text()),
            "Write it inside the if, switch, while or do that it belongs to.",
        );
        self.push_failed(start);
    }

    fn branch(&mut self, start: usize) {
        let mut ends = Vec::new();
        let mut start = start;
        loop {
            let branch = self.condition().map(|condition| {
                self.push_program_code(
                    start,
                    Statement::If {
                        condition,
                        otherwise: 0,
                    },
                )
            });
            if branch.is_none() {
                self.push_failed(start);
            }
            self.body(start);
            if self.next_keyword() != Some(Keyword::Else) {
                self.go_on_here(branch);
                break;
            }
            self.blank_lines();
            let at = self.cursor.at();
            self.begin_line();
            self.cursor.advance(Keyword::Else.text().len());
            ends.push(self.push_program_code(at, Statement::Else { end: 0 }));
            self.go_on_here(branch);
            if self.next_keyword() != Some(Keyword::If) {
                self.body(at);
                break;
            }
            self.blank_lines();
            start = self.cursor.at();
            self.begin_line();
            self.cursor.advance(Keyword::If.text().len());
        }
        for code in ends {
            self.go_on_here(Some(code));
        }
    }

    fn while_repetition(&mut self, start: usize) {
        let head = self.here();
        let condition = self.condition();
        let repetition =
            condition.map(|condition| self.push_program_code(start, Statement::While { condition, end: 0 }));
        if repetition.is_none() {
            self.push_failed(start);
        }
        let breaks = self.enter();
        self.body(start);
        self.begin_line();
        let at = self.cursor.at();
        self.push_program_code(at, Statement::Repeat { start: head });
        self.go_on_here(repetition);
        self.leave(breaks);
    }

    fn do_repetition(&mut self, start: usize, keyword_span: Span) {
        self.push_program_code(start, Statement::Do);
        let head = self.here();
        let breaks = self.enter();
        self.body(start);
        if self.next_keyword() == Some(Keyword::While) {
            self.blank_lines();
            let at = self.cursor.at();
            self.begin_line();
            self.cursor.advance(Keyword::While.text().len());
            if let Some(condition) = self.condition() {
                self.push_program_code(
                    at,
                    Statement::DoWhile {
                        condition,
                        start: head,
                    },
                );
            } else {
                self.push_failed(at);
            }
        } else if self.complete {
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
        let at = self.cursor;
        let value = self.number_in_parentheses();
        if value.is_none() {
            self.pass_parentheses(at);
        }
        let code = value.map(|value| {
            self.push_program_code(
                start,
                Statement::Switch {
                    value,
                    first: 0,
                    count: 0,
                    otherwise: 0,
                },
            )
        });
        if code.is_none() {
            self.push_failed(start);
        }
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
            let (first, count) = (index(self.cases.len()), index(open.cases.len()));
            self.cases.append(&mut open.cases);
            if let Some(Statement::Switch {
                first: f,
                count: c,
                otherwise,
                ..
            }) = code
                .and_then(|code| self.program_codes.get_mut(code))
                .map(|code| &mut code.statement)
            {
                (*f, *c, *otherwise) = (first, count, open.default.unwrap_or(end));
            }
        }
        self.leave(breaks);
    }

    fn case(&mut self, keyword: Keyword, start: usize, span: Span) {
        let depth = self.nesting.depth;
        if self
            .nesting
            .switches
            .last()
            .is_none_or(|open| open.depth != depth)
        {
            self.out_of_place(keyword, start, span);
            return;
        }
        let label = (keyword == Keyword::Case).then(|| self.case_label());
        self.blanks();
        let complete = label != Some(None) && self.cursor.take(b':');
        let block = self.here();
        let mut repeated = false;
        if let Some(open) = self.nesting.switches.last_mut().filter(|_| complete) {
            match label.flatten() {
                Some(label) => open.cases.push(CaseLabel { label, block }),
                None => repeated = open.default.replace(block).is_some(),
            }
        }
        if complete && !repeated {
            let statement = label
                .flatten()
                .map_or(Statement::Default, |label| Statement::Case { label });
            self.push_program_code(start, statement);
            return;
        }
        let span = self.cursor.span_from(start);
        if repeated {
            self.label_twice(span);
        } else {
            self.report(
                &diagnostics::CASE_LABEL,
                span,
                "the label is not written as one",
                "Write case, a whole number and a colon, or default and a colon.",
            );
        }
        self.push_failed(start);
    }

    /// Tells of labels that stand again, in cases ascending by label and place.
    fn repeated_labels(&mut self, cases: &[CaseLabel]) {
        for pair in cases.windows(2).filter(|pair| pair[0].label == pair[1].label) {
            let Some(block) = self.blocks.get_mut(pair[1].block as usize) else {
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
            "the label stands twice in the switch",
            "Keep one of them.",
        );
    }

    /// A whole number with an optional sign.
    fn case_label(&mut self) -> Option<i64> {
        self.blanks();
        let negative = self.cursor.peek() == Some(b'-');
        if negative || self.cursor.peek() == Some(b'+') {
            self.cursor.advance(1);
        }
        let digits = self.cursor.digits();
        self.cursor.advance(digits.len());
        let label: i64 = digits.parse().ok()?;
        Some(if negative { -label } else { label })
    }

    /// Begins what `break` leaves; how many breaks were open before it.
    fn enter(&mut self) -> usize {
        self.nesting.leavable += 1;
        self.nesting.breaks.len()
    }

    /// Ends what `break` leaves: the breaks since then go on here.
    fn leave(&mut self, breaks: usize) {
        self.nesting.leavable -= 1;
        for code in self.nesting.breaks.split_off(breaks) {
            self.go_on_here(Some(code));
        }
    }

    /// The index of the block to come.
    fn here(&self) -> u32 {
        index(self.blocks.len())
    }

    /// Settles that a program code goes on with the block to come.
    fn go_on_here(&mut self, code: Option<usize>) {
        let here = self.here();
        let Some(code) = code.and_then(|code| self.program_codes.get_mut(code)) else {
            return;
        };
        match &mut code.statement {
            Statement::If { otherwise: to, .. }
            | Statement::Else { end: to }
            | Statement::While { end: to, .. }
            | Statement::Break { end: to } => *to = here,
            _ => {}
        }
    }

    /// Notes that a line of the intermediate code begins here (D03).
    fn begin_line(&mut self) {
        self.flags = 0;
        self.line_start = self.cursor.at();
        self.comment_bytes_before = self.cursor.comment_bytes();
    }

    /// Reads `(condition)`; when it is wrong, passes it.
    fn condition(&mut self) -> Option<ExpressionId> {
        let at = self.cursor;
        let condition = self.condition_in_parentheses();
        if condition.is_none() {
            self.pass_parentheses(at);
        }
        condition
    }

    /// Passes from a place to the closing parenthesis of its line, if there is one, or what has been read there.
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
                    self.cursor
                        .advance((ahead.at() + 1).saturating_sub(self.cursor.at()));
                    return;
                }
                b')' => depth -= 1,
                b'\n' | b'{' | b'}' => return,
                _ => {}
            }
            ahead.pass_character();
        }
    }

    /// The keyword that comes next, across blank lines, without passing anything.
    fn next_keyword(&self) -> Option<Keyword> {
        let mut ahead = self.cursor;
        ahead.blank_lines(self.grammar).ok()?;
        keyword(ahead.letters())
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
        if !self.complete {
            return;
        }
        let span = self.cursor.span_from(start);
        self.report(
            &diagnostics::COMMAND_MISSING,
            Span::new(span.start, span.start + 1),
            "the commands are missing",
            "Write a command, or commands in braces.",
        );
        self.push_failed(start);
    }

    /// Goes one level deeper; false when that is too deep, which ends the reading.
    fn deeper(&mut self) -> bool {
        if self.nesting.depth >= NESTING_MAX {
            let at = index(self.cursor.at());
            self.report(
                &diagnostics::NESTING_TOO_DEEP,
                Span::new(at, at),
                format!("branches and repetitions nest deeper than {NESTING_MAX}"),
                "Move commands to a subprogram.",
            );
            self.complete = false;
            self.push_failed(self.cursor.at());
            self.cursor.finish();
            return false;
        }
        self.nesting.depth += 1;
        true
    }

    /// Reads commands in braces; the cursor stands at the opening one.
    fn braces(&mut self) {
        if !self.deeper() {
            return;
        }
        let start = self.cursor.at();
        self.begin_line();
        self.cursor.advance(1);
        self.push_program_code(start, Statement::Open);
        self.nesting.braces += 1;
        loop {
            self.code_line = self.cursor.line();
            self.blank_lines();
            match self.cursor.peek() {
                Some(b'}') => {
                    let end = self.cursor.at();
                    self.begin_line();
                    self.cursor.advance(1);
                    self.push_program_code(end, Statement::Close);
                    break;
                }
                Some(_) => self.line(true),
                None => {
                    if self.complete {
                        self.report(
                            &diagnostics::BRACE_UNMATCHED,
                            Span::new(index(start), index(start + 1)),
                            "`{` is not closed",
                            "Write `}` where it ends.",
                        );
                        self.push_failed(start);
                    }
                    self.complete = false;
                    break;
                }
            }
        }
        self.nesting.braces -= 1;
        self.nesting.depth -= 1;
    }

    /// Adds a program code that ends here, as a block; its index among the program codes.
    pub(super) fn push_program_code(&mut self, start: usize, statement: Statement) -> usize {
        let code = self.program_codes.len();
        let span = self.cursor.span_from(start);
        self.program_codes.push(ProgramCode { statement, span });
        self.blocks.push(Block {
            start: index(start),
            line: self.cursor.line_of(start),
            flags: self.flags,
            content: Content::ProgramCode(index(code)),
        });
        code
    }
}
