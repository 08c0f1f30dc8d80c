//! Expressions and conditions: priority climbing over the operators (manual 4-1).

use super::{NESTING_MAX, Parser, index};
use crate::cursor::NumberError;
use crate::diagnostics;
use crate::program_code::{BinaryOperator, Comparator, Expression, ExpressionId, Function};

/// What an expression has turned out to be (D09).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Number,
    Condition,
    /// `isnan(...)`: a condition, and 0 or 1 as a number (manual 4-1-3).
    Either,
}

/// A node and its kind.
type Node = (ExpressionId, Kind);

impl Parser<'_> {
    /// Reads a number's expression; `None` when an error has been reported.
    pub(super) fn expression(&mut self) -> Option<ExpressionId> {
        let start = self.cursor.at();
        let node = self.join(0)?;
        self.as_number(start, node)
    }

    /// Reads `(condition)`; `None` when an error has been reported.
    pub(super) fn condition_in_parentheses(&mut self) -> Option<ExpressionId> {
        let start = self.open_parenthesis()?;
        let node = self.join(0)?;
        self.close(start)?;
        self.as_condition(start, node)
    }

    /// Reads `(expression)`; `None` when an error has been reported.
    pub(super) fn number_in_parentheses(&mut self) -> Option<ExpressionId> {
        let start = self.open_parenthesis()?;
        let node = self.join(0)?;
        self.close(start)?;
        self.as_number(start, node)
    }

    fn open_parenthesis(&mut self) -> Option<usize> {
        self.blanks();
        let start = self.cursor.at();
        if self.cursor.take(b'(') {
            return Some(start);
        }
        self.malformed(start, "parentheses are missing");
        None
    }

    fn as_number(&mut self, start: usize, (id, kind): Node) -> Option<ExpressionId> {
        if kind != Kind::Condition {
            return Some(id);
        }
        self.wrong_kind(
            start,
            "a condition stands where a number is needed",
            "Use if to set a variable.",
        );
        None
    }

    fn as_condition(&mut self, start: usize, (id, kind): Node) -> Option<ExpressionId> {
        if kind != Kind::Number {
            return Some(id);
        }
        self.wrong_kind(
            start,
            "a number stands where a condition is needed",
            "Compare it, for example != 0.",
        );
        None
    }

    fn wrong_kind(&mut self, start: usize, message: &str, help: &str) {
        let span = self.cursor.span_from(start);
        self.report(&diagnostics::CONDITION_KIND, span, message, help);
    }

    fn join(&mut self, depth: usize) -> Option<Node> {
        let start = self.cursor.at();
        let mut left = self.conjunction(depth)?;
        while self.take_pair(*b"||") {
            let left_id = self.as_condition(start, left)?;
            let right_start = self.cursor.at();
            let right = self.conjunction(depth)?;
            left = self.joined(false, left_id, right_start, right)?;
        }
        Some(left)
    }

    fn conjunction(&mut self, depth: usize) -> Option<Node> {
        let start = self.cursor.at();
        let mut left = self.comparison(depth)?;
        while self.take_pair(*b"&&") {
            let left_id = self.as_condition(start, left)?;
            let right_start = self.cursor.at();
            let right = self.comparison(depth)?;
            left = self.joined(true, left_id, right_start, right)?;
        }
        Some(left)
    }

    fn joined(&mut self, both: bool, left: ExpressionId, start: usize, right: Node) -> Option<Node> {
        let right = self.as_condition(start, right)?;
        Some((self.node(Expression::Join { both, left, right }), Kind::Condition))
    }

    fn comparison(&mut self, depth: usize) -> Option<Node> {
        let start = self.cursor.at();
        let left = self.sum(depth)?;
        let Some(comparator) = self.comparator() else {
            return Some(left);
        };
        let left = self.as_number(start, left)?;
        let right_start = self.cursor.at();
        let right = self.sum(depth)?;
        let right = self.as_number(right_start, right)?;
        let node = self.node(Expression::Comparison {
            comparator,
            left,
            right,
        });
        let again = self.cursor.at();
        if self.comparator().is_some() {
            self.wrong_kind(
                again,
                "a comparison does not chain",
                "Join two comparisons with &&.",
            );
            return None;
        }
        Some((node, Kind::Condition))
    }

    fn comparator(&mut self) -> Option<Comparator> {
        self.blanks();
        let first = self.cursor.peek()?;
        let equal = self.cursor.peek_second() == Some(b'=');
        let comparator = match (first, equal) {
            (b'=', true) => Comparator::Equal,
            (b'!', true) => Comparator::NotEqual,
            (b'<', true) => Comparator::LessOrEqual,
            (b'>', true) => Comparator::GreaterOrEqual,
            (b'<', false) => Comparator::Less,
            (b'>', false) => Comparator::Greater,
            _ => return None,
        };
        self.cursor.advance(comparator.text().len());
        Some(comparator)
    }

    /// Passes two equal characters if they are there.
    fn take_pair(&mut self, pair: [u8; 2]) -> bool {
        self.blanks();
        let found = self.cursor.peek() == Some(pair[0]) && self.cursor.peek_second() == Some(pair[1]);
        if found {
            self.cursor.advance(2);
        }
        found
    }

    fn sum(&mut self, depth: usize) -> Option<Node> {
        self.operations(depth, Self::product, |byte| match byte {
            b'+' => Some(BinaryOperator::Add),
            b'-' => Some(BinaryOperator::Subtract),
            _ => None,
        })
    }

    fn product(&mut self, depth: usize) -> Option<Node> {
        self.operations(depth, Self::unary, |byte| match byte {
            b'*' => Some(BinaryOperator::Multiply),
            b'/' => Some(BinaryOperator::Divide),
            b'%' => Some(BinaryOperator::Modulo),
            _ => None,
        })
    }

    /// Operands of one priority, combined from the left.
    fn operations(
        &mut self,
        depth: usize,
        operand: impl Fn(&mut Self, usize) -> Option<Node>,
        operator: impl Fn(u8) -> Option<BinaryOperator>,
    ) -> Option<Node> {
        let start = self.cursor.at();
        let mut left = operand(self, depth)?;
        loop {
            self.blanks();
            let Some(operator) = self.cursor.peek().and_then(&operator) else {
                return Some(left);
            };
            self.cursor.advance(1);
            let left_id = self.as_number(start, left)?;
            let right_start = self.cursor.at();
            let right = operand(self, depth)?;
            let right = self.as_number(right_start, right)?;
            left = (
                self.node(Expression::Binary {
                    operator,
                    left: left_id,
                    right,
                }),
                Kind::Number,
            );
        }
    }

    fn unary(&mut self, depth: usize) -> Option<Node> {
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
                let operand = self.as_number(start, operand)?;
                Some((self.node(Expression::Negation(operand)), Kind::Number))
            }
            Some(b'!') => {
                self.cursor.advance(1);
                let open = self.open_parenthesis()?;
                let inner = self.join(depth + 1)?;
                self.close(open)?;
                let inner = self.as_condition(open, inner)?;
                Some((self.node(Expression::Not(inner)), Kind::Condition))
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
                let inner = self.join(depth + 1)?;
                self.close(start)?;
                Some(inner)
            }
            Some(b'A'..=b'Z' | b'a'..=b'z' | b'_') => self.operand(start, depth),
            _ => self.malformed(start, "an operand is missing"),
        }
    }

    fn argument(&mut self, depth: usize) -> Option<ExpressionId> {
        let start = self.cursor.at();
        let node = self.join(depth + 1)?;
        self.as_number(start, node)
    }

    fn number(&mut self, start: usize) -> Option<Node> {
        match self.cursor.number(false).map(|number| number.value) {
            Ok(value) => Some((self.node(Expression::Number(value)), Kind::Number)),
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
    fn operand(&mut self, start: usize, depth: usize) -> Option<Node> {
        if let Some(name) = self.variable() {
            let span = self.cursor.span_from(start);
            let variable = self.existing_variable(name, span)?;
            return Some((self.node(Expression::Variable(variable)), Kind::Number));
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
        let first = self.argument(depth)?;
        let mut second = None;
        if function.arguments() == 2 {
            self.blanks();
            if !self.cursor.take(b',') {
                return self.malformed(start, &format!("`{}` needs two arguments", function.text()));
            }
            second = Some(self.argument(depth)?);
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
        if self.cursor.take(b')') {
            return Some(());
        }
        self.malformed(start, "a closing parenthesis is missing");
        None
    }

    fn malformed(&mut self, start: usize, message: &str) -> Option<Node> {
        let span = self.cursor.span_from(start);
        self.report(
            &diagnostics::EXPRESSION_MALFORMED,
            span,
            message,
            "Write numbers, variables, functions, operators and parentheses.",
        );
        None
    }

    fn node(&mut self, expression: Expression) -> ExpressionId {
        let id = ExpressionId(index(self.expressions.len()));
        self.expressions.push(expression);
        id
    }
}
