//! The folder of programs: one file `<number>.nc` for each program, a checksum file, and possibly foreign
//! files.
//!
//! If the modification time of a file differs from the recorded one, the file was changed outside of the
//! runtime, which is allowed. If the time is the recorded one but the checksum differs, the file is damaged.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use tandem_model::limits::PROGRAM_BYTES_MAX;

use super::signing::{Signature, read_signature};
use super::{PROGRAMS_MAX, no_room, program_number};
use crate::disk::{
    ChecksumFile, Checksums, DiskPath, FileMetadata, Generations, SealedFileKind, Sealer, StoredPart,
    UNFINISHED, UnfinishedFile, checksum_hex, make_folder_in, read_regular, sync_folder, tighten,
};

/// Name of the checksum file in the folder.
const SUMS_FILE: &str = "sums";

/// Placeholder in the checksum file for a lost record of a program.
const LOST: &str = "lost";

/// Placeholder for the checksum of a program that is held back, that is, not usable until a person confirms
/// it.
const HELD_BACK: &str = "unconfirmed";

/// Reason reported for a program that is held back.
const HOW_HELD_BACK: &str = "the program is one of the stored files that do not fit together, and is not \
                             confirmed";

/// Separates the records of the old and the new file while the runtime replaces a file.
const OR: char = '|';

/// State of a program's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProgramFileState {
    /// The file is unchanged since it was stored; contains its bytes.
    Stored(Vec<u8>),
    /// The file was written or changed outside of the runtime. Contains the bytes, a description, and the
    /// previous checksum if it is known.
    FromOutside(Vec<u8>, String, Option<String>),
    /// The file is damaged or unreadable; contains the description.
    Damaged(String),
}

/// Result of scanning the folder.
#[derive(Debug, Default)]
pub struct FolderScan {
    /// State of the file of each program.
    pub programs: BTreeMap<u16, ProgramFileState>,
    /// Signature of each signed program.
    pub signatures: BTreeMap<u16, Signature>,
    /// Recorded dialects by program number; a program without a recorded dialect has no entry.
    pub dialects: BTreeMap<u16, String>,
    /// Stored programs whose files are missing, with their checksums if known.
    pub gone: Vec<(u16, Option<String>)>,
    /// Files that are not read, each as a text with the action to take.
    pub not_read: Vec<String>,
    /// Number of programs that were read although the folder has no checksum file.
    pub without_sum: usize,
}

/// Composes the record of a program: time, checksum and dialect.
fn mark(metadata: &FileMetadata, sum: &str, dialect: &str) -> String {
    format!("{} {sum} {dialect}", time_of(metadata))
}

fn time_of(metadata: &FileMetadata) -> String {
    let (seconds, ns) = metadata.modified;
    format!("{seconds}.{ns:09}")
}

/// Parsed record of a program.
#[derive(Clone, Copy, PartialEq, Eq)]
struct ProgramFileRecord<'a> {
    time: &'a str,
    sum: &'a str,
    dialect: Option<&'a str>,
}

/// Parses the records of a program, newest first; two records exist while a file is being replaced.
fn marks(noted: &str) -> impl Iterator<Item = ProgramFileRecord<'_>> {
    noted.rsplit(OR).filter_map(|mark| {
        let mut parts = mark.split(' ');
        Some(ProgramFileRecord {
            time: parts.next()?,
            sum: parts.next()?,
            dialect: parts.next(),
        })
    })
}

fn has_time(noted: &str, time: &str) -> bool {
    marks(noted).any(|mark| mark.time == time)
}

/// Returns the checksum of the newest record.
fn newest_checksum(noted: &str) -> Option<String> {
    marks(noted).next().map(|mark| mark.sum.to_owned())
}

/// Returns the dialect in the record with this time, or in the newest record if none has this time.
fn dialect_in(noted: &str, time: &str) -> Option<String> {
    let of_time = marks(noted).find(|mark| mark.time == time);
    let mark = of_time.or_else(|| marks(noted).next())?;
    mark.dialect.map(str::to_owned)
}

