//! Data of the exploration: nodes, decisions, and the programs that are checked.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_model::Span;
use tandem_syntax::{Block, NcProgram, diagnostics};

use super::state::CheckState;
use super::{CheckContext, Findings};
use crate::dialect::{Dialect, OtherMCodes};

/// A decision that leads from one node to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Decision {
    /// No decision: the path has only one continuation.
    On,
    /// `if`: true if the commands of the `if` are executed.
    If(bool),
    /// `while`: true for another turn of the loop.
    Loop(bool),
    /// `do` with `while`: another turn of the loop follows.
    Again,
    /// `switch`: the label of the case that matches; `None` for `default`.
    Case(Option<i64>),
    /// A block with block skip: true if the block is skipped.
    Skip(bool),
    /// Start of a called program.
    Called,
}

/// Whether a run reaches a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reachability {
    /// A run may reach the node.
    Real,
    /// No run reaches the node, because of the values compared, or because the node follows an end. The node
    /// is checked anyway.
    Supposed,
}

/// Place of a block: index of the program, and index of the block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct BlockPosition {
    pub program: usize,
    pub block: usize,
}

/// The block that is checked, with its node, place and program.
#[derive(Clone, Copy)]
pub(super) struct CurrentBlock<'t> {
    pub node: usize,
    pub place: BlockPosition,
    pub tree: &'t NcProgram,
    pub block: &'t Block,
}

impl CurrentBlock<'_> {
    /// Returns the place after the block.
    pub fn next_position(&self) -> BlockPosition {
        BlockPosition {
            block: self.place.block + 1,
            ..self.place
        }
    }
}

pub(super) struct Node {
    pub place: BlockPosition,
    pub kind: Reachability,
    /// True if a run certainly reaches this node, independent of other writers.
    pub is_certain: bool,
    /// True if a modal value of the state is unknown.
    pub is_open: bool,
    /// The node from which this node was first reached, and the decision that led to this node.
    pub before: Option<(usize, Decision)>,
    /// Index after the last block of the node's run.
    pub end: usize,
    /// State before the first block of the node's run.
    pub state: Arc<CheckState>,
    /// True if the node must be followed, for the first time or again.
    pub waits: bool,
}

/// A program that is checked.
pub(super) struct CheckedProgram<'a> {
    pub number: u16,
    pub tree: Tree<'a>,
    /// Marks of each block, and of the place after the last block.
    pub marks: Vec<u8>,
    pub m_codes: BTreeMap<u16, (Span, bool)>,
    pub programs: BTreeMap<u16, Call>,
    pub calls_any: bool,
}

/// The first call of a program, in the order of the text.
#[derive(Clone, Copy)]
pub(super) struct Call {
    pub span: Span,
    pub is_missing: bool,
}

/// Mark of a block before which paths join.
pub(super) const JOIN: u8 = 1;
/// Mark of a block that a run reaches.
pub(super) const REACHED: u8 = 2;
/// Mark of a block that has been checked.
pub(super) const LOOKED_AT: u8 = 4;

impl CheckedProgram<'_> {
    /// Returns true if the block has this mark.
    pub fn has(&self, block: usize, mark: u8) -> bool {
        self.marks.get(block).is_some_and(|marks| marks & mark != 0)
    }

    /// Adds a mark to a block.
    pub fn set(&mut self, block: usize, mark: u8) {
        if let Some(marks) = self.marks.get_mut(block) {
            *marks |= mark;
        }
    }
}

/// Tree of a program: borrowed for the main program, shared for a called program.
#[derive(Clone)]
pub(super) enum Tree<'a> {
    Main(&'a NcProgram),
    Called(Arc<NcProgram>),
}

impl std::ops::Deref for Tree<'_> {
    type Target = NcProgram;

    fn deref(&self) -> &NcProgram {
        match self {
            Tree::Main(tree) => tree,
            Tree::Called(tree) => tree,
        }
    }
}

impl CheckedProgram<'_> {
    /// Reports M codes without settings and missing programs, each where it is first used.
    pub fn report_missing(&self, dialect: &Dialect, context: &CheckContext<'_>, findings: &mut Findings) {
        let warns = dialect.policy.other_m_codes == OtherMCodes::Output;
        if let Some(known) = context.m_codes_with_settings.filter(|_| warns) {
            for (number, (span, needs_settings)) in &self.m_codes {
                if *needs_settings && !known.contains(number) {
                    findings.push(diagnostics::M_WITHOUT_SETTINGS.at(
                        *span,
                        format!("M{number:02} has no settings"),
                        format!("Add [m_code.{number}] to the configuration, or correct the number."),
                    ));
                }
            }
        }
        for (number, call) in &self.programs {
            if call.is_missing {
                findings.push(diagnostics::PROGRAM_MISSING.at(
                    call.span,
                    format!("program {number} does not exist"),
                    "Load the program before this one starts, or correct the number.",
                ));
            }
        }
    }

    /// Reports a program that does not begin with the mark of the dialect (manual dgshape, 1-1).
    pub fn mark(&self, dialect: &Dialect, findings: &mut Findings) {
        let mark = (dialect.grammar)().program_form.mark.map(char::from);
        if let Some(mark) = mark.filter(|_| !self.tree.is_marked()) {
            findings.push(diagnostics::MARK_MISSING.at(
                Span::default(),
                format!("the program does not begin with {mark}, and is not executed"),
                format!("Write a line with only {mark} before the program."),
            ));
        }
    }
}
