//! The program store: NC programs by number, parsed and checked when they are written.
//!
//! With a folder, each program is a file `<number>.nc` in it. It is written under a temporary name and renamed, and is on
//! disk before the write returns. A sum beside it tells a file that was changed outside from one that is damaged
//! (`folder`); a damaged one is no program until it is stored again.

pub(crate) mod folder;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parking_lot::{Mutex, RwLock};
use plc_api::types::program::{DiagnosticSeverity, ProgramCheck, ProgramDiagnostic, ProgramInfo};
use plc_api::types::request::{Refusal, RefusalCode};
use tandem_interp::{CheckContext, Dialect, check};
use tandem_model::limits::{PROGRAM_BYTES_MAX, PROGRAM_NUMBER_MAX};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Diagnostic, Severity};
use tandem_syntax::{Header, LineIndex, NcProgram, parse};

use crate::disk::sum_of;
use folder::{Found, Look, ProgramFolder};

/// Programs in the store at the most. A further one is refused.
pub const PROGRAMS_MAX: usize = 2000;

/// Digits of a sum that a person is shown.
const SUM_SHOWN: usize = 12;

/// Characters of a title.
const TITLE_MAX: usize = 80;

/// First subprogram number (D05).
const SUBPROGRAM_MIN: u16 = 1000;

/// What the intermediate code of a program of this number begins with.
pub fn header(number: u16) -> Header {
    if number >= SUBPROGRAM_MIN {
        Header::Subprogram(number)
    } else {
        Header::Program(number)
    }
}

/// The rules for checking a program for no coordinate system in particular.
#[derive(Debug, Clone, Copy)]
pub struct TextRules {
    /// NC dialect.
    pub dialect: &'static Dialect,
    /// How much a radius may fall short of half the chord, mm (D26): the most that a coordinate system allows.
    pub arc_radius_tolerance_mm: f64,
}

/// One program of the store.
#[derive(Debug)]
pub struct StoredProgram {
    /// Its number.
    pub number: u16,
    /// The tree.
    pub tree: Arc<NcProgram>,
    /// What parsing has found.
    pub parsed: Vec<Diagnostic>,
    /// What checking says of it alone.
    pub check: ProgramCheck,
    /// The dialect that it is written in.
    pub dialect: &'static Dialect,
    /// It begins in the current modal state, not in that of the start-up.
    goes_on: bool,
    /// The check for each coordinate system, by its number; made when first needed.
    here: Mutex<BTreeMap<u8, Arc<CheckHere>>>,
    title: String,
    /// Sum of the bytes that it was read from.
    sum: String,
    /// It was changed outside of the runtime while this ran.
    pub(crate) is_from_outside: bool,
    /// Byte offset of each line.
    line_starts: Vec<u32>,
}

/// What checking says of a program in a coordinate system.
#[derive(Debug)]
pub struct CheckHere {
    /// What keeps it from running, each once.
    pub errors: Vec<ProgramDiagnostic>,
    /// M codes that it puts out, ascending, each once.
    pub m_codes: Vec<u16>,
}

impl StoredProgram {
    /// Parses and checks a text.
    pub fn new(number: u16, text: &str, rules: TextRules) -> Self {
        Self::checked(number, text, rules, false)
    }

    /// A text without a number, which begins in the modal state of the start-up or, with `goes_on`, in the current one.
    pub(crate) fn manual(text: &str, rules: TextRules, goes_on: bool) -> Self {
        Self::checked(0, text, rules, goes_on)
    }

    fn checked(number: u16, text: &str, rules: TextRules, goes_on: bool) -> Self {
        let dialect = rules.dialect;
        let (tree, parsed) = parse(text, (dialect.grammar)());
        let context = CheckContext {
            goes_on,
            arc_radius_tolerance_mm: Some(rules.arc_radius_tolerance_mm),
            ..CheckContext::default()
        };
        let checked = check(&tree, dialect, &context);
        let mut diagnostics = parsed.clone();
        diagnostics.extend(checked.diagnostics);
        diagnostics.sort_by_key(|diagnostic| (diagnostic.span.start, diagnostic.span.end));
        let check = ProgramCheck {
            created: false,
            diagnostics: locate(text, &diagnostics),
            m_codes: checked.m_codes,
            programs: checked.programs,
        };
        Self {
            number,
            tree: Arc::new(tree),
            parsed,
            check,
            dialect,
            goes_on,
            here: Mutex::default(),
            title: title(text),
            sum: sum_of(text.as_bytes()),
            is_from_outside: false,
            line_starts: line_starts(text),
        }
    }

