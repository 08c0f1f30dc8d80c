//! Checks program codes: their assignments and possible jumps.

use tandem_syntax::{Expression, ExpressionId, NcProgram, Operator, ProgramCode, Statement, diagnostics};

use super::explore::{BlockOutcome, Explorer, Next};
use super::expressions::{holds, number, suppose};
use super::graph::{BlockPosition, CurrentBlock, Decision, Reachability};
use super::state::CheckState;
use super::verdict::Weight;
use crate::arithmetic::label;
use crate::range::Range;
use crate::text_values::Values;

impl Explorer<'_> {
    /// Checks a program code, and updates the state.
    pub(super) fn program_code(&mut self, here: CurrentBlock<'_>, state: &mut CheckState) -> BlockOutcome {
        let CurrentBlock {
            place, tree, block, ..
        } = here;
        let Some(code) = tree.program_code(block) else {
            return BlockOutcome::On;
        };
        self.calculation(here, code, state);
        let to = |block: u32| BlockPosition {
            block: block as usize,
            ..place
        };
        let on = here.next_position();
        let (holds_way, other_way) = match code.statement {
            Statement::Assignment(target) => {
                let range = code
                    .expression
                    .map_or(Range::ANY, |id| number(tree, id, &state.values));
                state.values.set(target, range);
                return BlockOutcome::On;
            }
            Statement::Switch { first, count } => return switch(tree, code, (first, count), place, state),
            Statement::Else | Statement::Break | Statement::Repeat => {
                if code.statement == Statement::Repeat {
                    state.values.pass_time();
                }
                let Some(target) = code.to else {
                    return BlockOutcome::On;
                };
                return BlockOutcome::Parts(vec![
                    part(to(target), state, Decision::On, Reachability::Real),
                    part(on, state, Decision::On, Reachability::Supposed),
                ]);
            }
            Statement::If => (
                (on, Decision::If(true)),
                code.to.map(|at| (to(at), Decision::If(false))),
            ),
            Statement::While => (
                (on, Decision::Loop(true)),
                code.to.map(|at| (to(at), Decision::Loop(false))),
            ),
            Statement::DoWhile => {
                let Some(back) = code.to else {
                    return BlockOutcome::On;
                };
                ((to(back), Decision::Again), Some((on, Decision::On)))
            }
            _ => return BlockOutcome::On,
        };
        match (code.expression, other_way) {
            (Some(condition), Some(other)) => branch(tree, condition, [holds_way, other], state),
            _ => BlockOutcome::On,
        }
    }

    /// Reports a calculation without a defined result.
    fn calculation(&mut self, here: CurrentBlock<'_>, code: &ProgramCode, state: &CheckState) {
        let CurrentBlock { tree, .. } = here;
        if let Some(id) = code.expression
            && self.is_real(here.node)
            && let Some(what) = undefined(tree, id, &state.values)
        {
            let finding = diagnostics::NO_RESULT.at(
                code.span,
                what,
                "Test the value before, or correct the calculation. If a word takes the result, the block is an alarm.",
            );
            self.record_finding(here, finding, Weight::Sure);
        }
    }
}

/// Returns the two continuations after a condition: for true and for false.
fn branch(
    tree: &NcProgram,
    condition: ExpressionId,
    ways: [(BlockPosition, Decision); 2],
    state: &CheckState,
) -> BlockOutcome {
    let known = holds(tree, condition, &state.values);
    let parts = ways.into_iter().zip([true, false]).map(|((place, way), is_so)| {
        let kind = if known == Some(!is_so) {
            Reachability::Supposed
        } else {
            Reachability::Real
        };
        let mut part = part(place, state, way, kind);
        if known.is_none() {
            suppose(tree, condition, is_so, &mut part.state.values);
        }
        if way == Decision::Again {
            part.state.values.pass_time();
        }
        part
    });
    BlockOutcome::Parts(parts.collect())
}

fn part(place: BlockPosition, state: &CheckState, way: Decision, kind: Reachability) -> Next {
    Next {
        place,
        state: state.clone(),
        way,
        kind,
    }
}

fn switch(
    tree: &NcProgram,
    code: &ProgramCode,
    (first, count): (u32, u32),
    place: BlockPosition,
    state: &CheckState,
) -> BlockOutcome {
    let range = code
        .expression
        .map_or(Range::ANY, |id| number(tree, id, &state.values));
    let known = range.value().filter(|_| range.own);
    let taken = known.map(|value| {
        label(value)
            .and_then(|label| tree.case(first, count, label))
            .or(code.to)
    });
    let to = |block: u32| BlockPosition {
        block: block as usize,
        ..place
    };
    let mut parts = Vec::new();
    let kind = |block: u32| match taken {
        Some(taken) if taken != Some(block) => Reachability::Supposed,
        _ => Reachability::Real,
    };
    for block in tree.case_blocks(first, count) {
        let label = match tree
            .blocks()
            .get(block as usize)
            .and_then(|at| tree.program_code(at))
        {
            Some(ProgramCode {
                statement: Statement::Case { label },
                ..
            }) => Some(*label),
            _ => None,
        };
        parts.push(part(to(block), state, Decision::Case(label), kind(block)));
    }
    if let Some(default) = code.to {
        parts.push(part(to(default), state, Decision::Case(None), kind(default)));
    }
    BlockOutcome::Parts(parts)
}

/// Finds the innermost operation without a defined result: a division by zero, or a function outside of its
/// domain (manual 4-1-3).
fn undefined(program: &NcProgram, id: ExpressionId, values: &Values) -> Option<String> {
    let known = |id| {
        let range = number(program, id, values);
        range.value().filter(|value| range.own && value.is_finite())
    };
    let is_lost = || {
        let range = number(program, id, values);
        range.value().is_some_and(|value| !value.is_finite())
    };
    match *program.expression(id)? {
        Expression::Negation(inner) | Expression::Not(inner) => undefined(program, inner, values),
        Expression::Binary {
            operator,
            left,
            right,
        } => {
            let inner = undefined(program, left, values).or_else(|| undefined(program, right, values));
            inner.or_else(|| {
                let divides = matches!(operator, Operator::Divide | Operator::Modulo);
                let by_zero = divides && known(right).is_some_and(|value| value.abs() <= 0.0);
                by_zero.then(|| "a division by 0 gives no number".to_owned())
            })
        }
        Expression::Call {
            function,
            first,
            second,
        } => {
            let inner = undefined(program, first, values);
            let inner = inner.or_else(|| undefined(program, second?, values));
            inner.or_else(|| {
                let argument = known(first)?;
                let others = second.is_none_or(|second| known(second).is_some());
                (others && is_lost()).then(|| {
                    format!(
                        "{}({argument}{}) gives no number; its arguments are {}",
                        function.text(),
                        second
                            .and_then(known)
                            .map_or_else(String::new, |y| format!(", {y}")),
                        function.domain()
                    )
                })
            })
        }
        Expression::Number(_) | Expression::Variable(_) => None,
    }
}
