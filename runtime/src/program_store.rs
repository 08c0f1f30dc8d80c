//! The program store: NC programs by number, parsed and checked when they are written.
//!
//! With a folder, each program is a file `<number>.nc` in it, written beside and renamed, and on disk before the
//! write is answered.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

use plc_api::types::program::{DiagnosticSeverity, ProgramCheck, ProgramDiagnostic, ProgramInfo};
use tandem_interp::{CheckContext, check};
use tandem_model::limits::PROGRAM_NUMBER_MAX;
use tandem_model::{Diagnostic, Severity};
use tandem_syntax::{Grammar, LineIndex, NcProgram, parse};

/// Programs in the store at the most. A further one is refused.
pub const PROGRAMS_MAX: usize = 2000;

/// Characters of a title.
const TITLE_MAX: usize = 80;

/// One program of the store.
#[derive(Debug)]
pub struct StoredProgram {
    /// Its number.
    pub number: u16,
    /// The tree.
    pub tree: Arc<NcProgram>,
    /// What checking says of it alone.
    pub check: ProgramCheck,
    title: String,
    line_starts: OnceLock<Vec<u32>>,
}

impl StoredProgram {
    /// Parses and checks a text.
    pub fn new(number: u16, text: &str) -> Self {
        let (tree, mut diagnostics) = parse(text, Grammar::nj());
        let checked = check(&tree, &CheckContext::default());
        diagnostics.extend(checked.diagnostics);
        diagnostics.sort_by_key(|diagnostic| (diagnostic.span.start, diagnostic.span.end));
        let check = ProgramCheck {
            created: false,
            diagnostics: locate(text, &diagnostics),
            m_codes: checked.m_codes,
            programs: checked.programs,
        };
        let title = title(text);
        Self {
            number,
            tree: Arc::new(tree),
            check,
            title,
            line_starts: OnceLock::new(),
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

    /// Text of a line, from 1; empty past the end.
    pub fn line(&self, line: u32) -> &str {
        let text = self.text();
        let starts = self.line_starts.get_or_init(|| {
            let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
            let after = ends.filter_map(|(index, _)| u32::try_from(index + 1).ok());
            std::iter::once(0).chain(after).collect()
        });
        let Some(index) = (line as usize).checked_sub(1) else {
            return "";
        };
        let Some(start) = starts.get(index) else { return "" };
        let rest = text.get(*start as usize..).unwrap_or("");
        rest.lines().next().unwrap_or("")
    }

    fn info(&self) -> ProgramInfo {
        let count = |severity| {
            let found = self
                .check
                .diagnostics
                .iter()
                .filter(|found| found.severity == severity);
            u32::try_from(found.count()).unwrap_or(u32::MAX)
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

fn title(text: &str) -> String {
    let first = text
        .lines()
        .find(|line| !line.trim().is_empty())
        .unwrap_or("")
        .trim();
    let comment = first
        .strip_prefix("//")
        .or_else(|| first.strip_prefix("/*"))
        .unwrap_or("");
    comment
        .trim_end_matches("*/")
        .trim()
        .chars()
        .take(TITLE_MAX)
        .collect()
}

/// All programs of a machine.
#[derive(Debug, Default)]
pub struct ProgramStore {
    programs: RwLock<Arc<BTreeMap<u16, Arc<StoredProgram>>>>,
    folder: Option<PathBuf>,
}

impl ProgramStore {
    /// A store that keeps nothing on disk.
    pub fn in_memory() -> Self {
        Self::default()
    }

    /// The store of a folder, which is made if it is missing. Files that are not programs are left alone.
    ///
    /// # Errors
    /// The folder cannot be made or read.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let store = Self {
            folder: Some(folder.to_owned()),
            ..Self::default()
        };
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if let Some(number) = program_number(&path) {
                let text = String::from_utf8_lossy(&fs::read(&path)?).into_owned();
                store.keep(StoredProgram::new(number, &text));
            }
        }
        Ok(store)
    }

    /// A view of all programs that later writes do not change.
    pub fn all(&self) -> Arc<BTreeMap<u16, Arc<StoredProgram>>> {
        Arc::clone(&self.programs.read().unwrap_or_else(PoisonError::into_inner))
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
        fs::metadata(self.path(number)?)
            .and_then(|metadata| metadata.modified())
            .ok()
    }

    /// Writes a program; with a folder it is on disk when this returns. True in the answer's `created`: it is new.
    ///
    /// # Errors
    /// The number is out of range, the store is full, or the disk refuses.
    pub fn write(&self, number: u16, text: &str) -> io::Result<ProgramCheck> {
        if !(1..=PROGRAM_NUMBER_MAX).contains(&number) {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("{number} is not a program number; write 1 to {PROGRAM_NUMBER_MAX}"),
            ));
        }
        let all = self.all();
        let created = !all.contains_key(&number);
        if created && all.len() >= PROGRAMS_MAX {
            return Err(io::Error::new(
                io::ErrorKind::StorageFull,
                format!("the store holds {PROGRAMS_MAX} programs; delete one first"),
            ));
        }
        let program = StoredProgram::new(number, text);
        if let (Some(folder), Some(path)) = (&self.folder, self.path(number)) {
            write_and_rename(folder, &path, text.as_bytes())?;
        }
        let check = ProgramCheck {
            created,
            ..program.check.clone()
        };
        self.keep(program);
        Ok(check)
    }

    /// Removes a program; false when there is none.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn delete(&self, number: u16) -> io::Result<bool> {
        if self.get(number).is_none() {
            return Ok(false);
        }
        if let Some(path) = self.path(number) {
            match fs::remove_file(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        let mut programs = self.programs.write().unwrap_or_else(PoisonError::into_inner);
        Ok(Arc::make_mut(&mut programs).remove(&number).is_some())
    }

    fn keep(&self, program: StoredProgram) {
        let mut programs = self.programs.write().unwrap_or_else(PoisonError::into_inner);
        Arc::make_mut(&mut programs).insert(program.number, Arc::new(program));
    }

    fn path(&self, number: u16) -> Option<PathBuf> {
        self.folder
            .as_ref()
            .map(|folder| folder.join(format!("{number}.nc")))
    }
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

fn write_and_rename(folder: &Path, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let beside = path.with_extension("nc.new");
    let mut file = fs::File::create(&beside)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&beside, path)?;
    fs::File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_program_is_there_after_the_store_is_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = ProgramStore::open(folder.path()).unwrap();
        assert!(store.write(7, "// Seven\nG90\nM30\n").unwrap().created);
        assert!(!store.write(7, "// Seven again\nG90\nM30\n").unwrap().created);
        let again = ProgramStore::open(folder.path()).unwrap();
        assert_eq!(again.list()[0].title, "Seven again");
        assert!(again.delete(7).unwrap());
        assert!(ProgramStore::open(folder.path()).unwrap().list().is_empty());
    }

    #[test]
    fn a_program_with_errors_is_stored_and_says_them() {
        let store = ProgramStore::in_memory();
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
        let store = ProgramStore::in_memory();
        assert!(store.write(0, "M30").is_err());
        assert!(store.write(10_000, "M30").is_err());
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
        let program = StoredProgram::new(1, "G90\r\nG01 X1\nM30");
        assert_eq!(
            [program.line(1), program.line(2), program.line(3), program.line(4)],
            ["G90", "G01 X1", "M30", ""]
        );
    }
}