/// Returns the modification time of a program's signature file; empty if the file does not exist.
fn signature_time(folder: &DiskPath, number: u16) -> String {
    let metadata = folder.join(signature_name(number)).metadata();
    metadata.map_or(String::new(), |metadata| time_of(&metadata))
}

/// Reads the checksum file of a folder.
pub fn read_checksums(folder: &DiskPath) -> Checksums {
    Checksums::read(&folder.join(SUMS_FILE), SealedFileKind::ProgramSums)
}

/// Scans all files of a folder without changing them. `is_mixed`: the machine has several dialects, so a
/// program whose dialect is lost cannot be read. `bytes_max`: size limit for all programs together, in bytes;
/// files beyond this limit are not read.
///
/// # Errors
/// Returns an error if the folder cannot be read.
pub fn scan_folder(folder: &DiskPath, is_mixed: bool, bytes_max: usize) -> io::Result<FolderScan> {
    let sums = read_checksums(folder);
    let mut look = FolderScan::default();
    let paths = sorted_entries(folder)?;
    let mut bytes_read = 0;
    for path in paths {
        let Some(number) = program_number(path.as_path()) else {
            continue;
        };
        let name = path.name();
        if name != file_name(number) {
            let text = format!("{}: rename it to {}", path.display(), file_name(number));
            look.not_read.push(text);
            continue;
        }
        let known = sums.by_name.get(&number.to_string());
        if look.programs.len() >= PROGRAMS_MAX {
            let text = format!("{}: the store holds {PROGRAMS_MAX} programs", path.display());
            look.not_read.push(text);
            continue;
        }
        let read = read_within(&path, bytes_max, &mut bytes_read);
        let is_lost = is_mixed
            && match known {
                Some(noted) => noted.as_deref().is_none_or(|noted| noted == LOST),
                None => sums.is_damaged,
            };
        let found = match (read, known) {
            (Ok(_), _) if is_lost => {
                ProgramFileState::Damaged("its checksum is damaged, and its dialect is unknown".to_owned())
            }
            (Ok((metadata, bytes)), known) => {
                let noted = known.and_then(Option::as_deref);
                let dialect = noted.and_then(|noted| dialect_in(noted, &time_of(&metadata)));
                look.dialects.extend(dialect.map(|dialect| (number, dialect)));
                inspect_file(known, &metadata, bytes)
            }
            (Err(error), Some(_)) => ProgramFileState::Damaged(format!("the file cannot be read: {error}")),
            (Err(error), None) => {
                look.not_read
                    .push(format!("{}: {error}; move it away", path.display()));
                continue;
            }
        };
        look.without_sum += usize::from(!sums.is_there);
        let found = match found {
            ProgramFileState::FromOutside(bytes, ..) if !sums.is_there => ProgramFileState::Stored(bytes),
            found => found,
        };
        look.programs.insert(number, found);
        // An unreadable signature is treated as missing.
        let signature = read_signature(&folder.join(signature_name(number)));
        look.signatures
            .extend(signature.unwrap_or_default().map(|signature| (number, signature)));
    }
    look.gone = missing_programs(&sums, &look.programs);
    Ok(look)
}

impl FolderScan {
    /// Marks every program as damaged until a person confirms it. A program that is already damaged keeps its
    /// reason, because a confirmation does not make it usable.
    pub fn hold_back(&mut self) {
        for found in self.programs.values_mut() {
            if !matches!(found, ProgramFileState::Damaged(_)) {
                *found = ProgramFileState::Damaged(HOW_HELD_BACK.to_owned());
            }
        }
    }
}

/// Reads a file, if its size fits into `bytes_max` together with the files that were read before.
fn read_within(
    path: &DiskPath,
    bytes_max: usize,
    bytes_read: &mut u64,
) -> io::Result<(FileMetadata, Vec<u8>)> {
    let metadata = path.metadata()?;
    if *bytes_read + metadata.length > bytes_max as u64 {
        return Err(io::Error::other(no_room(metadata.length, bytes_max)));
    }
    let bytes = read_regular(path, PROGRAM_BYTES_MAX as u64)?;
    *bytes_read += bytes.len() as u64;
    Ok((metadata, bytes))
}

