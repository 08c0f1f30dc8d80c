//! The program store: NC programs by number, parsed and checked when they are written.
//!
//! With a folder, each program is a file `<number>.nc` in it. It is written under a temporary name and renamed, and is on
//! disk before the write returns. A sum beside it tells a file that was changed outside from one that is damaged
//! (`folder`); a damaged one is no program until it is stored again.

mod file;
pub(crate) mod folder;
mod places;
mod program;
pub(crate) mod signing;

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::disk::fs;
use parking_lot::{Mutex, RwLock};
use plc_api::types::program::{ProgramCheck, ProgramInfo};
use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::upload::ProgramCondition;
use tandem_interp::dialects;
use tandem_model::limits::{PROGRAM_NUMBER_MAX, SUBPROGRAM_MIN};

pub(crate) use file::check_readable;
pub use file::{program_number, read_text, read_text_from};
use folder::{Accepted, Found, Look, Outside, ProgramFolder, look};
use places::Places;
pub(crate) use program::mentions_variables;
pub use program::{CheckHere, StoredProgram, TextRules, header, locate};
use serde::{Deserialize, Serialize};
use signing::Signature;
pub use signing::Signers;

/// Programs in the store at the most. A further one is refused.
pub const PROGRAMS_MAX: usize = 2000;

/// All programs of a machine.
#[derive(Debug)]
pub struct ProgramStore {
    /// Of the dialect of the lowest coordinate system.
    rules: TextRules,
    /// Of each dialect.
    rules_of: Vec<TextRules>,
    /// Coordinate systems have different dialects.
    is_mixed: bool,
    signers: Signers,
    programs: RwLock<Arc<BTreeMap<u16, Arc<StoredProgram>>>>,
    /// Damaged programs, and what is known of each. They are no programs.
    damaged: RwLock<BTreeMap<u16, String>>,
    /// How often a program has changed.
    changes: AtomicU64,
    path: Option<PathBuf>,
    /// Held while a program is written, so that one follows the other.
    writing: Mutex<()>,
    /// `None`: nothing is kept on disk, or the folder could not be opened.
    folder: Mutex<Option<ProgramFolder>>,
    /// In which folder of lists each program lies.
    places: Mutex<Places>,
    /// Files that a look found changed outside, with their times: one that the next look finds so, too, is read.
    changing: Mutex<BTreeMap<u16, Option<String>>>,
}

/// What a person should know of the folder of a store.
#[derive(Debug, Default)]
pub(crate) struct ProgramFindings {
    /// What was changed outside, in words.
    pub changed: Vec<String>,
    /// The same, and what was taken from the configuration.
    pub edits: Vec<Edit>,
    /// What is not read.
    pub not_read: Vec<String>,
    /// The folder, where it was there at an earlier start and is gone.
    pub lost: Option<PathBuf>,
    /// Programs that had no sum yet.
    pub without_sum: usize,
}

/// What has become of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edit {
    /// Its number.
    pub program: u16,
    /// What was done.
    pub what: EditKind,
    /// Hash of what was there before; `None`: nothing, or nobody knows.
    #[serde(rename = "old_hash", deserialize_with = "Option::deserialize")]
    pub old: Option<String>,
    /// Hash of what is there now; `None`: nothing.
    #[serde(rename = "new_hash", deserialize_with = "Option::deserialize")]
    pub new: Option<String>,
}

/// How a program has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EditKind {
    /// A new one was stored.
    Upload,
    /// Another one was stored in its place.
    Replace,
    /// The same was stored once more.
    Unchanged,
    /// It was removed.
    Delete,
    /// Its file was put there, changed or removed outside of the runtime.
    Outside,
    /// It was taken from the file that the configuration names.
    Configuration,
}

/// What a request to change a program has led to.
pub(crate) type Changed<T> = io::Result<Result<T, Refusal>>;

