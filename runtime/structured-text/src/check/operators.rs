//! Operators with two sides.

use tandem_model::Span;

use super::Checker;
use super::expressions::{ExprType, TypedExpr};
use crate::calculate::{calculate, compare, scale_time};
use crate::code::ExprKind;
use crate::finding::{CONSTANT_FAULT, TYPE};
use crate::tree::Binary;
use crate::types::{Elementary, Type};
use crate::value::Value;

impl Checker<'_> {
    pub(super) fn binary(
        &mut self,
        operator: Binary,
        left: TypedExpr,
        right: TypedExpr,
        span: Span,
    ) -> Option<TypedExpr> {
        if let (ExprType::Type(Type::Enumeration(..)), ExprType::Type(_)) = (&left.of, &right.of)
            && left.of == right.of
            && matches!(operator, Binary::Equal | Binary::NotEqual)
        {
            return self.comparison(operator, left, right, span);
        }
        let is_scaled = matches!(operator, Binary::Multiply | Binary::Divide);
        if left.elementary() == Some(Elementary::Time) && is_scaled {
            return self.scaled(operator, left, right, span);
        }
        if operator == Binary::Power {
            return self.power(left, right, span);
        }
        let untyped = |typed: &TypedExpr| matches!(typed.of, ExprType::Integer | ExprType::Real);
        if untyped(&left) && untyped(&right) && !matches!(operator, Binary::And | Binary::Or | Binary::Xor) {
            return self.untyped(operator, &left, &right, span);
        }
        let Some(kind) = common(&left, &right) else {
            let what = format!(
                "{} and {} have no common type for {}",
                left.of,
                right.of,
                operator.text()
            );
            self.found(
                &TYPE,
                span,
                what,
                "convert one of them, such as by DINT_TO_REAL(...)",
            );
            return None;
        };
        self.takes(operator, kind, span)?;
        let of = Type::from(kind);
        let left = self.become_type(left, &of)?;
        let right = self.become_type(right, &of)?;
        let typed = |expr| TypedExpr {
            expr,
            of: ExprType::Type(of.clone()),
        };
        let (left, right) = (typed(left), typed(right));
        if operator.is_comparison() {
            return self.comparison(operator, left, right, span);
        }
        let values = left.value().zip(right.value());
        let folded = values.map(|(left, right)| calculate(operator, kind, left, right));
        let node = ExprKind::Calculate(operator, kind, Box::new((left.expr, right.expr)));
        self.folded(folded, node, ExprType::Type(of), span)
    }

    /// Returns `None`, after a finding, if an operator does not accept values of a type.
    fn takes(&mut self, operator: Binary, kind: Elementary, span: Span) -> Option<()> {
        let fits = match operator {
            Binary::And | Binary::Or | Binary::Xor => kind == Elementary::Bool || kind.is_bits(),
            Binary::Modulo => kind.is_int(),
            Binary::Add | Binary::Subtract => kind.is_num() || kind == Elementary::Time,
            Binary::Multiply | Binary::Divide | Binary::Power => kind.is_num(),
            _ => true,
        };
        if !fits {
            let help = match operator {
                Binary::And | Binary::Or | Binary::Xor => "write BOOL or bit strings; compare numbers: a > 0",
                Binary::Modulo => "write integers",
                _ if kind.is_bits() => "convert bit strings to integers, for example with WORD_TO_UINT(...)",
                _ if kind == Elementary::String => "join strings with CONCAT(...)",
                _ => "write numbers",
            };
            let what = format!("{} does not accept {}", operator.text(), kind.text());
            self.found(&TYPE, span, what, help);
        }
        fits.then_some(())
    }

    fn comparison(
        &mut self,
        operator: Binary,
        left: TypedExpr,
        right: TypedExpr,
        span: Span,
    ) -> Option<TypedExpr> {
        let folded = left
            .value()
            .zip(right.value())
            .map(|(left, right)| Ok(compare(operator, left, right)));
        let node = ExprKind::Compare(operator, Box::new((left.expr, right.expr)));
        self.folded(folded, node, ExprType::Type(Type::BOOL), span)
    }

    /// Returns the result of two literals without a type, which has no type either.
    fn untyped(
        &mut self,
        operator: Binary,
        left: &TypedExpr,
        right: &TypedExpr,
        span: Span,
    ) -> Option<TypedExpr> {
        let (one, other) = (left.value()?.clone(), right.value()?.clone());
        let is_integer = left.of == ExprType::Integer && right.of == ExprType::Integer;
        let real = |value: &Value| Value::Real(value.real());
        if operator.is_comparison() {
            let value = if is_integer {
                compare(operator, &one, &other)
            } else {
                compare(operator, &real(&one), &real(&other))
            };
            return Some(TypedExpr::constant(value, ExprType::Type(Type::BOOL), span));
        }
        if operator == Binary::Modulo && !is_integer {
            self.found(&TYPE, span, "MOD needs integers", "write integers");
            return None;
        }
        let calculated = if is_integer {
            // any type of 64 bits
            let low = calculate(operator, Elementary::Lint, &one, &other);
            low.or_else(|fault| calculate(operator, Elementary::Ulint, &one, &other).map_err(|_| fault))
        } else {
            calculate(operator, Elementary::Lreal, &real(&one), &real(&other))
        };
        match calculated {
            Ok(value) => Some(TypedExpr::constant(
                value,
                if is_integer {
                    ExprType::Integer
                } else {
                    ExprType::Real
                },
                span,
            )),
            Err(fault) => {
                self.found(
                    &CONSTANT_FAULT,
                    span,
                    format!("this constant is {fault}"),
                    "write another value",
                );
                None
            }
        }
    }

    /// Checks `TIME * ANY_NUM` and `TIME / ANY_NUM`.
    fn scaled(&mut self, operator: Binary, time: TypedExpr, by: TypedExpr, span: Span) -> Option<TypedExpr> {
        let by = match by.of {
            ExprType::Integer => self.become_type(by, &Elementary::Lint.into())?,
            ExprType::Real => self.become_type(by, &Elementary::Lreal.into())?,
            _ if by.elementary().is_some_and(Elementary::is_num) => by.expr,
            of => {
                let what = format!("a TIME can be multiplied and divided only by a number, not by {of}");
                self.found(&TYPE, span, what, "write a number");
                return None;
            }
        };
        let by = TypedExpr {
            expr: by,
            of: ExprType::Integer,
        };
        let folded = time
            .value()
            .zip(by.value())
            .map(|(time, by)| scale_time(operator, time, by));
        let node = ExprKind::ScaleTime(operator, Box::new((time.expr, by.expr)));
        self.folded(folded, node, ExprType::Type(Elementary::Time.into()), span)
    }

    /// Checks `ANY_REAL ** ANY_NUM`.
    pub(super) fn power(&mut self, base: TypedExpr, exponent: TypedExpr, span: Span) -> Option<TypedExpr> {
        let kind = match base.of {
            ExprType::Integer | ExprType::Real => exponent
                .elementary()
                .filter(|kind| kind.is_real())
                .unwrap_or(Elementary::Lreal),
            _ => {
                let Some(kind) = base.elementary().filter(|kind| kind.is_real()) else {
                    let what = format!("the base of ** must be a REAL or an LREAL, not {}", base.of);
                    self.found(
                        &TYPE,
                        span,
                        what,
                        "convert it, for example with DINT_TO_LREAL(...)",
                    );
                    return None;
                };
                kind
            }
        };
        let base = self.become_type(base, &kind.into())?;
        // the exponent keeps its own type: the result has the type of the base
        let exponent = self.become_type(exponent, &Elementary::Lreal.into())?;
        let of = ExprType::Type(kind.into());
        let (base, exponent) = (
            TypedExpr {
                expr: base,
                of: of.clone(),
            },
            TypedExpr {
                expr: exponent,
                of: of.clone(),
            },
        );
        let values = base.value().zip(exponent.value());
        let folded = values.map(|(base, exponent)| calculate(Binary::Power, kind, base, exponent));
        let node = ExprKind::Calculate(Binary::Power, kind, Box::new((base.expr, exponent.expr)));
        self.folded(folded, node, of, span)
    }
}

