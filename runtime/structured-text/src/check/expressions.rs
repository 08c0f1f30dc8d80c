//! Expressions and their types.

use tandem_model::Span;

use super::Checker;
use crate::calculate;
use crate::code::{Expr, ExprKind};
use crate::convert::{convert, is_conversion};
use crate::finding::{CONSTANT_FAULT, LITERAL_RANGE, NARROWING, NOT_CONSTANT, TYPE, UNKNOWN};
use crate::tokens::Literal;
use crate::tree::{Expression, ExpressionKind, Name, Unary};
use crate::types::{Elementary, Type};
use crate::value::{Fault, Value};

/// The type of an expression.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum ExprType {
    Type(Type),
    /// An integer without a type, which takes the wanted type.
    Integer,
    /// A number with a fraction and without a type, which takes the wanted real type.
    Real,
    /// A function without a result.
    Nothing,
}

/// A checked expression.
#[derive(Debug, Clone)]
pub(super) struct TypedExpr {
    pub expr: Expr,
    pub of: ExprType,
}

impl TypedExpr {
    pub fn constant(value: Value, of: ExprType, span: Span) -> Self {
        let kind = ExprKind::Constant(value);
        Self {
            expr: Expr { kind, span },
            of,
        }
    }

    pub fn with_type(kind: ExprKind, of: impl Into<Type>, span: Span) -> Self {
        Self {
            expr: Expr { kind, span },
            of: ExprType::Type(of.into()),
        }
    }

    pub fn elementary(&self) -> Option<Elementary> {
        match &self.of {
            ExprType::Type(of) => of.elementary(),
            _ => None,
        }
    }

    /// Returns true for an integer with or without a type.
    pub fn is_int(&self) -> bool {
        self.of == ExprType::Integer || self.elementary().is_some_and(Elementary::is_int)
    }

    pub fn value(&self) -> Option<&Value> {
        match &self.expr.kind {
            ExprKind::Constant(value) => Some(value),
            _ => None,
        }
    }
}

impl std::fmt::Display for ExprType {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ExprType::Type(of) => of.fmt(f),
            ExprType::Integer => f.write_str("an integer"),
            ExprType::Real => f.write_str("a number with a fraction"),
            ExprType::Nothing => f.write_str("no value"),
        }
    }
}

