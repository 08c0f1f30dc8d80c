//! The folder of a program store. The store reads the folder when it opens the folder, and again if files
//! change outside of the runtime.

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::ProgramStore;
use super::edit::Edit;
use super::folder::{AcceptedFile, FolderScan, Opening, ProgramFileState, ProgramFolder, scan_folder};
use super::folder_assignments::{FolderAssignments, FolderByProgram};
use super::program::StoredProgram;
use super::signing::Signature;
use crate::disk::{DiskPath, Generations};

/// Findings about the folder of a program store, to report to a person.
#[derive(Debug, Default)]
pub struct ProgramFindings {
    /// Changes made outside of the runtime, as text.
    pub changed: Vec<String>,
    /// Changes made outside of the runtime, and the programs read from files in the configuration.
    pub edits: Vec<Edit>,
    /// Files that are not read, each as a text with the action to take.
    pub not_read: Vec<String>,
    /// The folder, if it existed at an earlier start and is now missing.
    pub lost: Option<DiskPath>,
    /// Number of programs that had no checksum yet.
    pub without_sum: usize,
    /// Reason why the assignments of programs to list folders are lost.
    pub folders_fault: Option<String>,
}

/// Parts of the folder that are held back until a person confirms them. Also contains the generations of the
/// data folder.
#[derive(Debug, Default)]
pub struct HeldBack {
    /// Generations of the data folder.
    pub generations: Arc<Generations>,
    /// True if all programs are held back.
    pub programs: bool,
    /// True if the assignments to folders are held back.
    pub folders: bool,
}

impl ProgramStore {
    /// Reads the programs of a folder, and stores later programs in it. If the folder cannot be written, its
    /// programs are read nevertheless, and the next write tries to open the folder again.
    pub fn open_folder(&mut self, path: &DiskPath, held: &HeldBack) -> (ProgramFindings, io::Result<()>) {
        self.path = Some(path.clone());
        self.generations = Arc::clone(&held.generations);
        self.holds_back.store(held.programs, Ordering::Relaxed);
        let opened = ProgramFolder::open(path, &self.opening());
        let (places, folders_fault) = FolderAssignments::open(path, &self.generations, held.folders);
        *self.places.get_mut() = places;
        let (look, opened) = match opened {
            Ok((folder, look)) => {
                self.holds_back.store(false, Ordering::Relaxed);
                *self.folder.get_mut() = Some(folder);
                (look, Ok(()))
            }
            Err(error) => {
                let mut look = scan_folder(path, self.is_mixed, self.bytes_max).unwrap_or_default();
                if held.programs {
                    look.hold_back();
                }
                (look, Err(error))
            }
        };
        let findings = self.take_over(look);
        (
            ProgramFindings {
                folders_fault,
                ..findings
            },
            opened,
        )
    }

    fn opening(&self) -> Opening {
        Opening {
            dialect: self.rules.dialect.name,
            is_mixed: self.is_mixed,
            bytes_max: self.bytes_max,
            generations: Arc::clone(&self.generations),
            holds_back: self.holds_back.load(Ordering::Relaxed),
        }
    }

    /// Accepts all held-back programs in their current form. Then assigns each program that is in no folder
    /// to its folder in `folders`. Returns the changes.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn confirm_held_back(&self, folders: &FolderByProgram) -> io::Result<Vec<Edit>> {
        let _one_at_a_time = self.writing.lock();
        let edits = self.with_folder(|folder| {
            let Some(folder) = folder else {
                return Ok(Vec::new());
            };
            let mut edits = Vec::new();
            for number in folder.held_back() {
                let accepted = match folder.accept(number) {
                    Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                    accepted => accepted?,
                };
                self.damaged.write().remove(&number);
                self.take_accepted(number, Some(accepted));
                let new = self.get(number);
                edits.push(Edit::outside(
                    number,
                    None,
                    new.as_deref().map(StoredProgram::checksum),
                ));
            }
            Ok(edits)
        })?;
        let mut places = self.places.lock();
        for (number, folder) in folders {
            if self.get(*number).is_some() && places.folder_of(*number).is_empty() {
                places.put(*number, folder)?;
            }
        }
        Ok(edits)
    }

    fn take_over(&self, look: FolderScan) -> ProgramFindings {
        let mut findings = ProgramFindings {
            not_read: look.not_read,
            without_sum: look.without_sum,
            ..ProgramFindings::default()
        };
        for (number, found) in look.programs {
            let signature = look.signatures.get(&number).copied();
            let dialect = look.dialects.get(&number).map(String::as_str);
            match found {
                ProgramFileState::Stored(bytes) => self.keep(self.of_file(number, bytes, dialect, signature)),
                ProgramFileState::FromOutside(bytes, how, old) => {
                    let program = self.of_file(number, bytes, dialect, signature);
                    let sum = program.short_checksum();
                    let text = format!("program {number}: {how}; its checksum is {sum}");
                    findings.changed.push(text);
                    findings
                        .edits
                        .push(Edit::outside(number, old, Some(program.checksum())));
                    self.keep(program);
                }
                ProgramFileState::Damaged(how) => {
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

    /// Finds files that were changed outside while the runtime runs, and reads those that are no longer being
    /// changed. Returns a text for a person and the change for each; nothing while a program is being
    /// written.
    ///
    /// # Errors
    /// Returns an error if the folder was removed or replaced.
    pub fn look_again(&self) -> io::Result<Vec<(String, Edit)>> {
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
            // The next scan reads an unreadable file again.
            let Ok(read) = read else { continue };
            let old = self.get(number).map(|program| program.checksum().to_owned());
            self.damaged.write().remove(&number);
            let how = self.take_accepted(number, read);
            let new = self.get(number);
            let new = new.as_deref().map(StoredProgram::checksum);
            said.push((
                format!("program {number}: {how}"),
                Edit::outside(number, old, new),
            ));
        }
        Ok(said)
    }

    /// Accepts the file of a program in its current form; `accepted` is `None` if the file was removed.
    /// Returns a text about the change.
    fn take_accepted(&self, number: u16, accepted: Option<AcceptedFile>) -> String {
        let Some(AcceptedFile {
            bytes,
            signature,
            dialect,
        }) = accepted
        else {
            self.forget(number);
            return "its file was removed".to_owned();
        };
        if let Err(error) = self.check_room(number, bytes.len()) {
            self.forget(number);
            return format!("its file was written, and is not read: {error}");
        }
        let mut program = self.of_file(number, bytes, Some(&dialect), signature);
        program.is_from_outside = true;
        let sum = program.short_checksum().to_owned();
        self.keep(program);
        format!("its file was written; its checksum is {sum}; load the program again")
    }

    /// Checks that the runtime can write programs.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn probe(&self) -> io::Result<()> {
        self.with_folder(|folder| folder.map_or(Ok(()), |folder| folder.probe()))
    }

    /// Runs `work` with the folder. If the folder is not open, it is opened again; if it was lost, all
    /// programs are written again. For a store in memory, `work` receives `None`.
    pub(super) fn with_folder<T>(
        &self,
        work: impl FnOnce(Option<&mut ProgramFolder>) -> io::Result<T>,
    ) -> io::Result<T> {
        let Some(path) = &self.path else { return work(None) };
        let mut folder = self.folder.lock();
        if folder.as_ref().is_some_and(|folder| folder.check().is_err()) {
            *folder = None;
        }
        if folder.is_none() {
            let (mut opened, look) = ProgramFolder::open(path, &self.opening())?;
            self.holds_back.store(false, Ordering::Relaxed);
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
}
