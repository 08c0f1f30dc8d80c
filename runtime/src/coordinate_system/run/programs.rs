//! The programs of the store as a coordinate system uses them: which of them it may run.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use plc_protocol::types::program::ProgramDiagnostic;
use plc_protocol::types::request::{Refusal, RefusalCode};
use tandem_config::declared::{SourcedDeclaration, wrong_params};
use tandem_store::program_store::{StoredProgram, called_by, locate, shown_to_be_called_by};

use crate::coordinate_system::context::Context;
use crate::sequence::stock;

/// Programs by their numbers.
pub(crate) type Texts = BTreeMap<u16, Arc<StoredProgram>>;

impl Context {
    pub fn stored(&self, number: u16) -> Result<Arc<StoredProgram>, Refusal> {
        self.shared.store.get(number).ok_or_else(|| {
            if let Some(refusal) = self.shared.store.refuse_damaged(number) {
                return refusal;
            }
            let text = format!("program {number} is not in the store; store the program first");
            Refusal::new(RefusalCode::NotFound, text)
        })
    }

    /// Refuses a program if it or a program that it calls has errors. Otherwise returns a note for the operator, which
    /// may be empty.
    pub fn check_called(&self, main: &Arc<StoredProgram>) -> Result<String, Refusal> {
        let all = self.shared.store.all();
        let number = main.number;
        let calls = shown_to_be_called_by(&all, number);
        for called in calls.iter().copied() {
            if let Some(refusal) = self.shared.store.refuse_damaged(called) {
                return Err(refusal);
            }
        }
        let mut errors = Vec::new();
        let mut m_codes = BTreeSet::new();
        let called = calls.iter().filter(|called| **called != number);
        let called = called.filter_map(|called| all.get(called));
        for program in std::iter::once(main).chain(called) {
            if let Some(refusal) = self.refuses(program) {
                return Err(refusal);
            }
            let here = program.check_in(&self.configured.settings);
            m_codes.extend(here.m_codes.iter().copied());
            let place = program_prefix(program.number, number);
            let wrong = self.wrong_params(program, &here.m_codes);
            errors.extend(here.errors.iter().chain(&wrong).map(|found| ProgramDiagnostic {
                message: format!("{place}{}", found.message),
                ..found.clone()
            }));
        }
        if calls.len() > 1 {
            for (called, found) in main.check_called(&self.configured.settings, &all) {
                let message = format!("{}{}", program_prefix(called, number), found.message);
                let found = ProgramDiagnostic { message, ..found };
                if !errors.contains(&found) {
                    errors.push(found);
                }
            }
        }
        if !errors.is_empty() {
            let what = match number {
                0 => "the text".to_owned(),
                number => format!("program {number}"),
            };
            let text = format!("{what} has {} errors", errors.len());
            return Err(Refusal {
                diagnostics: errors,
                ..Refusal::new(RefusalCode::ProgramHasErrors, text)
            });
        }
        let unhandled: Vec<String> = m_codes
            .into_iter()
            .filter(|m| !self.is_served(*m))
            .map(|m| format!("M{m:02}"))
            .collect();
        if unhandled.is_empty() {
            Ok(String::new())
        } else {
            Ok(format!("no handler is registered for {}", unhandled.join(", ")))
        }
    }

    /// Returns diagnostics for parameters that M codes of this machine do not accept. Online handlers and the
    /// configuration declare the accepted parameters.
    fn wrong_params(&self, program: &StoredProgram, m_codes: &[u16]) -> Vec<ProgramDiagnostic> {
        let each = m_codes.iter();
        let declared: Vec<SourcedDeclaration> = each
            .flat_map(|m| self.shared.declared_of(self.number, *m))
            .collect();
        let found = wrong_params(&program.tree, program.dialect, &declared);
        locate(program.tree.source(), &found)
    }

    /// Returns the reason why this coordinate system does not run a program, if any. Texts without a number (MDI) are
    /// not checked.
    pub fn refuses(&self, program: &StoredProgram) -> Option<Refusal> {
        if program.number == 0 {
            return None;
        }
        let (own, here) = (program.dialect.name, self.configured.dialect.name);
        if own != here {
            let (number, cs) = (program.number, self.number);
            let text = format!(
                "program {number} has dialect {own}, but coordinate system {cs} has {here}; load it in \
                 a coordinate system with {own}, or store it with dialect={here}"
            );
            return Some(Refusal::new(RefusalCode::WrongDialect, text));
        }
        let why = program.refusal()?;
        Some(Refusal::new(RefusalCode::NotSigned, why))
    }

    /// Returns true if an online handler or the stock sequence program resets this M code.
    pub fn is_served(&self, m: u16) -> bool {
        let stock = self.m_code(m).and_then(|settings| settings.stock);
        let has_spindle = self.configured.settings.spindle.is_some();
        stock.is_some()
            || has_spindle && stock::is_spindle_code(m)
            || self.shared.is_handled(self.number, m)
            || self.shared.handler_back_s(self.number, m).is_some()
    }

    /// Returns a program of the store and the programs that it calls.
    pub fn texts_of(&self, main: u16) -> Texts {
        let all = self.shared.store.all();
        let called = called_by(&all, main).into_iter();
        called
            .filter_map(|number| Some((number, Arc::clone(all.get(&number)?))))
            .collect()
    }

    /// Refuses to start a program that was changed outside of the runtime since the load. This includes the programs
    /// that it calls.
    pub fn check_loaded(&self, main: u16, loaded: &Texts) -> Result<(), Refusal> {
        for (number, program) in self.texts_of(main) {
            let is_loaded = loaded
                .get(&number)
                .is_some_and(|loaded| Arc::ptr_eq(loaded, &program));
            if program.is_from_outside && !is_loaded {
                let text = format!(
                    "program {number} was changed outside of the runtime since program {main} was loaded; load it again"
                );
                return Err(Refusal::new(RefusalCode::NotAllowed, text));
            }
        }
        Ok(())
    }

    /// Returns true if neither the program nor those that it calls were written since the texts in `then` were read.
    pub fn stand_as(&self, main: u16, then: &Texts) -> bool {
        let now = self.texts_of(main);
        now.len() == then.len()
            && now
                .iter()
                .zip(then)
                .all(|((a, now), (b, then))| a == b && Arc::ptr_eq(now, then))
    }
}

/// Returns the prefix of a message about a program: for a called program, the program's number.
pub(crate) fn program_prefix(number: u16, main: u16) -> String {
    if number == main {
        return String::new();
    }
    format!("in program {number}, which is called: ")
}