    /// What checking says of it in a coordinate system. Done once for each: text and settings stay as they are.
    pub fn check_in(&self, settings: &CoordinateSystemSettings) -> Arc<CheckHere> {
        let mut here = self.here.lock();
        let check = here
            .entry(settings.number)
            .or_insert_with(|| Arc::new(self.check_with(settings)));
        Arc::clone(check)
    }

    fn check_with(&self, settings: &CoordinateSystemSettings) -> CheckHere {
        let context = CheckContext {
            goes_on: self.goes_on,
            ..CheckContext::of(settings)
        };
        let check = check(&self.tree, self.dialect, &context);
        let of_check = locate(self.text(), &check.diagnostics);
        let mut errors: Vec<ProgramDiagnostic> = Vec::new();
        for found in self.check.diagnostics.iter().cloned().chain(of_check) {
            if found.severity == DiagnosticSeverity::Error && !errors.contains(&found) {
                errors.push(found);
            }
        }
        CheckHere {
            errors,
            m_codes: check.m_codes,
        }
    }

    /// The text.
    pub fn text(&self) -> &str {
        self.tree.source()
    }

    /// True when checking found errors.
    pub fn has_errors(&self) -> bool {
        self.check
            .diagnostics
            .iter()
            .any(|found| found.severity == DiagnosticSeverity::Error)
    }

    /// The intermediate code of a program without errors (D43).
    pub fn intermediate_code(&self) -> String {
        tandem_syntax::compile(&self.tree, header(self.number), self.dialect)
    }

    /// Text of a line, from 1; empty past the end.
    pub fn line(&self, line: u32) -> &str {
        let index = (line as usize).checked_sub(1);
        let start = index.and_then(|index| self.line_starts.get(index));
        let rest = start.and_then(|start| self.text().get(*start as usize..));
        rest.and_then(|rest| rest.lines().next()).unwrap_or_default()
    }

    fn info(&self) -> ProgramInfo {
        let count = |severity| {
            let found = self.check.diagnostics.iter();
            let count = found.filter(|found| found.severity == severity).count();
            u32::try_from(count).unwrap_or(u32::MAX)
        };
        ProgramInfo {
            number: self.number,
            title: self.title.clone(),
            bytes: self.text().len() as u64,
            errors: count(DiagnosticSeverity::Error),
            warnings: count(DiagnosticSeverity::Warning),
        }
    }
}

/// Diagnostics with lines and columns instead of byte offsets.
pub fn locate(text: &str, diagnostics: &[Diagnostic]) -> Vec<ProgramDiagnostic> {
    if diagnostics.is_empty() {
        return Vec::new();
    }
    let index = LineIndex::new(text);
    let place = |diagnostic: &Diagnostic| {
        let (line, column) = index.locate(diagnostic.span.start);
        let (end_line, end_column) = index.locate(diagnostic.span.end);
        ProgramDiagnostic {
            code: diagnostic.code.to_owned(),
            severity: match diagnostic.severity {
                Severity::Error => DiagnosticSeverity::Error,
                Severity::Warning => DiagnosticSeverity::Warning,
            },
            line,
            column,
            end_line,
            end_column,
            message: diagnostic.message.clone(),
            help: diagnostic.help.clone(),
        }
    };
    diagnostics.iter().map(place).collect()
}

/// Where each line begins. Found when the program is written, so that a run does not wait for it.
fn line_starts(text: &str) -> Vec<u32> {
    let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
    let after = ends.filter_map(|(index, _)| u32::try_from(index + 1).ok());
    std::iter::once(0).chain(after).collect()
}

