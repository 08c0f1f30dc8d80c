//! Links units to one program: checks their calls, and assigns the memory of functions.

use super::{Arc, BTreeSet, Checker, Code, CodeUnit, MachineNeeds, Section};
use crate::code::Stmt;
use crate::finding::{NUMBER_RANGE, RECURSION, TOO_DEEP};
use crate::limits::CALL_DEPTH_MAX;
use crate::tree::UnitKind;

impl Checker<'_> {
    /// Returns the whole program; `None` if it has findings.
    pub(super) fn link(mut self, program: usize, bodies: Vec<Vec<Stmt>>) -> Option<(Code, MachineNeeds)> {
        let mut depths = vec![None; self.file.units.len()];
        for unit in 0..depths.len() {
            self.depth(unit, &mut depths, &mut BTreeSet::new());
        }
        for ((cs, m), span) in std::mem::take(&mut self.asked) {
            if !self.needs.m_codes.contains(&(cs, m)) {
                let what =
                    format!("a question about M{m:02} is never asked, because no MCODE serves M{m:02}");
                let help = format!("call an MCODE with M := {m}, CS := {cs}");
                self.found(&NUMBER_RANGE, span, what, help);
            }
        }
        if !self.findings.is_empty() {
            return None;
        }
        let mut code = Code {
            program,
            memory: self.frames.get(program)?.initial.len(),
            ..Code::default()
        };
        for (number, body) in bodies.into_iter().enumerate() {
            let frame = &self.frames[number];
            let is_function = self.file.units[number].kind == UnitKind::Function;
            let base = if is_function { code.memory } else { 0 };
            if is_function {
                code.memory += frame.initial.len();
            }
            let temporary = frame
                .variables
                .iter()
                .filter(|variable| variable.section == Section::Temporary);
            let slots = temporary.flat_map(|variable| {
                let size = self.size(&variable.of);
                variable.offset..variable.offset + size
            });
            let temporary = slots
                .filter_map(|slot| Some((slot, frame.initial.get(slot)?.clone())))
                .collect();
            code.units.push(CodeUnit {
                body,
                initial: Arc::from(frame.initial.as_slice()),
                temporary,
                base,
            });
        }
        #[cfg(test)]
        for variable in &self.frames[program].variables {
            if let Some(kind) = variable.of.elementary() {
                code.names.insert(variable.name.clone(), (variable.offset, kind));
            }
        }
        Some((code, self.needs))
    }

    /// Returns the depth of the calls of a unit; reports a finding if the unit calls itself, or too deep.
    fn depth(&mut self, unit: usize, known: &mut Vec<Option<usize>>, open: &mut BTreeSet<usize>) -> usize {
        if let Some(depth) = known[unit] {
            return depth;
        }
        open.insert(unit);
        let mut deepest = 1;
        for (called, span) in self.calls.get(&unit).cloned().unwrap_or_default() {
            if open.contains(&called) {
                let what = format!("{} calls itself", self.file.units[called].name.text);
                self.found(
                    &RECURSION,
                    span,
                    what,
                    "write a loop; IEC 61131-3 allows no recursion",
                );
                continue;
            }
            let depth = 1 + self.depth(called, known, open);
            if depth == CALL_DEPTH_MAX + 1 {
                let what = format!("calls are nested more than {CALL_DEPTH_MAX} deep");
                self.found(&TOO_DEEP, span, what, "reduce the nesting of calls");
            }
            deepest = deepest.max(depth);
        }
        open.remove(&unit);
        known[unit] = Some(deepest);
        deepest
    }
}
