//! The program store: NC programs by number, parsed and checked when they are written.
//!
//! With a folder, each program is a file `<number>.nc` in it. It is written under a temporary name and renamed, and is on
//! disk before the write returns. A sum beside it tells a file that was changed outside from one that is damaged
//! (`folder`); a damaged one is no program until it is stored again.

mod file;
pub(crate) mod folder;
mod program;

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::disk::fs;
use parking_lot::{Mutex, RwLock};
use plc_api::types::program::{ProgramCheck, ProgramInfo};
use plc_api::types::request::{Refusal, RefusalCode};
use tandem_model::limits::{PROGRAM_NUMBER_MAX, SUBPROGRAM_MIN};

pub(crate) use file::check_readable;
pub use file::{program_number, read_text, read_text_from};
use folder::{Found, Look, ProgramFolder};
pub use program::{CheckHere, StoredProgram, TextRules, header, locate};

/// Programs in the store at the most. A further one is refused.
pub const PROGRAMS_MAX: usize = 2000;

/// All programs of a machine.
#[derive(Debug)]
pub struct ProgramStore {
    rules: TextRules,
    programs: RwLock<Arc<BTreeMap<u16, Arc<StoredProgram>>>>,
    /// Damaged programs, and what is known of each. They are no programs.
    damaged: RwLock<BTreeMap<u16, String>>,
    path: Option<PathBuf>,
    /// Held while a program is written, so that one follows the other.
    writing: Mutex<()>,
    /// `None`: nothing is kept on disk, or the folder could not be opened.
    folder: Mutex<Option<ProgramFolder>>,
    /// Files that a look found changed outside, with their times: one that the next look finds so, too, is read.
    changing: Mutex<BTreeMap<u16, Option<String>>>,
}

/// What a person should know of the folder of a store.
#[derive(Debug, Default)]
pub(crate) struct ProgramFindings {
    /// What was changed outside.
    pub changed: Vec<String>,
    /// What is not read.
    pub not_read: Vec<String>,
    /// Programs that had no sum yet.
    pub without_sum: usize,
}

impl ProgramStore {
    /// A store of programs that keeps nothing on disk.
    pub fn in_memory(rules: TextRules) -> Self {
        Self {
            rules,
            programs: RwLock::default(),
            damaged: RwLock::default(),
            path: None,
            writing: Mutex::default(),
            folder: Mutex::default(),
            changing: Mutex::default(),
        }
    }

    /// The store of a folder, which is made if it is missing. Files that are not programs, or are larger than one can
    /// be, are left alone.
    ///
    /// # Errors
    /// The folder cannot be made, read or written.
    pub fn open(folder: &Path, rules: TextRules) -> io::Result<Self> {
        let mut store = Self::in_memory(rules);
        store.open_folder(folder)?;
        Ok(store)
    }

    /// Reads the programs of a folder, and keeps what is written in it from now on. After an error it keeps trying when
    /// something is written.
    pub(crate) fn open_folder(&mut self, path: &Path) -> io::Result<ProgramFindings> {
        self.path = Some(path.to_owned());
        let (folder, look) = ProgramFolder::open(path)?;
        *self.folder.get_mut() = Some(folder);
        Ok(self.take_over(look))
    }

    fn take_over(&self, look: Look) -> ProgramFindings {
        let mut findings = ProgramFindings {
            not_read: look.not_read,
            without_sum: look.without_sum,
            ..ProgramFindings::default()
        };
        for (number, found) in look.programs {
            match found {
                Found::Stored(bytes) => self.keep(StoredProgram::of_file(number, bytes, self.rules)),
                Found::FromOutside(bytes, how) => {
                    let program = StoredProgram::of_file(number, bytes, self.rules);
                    let sum = program.short_sum();
                    findings
                        .changed
                        .push(format!("program {number}: {how}; its sum is {sum}"));
                    self.keep(program);
                }
                Found::Damaged(how) => {
                    self.damaged.write().insert(number, how);
                }
            }
        }
        let gone = look.gone.iter();
        (findings.changed).extend(gone.map(|number| format!("program {number}: its file was removed")));
        findings
    }

