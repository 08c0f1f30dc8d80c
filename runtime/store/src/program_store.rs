//! The program store: NC programs by number, parsed and checked when they are written.
//!
//! With a folder, each program is a file `<number>.nc` in this folder. The store writes a program to a temporary file
//! and renames it; the program is on disk before the write returns. A recorded checksum distinguishes a file that was
//! changed outside of the runtime from a damaged file (`folder`). A damaged file cannot be used as a program until it
//! is stored again.

mod calls;
mod edit;
mod file;
pub mod folder;
pub mod folder_assignments;
mod on_disk;
mod program;
mod run_programs;
pub mod signing;

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::disk::{DiskPath, Generations};
use parking_lot::{Mutex, RwLock};
use plc_protocol::types::program::{ProgramCheck, ProgramInfo};
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::upload::ProgramCondition;
use tandem_interp::dialects;
use tandem_model::limits::PROGRAM_NUMBER_MAX;

pub use calls::{called_by, shown_to_be_called_by};
pub use edit::{Edit, EditKind};
pub use file::check_readable;
pub use file::{program_number, read_text, read_text_from};
use folder::{Outside, ProgramFolder};
use folder_assignments::FolderAssignments;
pub use on_disk::{HeldBack, ProgramFindings};
pub use program::mentions_variables;
pub use program::{CheckHere, StoredProgram, TextRules, header, locate};
pub use signing::Signers;

/// Maximum number of programs in the store. Further programs are rejected.
pub const PROGRAMS_MAX: usize = 2000;

/// Default of the maximum bytes of all program texts together.
pub const PROGRAMS_BYTES_MAX: usize = 256 << 20;

/// All programs of a machine.
#[derive(Debug)]
pub struct ProgramStore {
    /// Rules of the dialect of the coordinate system with the lowest number.
    rules: TextRules,
    /// Rules of each dialect.
    rules_of: Vec<TextRules>,
    /// True if coordinate systems have different dialects.
    is_mixed: bool,
    signers: Signers,
    /// Maximum bytes of all program texts together.
    bytes_max: usize,
    programs: RwLock<Arc<BTreeMap<u16, Arc<StoredProgram>>>>,
    /// Damaged programs, each with a description of the damage. They are not in `programs`.
    damaged: RwLock<BTreeMap<u16, String>>,
    /// Number of program changes since the start.
    changes: AtomicU64,
    path: Option<DiskPath>,
    /// Serializes writes and removals of programs.
    writing: Mutex<()>,
    /// `None` if programs are in memory only, or if the folder could not be opened.
    folder: Mutex<Option<ProgramFolder>>,
    /// Folder of each program in the program list.
    places: Mutex<FolderAssignments>,
    generations: Arc<Generations>,
    /// True if all programs are withheld when the folder is opened.
    holds_back: AtomicBool,
    run_programs: run_programs::RunPrograms,
    /// Files that a scan found changed outside, with their times. A file is read when the next scan finds the same
    /// time.
    changing: Mutex<BTreeMap<u16, Option<String>>>,
}

/// Result of a request to change a program; the inner error is a refusal.
pub type ChangeResult<T> = io::Result<Result<T, Refusal>>;

impl ProgramStore {
    /// Creates a store that keeps programs in memory only.
    pub fn in_memory(rules: TextRules) -> Self {
        Self {
            rules,
            rules_of: vec![rules],
            is_mixed: false,
            signers: Signers::default(),
            bytes_max: PROGRAMS_BYTES_MAX,
            programs: RwLock::default(),
            damaged: RwLock::default(),
            changes: AtomicU64::new(0),
            path: None,
            writing: Mutex::default(),
            folder: Mutex::default(),
            places: Mutex::default(),
            generations: Arc::default(),
            holds_back: AtomicBool::new(false),
            run_programs: run_programs::RunPrograms::default(),
            changing: Mutex::default(),
        }
    }

    /// Sets the rules of all dialects and the accepted signers. `is_mixed` is true if coordinate systems have different
    /// dialects.
    #[must_use]
    pub fn for_dialects(self, rules_of: Vec<TextRules>, is_mixed: bool, signers: Signers) -> Self {
        Self {
            rules_of,
            is_mixed,
            signers,
            ..self
        }
    }

