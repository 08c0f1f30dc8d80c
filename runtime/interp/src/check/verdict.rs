//! Combines the findings of single states into reports. A finding in all states is an error; a finding in
//! only some states is a warning that names the path.

use std::collections::{BTreeMap, BTreeSet};

use tandem_model::{Diagnostic, Severity};
use tandem_syntax::{Grammar, NcProgram, diagnostics};

use super::graph::{BlockPosition, CheckedProgram, Decision, Node, Reachability};

/// Maximum number of findings that are distinguished; further findings could not be listed anyway.
const GROUPS_MAX: usize = 4 * tandem_syntax::DIAGNOSTICS_MAX;

/// A finding in one state.
pub(super) struct StateFinding {
    pub node: usize,
    pub place: BlockPosition,
    pub finding: Diagnostic,
    pub weight: Weight,
}

/// The data on which a finding depends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Weight {
    /// The finding depends only on the written text.
    Sure,
    /// The finding depends on a calculated value, and is an alarm in a run (D11).
    Calculated,
    /// The finding depends on a variable that another writer may have changed.
    Doubtful,
}

/// One fault, and the nodes in whose states it occurs.
struct Group {
    place: BlockPosition,
    finding: Diagnostic,
    nodes: BTreeSet<usize>,
    weight: Weight,
}