impl Checker<'_> {
    /// Returns an expression with its type; `None` after a finding.
    pub(super) fn expression(&mut self, expression: &Expression) -> Option<TypedExpr> {
        let (span, wanted) = (expression.span, self.wanted.take());
        match &expression.kind {
            ExpressionKind::Literal(literal, of) => self.literal(literal, *of, span),
            ExpressionKind::Parenthesized(inner) => {
                self.wanted = wanted;
                self.expression(inner)
            }
            ExpressionKind::Name(name) if self.variable(name).is_none() && !self.is_refused(name) => {
                self.enumerator(name, span)
            }
            ExpressionKind::Name(_) | ExpressionKind::Field(..) | ExpressionKind::Index(..) => {
                self.load(expression)
            }
            ExpressionKind::OfEnumeration(of, value) => self.qualified_enumerator(of, value, span),
            ExpressionKind::Call(callee, arguments) => self.function_call(callee, arguments, (span, wanted)),
            ExpressionKind::Unary(operator, of) => {
                let of = self.expression(of)?;
                self.unary(*operator, of, span)
            }
            ExpressionKind::Binary(operator, left, right) => {
                let (left, right) = (self.expression(left), self.expression(right));
                self.binary(*operator, left?, right?, span)
            }
        }
    }

    /// Returns an expression that has a value; `None` after a finding.
    pub(super) fn valued(&mut self, expression: &Expression) -> Option<TypedExpr> {
        let typed = self.expression(expression)?;
        if typed.of == ExprType::Nothing {
            self.found(
                &TYPE,
                expression.span,
                "this function has no result",
                "call it as a statement",
            );
            return None;
        }
        Some(typed)
    }

    fn literal(&mut self, literal: &Literal, of: Option<Elementary>, span: Span) -> Option<TypedExpr> {
        let (value, natural) = match literal {
            Literal::Bool(value) => (Value::Bool(*value), ExprType::Type(Type::BOOL)),
            Literal::Integer(value) => (Value::Int(*value), ExprType::Integer),
            Literal::Real(value) => (Value::Real(*value), ExprType::Real),
            Literal::Text(text) => (Value::Text(text.clone()), ExprType::Type(Type::STRING)),
            Literal::Time(ns) => (Value::Int(*ns), ExprType::Type(Elementary::Time.into())),
        };
        let typed = TypedExpr::constant(value, natural, span);
        match of {
            None => Some(typed),
            Some(of) => {
                let expr = self.become_type(typed, &of.into())?;
                Some(TypedExpr {
                    expr,
                    of: ExprType::Type(of.into()),
                })
            }
        }
    }

    fn load(&mut self, expression: &Expression) -> Option<TypedExpr> {
        if let ExpressionKind::Name(name) = &expression.kind
            && let Some(variable) = self.variable(name)
            && let Some(value) = variable.constant.clone()
        {
            let of = ExprType::Type(variable.of.clone());
            return Some(TypedExpr::constant(value, of, expression.span));
        }
        let found = self.variable_part(expression)?;
        Some(TypedExpr::with_type(
            ExprKind::Load(Box::new(found.place)),
            found.of,
            expression.span,
        ))
    }

    fn enumerator(&mut self, name: &str, span: Span) -> Option<TypedExpr> {
        let found = self.enumerators.get(name).cloned().unwrap_or_default();
        match found.as_slice() {
            [(number, value)] => Some(self.enumeration_value(*number, *value, span)),
            [] => {
                let what = format!("{name} is unknown");
                self.found(
                    &UNKNOWN,
                    span,
                    what,
                    "declare it in VAR ... END_VAR, or correct its name",
                );
                None
            }
            _ => {
                let what = format!("{name} is a value of several enumerations");
                self.found(&UNKNOWN, span, what, "write its type before it: Type#Value");
                None
            }
        }
    }

    fn enumeration_value(&self, number: usize, value: i128, span: Span) -> TypedExpr {
        let of = Type::Enumeration(number, self.file.types[number].name.text.as_str().into());
        TypedExpr::constant(Value::Int(value), ExprType::Type(of), span)
    }

    fn qualified_enumerator(&mut self, of: &Name, value: &Name, span: Span) -> Option<TypedExpr> {
        let values = self
            .enumerators
            .get(value.text.as_str())
            .cloned()
            .unwrap_or_default();
        let found = values
            .iter()
            .find(|(number, _)| self.file.types[*number].name.text == of.text);
        if let Some((number, value)) = found {
            return Some(self.enumeration_value(*number, *value, span));
        }
        let what = format!("no type {} has a value {}", of.text, value.text);
        self.found(&UNKNOWN, span, what, "declare it by TYPE, or correct the name");
        None
    }

    fn unary(&mut self, operator: Unary, of: TypedExpr, span: Span) -> Option<TypedExpr> {
        let kind = of.elementary();
        match (operator, &of.of, of.value()) {
            (Unary::Minus, ExprType::Integer | ExprType::Real, Some(value)) => {
                let value = match value {
                    Value::Real(value) => Value::Real(-value),
                    value => Value::Int(-value.int()),
                };
                return Some(TypedExpr::constant(value, of.of, span));
            }
            (Unary::Plus, ExprType::Integer | ExprType::Real, _) => return Some(of),
            _ => {}
        }
        let fits = |kind: &Elementary| match operator {
            Unary::Not => *kind == Elementary::Bool || kind.is_bits(),
            Unary::Minus | Unary::Plus => kind.is_num() || *kind == Elementary::Time,
        };
        let Some(kind) = kind.filter(fits) else {
            let (what, help) = match operator {
                Unary::Not => (
                    "NOT needs a BOOL or a bit string",
                    "write a comparison, such as a = 0",
                ),
                Unary::Minus | Unary::Plus => (
                    "a sign is allowed only before a number or a TIME",
                    "remove the sign",
                ),
            };
            self.found(&TYPE, span, format!("{what}, not {}", of.of), help);
            return None;
        };
        let (value, expr) = (of.value().cloned(), Box::new(of.expr));
        let (folded, node) = match operator {
            Unary::Plus => (value.map(Ok), expr.kind),
            Unary::Not => (
                value.map(|value| Ok(calculate::not(&value, kind))),
                ExprKind::Not(expr, kind),
            ),
            Unary::Minus => (
                value.map(|value| calculate::minus(&value, kind)),
                ExprKind::Minus(expr, kind),
            ),
        };
        self.folded(folded, node, ExprType::Type(kind.into()), span)
    }

    /// Returns a node as a constant, if it is one.
    pub(super) fn folded(
        &mut self,
        folded: Option<Result<Value, Fault>>,
        node: ExprKind,
        of: ExprType,
        span: Span,
    ) -> Option<TypedExpr> {
        let kind = match folded {
            Some(Ok(value)) => ExprKind::Constant(value),
            Some(Err(fault)) => {
                self.found(
                    &CONSTANT_FAULT,
                    span,
                    format!("this constant is {fault}"),
                    "write another value",
                );
                return None;
            }
            None => node,
        };
        let expr = Expr { kind, span };
        Some(TypedExpr { expr, of })
    }

    /// Returns the expression converted to a type, if the conversion is implicit; `None` after a finding.
    pub(super) fn become_type(&mut self, typed: TypedExpr, to: &Type) -> Option<Expr> {
        let span = typed.expr.span;
        let wanted = to.elementary();
        match (&typed.of, wanted) {
            (ExprType::Integer | ExprType::Real, Some(to)) => return self.literal_as(&typed, to),
            (ExprType::Type(from), Some(to)) => {
                if let Some(from) = from.elementary() {
                    if from == to {
                        return Some(typed.expr);
                    }
                    if from.widens_to(to) {
                        return widened(typed.expr, from, to);
                    }
                    self.no_widening(from, to, span);
                    return None;
                }
            }
            (ExprType::Type(from), None) if from == to => return Some(typed.expr),
            _ => {}
        }
        let what = format!("{} is expected here, not {}", to, typed.of);
        self.found(&TYPE, span, what, format!("write a value of {to}"));
        None
    }

    fn no_widening(&mut self, from: Elementary, to: Elementary, span: Span) {
        let (from_name, to_name) = (from.text(), to.text());
        let what = format!("{from_name} is not converted to {to_name} implicitly");
        if is_conversion(from, to) {
            self.found(
                &NARROWING,
                span,
                what,
                format!("write {from_name}_TO_{to_name}(...)"),
            );
        } else {
            self.found(&TYPE, span, what, format!("write a value of {to_name}"));
        }
    }

    fn literal_as(&mut self, typed: &TypedExpr, to: Elementary) -> Option<Expr> {
        let (span, value) = (typed.expr.span, typed.value()?.clone());
        let constant = |value| {
            let kind = ExprKind::Constant(value);
            Some(Expr { kind, span })
        };
        if to.is_real() {
            let source = if typed.of == ExprType::Integer {
                Elementary::Lint
            } else {
                Elementary::Lreal
            };
            if let Ok(value) = convert(&value, source, to) {
                return constant(value);
            }
        } else if to.is_int() || to.is_bits() {
            if typed.of == ExprType::Real {
                let help = format!("write an integer, or LREAL_TO_{}(...)", to.text());
                self.found(
                    &NARROWING,
                    span,
                    format!("a number with a fraction is not a value of type {}", to.text()),
                    help,
                );
                return None;
            }
            if to
                .range()
                .is_some_and(|(low, high)| (low..=high).contains(&value.int()))
            {
                return constant(value);
            }
        } else {
            let help = match to {
                Elementary::Bool => "write TRUE or FALSE",
                Elementary::Time => "write a time, such as T#5s",
                _ => "write a string: '...'",
            };
            self.found(
                &TYPE,
                span,
                format!("{} is expected here, not a number", to.text()),
                help,
            );
            return None;
        }
        let range = to
            .range()
            .map_or_else(String::new, |(low, high)| format!("{low} to {high}"));
        let shown = if typed.of == ExprType::Integer {
            value.int().to_string()
        } else {
            value.real().to_string()
        };
        let what = format!("{shown} does not fit {}", to.text());
        self.found(
            &LITERAL_RANGE,
            span,
            what,
            format!("write a value in the range {range}").trim_end(),
        );
        None
    }

    /// Returns a condition; `None` after a finding.
    pub(super) fn condition(&mut self, expression: &Expression) -> Option<Expr> {
        let typed = self.valued(expression)?;
        self.become_type(typed, &Type::BOOL)
    }

    /// Returns an integer that is known before the program runs; `None` after a finding.
    pub(super) fn constant_int(&mut self, expression: &Expression) -> Option<i128> {
        let typed = self.valued(expression)?;
        let value = typed.value().filter(|_| typed.is_int());
        if value.is_none() {
            let help = "write a number, or a VAR CONSTANT";
            self.found(
                &NOT_CONSTANT,
                expression.span,
                "a constant integer is expected here",
                help,
            );
        }
        value.map(Value::int)
    }

    /// Checks that a constant string fits its variable.
    pub(super) fn fits_text(&mut self, value: &Value, of: &Type, span: Span) -> Option<()> {
        if let (Value::Text(text), Type::Text(max)) = (value, of) {
            let length = text.chars().count();
            if length > *max {
                let what = format!("a string of {length} characters does not fit {of}");
                self.found(
                    &LITERAL_RANGE,
                    span,
                    what,
                    "write a shorter one, or a longer STRING",
                );
                return None;
            }
        }
        Some(())
    }
}

/// Returns a value converted to a wider type.
fn widened(expr: Expr, from: Elementary, to: Elementary) -> Option<Expr> {
    if !(to.is_real() && from.is_int()) {
        return Some(expr);
    }
    let span = expr.span;
    let kind = match &expr.kind {
        ExprKind::Constant(value) => ExprKind::Constant(convert(value, from, to).ok()?),
        _ => ExprKind::Convert(Box::new(expr), from, to),
    };
    Some(Expr { kind, span })
}