fn title(text: &str) -> String {
    let first = text.trim_start().lines().next().unwrap_or_default().trim();
    let comment = first.strip_prefix("//").or_else(|| first.strip_prefix("/*"));
    let title = comment.unwrap_or_default().trim_end_matches("*/").trim();
    title.chars().take(TITLE_MAX).collect()
}

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
                Found::Stored(bytes) => self.keep(self.program_of(number, bytes)),
                Found::FromOutside(bytes, how) => {
                    let program = self.program_of(number, bytes);
                    let sum = &program.sum[..SUM_SHOWN];
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

    fn program_of(&self, number: u16, bytes: Vec<u8>) -> StoredProgram {
        let sum = sum_of(&bytes);
        StoredProgram {
            sum,
            ..StoredProgram::new(number, &text_of(bytes), self.rules)
        }
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
                let mut program = self.program_of(number, bytes);
                program.is_from_outside = true;
                let sum = program.sum[..SUM_SHOWN].to_owned();
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

/// The text of an NC program's file. Bytes that are not UTF-8 become replacement characters, which checking then shows.
///
/// # Errors
/// The file cannot be read, or has more than [`PROGRAM_BYTES_MAX`] bytes; no more of it is read then.
pub fn read_text(path: &Path) -> io::Result<String> {
    let most = PROGRAM_BYTES_MAX as u64;
    let mut bytes = Vec::new();
    fs::File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    check_bytes(bytes.len() as u64)?;
    Ok(text_of(bytes))
}

fn text_of(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned())
}

/// Tells whether [`read_text`] would read a file, without its text.
///
/// # Errors
/// As those of [`read_text`].
pub(crate) fn check_readable(path: &Path) -> io::Result<()> {
    let metadata = fs::File::open(path)?.metadata()?;
    if metadata.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    check_bytes(metadata.len())
}

fn check_bytes(bytes: u64) -> io::Result<()> {
    if bytes <= PROGRAM_BYTES_MAX as u64 {
        return Ok(());
    }
    let text = format!("it has more than {PROGRAM_BYTES_MAX} bytes, the most that a program may have");
    Err(io::Error::new(io::ErrorKind::FileTooLarge, text))
}

/// The program number that a file name says: `<number>.nc` or `O<number>.nc`.
pub fn program_number(path: &Path) -> Option<u16> {
    if !path.extension()?.eq_ignore_ascii_case("nc") {
        return None;
    }
    let stem = path.file_stem()?.to_str()?;
    let number = stem.strip_prefix(['O', 'o']).unwrap_or(stem).parse().ok()?;
    (1..=PROGRAM_NUMBER_MAX).contains(&number).then_some(number)
}

/// A program and all that it calls, of those that there are.
pub(crate) fn called_by(all: &BTreeMap<u16, Arc<StoredProgram>>, main: u16) -> BTreeSet<u16> {
    let (mut called, mut left) = (BTreeSet::from([main]), vec![main]);
    while let Some(number) = left.pop() {
        let program = all.get(&number).into_iter();
        let calls = program.flat_map(|program| program.check.programs.iter().copied());
        left.extend(calls.filter(|number| called.insert(*number)));
    }
    called
}

#[cfg(test)]
mod tests {
    use tandem_interp::dialects::nj;

    use super::*;

    fn rules() -> TextRules {
        TextRules {
            dialect: nj(),
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
        fs::File::create(&path)
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

    #[test]
    fn file_names_tell_program_numbers() {
        let number = |name: &str| program_number(Path::new(name));
        assert_eq!(number("12.nc"), Some(12));
        assert_eq!(number("O1000.NC"), Some(1000));
        assert_eq!(number("main.nc"), None);
        assert_eq!(number("0.nc"), None);
    }

    #[test]
    fn lines_are_found_by_number() {
        let program = StoredProgram::new(1, "G90\r\nG01 X1\nM30", rules());
        assert_eq!(
            [program.line(1), program.line(2), program.line(3), program.line(4)],
            ["G90", "G01 X1", "M30", ""]
        );
    }
}
