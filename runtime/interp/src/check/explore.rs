//! Follows states from block to block until no new state is found.
//!
//! A node is a state at the start of a run of blocks; the run ends where paths fork or join. Up to
//! [`STATES_MAX`] states of one block are kept separate, so that related values stay together. Further states
//! are merged, which limits the work.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap, VecDeque};
use std::sync::Arc;

use tandem_model::Diagnostic;
use tandem_model::limits::PROGRAM_BYTES_MAX;
use tandem_syntax::{Content, NcProgram};

use super::graph::{
    BlockPosition, CheckedProgram, CurrentBlock, Decision, JOIN, LOOKED_AT, Node, REACHED, Reachability, Tree,
};
use super::state::CheckState;
use super::verdict::{Groups, StateFinding, Weight};
use super::{Check, CheckContext, Findings, structure};
use crate::block_words::BlockWords;
use crate::dialect::Dialect;
use crate::text_values::Values;

/// Maximum number of states of one block that are kept separate. A loop with this number of turns is followed
/// turn by turn.
const STATES_MAX: usize = 128;
/// Number of steps from block to block for each block, and minimum number. After this number of steps, states
/// are joined at once.
const STEPS_PER_BLOCK: usize = 8;
const STEPS_MIN: usize = 200_000;
/// Multiple of this number of steps after which the remaining blocks are only checked one by one.
const STEPS_HARD: usize = 4;

/// A place where a run may continue, and the decision that leads to this place.
pub(super) struct Next {
    pub place: BlockPosition,
    pub state: CheckState,
    pub way: Decision,
    pub kind: Reachability,
}

/// Continuation of a run after a block.
pub(super) enum BlockOutcome {
    /// The run continues with the next block.
    On,
    /// The run continues at one of these places; a single place is certain.
    Parts(Vec<Next>),
}

pub(super) struct Explorer<'a> {
    pub dialect: &'static Dialect,
    pub context: &'a CheckContext<'a>,
    pub programs: Vec<CheckedProgram<'a>>,
    pub nodes: Vec<Node>,
    pub groups: Groups,
    pub words: BlockWords,
    /// The state as the text alone shows it since paths have joined, if faults of calculated values are not
    /// errors. `None` if it equals the explored state.
    pub shown: Option<CheckState>,
    heads: HashMap<BlockPosition, Vec<usize>>,
    open: BinaryHeap<Reverse<(usize, usize)>>,
    supposed: VecDeque<(usize, Next)>,
    steps: usize,
    steps_max: usize,
    is_cut: bool,
}

impl<'a> Explorer<'a> {
    pub fn new(program: &'a NcProgram, dialect: &'static Dialect, context: &'a CheckContext<'a>) -> Self {
        let mut explorer = Self {
            dialect,
            context,
            programs: Vec::new(),
            nodes: Vec::new(),
            groups: Groups::default(),
            words: BlockWords::new(dialect),
            shown: None,
            heads: HashMap::new(),
            open: BinaryHeap::new(),
            supposed: VecDeque::new(),
            steps: 0,
            steps_max: STEPS_MIN,
            is_cut: false,
        };
        explorer.add_program(0, Tree::Main(program));
        explorer
    }

    /// Checks all blocks of all programs.
    pub fn explore(&mut self) {
        let main = Arc::clone(self.programs[0].tree.source());
        if main.len() > PROGRAM_BYTES_MAX {
            return;
        }
        let head = BlockPosition { program: 0, block: 0 };
        let mut start = CheckState::start_up(self.dialect, self.context);
        let tree = self.programs[0].tree.clone();
        let mut is_certain = true;
        if self.context.goes_on {
            start.forget();
        } else if structure::may_be_called(&tree, self.dialect) {
            let mut called = start.clone();
            called.forget_all();
            // a program that calls this program may have programmed F
            start.has_feed |= self.context.default_feedrate_mm_min.is_none();
            is_certain = false;
            self.start_path(head, called, Reachability::Real, false);
        }
        self.start_path(head, start, Reachability::Real, is_certain);
        self.follow_all();
        self.check_unreached_blocks();
    }

