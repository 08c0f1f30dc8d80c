//! Statements.

use super::{ParseResult, Parser};
use crate::finding::SYNTAX;
use crate::tree::{ExpressionKind, Label, Statement};

/// Words that end the statements within another statement or unit.
const ENDS: [&str; 12] = [
    "END_IF",
    "END_CASE",
    "END_FOR",
    "END_WHILE",
    "END_REPEAT",
    "END_PROGRAM",
    "END_FUNCTION",
    "END_FUNCTION_BLOCK",
    "PROGRAM",
    "FUNCTION",
    "FUNCTION_BLOCK",
    "TYPE",
];

impl Parser<'_> {
    /// Reads statements up to one of these words. A statement with a mistake is omitted.
    pub(super) fn statements(&mut self, ends: &[&str]) -> Vec<Statement> {
        let mut statements = Vec::new();
        while !self.is_any(ends) && !self.is_any(&ENDS) && !self.is_end() {
            if self.accept(";") {
                continue;
            }
            let before = self.at;
            match self.deeper(Self::statement) {
                Ok(statement) => statements.push(statement),
                Err(_) => self.skip_statement(before, ends),
            }
        }
        statements
    }

    /// Skips to after the next semicolon, or to an end.
    fn skip_statement(&mut self, before: usize, ends: &[&str]) {
        if self.at == before {
            self.advance();
        }
        while !self.is_end() && !self.is_any(ends) && !self.is_any(&ENDS) {
            if self.accept(";") {
                return;
            }
            self.advance();
        }
        // the end of a statement whose beginning is wrong
        let closes = ["END_IF", "END_CASE", "END_FOR", "END_WHILE", "END_REPEAT"];
        if self.is_any(&closes) && !self.is_any(ends) {
            self.advance();
            self.accept(";");
        }
    }

    fn statement(&mut self) -> ParseResult<Statement> {
        let span = self.span();
        let statement = if self.accept("IF") {
            self.if_statement()?
        } else if self.accept("CASE") {
            self.case()?
        } else if self.accept("FOR") {
            self.for_statement()?
        } else if self.accept("WHILE") {
            let condition = self.expression()?;
            self.expect("DO")?;
            let body = self.statements(&["END_WHILE"]);
            self.expect("END_WHILE")?;
            Statement::While(condition, body)
        } else if self.accept("REPEAT") {
            let body = self.statements(&["UNTIL"]);
            self.expect("UNTIL")?;
            let condition = self.expression()?;
            self.accept(";");
            self.expect("END_REPEAT")?;
            Statement::Repeat(body, condition)
        } else if self.accept("EXIT") {
            Statement::Exit(span)
        } else if self.accept("CONTINUE") {
            Statement::Continue(span)
        } else if self.accept("RETURN") {
            Statement::Return
        } else {
            return self.assignment_or_call();
        };
        self.semicolon()?;
        Ok(statement)
    }

    /// Reads the semicolon after a statement. The standard also requires one after `END_...`.
    fn semicolon(&mut self) -> ParseResult<()> {
        if self.accept(";") {
            return Ok(());
        }
        let span = self.last_span();
        Err(self.found(
            &SYNTAX,
            span,
            "a semicolon is missing after this",
            "write ; after each statement",
        ))
    }

    fn assignment_or_call(&mut self) -> ParseResult<Statement> {
        let is_outside = super::OUTSIDE.iter().any(|(word, _)| self.is(word));
        let is_variable = [":=", "(", ".", "["].iter().any(|text| self.is_next(text));
        if (is_outside && !is_variable) || !self.begins_name() {
            return Err(self.expected("a statement"));
        }
        let to = self.primary()?;
        if self.accept(":=") {
            let value = self.expression()?;
            self.semicolon()?;
            return Ok(Statement::Assign { to, value });
        }
        if matches!(to.kind, ExpressionKind::Call(..)) {
            self.semicolon()?;
            return Ok(Statement::Call(to));
        }
        if self.is("=") {
            let span = self.span();
            return Err(self.found(&SYNTAX, span, "= compares", "write := to assign"));
        }
        Err(self.expected(":= or ("))
    }

    fn if_statement(&mut self) -> ParseResult<Statement> {
        let ends = ["ELSIF", "ELSE", "END_IF"];
        let mut branches = Vec::new();
        loop {
            let condition = self.expression()?;
            self.expect("THEN")?;
            branches.push((condition, self.statements(&ends)));
            if !self.accept("ELSIF") {
                break;
            }
        }
        let otherwise = if self.accept("ELSE") {
            self.statements(&["END_IF"])
        } else {
            Vec::new()
        };
        self.expect("END_IF")?;
        Ok(Statement::If(branches, otherwise))
    }

    fn case(&mut self) -> ParseResult<Statement> {
        let selector = self.expression()?;
        self.expect("OF")?;
        let mut branches = Vec::new();
        while !self.is_any(&["ELSE", "END_CASE"]) {
            let mut labels = vec![self.label()?];
            while self.accept(",") {
                labels.push(self.label()?);
            }
            self.expect(":")?;
            branches.push((labels, self.branch()));
        }
        let otherwise = if self.accept("ELSE") {
            self.statements(&["END_CASE"])
        } else {
            Vec::new()
        };
        self.expect("END_CASE")?;
        Ok(Statement::Case {
            selector,
            branches,
            otherwise,
        })
    }

    fn label(&mut self) -> ParseResult<Label> {
        let from = self.expression()?;
        let to = if self.accept("..") {
            Some(self.expression()?)
        } else {
            None
        };
        Ok(Label { from, to })
    }

    /// Reads statements up to the labels of the next branch.
    fn branch(&mut self) -> Vec<Statement> {
        let ends = ["ELSE", "END_CASE"];
        let mut statements = Vec::new();
        while !self.is_any(&ends) && !self.is_any(&ENDS) && !self.is_end() && !self.is_label() {
            if self.accept(";") {
                continue;
            }
            let before = self.at;
            match self.deeper(Self::statement) {
                Ok(statement) => statements.push(statement),
                Err(_) => self.skip_statement(before, &ends),
            }
        }
        statements
    }

    /// Returns true at labels: tokens that no statement has before a colon.
    fn is_label(&self) -> bool {
        for token in self.tokens.get(self.at..).unwrap_or_default() {
            if Self::is_text(token, ":") {
                return true;
            }
            let is_part = match &token.kind {
                crate::tokens::TokenKind::Literal(..) => true,
                crate::tokens::TokenKind::Name(name) => !super::KEYWORDS.contains(&name.as_str()),
                crate::tokens::TokenKind::Symbol(symbol) => [",", "..", "-", "+", "#", "*"].contains(symbol),
                crate::tokens::TokenKind::Refused | crate::tokens::TokenKind::End => false,
            };
            if !is_part {
                return false;
            }
        }
        false
    }

    fn for_statement(&mut self) -> ParseResult<Statement> {
        let variable = self.name()?;
        self.expect(":=")?;
        let from = self.expression()?;
        self.expect("TO")?;
        let to = self.expression()?;
        let by = if self.accept("BY") {
            Some(self.expression()?)
        } else {
            None
        };
        self.expect("DO")?;
        let body = self.statements(&["END_FOR"]);
        self.expect("END_FOR")?;
        Ok(Statement::For {
            variable,
            from,
            to,
            by,
            body,
        })
    }
}