impl ProgramStore {
    /// A store of programs that keeps nothing on disk.
    pub fn in_memory(rules: TextRules) -> Self {
        Self {
            rules,
            rules_of: vec![rules],
            is_mixed: false,
            signers: Signers::default(),
            programs: RwLock::default(),
            damaged: RwLock::default(),
            changes: AtomicU64::new(0),
            path: None,
            writing: Mutex::default(),
            folder: Mutex::default(),
            places: Mutex::default(),
            changing: Mutex::default(),
        }
    }

    /// With the rules of further dialects, and those whose programs are run. `is_mixed`: coordinate systems have different
    /// dialects.
    #[must_use]
    pub(crate) fn for_dialects(self, rules_of: Vec<TextRules>, is_mixed: bool, signers: Signers) -> Self {
        Self {
            rules_of,
            is_mixed,
            signers,
            ..self
        }
    }

    /// The store of a folder, which is made if it is missing. Files that are not programs, or are larger than one can
    /// be, are left alone.
    ///
    /// # Errors
    /// The folder cannot be made, read or written.
    pub fn open(folder: &Path, rules: TextRules) -> io::Result<Self> {
        let mut store = Self::in_memory(rules);
        store.open_folder(folder).1?;
        Ok(store)
    }

    /// Reads the programs of a folder, and keeps what is written in it from now on. A folder that the disk lets nobody write
    /// is read all the same; when something is written, it is tried again.
    pub(crate) fn open_folder(&mut self, path: &Path) -> (ProgramFindings, io::Result<()>) {
        self.path = Some(path.to_owned());
        let opened = ProgramFolder::open(path, self.rules.dialect.name, self.is_mixed);
        *self.places.get_mut() = Places::read(path);
        let (look, opened) = match opened {
            Ok((folder, look)) => {
                *self.folder.get_mut() = Some(folder);
                (look, Ok(()))
            }
            Err(error) => (look(path, self.is_mixed).unwrap_or_default(), Err(error)),
        };
        (self.take_over(look), opened)
    }

    fn take_over(&self, look: Look) -> ProgramFindings {
        let mut findings = ProgramFindings {
            not_read: look.not_read,
            without_sum: look.without_sum,
            ..ProgramFindings::default()
        };
        for (number, found) in look.programs {
            let signature = look.signatures.get(&number).copied();
            let dialect = look.dialects.get(&number).map(String::as_str);
            match found {
                Found::Stored(bytes) => self.keep(self.of_file(number, bytes, dialect, signature)),
                Found::FromOutside(bytes, how, old) => {
                    let program = self.of_file(number, bytes, dialect, signature);
                    let sum = program.short_sum();
                    let text = format!("program {number}: {how}; its sum is {sum}");
                    findings.changed.push(text);
                    findings
                        .edits
                        .push(Edit::outside(number, old, Some(program.sum())));
                    self.keep(program);
                }
                Found::Damaged(how) => {
                    self.damaged.write().insert(number, how);
                }
            }
        }
        for (number, old) in look.gone {
            let text = format!("program {number}: its file was removed");
            findings.changed.push(text);
            findings.edits.push(Edit::outside(number, old, None));
        }
        findings
    }

    fn of_file(
        &self,
        number: u16,
        bytes: Vec<u8>,
        dialect: Option<&str>,
        signature: Option<Signature>,
    ) -> StoredProgram {
        let rules = self.rules_of(dialect).unwrap_or(self.rules);
        StoredProgram::of_file(number, bytes, signature, rules, &self.signers)
    }

