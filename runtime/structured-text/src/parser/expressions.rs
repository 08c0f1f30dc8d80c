//! Expressions, from the operators of the lowest priority to those of the highest: IEC 61131-3, operators of
//! the ST language.

use tandem_model::Span;

use super::{KEYWORDS, ParseResult, Parser};
use crate::finding::{NOT_IN_SUBSET, SYNTAX, TOO_DEEP};
use crate::limits::NESTING_MAX;
use crate::tokens::TokenKind;
use crate::tree::{Argument, Binary, Expression, ExpressionKind, Unary};

/// Operators in ascending priority; those of one row are evaluated from left to right.
const LEVELS: [&[(&str, Binary)]; 7] = [
    &[("OR", Binary::Or)],
    &[("XOR", Binary::Xor)],
    &[("AND", Binary::And), ("&", Binary::And)],
    &[("=", Binary::Equal), ("<>", Binary::NotEqual)],
    &[
        ("<=", Binary::LessOrEqual),
        (">=", Binary::GreaterOrEqual),
        ("<", Binary::Less),
        (">", Binary::Greater),
    ],
    &[("+", Binary::Add), ("-", Binary::Subtract)],
    &[
        ("*", Binary::Multiply),
        ("/", Binary::Divide),
        ("MOD", Binary::Modulo),
    ],
];

