//! The paths through a program that its structure allows, independent of conditions.

use tandem_model::Span;
use tandem_syntax::{Address, Block, NcProgram, ProgramCode, Statement, Word, diagnostics};

use super::Findings;
use super::graph::{CheckedProgram, REACHED};
use crate::codes::{Code, tenths};
use crate::dialect::Dialect;
use crate::meaning::Role;

/// Reports blocks that are never executed, and a program that runs past its last block (D06).
pub(super) fn report_flow_faults(of: &CheckedProgram<'_>, dialect: &Dialect, findings: &mut Findings) {
    let program: &NcProgram = &of.tree;
    let blocks = program.blocks();
    let dead = of.marks.iter().position(|marks| marks & REACHED == 0);
    let branches = has_branches(program);
    let (dead, has_no_end) = if branches {
        let reached = reachable(program, dialect);
        let mut all = blocks.iter().zip(&reached);
        let dead = all.position(|(block, reached)| !reached && !is_mark(program, block));
        // a program that ends in an endless loop needs no end
        let is_run = of.has(0, REACHED);
        let ends_there = reached.last() == Some(&true);
        (dead, ends_there && (!is_run || of.has(blocks.len(), REACHED)))
    } else {
        (dead, dead.is_none())
    };
    // a block that cannot be read may contain a jump to the unreached block
    let is_clear = !branches || !blocks.iter().any(Block::has_errors);
    if let Some(block) = dead.and_then(|dead| blocks.get(dead)).filter(|_| is_clear) {
        let (message, help) = if branches {
            (
                "this block is never executed",
                "Remove it, or move the end of the program below it.",
            )
        } else {
            (
                "this block and the blocks after it are never executed",
                "Remove them, or move the end of the program below them.",
            )
        };
        findings.push(diagnostics::UNREACHABLE.at(program.span(block), message, help));
    }
    let last = blocks.last();
    let unclear = !program.is_complete() || last.is_some_and(Block::has_errors);
    if unclear || !has_no_end {
        return;
    }
    let span = last.map_or_else(Span::default, |block| program.span(block));
    let end = dialect.m_code(Role::End).map_or("", |code| code.code);
    let of_what = dialect.m_code(Role::Return).map_or_else(String::new, |back| {
        format!(" of a main program, {} in that of a subprogram", back.code)
    });
    findings.push(diagnostics::END_MISSING.at(
        span,
        "the program runs past this block and has no end",
        format!("Write {end} in the last block{of_what}, without block skip."),
    ));
}

fn has_branches(program: &NcProgram) -> bool {
    program.has_program_codes() && program.blocks().iter().any(|block| is_mark(program, block))
}

/// Returns for each block whether a run may reach the block, independent of conditions. The last entry is for
/// the place after the last block.
fn reachable(program: &NcProgram, dialect: &Dialect) -> Vec<bool> {
    let blocks = program.blocks();
    let mut reached = vec![false; blocks.len() + 1];
    let mut open = vec![0];
    while let Some(at) = open.pop() {
        let Some(seen) = reached.get_mut(at) else { continue };
        if std::mem::replace(seen, true) {
            continue;
        }
        let Some(block) = blocks.get(at) else { continue };
        let code = program.program_code(block);
        open.extend(code.iter().flat_map(|code| targets(program, code)));
        let goes_on = match code.map(|code| code.statement) {
            Some(Statement::Else | Statement::Break | Statement::Repeat | Statement::Switch { .. }) => false,
            Some(_) => true,
            None => !ends(program, block, dialect),
        };
        if goes_on {
            open.push(at + 1);
        }
    }
    reached
}

/// Returns the indices of the blocks to which a program code may jump.
fn targets(program: &NcProgram, code: &ProgramCode) -> impl Iterator<Item = usize> {
    let cases = match code.statement {
        Statement::Switch { first, count } => Some(program.case_blocks(first, count)),
        _ => None,
    };
    let blocks = code.to.into_iter().chain(cases.into_iter().flatten());
    blocks.map(|block| block as usize)
}

/// Returns the indices of all blocks to which a program code of the program may jump.
pub(super) fn joins(program: &NcProgram) -> Vec<usize> {
    if !program.has_program_codes() {
        return Vec::new();
    }
    let blocks = program.blocks().iter();
    let codes = blocks.filter_map(|block| program.program_code(block));
    codes.flat_map(|code| targets(program, code)).collect()
}

/// Returns true for a block that always ends its program.
fn ends(program: &NcProgram, block: &Block, dialect: &Dialect) -> bool {
    let ends = |word: &Word| m_code(word, dialect).is_some_and(Code::ends);
    block.skip_numbers() == 0 && program.words(block).iter().any(ends)
}

/// Returns true for a program with a return: its initial modal state may be the state of a caller.
pub(super) fn may_be_called(program: &NcProgram, dialect: &Dialect) -> bool {
    let returns = |word: &Word| m_code(word, dialect).is_some_and(|code| code.role == Role::Return);
    if !program.all_words().iter().any(returns) {
        return false;
    }
    let mut blocks = program.blocks().iter();
    blocks.any(|block| program.words(block).iter().any(returns))
}

/// Returns the M code of a word if the runtime handles this M code itself.
fn m_code(word: &Word, dialect: &Dialect) -> Option<&'static Code> {
    let number = word.number().filter(|_| word.address == Address::M)?;
    dialect.m_codes.find(tenths(number)?)
}

/// Returns true for a program code that a run need not reach, such as the end of a branch whose commands end
/// the program.
fn is_mark(program: &NcProgram, block: &Block) -> bool {
    program
        .program_code(block)
        .is_some_and(|code| !matches!(code.statement, Statement::Assignment { .. }))
}
