//! Nodes and programs that are followed.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_model::Span;
use tandem_syntax::{Block, NcProgram, diagnostics};

use super::state::CheckState;
use super::{CheckContext, Findings};
use crate::dialect::{Dialect, OtherMCodes};

/// A decision taken on a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Decision {
    /// No decision.
    On,
    /// `if`: its commands are executed, or not.
    If(bool),
    /// `while`: another turn, or none.
    Loop(bool),
    /// `do` with `while`: another turn.
    Again,
    /// `switch`: the case of a label, or `default`.
    Case(Option<i64>),
    /// A block with block skip: skipped, or not.
    Skip(bool),
    /// The called program begins.
    Called,
}

/// Whether a run reaches a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reachability {
    /// A run may reach the node.
    Real,
    /// No run reaches the node, because of compared values or because it follows the end; it is checked
    /// anyway.
    Supposed,
}

/// A place of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct BlockPosition {
    pub program: usize,
    pub block: usize,
}

/// The block that is checked: its node, its place, and its text.
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
    /// True if a run reaches this node, independent of other writers.
    pub is_certain: bool,
    /// True if a modal value is unknown.
    pub is_open: bool,
    /// The node from which this node was first reached, and the decision there.
    pub before: Option<(usize, Decision)>,
    /// One past the last block of its run.
    pub end: usize,
    /// State after the last block of its run, where the path continues.
    pub state: Arc<CheckState>,
    /// True if the node must be followed, or followed again.
    pub waits: bool,
}

/// A program that is checked.
pub(super) struct CheckedProgram<'a> {
    pub number: u16,
    pub tree: Tree<'a>,
    /// Knowledge about each block, and about the place past the last one.
    pub marks: Vec<u8>,
    pub m_codes: BTreeMap<u16, (Span, bool)>,
    pub programs: BTreeMap<u16, Call>,
    pub calls_any: bool,
}

/// The first call of a program.
#[derive(Clone, Copy)]
pub(super) struct Call {
    pub span: Span,
    pub is_missing: bool,
}

/// Paths join before the block.
pub(super) const JOIN: u8 = 1;
/// A run reaches the block.
pub(super) const REACHED: u8 = 2;
/// The block has been checked.
pub(super) const LOOKED_AT: u8 = 4;

impl CheckedProgram<'_> {
    /// Returns true for a block with this mark.
    pub fn has(&self, block: usize, mark: u8) -> bool {
        self.marks.get(block).is_some_and(|marks| marks & mark != 0)
    }

    /// Marks a block.
    pub fn set(&mut self, block: usize, mark: u8) {
        if let Some(marks) = self.marks.get_mut(block) {
            *marks |= mark;
        }
    }
}

/// A tree, borrowed or shared.
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
    /// Reports M codes without settings and missing programs, each at its first place.
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