impl Parser<'_> {
    pub(super) fn expression(&mut self) -> ParseResult<Expression> {
        self.deeper(|parser| parser.level(0))
    }

    fn level(&mut self, level: usize) -> ParseResult<Expression> {
        let Some(operators) = LEVELS.get(level) else {
            return self.power();
        };
        let mut left = self.level(level + 1)?;
        while let Some((_, operator)) = operators.iter().find(|(text, _)| self.is(text)) {
            self.advance();
            let right = self.level(level + 1)?;
            left = self.binary(*operator, left, right)?;
        }
        Ok(left)
    }

    /// Creates the node of an expression; reports a finding if the nesting is too deep. Operators in a row,
    /// `a + b + c`, are nested too.
    fn node(&mut self, kind: ExpressionKind, span: Span) -> ParseResult<Expression> {
        let node = Expression::new(kind, span);
        if node.height > NESTING_MAX {
            let what = format!("more than {NESTING_MAX} operators are nested or in a row");
            return Err(self.found(
                &TOO_DEEP,
                span,
                what,
                "assign a part of the expression to a variable",
            ));
        }
        Ok(node)
    }

    fn binary(&mut self, operator: Binary, left: Expression, right: Expression) -> ParseResult<Expression> {
        let span = left.span.to(right.span);
        self.node(
            ExpressionKind::Binary(operator, Box::new(left), Box::new(right)),
            span,
        )
    }

    fn power(&mut self) -> ParseResult<Expression> {
        let mut left = self.unary()?;
        while self.is("**") {
            // in edition 2 of the standard, ** has a higher priority than a sign, in edition 3 a lower one
            if matches!(left.kind, ExpressionKind::Unary(..)) {
                let what = "the base of ** has a sign, and editions of the standard differ in its priority";
                let help = "write (-a) ** b or -(a ** b)";
                return Err(self.found(&SYNTAX, left.span, what, help));
            }
            self.advance();
            let right = self.unary()?;
            if matches!(left.kind, ExpressionKind::Binary(Binary::Power, ..)) {
                let help = "write (a ** b) ** c or a ** (b ** c)";
                return Err(self.found(&SYNTAX, left.span, "two ** in a row are ambiguous", help));
            }
            left = self.binary(Binary::Power, left, right)?;
        }
        Ok(left)
    }

    fn unary(&mut self) -> ParseResult<Expression> {
        let start = self.span();
        let operators = [("-", Unary::Minus), ("+", Unary::Plus), ("NOT", Unary::Not)];
        let Some((_, operator)) = operators.into_iter().find(|(text, _)| self.accept(text)) else {
            return self.primary();
        };
        let of = self.deeper(Self::unary)?;
        let span = start.to(of.span);
        self.node(ExpressionKind::Unary(operator, Box::new(of)), span)
    }

    /// Returns true if the token is a name and not a keyword.
    pub(super) fn begins_name(&self) -> bool {
        matches!(self.token().map(|token| &token.kind), Some(TokenKind::Name(name)) if !KEYWORDS.contains(&name.as_str()))
    }

    /// Reads a literal, a variable with its parts, a call, or an expression in parentheses.
    pub(super) fn primary(&mut self) -> ParseResult<Expression> {
        let span = self.span();
        if let Some(TokenKind::Literal(literal, of)) = self.token().map(|token| token.kind.clone()) {
            self.advance();
            return self.node(ExpressionKind::Literal(literal, of), span);
        }
        if self.accept("(") {
            let inner = self.expression()?;
            self.expect(")")?;
            let kind = ExpressionKind::Parenthesized(Box::new(inner));
            let span = span.to(self.last_span());
            return self.node(kind, span);
        }
        // MOD is an operator, and a function of the same name
        let is_operator = self.is_any(&["MOD", "AND", "OR", "XOR"]) && self.is_next("(");
        if !(self.begins_name() || is_operator) {
            return Err(self.expected("a value"));
        }
        let Some(TokenKind::Name(name)) = self.token().map(|token| token.kind.clone()) else {
            return Err(self.expected("a value"));
        };
        self.advance();
        if self.accept("#") {
            let value = self.name()?;
            let of = crate::tree::Name { text: name, span };
            let span = span.to(value.span);
            return self.node(ExpressionKind::OfEnumeration(of, value), span);
        }
        let name = self.node(ExpressionKind::Name(name), span)?;
        self.parts(name)
    }

    /// Reads fields, indices and parameters after a name.
    fn parts(&mut self, of: Expression) -> ParseResult<Expression> {
        let mut whole = of;
        loop {
            let start = whole.span;
            let kind = if self.accept(".") {
                if self.is("%")
                    || matches!(
                        self.token().map(|token| &token.kind),
                        Some(TokenKind::Literal(..))
                    )
                {
                    let span = self.span();
                    let help = "write (SHR(a, 3) AND 1) = 1";
                    return Err(self.found(
                        &NOT_IN_SUBSET,
                        span,
                        "single bits are not part of this subset",
                        help,
                    ));
                }
                ExpressionKind::Field(Box::new(whole), self.name()?)
            } else if self.accept("[") {
                let mut indices = vec![self.expression()?];
                while self.accept(",") {
                    indices.push(self.expression()?);
                }
                self.expect("]")?;
                ExpressionKind::Index(Box::new(whole), indices)
            } else if self.accept("(") {
                let arguments = self.arguments()?;
                ExpressionKind::Call(Box::new(whole), arguments)
            } else {
                return Ok(whole);
            };
            let span = start.to(self.last_span());
            whole = self.node(kind, span)?;
        }
    }

    /// Reads arguments after `(`.
    fn arguments(&mut self) -> ParseResult<Vec<Argument>> {
        let mut arguments = Vec::new();
        if self.accept(")") {
            return Ok(arguments);
        }
        loop {
            if self.is("NOT")
                && self
                    .tokens
                    .get(self.at + 2)
                    .is_some_and(|token| Self::is_text(token, "=>"))
            {
                let span = self.span();
                let help = "write Q => a, then a := NOT a";
                return Err(self.found(
                    &NOT_IN_SUBSET,
                    span,
                    "NOT before => is not part of this subset",
                    help,
                ));
            }
            let (is_input, is_output) = (self.is_next(":="), self.is_next("=>"));
            let name = if is_input || is_output {
                let name = self.name()?;
                self.advance();
                Some(name)
            } else {
                None
            };
            let value = self.expression()?;
            arguments.push(Argument {
                name,
                is_output,
                value,
            });
            if !self.accept(",") {
                break;
            }
        }
        self.expect(")")?;
        Ok(arguments)
    }
}