    /// Sets the maximum bytes of all program texts together.
    #[must_use]
    pub fn with_room(self, bytes_max: usize) -> Self {
        Self { bytes_max, ..self }
    }

    /// Opens the store of a folder, and creates the folder if it is missing. Files that are not programs or exceed the
    /// size limit are left unchanged.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be created, read or written.
    pub fn open(folder: &Path, rules: TextRules) -> io::Result<Self> {
        let mut store = Self::in_memory(rules);
        store.open_folder(&folder.into(), &HeldBack::default()).1?;
        Ok(store)
    }

    /// Returns the refusal of a request for this program if the program is damaged.
    pub fn refuse_damaged(&self, number: u16) -> Option<Refusal> {
        let how = self.damaged.read().get(&number).cloned()?;
        let text = format!(
            "program {number} is damaged: {how}; store it again, or stop the runtime and run tandem store \
             repair"
        );
        Some(Refusal::new(RefusalCode::Unavailable, text))
    }

    /// Returns the damaged programs, each with a description of the damage.
    pub fn damaged(&self) -> BTreeMap<u16, String> {
        self.damaged.read().clone()
    }

    /// Returns a snapshot of all programs. Later writes do not change the snapshot.
    pub fn all(&self) -> Arc<BTreeMap<u16, Arc<StoredProgram>>> {
        Arc::clone(&self.programs.read())
    }

    /// Returns one program.
    pub fn get(&self, number: u16) -> Option<Arc<StoredProgram>> {
        self.all().get(&number).cloned()
    }

    /// Returns the number of program changes. If two calls return the same number, no program has changed between them.
    pub fn changes(&self) -> u64 {
        self.changes.load(Ordering::Acquire)
    }

    /// Returns the entries of the program list in ascending order of numbers.
    pub fn list(&self) -> Vec<ProgramInfo> {
        let places = self.places.lock();
        self.all()
            .values()
            .map(|program| ProgramInfo {
                folder: places.folder_of(program.number).to_owned(),
                ..program.info()
            })
            .collect()
    }

