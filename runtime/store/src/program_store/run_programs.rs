//! Programs that runs need unchanged: the store rejects changes under their numbers until the run and all its
//! parts have ended.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::request::{Refusal, RefusalCode};

use super::{ProgramStore, StoredProgram};

/// The programs of each run, and the program that is being written.
#[derive(Debug, Default)]
pub(super) struct RunPrograms(Mutex<ProgramLocks>);

#[derive(Debug, Default)]
struct ProgramLocks {
    runs: BTreeMap<CoordinateSystemNumber, ProgramsOfRun>,
    /// The program that is being written; there is at most one.
    written: Option<u16>,
}

#[derive(Debug)]
struct ProgramsOfRun {
    run_id: String,
    programs: BTreeSet<u16>,
}

/// Guard of a write: while it exists, a program is being written.
pub(super) struct WriteGuard<'a>(&'a RunPrograms);

impl Drop for WriteGuard<'_> {
    fn drop(&mut self) {
        self.0.0.lock().written = None;
    }
}

impl RunPrograms {
    /// Begins to write a program; returns a refusal if the program belongs to a run.
    pub fn begin_writing(&self, number: u16) -> Result<WriteGuard<'_>, Refusal> {
        let mut kept = self.0.lock();
        if let Some(refusal) = kept.refusal(number) {
            return Err(refusal);
        }
        kept.written = Some(number);
        Ok(WriteGuard(self))
    }
}

impl ProgramLocks {
    fn refusal(&self, number: u16) -> Option<Refusal> {
        let mut runs = self.runs.iter();
        let (cs, run) = runs.find(|(_, run)| run.programs.contains(&number))?;
        let run_id = &run.run_id;
        let text = format!(
            "program {number} belongs to run {run_id} in coordinate system {cs}, which has not ended; stop the run first"
        );
        Some(Refusal {
            run_id: Some(run_id.clone()),
            ..Refusal::new(RefusalCode::ProgramRuns, text)
        })
    }
}

impl ProgramStore {
    /// Returns the refusal of a change, if the program belongs to a run.
    pub fn refuse_because_of_run(&self, number: u16) -> Option<Refusal> {
        self.run_programs.0.lock().refusal(number)
    }

    /// Returns true while a program is being written or removed.
    pub fn is_storing(&self) -> bool {
        self.run_programs.0.lock().written.is_some()
    }

    /// Begins a run with these texts, or its next part. From now on, the store rejects changes under their
    /// numbers.
    ///
    /// # Errors
    /// Returns a refusal if one of the programs was stored since its text was read, or is being stored.
    pub fn begin_run(
        &self,
        cs: CoordinateSystemNumber,
        run_id: &str,
        texts: &BTreeMap<u16, Arc<StoredProgram>>,
    ) -> Result<(), Refusal> {
        let mut kept = self.run_programs.0.lock();
        let all = self.all();
        let is_other = |(number, text): &(&u16, &Arc<StoredProgram>)| {
            let is_stored = all.get(number).is_some_and(|stored| Arc::ptr_eq(stored, text));
            kept.written == Some(**number) || !is_stored
        };
        if let Some((number, _)) = texts.iter().find(is_other) {
            let text = format!("program {number} is being stored; repeat the start");
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let run = ProgramsOfRun {
            run_id: run_id.to_owned(),
            programs: texts.keys().copied().collect(),
        };
        kept.runs.insert(cs, run);
        Ok(())
    }

    /// Ends a part of a run: until the next part begins, only `programs` belong to the run.
    pub fn end_part(&self, cs: CoordinateSystemNumber, run_id: &str, programs: BTreeSet<u16>) {
        let mut kept = self.run_programs.0.lock();
        if let Some(run) = kept.runs.get_mut(&cs).filter(|run| run.run_id == run_id) {
            run.programs = programs;
        }
    }

    /// Ends a run with all its parts; changes of its programs are allowed again.
    pub fn end_run(&self, cs: CoordinateSystemNumber, run_id: &str) {
        let mut kept = self.run_programs.0.lock();
        if kept.runs.get(&cs).is_some_and(|run| run.run_id == run_id) {
            kept.runs.remove(&cs);
        }
    }

    /// Ends any run of a coordinate system that runs no program until the runtime is restarted.
    pub fn end_run_of(&self, cs: CoordinateSystemNumber) {
        self.run_programs.0.lock().runs.remove(&cs);
    }
}
