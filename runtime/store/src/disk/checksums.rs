//! Recorded checksums of stored data by name, in a text file next to the data.
//!
//! Each line contains its number, the number of the previous line, and its own checksum. It is written twice:
//! if one is damaged, the copy is used. The first line contains all checksums; each further line contains
//! only changes. If a line and its copy are damaged, the changed names are unknown. All earlier checksums are
//! then unknown, but their names stay known.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::file_system::{DiskFile, OpenMode};
use super::files::{Identity, open_regular, read_regular, write_whole};
use super::generations::{Generations, Seal, SealedFileKind, StoredPart};
use super::line::{Unusable, number, read_sealed, seal};
use super::path::DiskPath;

/// Size in bytes up to which lines are always added. A longer file is rewritten without superseded lines when
/// it has grown to [`GROWTH_MAX`] times its size after the last rewrite. Reason: without runs, the checksums
/// of all stored data take about 100 KiB, including the copies.
const BYTES_MAX: u64 = 512 << 10;

/// Growth factor at which the file is rewritten. Reason: the average work for a change is then proportional
/// to the change, not to the number of checksums.
const GROWTH_MAX: u64 = 2;

/// Maximum bytes read of a checksum file.
const READ_MAX: u64 = 16 << 20;

/// Returns the SHA-256 checksum of some bytes as hexadecimal digits.
pub fn checksum_hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// Computes the checksum of bytes that arrive in parts.
#[derive(Debug, Default)]
pub struct ChecksumHasher(Sha256);

impl ChecksumHasher {
    /// Adds the next bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// Returns the checksum of all bytes, in the form of [`checksum_hex`].
    pub fn finish(self) -> String {
        hex::encode(self.0.finalize())
    }
}

/// Changed checksums by name; `None` if the value is no longer stored.
pub type ChecksumChange = BTreeMap<String, Option<String>>;

/// Content of a checksum file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Checksums {
    /// The file exists and has at least one line.
    pub is_there: bool,
    /// Number of the newest line.
    pub last: u64,
    /// True if at least one line and its copy are damaged.
    pub is_damaged: bool,
    /// Description, if some lines belong to another file or have no seal.
    pub foreign: Option<String>,
    /// Seal of the newest line.
    pub seal: Option<Seal>,
    /// Checksums by name; `None` if the value is stored, but its checksum is unknown.
    pub by_name: BTreeMap<String, Option<String>>,
}

impl Checksums {
    /// Reads a file. Unreadable content is skipped.
    pub fn read(path: &DiskPath, kind: SealedFileKind) -> Self {
        let mut sums = Self::default();
        let bytes = match read_regular(path, READ_MAX) {
            Ok(bytes) => bytes,
            Err(error) => {
                sums.is_damaged = error.kind() != io::ErrorKind::NotFound;
                return sums;
            }
        };
        let mut lines: Vec<&[u8]> = bytes.split(|byte| *byte == b'\n').collect();
        // After the last line end is nothing, or a fragment of a line left by a kill.
        lines.pop();
        let (mut copy_bytes, mut damaged_bytes) = (0, 0);
        for line in lines.into_iter().filter(|line| !line.is_empty()) {
            sums.is_there = true;
            let (whole, seal) = match read_sealed(kind, line) {
                Ok((whole, seal)) if number(&whole) > 0 => (whole, seal),
                unusable => {
                    if let Err(Unusable::Foreign(how)) = unusable {
                        sums.foreign = Some(how);
                    }
                    damaged_bytes += line.len() + 1;
                    continue;
                }
            };
            let is_copy = number(&whole) == sums.last;
            if damaged_bytes > 0 && !is_copy && whole["after"] != sums.last {
                sums.forget();
            }
            // Maximum size of the copy of this line, including a damaged line end.
            copy_bytes = if is_copy { 0 } else { line.len() + 2 };
            damaged_bytes = 0;
            sums.add_line(&whole);
            sums.seal = Some(seal);
        }
        if damaged_bytes > copy_bytes {
            sums.forget();
        }
        sums
    }

    /// Returns the reason why the file cannot be used; `None` if it is usable.
    pub fn fault(&self) -> Option<String> {
        let fault = match (self.is_there, self.is_damaged) {
            (false, _) => "the file is missing or damaged",
            (_, true) => "lines are damaged",
            _ => return None,
        };
        Some(self.foreign.clone().unwrap_or_else(|| fault.to_owned()))
    }

    fn add_line(&mut self, line: &Value) {
        self.last = self.last.max(number(line));
        for (name, sum) in line["sums"].as_object().into_iter().flatten() {
            match sum.as_str() {
                Some(sum) => self.by_name.insert(name.clone(), Some(sum.to_owned())),
                None => self.by_name.remove(name),
            };
        }
    }

    fn forget(&mut self) {
        self.is_damaged = true;
        self.by_name.values_mut().for_each(|sum| *sum = None);
    }
}

