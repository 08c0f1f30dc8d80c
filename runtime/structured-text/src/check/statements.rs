//! Statements.

use super::{Checker, Progress};
use crate::code::{ExprKind, ForLoop, Stmt};
use crate::finding::{LABELS, SYNTAX, TYPE};
use crate::tree::{Expression, ExpressionKind, Label, Name, Statement};
use crate::types::{Elementary, Type};
use crate::value::Value;

impl Checker<'_> {
    /// Returns the statements of a unit.
    pub(super) fn body(&mut self, unit: usize) -> Vec<Stmt> {
        if self.frames[unit].progress != Progress::Done {
            return Vec::new();
        }
        let file = self.file;
        self.unit = Some(unit);
        let body = self.statements(&file.units[unit].body);
        self.unit = None;
        body
    }

    fn statements(&mut self, statements: &[Statement]) -> Vec<Stmt> {
        statements
            .iter()
            .filter_map(|statement| self.statement(statement))
            .collect()
    }

    fn statement(&mut self, statement: &Statement) -> Option<Stmt> {
        match statement {
            Statement::Assign { to, value } => {
                // both sides, so that mistakes in both are found
                let target = self.assignable(to);
                let Some(target) = target else {
                    self.valued(value);
                    return None;
                };
                self.assignment(target.place, &target.of, value)
            }
            Statement::Call(call) => self.call(call),
            Statement::If(branches, otherwise) => {
                let mut checked = Vec::new();
                for (condition, body) in branches {
                    let (condition, body) = (self.condition(condition), self.statements(body));
                    checked.extend(condition.map(|condition| (condition, body)));
                }
                Some(Stmt::If(checked, self.statements(otherwise)))
            }
            Statement::Case {
                selector,
                branches,
                otherwise,
            } => self.case(selector, branches, otherwise),
            Statement::For {
                variable,
                from,
                to,
                by,
                body,
            } => self.for_loop(variable, (from, to, by.as_ref()), body),
            Statement::While(condition, body) => {
                let (condition, body) = (self.condition(condition), self.in_loop(body));
                Some(Stmt::While(condition?, body))
            }
            Statement::Repeat(body, condition) => {
                let (body, condition) = (self.in_loop(body), self.condition(condition));
                Some(Stmt::Repeat(body, condition?))
            }
            Statement::Exit(span) | Statement::Continue(span) if self.loops == 0 => {
                self.found(
                    &SYNTAX,
                    *span,
                    "this is not within a loop",
                    "write it within FOR, WHILE or REPEAT",
                );
                None
            }
            Statement::Exit(_) => Some(Stmt::Exit),
            Statement::Continue(_) => Some(Stmt::Continue),
            Statement::Return => Some(Stmt::Return),
        }
    }

    fn call(&mut self, call: &Expression) -> Option<Stmt> {
        let ExpressionKind::Call(callee, arguments) = &call.kind else {
            return None;
        };
        let is_variable = match &callee.kind {
            // an instance may have the name of a function
            ExpressionKind::Name(name) => {
                self.type_of_variable(name).is_some_and(Type::is_block) || self.is_refused(name)
            }
            _ => true,
        };
        if is_variable {
            self.block_call(callee, arguments, call.span)
        } else {
            self.function_statement(callee, arguments, call.span)
        }
    }

    fn in_loop(&mut self, body: &[Statement]) -> Vec<Stmt> {
        self.loops += 1;
        let body = self.statements(body);
        self.loops -= 1;
        body
    }

    fn case(
        &mut self,
        selector: &Expression,
        branches: &[(Vec<Label>, Vec<Statement>)],
        otherwise: &[Statement],
    ) -> Option<Stmt> {
        let typed = self.valued(selector);
        let of = typed.as_ref().and_then(|typed| match &typed.of {
            super::expressions::ExprType::Type(of) => Some(of.clone()),
            _ => None,
        });
        let is_ordinal = |of: &Type| {
            matches!(of, Type::Enumeration(..))
                || of
                    .elementary()
                    .is_some_and(|kind| kind.is_int() || kind.is_bits())
        };
        let of = of.filter(is_ordinal);
        if typed.is_some() && of.is_none() {
            self.found(
                &TYPE,
                selector.span,
                "CASE needs an integer or an enumeration",
                "write IF ... ELSIF",
            );
        }
        let mut checked = Vec::new();
        let mut seen: Vec<(i128, i128)> = Vec::new();
        for (labels, body) in branches {
            let mut ranges = Vec::new();
            for label in labels {
                let range = of.as_ref().and_then(|of| self.label(label, of));
                let Some((low, high)) = range else {
                    continue;
                };
                if seen.iter().any(|(from, to)| low <= *to && *from <= high) {
                    let what = if low == high {
                        format!("the label {low} appears twice")
                    } else {
                        "labels overlap".to_owned()
                    };
                    self.found(&LABELS, label.from.span, what, "remove one of them");
                }
                seen.push((low, high));
                ranges.push((low, high));
            }
            checked.push((ranges, self.statements(body)));
        }
        let otherwise = self.statements(otherwise);
        of?;
        Some(Stmt::Case {
            selector: typed?.expr,
            branches: checked,
            otherwise,
        })
    }

    fn label(&mut self, label: &Label, of: &Type) -> Option<(i128, i128)> {
        let from = self.label_value(&label.from, of)?;
        let to = match &label.to {
            Some(to) => self.label_value(to, of)?,
            None => from,
        };
        if from > to {
            self.found(
                &LABELS,
                label.from.span,
                "the first value of the range is above the last",
                "write the lower value first",
            );
            return None;
        }
        Some((from, to))
    }

    fn label_value(&mut self, label: &Expression, of: &Type) -> Option<i128> {
        let typed = self.valued(label)?;
        let value = self.become_type(typed, of)?;
        if let ExprKind::Constant(Value::Int(value)) = value.kind {
            return Some(value);
        }
        let help = "write a number, a VAR CONSTANT, or a value of an enumeration";
        self.found(
            &crate::finding::NOT_CONSTANT,
            label.span,
            "a label must be constant",
            help,
        );
        None
    }

    fn for_loop(
        &mut self,
        variable: &Name,
        (from, to, by): (&Expression, &Expression, Option<&Expression>),
        body: &[Statement],
    ) -> Option<Stmt> {
        let name = Expression::new(ExpressionKind::Name(variable.text.clone()), variable.span);
        let found = self.assignable(&name);
        let kind = found
            .as_ref()
            .and_then(|found| found.of.elementary())
            .filter(|kind| kind.is_int());
        if found.is_some() && kind.is_none() {
            self.found(
                &TYPE,
                variable.span,
                "the variable of a FOR must be an integer",
                "declare it as INT or DINT",
            );
        }
        let (mut bounds, mut step) = (None, None);
        if let Some(kind) = kind {
            let of = Type::from(kind);
            let value = |checker: &mut Self, expression: &Expression, of: &Type| {
                let typed = checker.valued(expression)?;
                checker.become_type(typed, of)
            };
            bounds = value(self, from, &of).zip(value(self, to, &of));
            // a step may be negative even if the variable cannot be
            step = Some(by.map(|by| {
                value(
                    self,
                    by,
                    &if kind.is_signed() {
                        of
                    } else {
                        Elementary::Lint.into()
                    },
                )
            }));
        }
        self.running.push(variable.text.clone());
        let body = self.in_loop(body);
        self.running.pop();
        let (from, to) = bounds?;
        let by = match step? {
            Some(by) => Some(by?),
            None => None,
        };
        Some(Stmt::For(Box::new(ForLoop {
            variable: found?.place,
            of: kind?,
            from,
            to,
            by,
            body,
        })))
    }
}
