//! Parses expressions and conditions by the priorities of their operators (manual 4-1).

use super::{NESTING_MAX, Parser, index};
use crate::cursor::NumberError;
use crate::diagnostics;
use crate::program_code::{Expression, ExpressionId, Function, Operator};

/// Kind of a parsed expression (D09).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Number,
    Condition,
    /// `isnan(...)`: a condition, and 0 or 1 as a number (manual 4-1-3).
    Either,
}

/// A node of an expression, and its kind.
type Node = (ExpressionId, Kind);

impl Parser<'_> {
    /// Reads an arithmetic expression at this nesting depth. Returns `None` if an error was reported.
    pub(super) fn expression(&mut self, depth: usize) -> Option<ExpressionId> {
        let start = self.cursor.at();
        let node = self.operations(depth, 1)?;
        self.require_kind(Kind::Number, start, node)
    }

    /// Reads a number or a condition in parentheses. Returns `None` if an error was reported.
    pub(super) fn in_parentheses(&mut self, kind: Kind, depth: usize) -> Option<ExpressionId> {
        self.blanks();
        let start = self.cursor.at();
        if !self.cursor.skip_byte(b'(') {
            return self.malformed(start, "parentheses are missing");
        }
        let node = self.operations(depth, 1)?;
        self.close(start)?;
        self.require_kind(kind, start, node)
    }

    /// Returns the expression of a node with this kind; for another kind, reports an error and returns
    /// `None`.
    fn require_kind(&mut self, kind: Kind, start: usize, (id, found): Node) -> Option<ExpressionId> {
        if found == kind || found == Kind::Either {
            return Some(id);
        }
        let (message, help) = match found {
            Kind::Condition => (
                "a number is needed here, not a condition",
                "Use if to set a variable.",
            ),
            _ => (
                "a condition is needed here, not a number",
                "Compare it, for example != 0.",
            ),
        };
        self.report_from(start, &diagnostics::CONDITION_KIND, message, help);
        None
    }

    /// Reads operands joined by operators of this priority or a higher one. Operators of equal priority join
    /// from the left.
    fn operations(&mut self, depth: usize, priority: u8) -> Option<Node> {
        if priority > Operator::PRIORITY_MAX {
            return self.unary(depth);
        }
        let start = self.cursor.at();
        let mut left = self.operations(depth, priority + 1)?;
        let mut compared = false;
        loop {
            self.blanks();
            let at = self.cursor.at();
            let Some(operator) = self.operator(priority) else {
                return Some(left);
            };
            if compared {
                self.report_from(
                    at,
                    &diagnostics::CONDITION_KIND,
                    "comparisons cannot be chained",
                    "Join two comparisons with &&.",
                );
                return None;
            }
            let (operands, result) = match operator {
                Operator::Or | Operator::And => (Kind::Condition, Kind::Condition),
                _ if operator.compares() => (Kind::Number, Kind::Condition),
                _ => (Kind::Number, Kind::Number),
            };
            let left_id = self.require_kind(operands, start, left)?;
            let right_start = self.cursor.at();
            let right = self.operations(depth, priority + 1)?;
            let right = self.require_kind(operands, right_start, right)?;
            let node = Expression::Binary {
                operator,
                left: left_id,
                right,
            };
            left = (self.node(node), result);
            compared = operator.compares();
        }
    }

    /// Reads an operator of this priority; `None` if the cursor is not at such an operator.
    fn operator(&mut self, priority: u8) -> Option<Operator> {
        let mut operators = Operator::ALL.iter().copied();
        let found = operators
            .find(|operator| operator.priority() == priority && self.cursor.begins_with(operator.text()))?;
        self.cursor.advance(found.text().len());
        Some(found)
    }

    fn unary(&mut self, depth: usize) -> Option<Node> {
        self.blanks();
        let start = self.cursor.at();
        if self.too_long(start) {
            return None;
        }
        if depth >= NESTING_MAX {
            self.report_from(
                start,
                &diagnostics::NESTING_TOO_DEEP,
                format!("the expression is nested deeper than {NESTING_MAX}"),
                "Assign parts of it to variables first.",
            );
            return None;
        }
        match self.cursor.peek() {
            Some(b'-') => {
                self.cursor.advance(1);
                let operand = self.unary(depth + 1)?;
                let operand = self.require_kind(Kind::Number, start, operand)?;
                Some((self.node(Expression::Negation(operand)), Kind::Number))
            }
            Some(b'!') => {
                self.cursor.advance(1);
                let inner = self.in_parentheses(Kind::Condition, depth + 1)?;
                Some((self.node(Expression::Not(inner)), Kind::Condition))
            }
            Some(b'+') => {
                self.cursor.advance(1);
                // the language has no unary plus: a plus may only be the sign of a number
                if matches!(self.cursor.peek(), Some(b'0'..=b'9' | b'.')) {
                    self.number(start)
                } else {
                    self.malformed(start, "the sign + is allowed only before a number")
                }
            }
            Some(b'0'..=b'9' | b'.') => self.number(start),
            Some(b'(') => {
                self.cursor.advance(1);
                let inner = self.operations(depth + 1, 1)?;
                self.close(start)?;
                Some(inner)
            }
            Some(b'A'..=b'Z' | b'a'..=b'z' | b'_') => self.operand(start, depth),
            _ => self.malformed(start, "an operand is missing"),
        }
    }

    fn number(&mut self, start: usize) -> Option<Node> {
        match self.cursor.number(false) {
            Ok(_) if self.pass_exponent() => {
                let text = self.cursor.excerpt(self.cursor.span_from(start));
                self.report_from(
                    start,
                    &diagnostics::NUMBER_MALFORMED,
                    format!("`{text}` is not a number"),
                    "Write it without an exponent, for example 1000, or with exp2 and pow.",
                );
                None
            }
            Ok(number) => Some((self.node(Expression::Number(number.value)), Kind::Number)),
            Err(NumberError::TooLarge) => {
                self.report_from(
                    start,
                    &diagnostics::NUMBER_TOO_LARGE,
                    "the number is too large",
                    "Write a smaller number.",
                );
                None
            }
            Err(NumberError::Missing | NumberError::Malformed) => {
                self.malformed(start, "a decimal point has no digit")
            }
        }
    }

    /// Reads a variable or a function call.
    fn operand(&mut self, start: usize, depth: usize) -> Option<Node> {
        if let Some(name) = self.variable() {
            let span = self.cursor.span_from(start);
            let variable = self.existing_variable(name, span)?;
            return Some((self.node(Expression::Variable(variable)), Kind::Number));
        }
        let name = self.cursor.name();
        self.cursor.advance(name.len());
        if self.cursor.peek() == Some(b'[') {
            self.report_from(
                start,
                &diagnostics::INDIRECTION_MALFORMED,
                "indirection cannot be used in a program code",
                "Name the variable by its number.",
            );
            return None;
        }
        let Some(function) = Function::find(name) else {
            return self.malformed(start, &format!("`{name}` is neither a variable nor a function"));
        };
        self.blanks();
        if !self.cursor.skip_byte(b'(') {
            return self.malformed(start, &format!("`{}` needs parentheses", function.text()));
        }
        let first = self.expression(depth + 1)?;
        let mut second = None;
        if function.arguments() == 2 {
            self.blanks();
            if !self.cursor.skip_byte(b',') {
                return self.malformed(start, &format!("`{}` needs two arguments", function.text()));
            }
            second = Some(self.expression(depth + 1)?);
        }
        self.close(start)?;
        let kind = if function == Function::Isnan {
            Kind::Either
        } else {
            Kind::Number
        };
        let call = Expression::Call {
            function,
            first,
            second,
        };
        Some((self.node(call), kind))
    }

    fn close(&mut self, start: usize) -> Option<()> {
        self.blanks();
        if self.cursor.skip_byte(b')') {
            return Some(());
        }
        self.malformed(start, "a closing parenthesis is missing")
    }

    fn malformed<T>(&mut self, start: usize, message: &str) -> Option<T> {
        self.report_from(
            start,
            &diagnostics::EXPRESSION_MALFORMED,
            message,
            "Write numbers, variables, functions, operators and parentheses.",
        );
        None
    }

    fn node(&mut self, expression: Expression) -> ExpressionId {
        let id = ExpressionId(index(self.tree.expressions.len()));
        self.tree.expressions.push(expression);
        id
    }
}