/// Returns a line and its copy as text. If one of the two line ends is damaged, the other one remains.
fn twice(number: u64, after: u64, sums: &impl serde::Serialize, of_line: &Seal) -> String {
    let mut line = json!({"n": number, "after": after, "sums": sums});
    of_line.put(&mut line);
    let line = seal(&line.to_string());
    format!("{line}\n{line}\n")
}

/// Creates the seals for the lines of one file.
#[derive(Debug, Clone)]
pub struct Sealer {
    /// Kind of the file.
    pub kind: SealedFileKind,
    /// Part of the data folder to which the file belongs.
    pub part: StoredPart,
    /// Generations of all parts, from which each seal is made.
    pub generations: Arc<Generations>,
}

impl Sealer {
    /// Records that the file is on disk with this generation.
    fn note_on_disk(&self, generation: u64) {
        self.generations.note_on_disk(self.part, generation);
    }
}

/// An open checksum file.
#[derive(Debug)]
pub struct ChecksumFile {
    sealer: Sealer,
    path: DiskPath,
    /// The open file.
    pub file: Box<dyn DiskFile>,
    identity: Identity,
    bytes: u64,
    /// Size after the last rewrite, in bytes.
    begun_bytes: u64,
    last: u64,
    by_name: BTreeMap<String, String>,
}

impl ChecksumFile {
    /// Rewrites the file with these checksums.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn create(
        path: &DiskPath,
        sealer: Sealer,
        last: u64,
        by_name: BTreeMap<String, String>,
    ) -> io::Result<Self> {
        let generation = sealer.generations.next();
        Self::create_at(path, sealer, last, generation, by_name)
    }

    /// Rewrites the file as [`ChecksumFile::create`] does, with this generation.
    ///
    /// # Errors
    /// Returns an error if a disk operation fails.
    pub fn create_at(
        path: &DiskPath,
        sealer: Sealer,
        last: u64,
        generation: u64,
        by_name: BTreeMap<String, String>,
    ) -> io::Result<Self> {
        let of_line = sealer.generations.seal(sealer.kind, generation);
        let text = twice(last.max(1), 0, &by_name, &of_line);
        write_whole(path, text.as_bytes())?;
        sealer.note_on_disk(generation);
        let file = open_regular(path, OpenMode::Append)?;
        Ok(Self {
            sealer,
            path: path.clone(),
            identity: Identity::from_file(&*file)?,
            file,
            bytes: text.len() as u64,
            begun_bytes: text.len() as u64,
            last: last.max(1),
            by_name,
        })
    }

    /// Returns the recorded checksum of a value by its name.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.by_name.get(name).map(String::as_str)
    }

    /// Returns all checksums.
    pub fn all(&self) -> &BTreeMap<String, String> {
        &self.by_name
    }

    /// Checks that the path still leads to the file that was opened.
    ///
    /// # Errors
    /// Returns an error if the file was removed or replaced.
    pub fn check(&self) -> io::Result<()> {
        self.identity.check(&self.path)
    }

    /// Adds a line with the next number, or with `number` if that is higher. The line is on disk when this
    /// function returns.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn add(&mut self, number: u64, change: ChecksumChange) -> io::Result<()> {
        let generation = self.sealer.generations.next();
        self.add_at(number, generation, change)
    }

    /// Adds a line as [`ChecksumFile::add`] does, with this generation.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn add_at(&mut self, number: u64, generation: u64, change: ChecksumChange) -> io::Result<()> {
        self.check()?;
        let last = number.max(self.last + 1);
        let of_line = self.sealer.generations.seal(self.sealer.kind, generation);
        let text = twice(last, self.last, &change, &of_line);
        if self.bytes > BYTES_MAX.max(self.begun_bytes * GROWTH_MAX) {
            let mut by_name = self.by_name.clone();
            apply(&mut by_name, change);
            *self = Self::create_at(&self.path, self.sealer.clone(), last, generation, by_name)?;
            return Ok(());
        }
        let written = self
            .file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.sync_data());
        if written.is_err() {
            // Truncates the file, so the next line does not follow a fragment of this one.
            self.file.set_len(self.bytes)?;
        }
        written?;
        self.sealer.note_on_disk(generation);
        // The checksums in memory change only after the line is in the file.
        apply(&mut self.by_name, change);
        (self.last, self.bytes) = (last, self.bytes + text.len() as u64);
        Ok(())
    }
}