/// Returns the programs that have a checksum but no file, with their checksums if known.
fn missing_programs(sums: &Checksums, there: &BTreeMap<u16, ProgramFileState>) -> Vec<(u16, Option<String>)> {
    let known = sums.by_name.iter();
    let known = known
        .filter_map(|(name, mark)| Some((name.parse().ok()?, mark.as_deref().and_then(newest_checksum))));
    known.filter(|(number, _)| !there.contains_key(number)).collect()
}

fn inspect_file(known: Option<&Option<String>>, metadata: &FileMetadata, bytes: Vec<u8>) -> ProgramFileState {
    let Some(known) = known else {
        return ProgramFileState::FromOutside(bytes, "its file was put into the folder".to_owned(), None);
    };
    let Some(known) = known else {
        let how = "its checksum is damaged, so it cannot be verified".to_owned();
        return ProgramFileState::FromOutside(bytes, how, None);
    };
    let (time, sum) = (time_of(metadata), checksum_hex(&bytes));
    if marks(known).any(|mark| (mark.time, mark.sum) == (time.as_str(), sum.as_str())) {
        return ProgramFileState::Stored(bytes);
    }
    if marks(known).any(|mark| (mark.time, mark.sum) == (time.as_str(), HELD_BACK)) {
        return ProgramFileState::Damaged(HOW_HELD_BACK.to_owned());
    }
    if has_time(known, &time) {
        let how = "its content differs from the stored one, although the file's time is unchanged";
        return ProgramFileState::Damaged(how.to_owned());
    }
    ProgramFileState::FromOutside(bytes, "its file was written".to_owned(), newest_checksum(known))
}

/// Returns the file name of a program; the runtime accepts no other spelling.
pub fn file_name(number: u16) -> String {
    format!("{number}.nc")
}

/// Returns the name of a program's signature file.
fn signature_name(number: u16) -> String {
    format!("{number}.nc.sig")
}

/// Content of a file that the runtime has accepted as a program in its current form.
#[derive(Debug)]
pub struct AcceptedFile {
    /// The accepted text.
    pub bytes: Vec<u8>,
    /// Signature, if the program is signed.
    pub signature: Option<Signature>,
    /// Name of the dialect of the program.
    pub dialect: String,
}

/// Change made to a file outside of the runtime.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outside {
    /// The file has not changed.
    Nothing,
    /// The file was removed.
    Removed,
    /// The file was written; contains its current checksum.
    Written(String),
}

/// Parameters for opening a folder.
#[derive(Debug, Clone)]
pub struct Opening {
    /// Dialect of programs without a recorded dialect.
    pub dialect: &'static str,
    /// True if the machine has several dialects.
    pub is_mixed: bool,
    /// Size limit of all programs together, in bytes.
    pub bytes_max: usize,
    /// Generations of the data folder.
    pub generations: Arc<Generations>,
    /// True if all programs are held back until a person confirms them.
    pub holds_back: bool,
}

/// The folder of programs, open for writing.
#[derive(Debug)]
pub struct ProgramFolder {
    path: DiskPath,
    sums: ChecksumFile,
    /// Dialect of programs that were put into the folder outside of the runtime.
    dialect: &'static str,
    /// Times of the signature files when they were read. They are not stored, because every start reads all
    /// signatures.
    signed_at: BTreeMap<u16, String>,
}