/// Returns the type to which both sides are converted.
pub(super) fn common(left: &TypedExpr, right: &TypedExpr) -> Option<Elementary> {
    match (&left.of, &right.of) {
        (ExprType::Integer | ExprType::Real, ExprType::Type(_)) => literal_beside(left, right.elementary()?),
        (ExprType::Type(_), ExprType::Integer | ExprType::Real) => literal_beside(right, left.elementary()?),
        (ExprType::Integer, ExprType::Integer) => Some(Elementary::Lint),
        (ExprType::Integer | ExprType::Real, ExprType::Integer | ExprType::Real) => Some(Elementary::Lreal),
        (ExprType::Type(left), ExprType::Type(right)) => left.elementary()?.common(right.elementary()?),
        _ => None,
    }
}

/// Returns the type of both, if one is a literal without a type.
fn literal_beside(literal: &TypedExpr, other: Elementary) -> Option<Elementary> {
    if literal.of == ExprType::Real {
        if other.is_real() {
            return Some(other);
        }
        return [Elementary::Real, Elementary::Lreal]
            .into_iter()
            .find(|real| other.is_int() && other.widens_to(*real));
    }
    let Some(value) = literal.value().map(Value::int) else {
        return Some(other);
    };
    let fits = |kind: &Elementary| {
        kind.range()
            .is_some_and(|(low, high)| (low..=high).contains(&value))
    };
    if fits(&other) || !(other.is_int() || other.is_bits()) {
        return Some(other);
    }
    let wider = Elementary::ALL
        .iter()
        .copied()
        .find(|kind| other.widens_to(*kind) && fits(kind));
    Some(wider.unwrap_or(other))
}
