//! Determines the programs that a program may call.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tandem_model::limits::SUBPROGRAM_MIN;

use super::program::StoredProgram;

/// Returns the number of a program and of all programs that it may call, directly or indirectly. A text that
/// computes a called number may call any stored subprogram.
pub fn called_by(all: &BTreeMap<u16, Arc<StoredProgram>>, main: u16) -> BTreeSet<u16> {
    followed(main, |number| {
        let program = all.get(&number).into_iter();
        program
            .flat_map(|program| {
                let any = all.range(SUBPROGRAM_MIN..).filter(|_| program.calls_any);
                let shown = program.check.programs.iter().copied();
                shown.chain(any.map(|(number, _)| *number))
            })
            .collect()
    })
}

/// Returns the number of a program and of all programs that the texts call by a written number.
pub fn shown_to_be_called_by(all: &BTreeMap<u16, Arc<StoredProgram>>, main: u16) -> BTreeSet<u16> {
    followed(main, |number| {
        let program = all.get(&number);
        program.map_or_else(Vec::new, |program| program.check.programs.clone())
    })
}

fn followed(main: u16, calls: impl Fn(u16) -> Vec<u16>) -> BTreeSet<u16> {
    let (mut called, mut left) = (BTreeSet::from([main]), vec![main]);
    while let Some(number) = left.pop() {
        let calls = calls(number).into_iter();
        left.extend(calls.filter(|number| called.insert(*number)));
    }
    called
}
