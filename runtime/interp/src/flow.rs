//! Effects of program codes: assignments and jumps.

use std::cell::Cell;

use tandem_syntax::{Block, NcProgram, Statement, Value, Variable, VariableKind};

use crate::arithmetic::label;
use crate::evaluation::{Locals, Scope, reads};
use crate::inputs::Inputs;

/// Executes a program code. `next` is the index of the block after the program code; a jump changes `next`.
///
/// # Errors
/// Fails if the program code reads a variable that has lost its value; the program code then has no effect.
pub(crate) fn run(
    program: &NcProgram,
    block: &Block,
    next: &mut usize,
    locals: &mut Locals,
    inputs: &Inputs<'_>,
) -> Result<(), Variable> {
    let lost = Cell::new(None);
    let scope = Scope {
        locals,
        variables: inputs.variables,
        captured: inputs.captured.as_ref(),
        lost: &lost,
    };
    let Some(code) = program.program_code(block) else {
        return Ok(());
    };
    let number = || {
        code.expression
            .map_or(f64::NAN, |value| scope.number(program, value))
    };
    let holds = || {
        code.expression
            .is_some_and(|condition| scope.condition(program, condition))
    };
    let jump = match code.statement {
        Statement::Assignment(target) => {
            let (index, value) = (usize::from(target.index), number());
            if let Some(variable) = lost.get() {
                return Err(variable);
            }
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
                // read only: the parser rejects an assignment to a captured position
                VariableKind::CapturedPosition => {}
            }
            None
        }
        Statement::If | Statement::While => code.to.filter(|_| !holds()),
        Statement::DoWhile => code.to.filter(|_| holds()),
        Statement::Else | Statement::Break | Statement::Repeat => code.to,
        Statement::Switch { first, count } => label(number())
            .and_then(|label| program.case(first, count, label))
            .or(code.to),
        Statement::Do | Statement::Case { .. } | Statement::Default | Statement::Open | Statement::Close => {
            None
        }
    };
    if let Some(variable) = lost.get() {
        return Err(variable);
    }
    if let Some(to) = jump {
        *next = to as usize;
    }
    Ok(())
}

/// Returns true if the program code of a block reads P or Q, which other writers may change.
pub(crate) fn reads_shared(program: &NcProgram, block: &Block) -> bool {
    let code = program.program_code(block);
    let expression = code.and_then(|code| code.expression);
    expression.is_some_and(|id| {
        reads(program, id, |kind| {
            matches!(kind, VariableKind::Global | VariableKind::CoordinateSystem)
        })
    })
}

/// Returns true if a block reads a captured position.
pub(crate) fn reads_captured_position(program: &NcProgram, block: &Block) -> bool {
    match program.program_code(block) {
        Some(code) => code
            .expression
            .is_some_and(|id| reads(program, id, |kind| kind == VariableKind::CapturedPosition)),
        None => program.words(block).iter().any(|word| {
            matches!(word.value(), Value::Indirection(variable) if variable.kind == VariableKind::CapturedPosition)
        }),
    }
}