    /// Looks for files that were changed outside while the runtime ran, and reads those that no longer change; gives what
    /// a person should know of it. Nothing can be said while a program is being written.
    ///
    /// # Errors
    /// The folder was removed or replaced.
    pub(crate) fn look_again(&self) -> io::Result<Vec<String>> {
        let Some(mut folder) = self.folder.try_lock() else {
            return Ok(Vec::new());
        };
        if let Some(folder) = folder.as_ref() {
            folder.check()?;
        }
        let changed = folder.as_ref().and_then(|folder| folder.changed().ok());
        let changed = changed.unwrap_or_default();
        let before = std::mem::replace(&mut *self.changing.lock(), changed.clone());
        let mut said = Vec::new();
        for (number, time) in changed {
            if before.get(&number) != Some(&time) {
                continue;
            }
            let Some(folder) = folder.as_mut() else { break };
            let read = match time {
                Some(_) => folder.accept(number).map(Some),
                None => folder.remove(number).map(|()| None),
            };
            // what cannot be read now is looked at again
            let Ok(read) = read else { continue };
            self.damaged.write().remove(&number);
            let how = if let Some(bytes) = read {
                let mut program = StoredProgram::of_file(number, bytes, self.rules);
                program.is_from_outside = true;
                let sum = program.short_sum().to_owned();
                self.keep(program);
                format!("its file was written; its sum is {sum}; load it again")
            } else {
                self.forget(number);
                "its file was removed".to_owned()
            };
            said.push(format!("program {number}: {how}"));
        }
        Ok(said)
    }

    /// The refusal of whatever needs a program, if it is damaged.
    pub(crate) fn refuse_damaged(&self, number: u16) -> Option<Refusal> {
        let how = self.damaged.read().get(&number).cloned()?;
        let text = format!(
            "program {number} is damaged: {how}; store it again, or stop the runtime and look at tandem store repair"
        );
        Some(Refusal::new(RefusalCode::Unavailable, text))
    }

    /// Damaged programs, and what is known of each.
    pub(crate) fn damaged(&self) -> BTreeMap<u16, String> {
        self.damaged.read().clone()
    }

    /// Checks that programs can be written.
    ///
    /// # Errors
    /// The disk refuses.
    pub(crate) fn probe(&self) -> io::Result<()> {
        self.with_folder(|folder| folder.probe())
    }

    /// Does something with the folder, which is opened again where it was not; one that was lost is filled again.
    fn with_folder(&self, work: impl FnOnce(&mut ProgramFolder) -> io::Result<()>) -> io::Result<()> {
        let Some(path) = &self.path else { return Ok(()) };
        let mut folder = self.folder.lock();
        if folder.as_ref().is_some_and(|folder| folder.check().is_err()) {
            *folder = None;
        }
        if folder.is_none() {
            let (mut opened, look) = ProgramFolder::open(path)?;
            for (number, program) in &*self.all() {
                if !look.programs.contains_key(number) {
                    opened.write(*number, program.text().as_bytes())?;
                }
            }
            *folder = Some(opened);
            for warning in self.take_over(look).changed {
                tracing::warn!("{warning}");
            }
        }
        folder
            .as_mut()
            .map_or(Ok(()), work)
            .map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", path.display())))
    }

    /// A view of all programs that later writes do not change.
    pub fn all(&self) -> Arc<BTreeMap<u16, Arc<StoredProgram>>> {
        Arc::clone(&self.programs.read())
    }

    /// One program.
    pub fn get(&self, number: u16) -> Option<Arc<StoredProgram>> {
        self.all().get(&number).cloned()
    }

    /// Programs for lists, ascending.
    pub fn list(&self) -> Vec<ProgramInfo> {
        self.all().values().map(|program| program.info()).collect()
    }

    /// When the program's file was last written; `None` without one.
    pub fn written_at(&self, number: u16) -> Option<std::time::SystemTime> {
        fs::metadata(self.path(number)?).ok()?.modified().ok()
    }

    /// Writes a program; with a folder it is on disk when this returns. True in the answer's `created`: it is new.
    ///
    /// # Errors
    /// The number is out of range, the store is full, or the disk refuses.
    pub fn write(&self, number: u16, text: &str) -> io::Result<ProgramCheck> {
        self.put(StoredProgram::new(number, text, self.rules))
    }

    /// The same for a program that has been parsed and checked by the rules of this store.
    ///
    /// # Errors
    /// As [`ProgramStore::write`].
    pub fn put(&self, program: StoredProgram) -> io::Result<ProgramCheck> {
        let number = program.number;
        let _one_at_a_time = self.writing.lock();
        let created = self.check_room(number)?;
        let check = ProgramCheck {
            created,
            ..program.check.clone()
        };
        if self.path.is_none() {
            self.keep(program);
            return Ok(check);
        }
        self.with_folder(|folder| {
            folder.write(number, program.text().as_bytes())?;
            self.keep(program);
            Ok(())
        })?;
        Ok(check)
    }