/// The findings so far, by index of the program, first byte, diagnostic code and last byte.
#[derive(Default)]
pub(super) struct Groups(BTreeMap<(usize, u32, &'static str, u32), Group>);

impl Groups {
    pub fn record(&mut self, found: StateFinding) {
        let span = found.finding.span;
        let key = (found.place.program, span.start, found.finding.code, span.end);
        if self.0.len() >= GROUPS_MAX && !self.0.contains_key(&key) {
            return;
        }
        let group = self.0.entry(key).or_insert_with(|| Group {
            place: found.place,
            finding: found.finding,
            nodes: BTreeSet::new(),
            weight: Weight::Doubtful,
        });
        group.weight = group.weight.min(found.weight);
        group.nodes.insert(found.node);
    }

    /// Returns the reports for each program, by its index.
    pub fn into_reports(
        self,
        grammar: &Grammar,
        nodes: &[Node],
        programs: &[CheckedProgram<'_>],
    ) -> BTreeMap<usize, Vec<Diagnostic>> {
        let mut all: BTreeMap<usize, Vec<Diagnostic>> = BTreeMap::new();
        for group in self.0.into_values() {
            let program = group.place.program;
            all.entry(program)
                .or_default()
                .extend(summarize_group(group, grammar, nodes, programs));
        }
        all
    }
}

/// Number of states in which a fault occurs: all, some or none.
enum Verdict {
    Always,
    Sometimes { with: usize, without: Option<usize> },
    Never,
}

fn summarize_group(
    group: Group,
    grammar: &Grammar,
    nodes: &[Node],
    programs: &[CheckedProgram<'_>],
) -> Option<Diagnostic> {
    let mut finding = group.finding;
    if finding.severity == Severity::Warning {
        return Some(finding);
    }
    let doubt = match group.weight {
        Weight::Sure => "",
        Weight::Calculated => "; a run stops at this block with an alarm",
        Weight::Doubtful => ", unless another program has written the variable",
    };
    let way = match verdict(group.place, &group.nodes, nodes) {
        Verdict::Never => return None,
        Verdict::Always if group.weight == Weight::Sure => return Some(finding),
        Verdict::Always => String::new(),
        Verdict::Sometimes { with, without } => {
            let parting = parting(nodes, with, without);
            match parting {
                Some((at, way)) => format!(
                    " {}",
                    describe_decision(programs, group.place.program, at, nodes, way)
                ),
                None if is_root_of_two(nodes) => " if the program is started as a main program".to_owned(),
                None => String::new(),
            }
        }
    };
    let code = finding.code;
    finding.help = grammar.cite(code, finding.help);
    finding.code = diagnostics::WRONG_IN_SOME.code;
    finding.severity = Severity::Warning;
    finding.message = format!("{}{way}{doubt} ({code})", finding.message);
    Some(finding)
}

fn verdict(place: BlockPosition, found: &BTreeSet<usize>, nodes: &[Node]) -> Verdict {
    if found.iter().any(|node| {
        nodes[*node].is_certain && nodes[*node].kind == Reachability::Real && !nodes[*node].is_open
    }) {
        return Verdict::Always;
    }
    let comes = |node: &Node| {
        node.place.program == place.program && (node.place.block..node.end).contains(&place.block)
    };
    let all = nodes.iter().enumerate().filter(|(_, node)| comes(node));
    let is_real = all.clone().any(|(_, node)| node.kind == Reachability::Real);
    let of_kind = all.filter(|(_, node)| !is_real || node.kind == Reachability::Real);
    let mut with = None;
    let (mut without, mut without_open) = (None, None);
    for (at, node) in of_kind {
        match (found.contains(&at), node.is_open) {
            (true, false) => with = with.or(Some(at)),
            (true, true) => {}
            (false, false) => without = without.or(Some(at)),
            (false, true) => without_open = without_open.or(Some(at)),
        }
    }
    match (with, without.or(without_open)) {
        (_, None) => Verdict::Always,
        (Some(with), without) => Verdict::Sometimes { with, without },
        // a merged state proves nothing about the single states
        (None, Some(_)) => Verdict::Never,
    }
}

/// Returns true if the main program was checked twice: as a started program and as a called program.
fn is_root_of_two(nodes: &[Node]) -> bool {
    let roots = nodes
        .iter()
        .filter(|node| node.before.is_none() && node.kind == Reachability::Real);
    roots.count() > 1
}

/// Returns the node and the decision at which the path to `with` leaves the path to `without`. If the paths
/// have no common node, returns the first decision on the path to `with`.
fn parting(nodes: &[Node], with: usize, without: Option<usize>) -> Option<(usize, Decision)> {
    let mut others = BTreeSet::new();
    let mut at = without;
    while let Some(node) = at {
        others.insert(node);
        at = nodes[node].before.map(|(before, _)| before);
    }
    let mut at = with;
    let mut last = None;
    while let Some((before, way)) = nodes[at].before {
        if way != Decision::On {
            last = Some((before, way));
        }
        if others.contains(&before) {
            return last;
        }
        at = before;
    }
    last
}

/// Returns a text that describes a decision in the last block of a node.
fn describe_decision(
    programs: &[CheckedProgram<'_>],
    reader: usize,
    node: usize,
    nodes: &[Node],
    way: Decision,
) -> String {
    let program = nodes[node].place.program;
    let of = &programs[program];
    let tree: &NcProgram = &of.tree;
    let last = nodes[node].end.saturating_sub(1);
    let line = tree.blocks().get(last).map_or(0, |block| block.line);
    let here = if program == reader {
        format!("line {line}")
    } else if of.number == 0 {
        format!("line {line} of the main program")
    } else {
        format!("line {line} of program {}", of.number)
    };
    match way {
        Decision::On => String::new(),
        Decision::If(true) => format!("if the condition in {here} is true"),
        Decision::If(false) => format!("if the condition in {here} is false"),
        Decision::Loop(true) => format!("in the loop of {here}"),
        Decision::Loop(false) => format!("after the loop of {here}"),
        Decision::Again => format!("in a further turn of the loop of {here}"),
        Decision::Case(Some(label)) => format!("if case {label} in {here} matches"),
        Decision::Case(None) => format!("if no case in {here} matches"),
        Decision::Skip(true) => format!("if the block in {here} is skipped"),
        Decision::Skip(false) => format!("if the block in {here} is not skipped"),
        Decision::Called => format!("if {here} calls the program"),
    }
}