    fn start_path(&mut self, place: BlockPosition, state: CheckState, kind: Reachability, is_certain: bool) {
        let next = Next {
            place,
            state,
            way: Decision::On,
            kind,
        };
        self.arrive(None, next, is_certain);
    }

    /// Returns the index of a called program in `programs`; `None` if its text is unknown or too long.
    pub fn called(&mut self, number: u16) -> Option<usize> {
        let known = self.programs.iter().skip(1).position(|of| of.number == number);
        if let Some(at) = known {
            return Some(at + 1);
        }
        let tree = self.context.programs?.find(number)?;
        (tree.source().len() <= PROGRAM_BYTES_MAX).then(|| {
            self.add_program(number, Tree::Called(tree));
            self.programs.len() - 1
        })
    }

    fn add_program(&mut self, number: u16, tree: Tree<'a>) {
        let blocks = tree.blocks().len();
        self.steps_max += blocks * STEPS_PER_BLOCK;
        let mut marks = vec![0; blocks + 1];
        for join in structure::joins(&tree) {
            if let Some(marks) = marks.get_mut(join) {
                *marks |= JOIN;
            }
        }
        self.programs.push(CheckedProgram {
            number,
            tree,
            marks,
            m_codes: BTreeMap::new(),
            programs: BTreeMap::new(),
            calls_any: false,
        });
    }

    fn follow_all(&mut self) {
        loop {
            while let Some(Reverse((_, node))) = self.open.pop() {
                if self.steps > self.steps_max * STEPS_HARD {
                    self.is_cut = true;
                    return;
                }
                if std::mem::take(&mut self.nodes[node].waits) {
                    self.run(node);
                }
            }
            let Some((from, next)) = self.supposed.pop_front() else {
                return;
            };
            let BlockPosition { program, block } = next.place;
            if !self.programs[program].has(block, LOOKED_AT) {
                self.arrive(Some(from), next, false);
            }
        }
    }

    /// Checks blocks that no state has reached.
    fn check_unreached_blocks(&mut self) {
        let mut program = 0;
        // the blocks checked here may call programs that no other block calls
        while program < self.programs.len() {
            let blocks = self.programs[program].tree.blocks().len();
            for block in 0..blocks {
                if self.programs[program].has(block, LOOKED_AT) {
                    continue;
                }
                let mut state = CheckState::start_up(self.dialect, self.context);
                state.forget_all();
                state.values = Values::unknown();
                self.nodes.push(Node {
                    place: BlockPosition { program, block },
                    kind: Reachability::Supposed,
                    is_certain: false,
                    is_open: true,
                    before: None,
                    end: block,
                    state: Arc::new(state),
                    waits: false,
                });
                self.run(self.nodes.len() - 1);
                self.open.clear();
                self.supposed.clear();
            }
            program += 1;
        }
    }

    /// Follows the blocks of a node to the next fork or join of paths.
    fn run(&mut self, node: usize) {
        let BlockPosition {
            program,
            block: start,
        } = self.nodes[node].place;
        let tree = self.programs[program].tree.clone();
        let mut state = CheckState::clone(&self.nodes[node].state);
        let kind = self.nodes[node].kind;
        self.shown = self.shown_at(node, &state);
        let reached = if kind == Reachability::Real { REACHED } else { 0 };
        let mut at = start;
        loop {
            let checked = &mut self.programs[program];
            let Some(block) = tree.blocks().get(at) else {
                checked.set(at, reached);
                // the checker reports a missing M99, and assumes that the called program returns
                let place = BlockPosition { program, block: at };
                let parts = returned(&state, place).into_iter();
                self.fork_path(
                    node,
                    parts.filter(|next| next.kind == Reachability::Real).collect(),
                );
                break;
            };
            if at != start && checked.has(at, JOIN) {
                checked.set(at, reached);
                self.continue_path(node, at, state);
                break;
            }
            checked.set(at, reached | LOOKED_AT);
            self.steps += 1;
            let here = CurrentBlock {
                node,
                place: BlockPosition { program, block: at },
                tree: &tree,
                block,
            };
            let step = self.step(here, &mut state);
            at += 1;
            if let BlockOutcome::Parts(parts) = step {
                self.fork_path(node, parts);
                break;
            }
        }
        self.nodes[node].end = at;
    }

