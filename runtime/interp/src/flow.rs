//! What program codes do: they assign, or tell where the program goes on.

use tandem_syntax::{Block, NcProgram, Statement, VariableKind};

use crate::evaluation::{Locals, Scope, label};
use crate::inputs::Inputs;

/// Runs a program code. `next` is the block after it, and changes where the program goes on elsewhere.
pub(crate) fn run(
    program: &NcProgram,
    block: &Block,
    next: &mut usize,
    locals: &mut Locals,
    inputs: &Inputs<'_>,
) {
    let scope = Scope {
        locals,
        variables: inputs.variables,
        captured: inputs.captured.as_ref(),
    };
    let mut go_to = |to: u32| *next = to as usize;
    match program.program_code(block).map(|code| code.statement) {
        Some(Statement::Assignment { target, value }) => {
            let value = scope.number(program, value);
            let index = usize::from(target.index);
            match target.kind {
                VariableKind::Local => {
                    if let Some(variable) = locals.get_mut(index) {
                        *variable = value;
                    }
                }
                VariableKind::CoordinateSystem => {
                    inputs.variables.coordinate_system.set(index, value);
                }
                VariableKind::Global => {
                    inputs.variables.global.set(index, value);
                }
                // read only; the parser makes no such target
                VariableKind::CapturedPosition => {}
            }
        }
        Some(
            Statement::If {
                condition,
                otherwise: to,
            }
            | Statement::While { condition, end: to },
        ) => {
            if !scope.condition(program, condition) {
                go_to(to);
            }
        }
        Some(Statement::DoWhile { condition, start }) => {
            if scope.condition(program, condition) {
                go_to(start);
            }
        }
        Some(
            Statement::Else { end: to } | Statement::Break { end: to } | Statement::Repeat { start: to },
        ) => go_to(to),
        Some(Statement::Switch {
            value,
            first,
            count,
            otherwise,
        }) => {
            let case =
                label(scope.number(program, value)).and_then(|label| program.case(first, count, label));
            go_to(case.unwrap_or(otherwise));
        }
        Some(
            Statement::Do | Statement::Case { .. } | Statement::Default | Statement::Open | Statement::Close,
        )
        | None => {}
    }
}