    /// Tells whether a program would be new.
    ///
    /// # Errors
    /// The number is out of range, or the store is full.
    pub(crate) fn check_room(&self, number: u16) -> io::Result<bool> {
        if !(1..=PROGRAM_NUMBER_MAX).contains(&number) {
            let text = format!("{number} is not a program number; write 1 to {PROGRAM_NUMBER_MAX}");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        }
        let all = self.all();
        let created = !all.contains_key(&number);
        if created && all.len() >= PROGRAMS_MAX {
            let text = format!("the store holds {PROGRAMS_MAX} programs; delete one first");
            return Err(io::Error::new(io::ErrorKind::QuotaExceeded, text));
        }
        Ok(created)
    }

    /// The rules by which programs are parsed and checked.
    pub(crate) fn rules(&self) -> TextRules {
        self.rules
    }

    /// Removes a program, a damaged one, too; false when there is none.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn delete(&self, number: u16) -> io::Result<bool> {
        let _one_at_a_time = self.writing.lock();
        if self.get(number).is_none() && !self.damaged.read().contains_key(&number) {
            return Ok(false);
        }
        self.with_folder(|folder| folder.remove(number))?;
        let was_damaged = self.damaged.write().remove(&number).is_some();
        Ok(self.forget(number) || was_damaged)
    }

    fn forget(&self, number: u16) -> bool {
        let mut programs = self.programs.write();
        Arc::make_mut(&mut programs).remove(&number).is_some()
    }

    /// Takes a program for the one of its number, without writing it.
    pub(crate) fn keep(&self, program: StoredProgram) {
        self.damaged.write().remove(&program.number);
        let mut programs = self.programs.write();
        Arc::make_mut(&mut programs).insert(program.number, Arc::new(program));
    }

    fn path(&self, number: u16) -> Option<PathBuf> {
        Some(self.path.as_ref()?.join(folder::file_name(number)))
    }
}

/// A program and all that it may call, of those that there are: where its text does not show which, all subprograms.
pub(crate) fn called_by(all: &BTreeMap<u16, Arc<StoredProgram>>, main: u16) -> BTreeSet<u16> {
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

/// A program and all that its text shows that it calls.
pub(crate) fn shown_to_be_called_by(all: &BTreeMap<u16, Arc<StoredProgram>>, main: u16) -> BTreeSet<u16> {
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

#[cfg(test)]
mod tests {
    use plc_api::types::program::DiagnosticSeverity;
    use tandem_interp::dialects::nj;
    use tandem_model::limits::PROGRAM_BYTES_MAX;
    use tandem_model::settings::NcOptions;

    use super::*;

    fn rules() -> TextRules {
        TextRules {
            dialect: nj(),
            options: NcOptions::default(),
            arc_radius_tolerance_mm: 0.01,
        }
    }

    #[test]
    fn a_written_program_is_there_after_the_store_is_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = ProgramStore::open(folder.path(), rules()).unwrap();
        assert!(store.write(7, "// Seven\nG90\nM30\n").unwrap().created);
        assert!(!store.write(7, "// Seven again\nG90\nM30\n").unwrap().created);
        let again = ProgramStore::open(folder.path(), rules()).unwrap();
        assert_eq!(again.list()[0].title, "Seven again");
        assert!(again.delete(7).unwrap());
        assert!(
            ProgramStore::open(folder.path(), rules())
                .unwrap()
                .list()
                .is_empty()
        );
    }

    #[test]
    fn a_program_with_errors_is_stored_and_says_them() {
        let store = ProgramStore::in_memory(rules());
        let check = store.write(1, "G01 X\nM30\n").unwrap();
        assert!(
            check
                .diagnostics
                .iter()
                .any(|found| found.severity == DiagnosticSeverity::Error)
        );
        assert!(store.get(1).unwrap().has_errors());
    }

    #[test]
    fn program_numbers_outside_1_to_9999_are_refused() {
        let store = ProgramStore::in_memory(rules());
        assert!(store.write(0, "M30").is_err());
        assert!(store.write(10_000, "M30").is_err());
    }

    #[test]
    fn a_file_that_is_larger_than_a_program_may_be_is_not_read_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("7.nc");
        std::fs::File::create(&path)
            .unwrap()
            .set_len(PROGRAM_BYTES_MAX as u64 + 1)
            .unwrap();
        assert_eq!(read_text(&path).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        assert!(
            ProgramStore::open(folder.path(), rules())
                .unwrap()
                .list()
                .is_empty()
        );
    }
}