    /// Returns the state that the text alone shows before a node: unknown after a jump, a call or a block
    /// that may be skipped. Returns `None` if this state equals `state`.
    fn shown_at(&self, node: usize, state: &CheckState) -> Option<CheckState> {
        let Node { place, before, .. } = &self.nodes[node];
        let (before, way) = before.filter(|_| !self.calculates(node))?;
        let is_behind = self.programs[place.program].has(place.block, JOIN)
            || matches!(way, Decision::Skip(_) | Decision::Called)
            || self.nodes[before].place.program != place.program;
        is_behind.then(|| {
            let mut shown = state.clone();
            shown.forget_all();
            shown
        })
    }

    /// Returns true if a fault that would be an alarm in a run is reported as an error. For blocks that no
    /// run reaches, returns false, as when a program is loaded.
    pub fn calculates(&self, node: usize) -> bool {
        self.context.calculates && self.is_real(node)
    }

    pub fn is_real(&self, node: usize) -> bool {
        self.nodes[node].kind == Reachability::Real
    }

    fn step(&mut self, here: CurrentBlock<'_>, state: &mut CheckState) -> BlockOutcome {
        match here.block.content {
            Content::ProgramCode(_) => self.program_code(here, state),
            Content::Words { .. } => self.block(here, state),
        }
    }

    fn continue_path(&mut self, node: usize, block: usize, state: CheckState) {
        let Node {
            place,
            kind,
            is_certain,
            ..
        } = self.nodes[node];
        let place = BlockPosition { block, ..place };
        let next = Next {
            place,
            state,
            way: Decision::On,
            kind,
        };
        self.arrive(Some(node), next, is_certain);
    }

    fn fork_path(&mut self, node: usize, parts: Vec<Next>) {
        let Node { kind, is_certain, .. } = self.nodes[node];
        let real = parts
            .iter()
            .filter(|next| next.kind == Reachability::Real)
            .count();
        for next in parts {
            if next.kind == Reachability::Supposed {
                self.supposed.push_back((node, next));
            } else {
                let next = Next { kind, ..next };
                self.arrive(Some(node), next, is_certain && real == 1);
            }
        }
    }

    /// Records that a run may reach a place in a state.
    fn arrive(&mut self, from: Option<usize>, next: Next, is_certain: bool) {
        let Next {
            place,
            state,
            way,
            kind,
        } = next;
        if kind == Reachability::Supposed && self.programs[place.program].has(place.block, REACHED) {
            return;
        }
        let heads = self.heads.entry(place).or_default();
        let same = heads.iter().copied().find(|node| {
            let node = &self.nodes[*node];
            node.kind == kind && *node.state == state
        });
        if let Some(node) = same {
            self.nodes[node].is_certain |= is_certain;
            return;
        }
        let states_max = if self.steps > self.steps_max {
            1
        } else {
            STATES_MAX
        };
        let alike = |node: &&usize| {
            let of = &self.nodes[**node];
            of.kind == kind && of.state.callers == state.callers
        };
        if heads.len() >= states_max {
            let same_modal = |node: &&usize| self.nodes[**node].state.modal == state.modal;
            let candidates: Vec<usize> = heads.iter().rev().filter(alike).copied().collect();
            let with = candidates.iter().find(same_modal);
            let with = with.or(candidates.first().filter(|_| heads.len() >= 2 * states_max));
            if let Some(with) = with.copied() {
                self.join(with, &state);
                return;
            }
        }
        let node = self.nodes.len();
        heads.push(node);
        self.nodes.push(Node {
            place,
            kind,
            is_certain,
            is_open: state.is_open,
            before: from.map(|from| (from, way)),
            end: place.block,
            state: Arc::new(state),
            waits: true,
        });
        self.open.push(Reverse((place.block, node)));
    }