    /// Looks for files that were changed outside while the runtime ran, and reads those that no longer change; gives what
    /// a person should know of it. Nothing can be said while a program is being written.
    ///
    /// # Errors
    /// The folder was removed or replaced.
    pub(crate) fn look_again(&self) -> io::Result<Vec<(String, Edit)>> {
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
            let old = self.get(number).map(|program| program.sum().to_owned());
            self.damaged.write().remove(&number);
            let how = if let Some(Accepted {
                bytes,
                signature,
                dialect,
            }) = read
            {
                let mut program = self.of_file(number, bytes, Some(&dialect), signature);
                program.is_from_outside = true;
                let sum = program.short_sum().to_owned();
                self.keep(program);
                format!("its file was written; its sum is {sum}; load it again")
            } else {
                self.forget(number);
                "its file was removed".to_owned()
            };
            let new = self.get(number);
            let new = new.as_deref().map(StoredProgram::sum);
            said.push((
                format!("program {number}: {how}"),
                Edit::outside(number, old, new),
            ));
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
        self.with_folder(|folder| folder.map_or(Ok(()), |folder| folder.probe()))
    }

    /// Does something with the folder, which is opened again where it was not; one that was lost is filled again. A store
    /// in memory has none.
    fn with_folder<T>(
        &self,
        work: impl FnOnce(Option<&mut ProgramFolder>) -> io::Result<T>,
    ) -> io::Result<T> {
        let Some(path) = &self.path else { return work(None) };
        let mut folder = self.folder.lock();
        if folder.as_ref().is_some_and(|folder| folder.check().is_err()) {
            *folder = None;
        }
        if folder.is_none() {
            let (mut opened, look) = ProgramFolder::open(path, self.rules.dialect.name, self.is_mixed)?;
            for (number, program) in &*self.all() {
                if !look.programs.contains_key(number) {
                    opened.write(
                        *number,
                        program.text().as_bytes(),
                        program.dialect.name,
                        program.signature(),
                    )?;
                }
            }
            *folder = Some(opened);
            for warning in self.take_over(look).changed {
                tracing::warn!("{warning}");
            }
        }
        work(folder.as_mut())
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

    /// How often a program has changed: another number says that another program may be there.
    pub(crate) fn changes(&self) -> u64 {
        self.changes.load(Ordering::Acquire)
    }

    /// Programs for lists, ascending.
    pub fn list(&self) -> Vec<ProgramInfo> {
        let places = self.places.lock();
        self.all()
            .values()
            .map(|program| ProgramInfo {
                folder: places.of(program.number).to_owned(),
                ..program.info()
            })
            .collect()
    }

    /// Puts a program into a folder of lists; empty: into none. False when there is no such program.
    ///
    /// # Errors
    /// The disk refuses.
    pub(crate) fn put_in_folder(&self, number: u16, folder: &str) -> io::Result<bool> {
        let _one_at_a_time = self.writing.lock();
        if self.get(number).is_none() {
            return Ok(false);
        }
        self.places.lock().put(number, folder)?;
        Ok(true)
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
        let stored = self.store(program, &ProgramCondition::default())?;
        stored.map(|(check, _)| check).map_err(io::Error::other)
    }

    /// The same under a condition, which is compared with what is there in the same step. Nothing is written where the
    /// same program is there; a signature that comes with it counts, and none leaves that which is there.
    ///
    /// # Errors
    /// As [`ProgramStore::write`].
    pub(crate) fn store(
        &self,
        program: StoredProgram,
        condition: &ProgramCondition,
    ) -> Changed<(ProgramCheck, Edit)> {
        let number = program.number;
        let _one_at_a_time = self.writing.lock();
        let created = self.check_room(number)?;
        self.with_folder(|folder| {
            let outside = outside(folder.as_deref(), number)?;
            let old = self.hash_now(number, &outside);
            if let Err(refusal) = condition.judge(number, old.as_deref()) {
                return Ok(Err(refusal));
            }
            let before = self
                .get(number)
                .filter(|before| outside == Outside::Nothing && before.is_same(&program));
            let what = match (&before, created) {
                (Some(_), _) => EditKind::Unchanged,
                (None, true) => EditKind::Upload,
                (None, false) => EditKind::Replace,
            };
            let new = Some(program.sum().to_owned());
            let check = ProgramCheck {
                created,
                unchanged: before.is_some(),
                ..before.as_ref().map_or(&program, |before| before).check.clone()
            };
            if before.is_none() {
                if let Some(folder) = folder {
                    let dialect = program.dialect.name;
                    folder.write(number, program.text().as_bytes(), dialect, program.signature())?;
                }
                self.keep(program);
            }
            let old = old.filter(|old| !old.is_empty());
            let edit = Edit {
                program: number,
                what,
                old,
                new,
            };
            Ok(Ok((check, edit)))
        })
    }

    /// The hash of what is there now: empty where that is damaged. `outside` is what was made of its file meanwhile.
    fn hash_now(&self, number: u16, outside: &Outside) -> Option<String> {
        match outside {
            Outside::Written(sum) => Some(sum.clone()),
            Outside::Removed => None,
            Outside::Nothing if self.damaged.read().contains_key(&number) => Some(String::new()),
            Outside::Nothing => self.get(number).map(|program| program.sum().to_owned()),
        }
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

    /// The rules by which programs of a dialect are parsed and checked; `None`: of that of the lowest coordinate system.
    ///
    /// # Errors
    /// There is no such dialect.
    pub(crate) fn rules_of(&self, dialect: Option<&str>) -> Result<TextRules, String> {
        let Some(dialect) = dialect else {
            return Ok(self.rules);
        };
        let dialect = dialects::find(dialect)?;
        let mut all = self.rules_of.iter().copied();
        let known = all.find(|rules| rules.dialect.name == dialect.name);
        Ok(known.unwrap_or(TextRules {
            dialect,
            ..self.rules
        }))
    }

    /// Those whose programs are run.
    pub(crate) fn signers(&self) -> &Signers {
        &self.signers
    }

    /// Removes a program, a damaged one, too; false when there is none.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn delete(&self, number: u16) -> io::Result<bool> {
        let removed = self.remove(number, &ProgramCondition::default())?;
        Ok(removed.map_err(io::Error::other)?.is_some())
    }

    /// The same under a condition, which is compared with what is there in the same step; `None`: there is none.
    ///
    /// # Errors
    /// The disk refuses.
    pub(crate) fn remove(&self, number: u16, condition: &ProgramCondition) -> Changed<Option<Edit>> {
        let _one_at_a_time = self.writing.lock();
        self.with_folder(|folder| {
            let outside = outside(folder.as_deref(), number)?;
            let old = self.hash_now(number, &outside);
            if let Err(refusal) = condition.judge(number, old.as_deref()) {
                return Ok(Err(refusal));
            }
            if old.is_none() && self.get(number).is_none() {
                return Ok(Ok(None));
            }
            if let Some(folder) = folder {
                folder.delete(number)?;
            }
            self.places.lock().put(number, "")?;
            self.damaged.write().remove(&number);
            self.forget(number);
            Ok(Ok(Some(Edit {
                program: number,
                what: EditKind::Delete,
                old: old.filter(|old| !old.is_empty()),
                new: None,
            })))
        })
    }

    fn forget(&self, number: u16) {
        let mut programs = self.programs.write();
        Arc::make_mut(&mut programs).remove(&number);
        self.changes.fetch_add(1, Ordering::Release);
    }

    /// Takes a program for the one of its number, without writing it.
    pub(crate) fn keep(&self, program: StoredProgram) {
        self.damaged.write().remove(&program.number);
        let mut programs = self.programs.write();
        Arc::make_mut(&mut programs).insert(program.number, Arc::new(program));
        self.changes.fetch_add(1, Ordering::Release);
    }

    fn path(&self, number: u16) -> Option<PathBuf> {
        Some(self.path.as_ref()?.join(folder::file_name(number)))
    }
}

fn outside(folder: Option<&ProgramFolder>, number: u16) -> io::Result<Outside> {
    folder.map_or(Ok(Outside::Nothing), |folder| folder.outside(number))
}

impl Edit {
    fn outside(program: u16, old: Option<String>, new: Option<&str>) -> Self {
        Self {
            program,
            what: EditKind::Outside,
            old,
            new: new.map(str::to_owned),
        }
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
mod tests;