impl ProgramFolder {
    /// Opens a folder and scans it; creates the folder if it is missing. Removes the remains of unfinished
    /// uploads, and revokes the access rights of other users. Renames misspelled program files if the correct
    /// name is free.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn open(path: &DiskPath, opening: &Opening) -> io::Result<(Self, FolderScan)> {
        let Opening {
            dialect,
            is_mixed,
            bytes_max,
            ..
        } = *opening;
        make_folder_in(path)?;
        tighten(path);
        tidy_up(path)?;
        let mut look = scan_folder(path, is_mixed, bytes_max)?;
        let mut known = BTreeMap::new();
        let old = read_checksums(path);
        for (number, found) in &look.programs {
            let sum = match found {
                ProgramFileState::Stored(bytes) | ProgramFileState::FromOutside(bytes, ..) => {
                    let metadata = path.join(file_name(*number)).metadata()?;
                    let dialect = look.dialects.get(number).map_or(dialect, String::as_str);
                    let sum = if opening.holds_back {
                        HELD_BACK.to_owned()
                    } else {
                        checksum_hex(bytes)
                    };
                    Some(mark(&metadata, &sum, dialect))
                }
                // A damaged program stays damaged: its record is kept.
                ProgramFileState::Damaged(_) => {
                    let noted = old.by_name.get(&number.to_string()).cloned().flatten();
                    noted.or_else(|| is_mixed.then(|| LOST.to_owned()))
                }
            };
            if let Some(sum) = sum {
                known.insert(number.to_string(), sum);
            }
        }
        if opening.holds_back {
            look.hold_back();
        }
        let sealer = Sealer {
            kind: SealedFileKind::ProgramSums,
            part: StoredPart::Programs,
            generations: Arc::clone(&opening.generations),
        };
        let sums = ChecksumFile::create(&path.join(SUMS_FILE), sealer, old.last, known)?;
        let numbers = look.programs.keys();
        let signed_at = numbers.map(|number| (*number, signature_time(path, *number)));
        let folder = Self {
            path: path.clone(),
            sums,
            dialect,
            signed_at: signed_at.collect(),
        };
        Ok((folder, look))
    }

    /// Checks that the path still leads to the folder that was opened.
    ///
    /// # Errors
    /// Returns an error if the folder was removed or replaced.
    pub fn check(&self) -> io::Result<()> {
        self.sums.check()
    }

    /// Returns the change that was made to a program's file outside of the runtime since the file was
    /// recorded.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read.
    pub fn outside(&self, number: u16) -> io::Result<Outside> {
        let (path, noted) = (
            self.path.join(file_name(number)),
            self.sums.get(&number.to_string()),
        );
        let metadata = match path.metadata() {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(noted.map_or(Outside::Nothing, |_| Outside::Removed));
            }
            metadata => metadata?,
        };
        let time = time_of(&metadata);
        if noted.is_some_and(|noted| has_time(noted, &time)) {
            return Ok(Outside::Nothing);
        }
        let bytes = read_regular(&path, PROGRAM_BYTES_MAX as u64)?;
        Ok(Outside::Written(checksum_hex(&bytes)))
    }

    /// Writes a program and its signature. If `signature` is `None`, removes an existing signature. The files
    /// are on disk when this function returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the program is then unchanged.
    pub fn write(
        &mut self,
        number: u16,
        bytes: &[u8],
        dialect: &str,
        signature: Option<&Signature>,
    ) -> io::Result<()> {
        let (name, path) = (number.to_string(), self.path.join(file_name(number)));
        let of_signature = self.path.join(signature_name(number));
        let signature = signature.map(|signature| UnfinishedFile::write(&of_signature, signature));
        let signature = signature.transpose()?;
        let file = UnfinishedFile::write(&path, bytes)?;
        let new = mark(&file.metadata()?, &checksum_hex(bytes), dialect);
        // Until the new file has its final name, a start may find the old or the new file; both are recorded.
        let before = self.sums.get(&name).and_then(|known| known.split(OR).next_back());
        let either = before.map_or(new.clone(), |before| format!("{before}{OR}{new}"));
        self.sums.add(0, [(name.clone(), Some(either))].into())?;
        file.finish(&path)?;
        self.sums.add(0, [(name, Some(new))].into())?;
        match signature {
            Some(signature) => signature.finish(&of_signature)?,
            None => remove(&of_signature)?,
        }
        self.signed_at.insert(number, signature_time(&self.path, number));
        Ok(())
    }

    /// Removes a program and all files with other spellings of its name. Otherwise the next start would load
    /// one of these files.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn delete(&mut self, number: u16) -> io::Result<()> {
        for path in self.path.list_folder()? {
            let is_of_it = program_number(path.as_path()) == Some(number);
            if is_of_it && path.link_metadata().is_ok_and(|metadata| metadata.is_file()) {
                remove(&path)?;
            }
        }
        self.remove(number)
    }

    /// Removes a program, whose file may already be missing.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn remove(&mut self, number: u16) -> io::Result<()> {
        remove(&self.path.join(file_name(number)))?;
        remove(&self.path.join(signature_name(number)))?;
        sync_folder(&self.path)?;
        self.signed_at.remove(&number);
        self.sums.add(0, [(number.to_string(), None)].into())
    }

    /// Accepts the file of a program in its current form.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or the disk operation fails.
    pub fn accept(&mut self, number: u16) -> io::Result<AcceptedFile> {
        let path = self.path.join(file_name(number));
        let signed_at = signature_time(&self.path, number);
        let signature = read_signature(&self.path.join(signature_name(number)))?;
        let metadata = path.metadata()?;
        let bytes = read_regular(&path, PROGRAM_BYTES_MAX as u64)?;
        let noted = self.sums.get(&number.to_string());
        let dialect = noted.and_then(|noted| dialect_in(noted, &time_of(&metadata)));
        let dialect = dialect.unwrap_or_else(|| self.dialect.to_owned());
        let now = mark(&metadata, &checksum_hex(&bytes), &dialect);
        self.sums.add(0, [(number.to_string(), Some(now))].into())?;
        self.signed_at.insert(number, signed_at);
        Ok(AcceptedFile {
            bytes,
            signature,
            dialect,
        })
    }

    /// Returns the numbers of the programs that are held back.
    pub fn held_back(&self) -> Vec<u16> {
        let all = self.sums.all().iter();
        let held_back = all.filter(|(_, noted)| marks(noted).any(|mark| mark.sum == HELD_BACK));
        held_back.filter_map(|(name, _)| name.parse().ok()).collect()
    }

    /// Returns the programs for which the file or the signature has another time than recorded, with the
    /// current time. The time is `None` if the file is missing.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be read.
    pub fn changed(&self) -> io::Result<BTreeMap<u16, Option<String>>> {
        let mut changed = BTreeMap::new();
        for name in self.sums.all().keys() {
            if let Ok(number) = name.parse() {
                changed.insert(number, None);
            }
        }
        for path in self.path.list_folder()? {
            let Some(number) = program_number(path.as_path()) else {
                continue;
            };
            let has_its_name = path.name() == file_name(number);
            let Ok(metadata) = path.metadata() else {
                continue;
            };
            if !has_its_name || !metadata.is_file() {
                continue;
            }
            let (time, noted) = (time_of(&metadata), self.sums.get(&number.to_string()));
            let signed_at = signature_time(&self.path, number);
            let is_signed_as_then = self.signed_at.get(&number).is_some_and(|then| *then == signed_at);
            if is_signed_as_then && noted.is_some_and(|noted| has_time(noted, &time)) {
                changed.remove(&number);
            } else {
                changed.insert(number, Some(format!("{time} {signed_at}")));
            }
        }
        Ok(changed)
    }

    /// Checks that the folder allows the runtime to write files.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn probe(&self) -> io::Result<()> {
        UnfinishedFile::write(&self.path.join("probe"), &[b'\n'; 4096]).map(drop)
    }
}

