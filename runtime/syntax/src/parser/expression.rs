//! Expressions: priority climbing over the arithmetic operators (manual 4-1).

use super::{NESTING_MAX, Parser, index};
use crate::cursor::NumberError;
use crate::diagnostics;
use crate::program_code::{BinaryOperator, Expression, ExpressionId, Function};

impl Parser<'_> {
    /// Reads an expression; `None` when an error has been reported.
    pub(super) fn expression(&mut self) -> Option<ExpressionId> {
        self.sum(0)
    }

    fn sum(&mut self, depth: usize) -> Option<ExpressionId> {
        let mut left = self.product(depth)?;
        loop {
            self.blanks();
            let operator = match self.cursor.peek() {
                Some(b'+') => BinaryOperator::Add,
                Some(b'-') => BinaryOperator::Subtract,
                _ => return Some(left),
            };
            self.cursor.advance(1);
            let right = self.product(depth)?;
            left = self.node(Expression::Binary {
                operator,
                left,
                right,
            });
        }
    }

    fn product(&mut self, depth: usize) -> Option<ExpressionId> {
        let mut left = self.unary(depth)?;
        loop {
            self.blanks();
            let operator = match self.cursor.peek() {
                Some(b'*') => BinaryOperator::Multiply,
                Some(b'/') => BinaryOperator::Divide,
                Some(b'%') => BinaryOperator::Modulo,
                _ => return Some(left),
            };
            self.cursor.advance(1);
            let right = self.unary(depth)?;
            left = self.node(Expression::Binary {
                operator,
                left,
                right,
            });
        }
    }

    fn unary(&mut self, depth: usize) -> Option<ExpressionId> {
        self.blanks();
        let start = self.cursor.at();
        if self.too_long(start) {
            return None;
        }
        if depth >= NESTING_MAX {
            let span = self.cursor.span_from(start);
            self.report(
                &diagnostics::NESTING_TOO_DEEP,
                span,
                format!("the expression nests deeper than {NESTING_MAX}"),
                "Assign parts of it to variables first.",
            );
            return None;
        }
        match self.cursor.peek() {
            Some(b'-') => {
                self.cursor.advance(1);
                let operand = self.unary(depth + 1)?;
                Some(self.node(Expression::Negation(operand)))
            }
            Some(b'+') => {
                self.cursor.advance(1);
                // plus has no unary form: it may only be the sign of a number
                if matches!(self.cursor.peek(), Some(b'0'..=b'9' | b'.')) {
                    self.number(start)
                } else {
                    self.malformed(start, "a sign + stands before something that is no number")
                }
            }
            Some(b'0'..=b'9' | b'.') => self.number(start),
            Some(b'(') => {
                self.cursor.advance(1);
                let inner = self.sum(depth + 1)?;
                self.close(start)?;
                Some(inner)
            }
            Some(b'A'..=b'Z' | b'a'..=b'z' | b'_') => self.operand(start, depth),
            _ => self.malformed(start, "an operand is missing"),
        }
    }

    fn number(&mut self, start: usize) -> Option<ExpressionId> {
        match self.cursor.number(false) {
            Ok(value) => Some(self.node(Expression::Number(value))),
            Err(NumberError::TooLarge) => {
                let span = self.cursor.span_from(start);
                self.report(
                    &diagnostics::NUMBER_TOO_LARGE,
                    span,
                    "the number is too large",
                    "Write a smaller number.",
                );
                None
            }
            Err(NumberError::Missing | NumberError::Malformed) => {
                self.malformed(start, "a decimal point stands without a digit")
            }
        }
    }

    /// A variable or a function call.
    fn operand(&mut self, start: usize, depth: usize) -> Option<ExpressionId> {
        if let Some(name) = self.variable() {
            let span = self.cursor.span_from(start);
            let variable = self.existing_variable(name, span)?;
            return Some(self.node(Expression::Variable(variable)));
        }
        let name = self.cursor.name();
        self.cursor.advance(name.len());
        if self.cursor.peek() == Some(b'[') {
            let span = self.cursor.span_from(start);
            self.report(
                &diagnostics::INDIRECTION_MALFORMED,
                span,
                "indirection cannot be used in a program code",
                "Name the variable by its number.",
            );
            return None;
        }
        let function = Function::ALL
            .iter()
            .copied()
            .find(|function| function.text().eq_ignore_ascii_case(name));
        let Some(function) = function else {
            return self.malformed(start, &format!("`{name}` is neither a variable nor a function"));
        };
        self.blanks();
        if !self.cursor.take(b'(') {
            return self.malformed(start, &format!("`{}` needs parentheses", function.text()));
        }
        let first = self.sum(depth + 1)?;
        let mut second = None;
        if function.arguments() == 2 {
            self.blanks();
            if !self.cursor.take(b',') {
                return self.malformed(start, &format!("`{}` needs two arguments", function.text()));
            }
            second = Some(self.sum(depth + 1)?);
        }
        self.close(start)?;
        Some(self.node(Expression::Call {
            function,
            first,
            second,
        }))
    }

    fn close(&mut self, start: usize) -> Option<()> {
        self.blanks();
        if self.cursor.take(b')') {
            return Some(());
        }
        self.malformed(start, "a closing parenthesis is missing");
        None
    }

    fn malformed(&mut self, start: usize, message: &str) -> Option<ExpressionId> {
        let span = self.cursor.span_from(start);
        self.report(
            &diagnostics::EXPRESSION_MALFORMED,
            span,
            message,
            "Write numbers, variables, functions, + - * / % and parentheses.",
        );
        None
    }

    fn node(&mut self, expression: Expression) -> ExpressionId {
        let id = ExpressionId(index(self.expressions.len()));
        self.expressions.push(expression);
        id
    }
}