    /// Assigns a program to a folder of the program list; an empty name removes the assignment. Returns false if the
    /// program does not exist.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn put_in_folder(&self, number: u16, folder: &str) -> io::Result<bool> {
        let _one_at_a_time = self.writing.lock();
        if self.get(number).is_none() {
            return Ok(false);
        }
        self.places.lock().put(number, folder)?;
        Ok(true)
    }

    /// Returns the time of the last write of the program's file; `None` without a file.
    pub fn written_at(&self, number: u16) -> Option<std::time::SystemTime> {
        Some(self.path(number)?.metadata().ok()?.modified_at())
    }

    /// Parses, checks and writes a program. In a store with a folder, the program is on disk when this returns.
    /// `created` in the result is true for a new program.
    ///
    /// # Errors
    /// Returns an error if the number is out of range, the store is full, or the disk operation fails.
    pub fn write(&self, number: u16, text: &str) -> io::Result<ProgramCheck> {
        self.put(StoredProgram::new(number, text, self.rules))
    }

    /// Writes a program that was already parsed and checked by the rules of this store.
    ///
    /// # Errors
    /// Returns an error in the cases of [`ProgramStore::write`].
    pub fn put(&self, program: StoredProgram) -> io::Result<ProgramCheck> {
        let stored = self.store(program, &ProgramCondition::default())?;
        stored.map(|(check, _)| check).map_err(io::Error::other)
    }

    /// Writes a program if `condition` holds. No other change can occur between the comparison and the write. An
    /// identical stored program is not written again. A signature of the new program replaces the stored signature;
    /// otherwise the stored signature stays.
    ///
    /// # Errors
    /// Returns an error in the cases of [`ProgramStore::write`].
    pub fn store(
        &self,
        program: StoredProgram,
        condition: &ProgramCondition,
    ) -> ChangeResult<(ProgramCheck, Edit)> {
        let number = program.number;
        let _one_at_a_time = self.writing.lock();
        let created = self.check_room(number, program.text().len())?;
        let _writing = match self.run_programs.begin_writing(number) {
            Ok(writing) => writing,
            Err(refusal) => return Ok(Err(refusal)),
        };
        self.with_folder(|folder| {
            let outside = outside(folder.as_deref(), number)?;
            let old = self.hash_now(number, &outside);
            if let Err(refusal) = condition.check_stored_hash(number, old.as_deref()) {
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
            let new = Some(program.checksum().to_owned());
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

    /// Returns the current hash of a program; empty for a damaged program. `outside` is a change of its file that the
    /// store has not read yet.
    fn hash_now(&self, number: u16, outside: &Outside) -> Option<String> {
        match outside {
            Outside::Written(sum) => Some(sum.clone()),
            Outside::Removed => None,
            Outside::Nothing if self.damaged.read().contains_key(&number) => Some(String::new()),
            Outside::Nothing => self.get(number).map(|program| program.checksum().to_owned()),
        }
    }

    /// Checks that a program of `bytes` bytes can be stored. Returns true if the program would be new.
    ///
    /// # Errors
    /// Returns an error if the number is out of range, or the store is full.
    pub fn check_room(&self, number: u16, bytes: usize) -> io::Result<bool> {
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
        let others = all.values().filter(|program| program.number != number);
        let taken: usize = others.map(|program| program.text().len()).sum();
        if taken + bytes > self.bytes_max {
            let text = no_room(bytes as u64, self.bytes_max);
            return Err(io::Error::new(io::ErrorKind::QuotaExceeded, text));
        }
        Ok(created)
    }

    /// Returns the rules for parsing and checking programs of a dialect. For `None`, returns those of the coordinate
    /// system with the lowest number.
    ///
    /// # Errors
    /// Returns an error if the dialect does not exist.
    pub fn rules_of(&self, dialect: Option<&str>) -> Result<TextRules, String> {
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

    /// Returns the signers whose programs may run.
    pub fn signers(&self) -> &Signers {
        &self.signers
    }

    /// Removes a program, even a damaged one. Returns false if the program does not exist.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn delete(&self, number: u16) -> io::Result<bool> {
        let removed = self.remove(number, &ProgramCondition::default())?;
        Ok(removed.map_err(io::Error::other)?.is_some())
    }

    /// Removes a program if `condition` holds. No other change can occur between the comparison and the removal.
    /// Returns `None` if the program does not exist.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn remove(&self, number: u16, condition: &ProgramCondition) -> ChangeResult<Option<Edit>> {
        let _one_at_a_time = self.writing.lock();
        let _writing = match self.run_programs.begin_writing(number) {
            Ok(writing) => writing,
            Err(refusal) => return Ok(Err(refusal)),
        };
        self.with_folder(|folder| {
            let outside = outside(folder.as_deref(), number)?;
            let old = self.hash_now(number, &outside);
            if let Err(refusal) = condition.check_stored_hash(number, old.as_deref()) {
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

    /// Adds a program to the programs in memory, without writing a file.
    pub fn keep(&self, program: StoredProgram) {
        self.damaged.write().remove(&program.number);
        let mut programs = self.programs.write();
        Arc::make_mut(&mut programs).insert(program.number, Arc::new(program));
        self.changes.fetch_add(1, Ordering::Release);
    }

    fn path(&self, number: u16) -> Option<DiskPath> {
        Some(self.path.as_ref()?.join(folder::file_name(number)))
    }
}

/// Returns the reason for the rejection of a program of `bytes` bytes.
fn no_room(bytes: u64, bytes_max: usize) -> String {
    format!(
        "with {bytes} more bytes, all programs together would exceed {bytes_max} bytes; delete a program \
         first, or \
         raise total_max_mib in [programs]"
    )
}

fn outside(folder: Option<&ProgramFolder>, number: u16) -> io::Result<Outside> {
    folder.map_or(Ok(Outside::Nothing), |folder| folder.outside(number))
}

#[cfg(test)]
mod tests;