fn remove(path: &DiskPath) -> io::Result<()> {
    match path.remove_file() {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Returns the entries of a folder in the order of their names.
fn sorted_entries(folder: &DiskPath) -> io::Result<Vec<DiskPath>> {
    let mut entries = folder.list_folder()?;
    entries.sort_by(|a, b| a.as_path().cmp(b.as_path()));
    Ok(entries)
}

fn tidy_up(folder: &DiskPath) -> io::Result<()> {
    for path in sorted_entries(folder)? {
        let name = path.name();
        let Ok(metadata) = path.link_metadata() else {
            continue;
        };
        if name.ends_with(UNFINISHED) && !metadata.is_folder() {
            path.remove_file()?;
            tracing::warn!("{}: the rest of an incomplete upload is removed", path.display());
            continue;
        }
        if !metadata.is_file() {
            continue;
        }
        let Some(number) = program_number(path.as_path()) else {
            continue;
        };
        tighten(&path);
        let right = folder.join(file_name(number));
        if name != file_name(number) && right.link_metadata().is_err() {
            path.rename(&right)?;
            tracing::warn!(
                "{} is renamed to {}: a program has only one name",
                path.display(),
                right.display()
            );
        }
    }
    sync_folder(folder)
}

#[cfg(test)]
mod tests;