fn apply(by_name: &mut BTreeMap<String, String>, change: ChecksumChange) {
    for (name, sum) in change {
        match sum {
            Some(sum) => by_name.insert(name, sum),
            None => by_name.remove(&name),
        };
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn sealer() -> Sealer {
        Sealer {
            kind: SealedFileKind::ProgramSums,
            part: StoredPart::Programs,
            generations: Arc::new(Generations::new("mill")),
        }
    }

    fn read(path: &Path) -> Checksums {
        Checksums::read(&path.into(), SealedFileKind::ProgramSums)
    }

    fn change(sums: &[(&str, Option<&str>)]) -> ChecksumChange {
        let owned = sums
            .iter()
            .map(|(name, sum)| ((*name).to_owned(), sum.map(str::to_owned)));
        owned.collect()
    }

    fn known(sums: &Checksums) -> Vec<(&str, Option<&str>)> {
        let all = sums.by_name.iter();
        all.map(|(name, sum)| (name.as_str(), sum.as_deref())).collect()
    }

    #[test]
    fn sums_are_read_as_they_were_added() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        assert_eq!(read(&path), Checksums::default());
        let mut file = ChecksumFile::create(
            &path.as_path().into(),
            sealer(),
            7,
            [("a".to_owned(), "1".to_owned())].into(),
        )
        .unwrap();
        file.add(0, change(&[("b", Some("2")), ("c", Some("3"))]))
            .unwrap();
        file.add(12, change(&[("a", None), ("c", Some("4"))])).unwrap();
        let sums = read(&path);
        assert_eq!(known(&sums), [("b", Some("2")), ("c", Some("4"))]);
        assert_eq!((sums.last, sums.is_there, sums.is_damaged), (12, true, false));
    }

    #[test]
    fn a_file_of_many_sums_is_not_written_again_with_each_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let many = (0..10_000).map(|number| (format!("run/{number}"), "0123456789abcdef".repeat(4)));
        let mut file = ChecksumFile::create(&path.as_path().into(), sealer(), 1, many.collect()).unwrap();
        let identity = file.identity;
        assert!(file.bytes > BYTES_MAX, "{}", file.bytes);
        for round in 0..100 {
            file.add(0, change(&[("run/1", Some("2"))])).unwrap();
            assert_eq!(file.identity, identity, "line {round}");
        }
        assert_eq!(read(&path).by_name.len(), 10_000);
    }

    #[test]
    fn behind_a_damaged_line_names_are_known_and_earlier_sums_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = ChecksumFile::create(
            &path.as_path().into(),
            sealer(),
            1,
            [("a".to_owned(), "1".to_owned())].into(),
        )
        .unwrap();
        file.add(2, change(&[("a", Some("2"))])).unwrap();
        file.add(3, change(&[("b", Some("3"))])).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("\"a\":\"2\"", "\"c\":\"2\"") + "half of a li").unwrap();
        let sums = read(&path);
        assert_eq!(known(&sums), [("a", None), ("b", Some("3"))]);
        assert!(sums.is_damaged);
    }

    #[test]
    fn any_flipped_bit_loses_no_sum() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = ChecksumFile::create(
            &path.as_path().into(),
            sealer(),
            1,
            [("J".to_owned(), "1*".to_owned())].into(),
        )
        .unwrap();
        file.add(2, change(&[("J", Some("2*")), ("b", Some("2"))]))
            .unwrap();
        file.add(9, change(&[("b", None), ("*", Some("3"))])).unwrap();
        let (bytes, sums) = (std::fs::read(&path).unwrap(), read(&path));
        assert_eq!(known(&sums), [("*", Some("3")), ("J", Some("2*"))]);
        for place in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[place / 8] ^= 1 << (place % 8);
            std::fs::write(&path, &flipped).unwrap();
            assert_eq!(read(&path), sums, "{}", String::from_utf8_lossy(&flipped));
        }
    }

    #[test]
    fn a_file_of_another_kind_names_no_sums_and_says_what_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        ChecksumFile::create(
            &path.as_path().into(),
            sealer(),
            1,
            [("a".to_owned(), "1".to_owned())].into(),
        )
        .unwrap();
        let sums = Checksums::read(&path.as_path().into(), SealedFileKind::StoreSums);
        assert_eq!((known(&sums), sums.last), (vec![], 0));
        assert_eq!(sums.fault().unwrap(), "it contains lines of program_sums");
        std::fs::write(&path, seal("{\"n\":1,\"sums\":{\"a\":\"1\"}}")).unwrap();
        let fault = read(&path).fault().unwrap();
        assert!(fault.contains("no seal"), "{fault}");
    }

    #[test]
    fn the_file_is_written_anew_before_it_grows_large() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = ChecksumFile::create(&path.as_path().into(), sealer(), 1, BTreeMap::new()).unwrap();
        for n in 0..500 {
            let name = "x".repeat(2000);
            file.add(0, [(name, Some(n.to_string()))].into()).unwrap();
        }
        assert!(std::fs::metadata(&path).unwrap().len() <= BYTES_MAX + 4096);
        assert_eq!(known(&read(&path))[0].1, Some("499"));
    }

    #[test]
    fn a_file_that_was_removed_is_not_written_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = ChecksumFile::create(&path.as_path().into(), sealer(), 1, BTreeMap::new()).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(file.add(0, change(&[("a", Some("1"))])).is_err());
    }
}