    /// Joins a state to the state of a node. If the state of the node grows, the node is followed again.
    fn join(&mut self, node: usize, state: &CheckState) {
        let of = &mut self.nodes[node];
        of.is_certain = false;
        if Arc::make_mut(&mut of.state).widen(state) {
            of.is_open = of.state.is_open;
            if !std::mem::replace(&mut of.waits, true) {
                self.open.push(Reverse((of.place.block, node)));
            }
        }
    }

    /// Records a finding in a block that a node reaches. In blocks that no run reaches, ignores findings of
    /// calculated values.
    pub fn record_finding(&mut self, here: CurrentBlock<'_>, finding: Diagnostic, weight: Weight) {
        if weight != Weight::Sure && !self.is_real(here.node) {
            return;
        }
        self.groups.record(StateFinding {
            node: here.node,
            place: here.place,
            finding,
            weight,
        });
    }

    /// Returns the results of all programs.
    pub fn finish(self) -> Check {
        let Self {
            dialect,
            context,
            programs,
            nodes,
            groups,
            is_cut,
            ..
        } = self;
        let mut verdicts = groups.into_reports((dialect.grammar)(), &nodes, &programs);
        let mut main = Check::default();
        for (index, of) in programs.into_iter().enumerate() {
            let mut findings = Findings::new(dialect);
            for finding in verdicts.remove(&index).unwrap_or_default() {
                findings.push(finding);
            }
            of.report_missing(dialect, context, &mut findings);
            if !(is_cut || of.tree.source().len() > PROGRAM_BYTES_MAX) {
                structure::report_flow_faults(&of, dialect, &mut findings);
            }
            if index > 0 || !context.manual {
                of.mark(dialect, &mut findings);
            }
            findings.list.sort_by_key(|finding| finding.span.start);
            let check = Check {
                diagnostics: findings.list,
                m_codes: of.m_codes.into_keys().collect(),
                programs: of.programs.into_keys().collect(),
                calls_any: of.calls_any,
                called: BTreeMap::new(),
            };
            if index == 0 {
                main = check;
            } else {
                main.called.insert(of.number, check);
            }
        }
        main
    }
}

/// Returns the places where a run continues after a called program has ended: another repetition, or the
/// caller.
pub(super) fn returned(state: &CheckState, place: BlockPosition) -> Vec<Next> {
    let mut outside = state.clone();
    let Some(caller) = outside.callers.pop() else {
        return Vec::new();
    };
    let mut parts = Vec::new();
    if caller.repetitions != Some(0) {
        let mut again = state.clone();
        again.values.repeat();
        if let Some(last) = again.callers.last_mut() {
            last.repetitions = last.repetitions.map(|left| left - 1);
        }
        parts.push(Next {
            place: BlockPosition { block: 0, ..place },
            state: again,
            way: Decision::On,
            kind: Reachability::Real,
        });
    }
    if caller.repetitions.is_none_or(|left| left == 0) {
        outside.values.leave(&caller.locals);
        parts.push(Next {
            place: BlockPosition {
                program: caller.program,
                block: caller.block,
            },
            state: outside,
            way: Decision::On,
            kind: Reachability::Real,
        });
    }
    parts.push(Next {
        place: BlockPosition {
            block: place.block + 1,
            ..place
        },
        state: state.clone(),
        way: Decision::On,
        kind: Reachability::Supposed,
    });
    parts
}
