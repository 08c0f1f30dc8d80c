//! What is known to have been kept: a sum for each thing by its name, in a file of lines beside what they vouch for.
//!
//! Each line has a number, that of the line before it, and its own check sum, and stands there twice: one that is damaged
//! has its copy. A line adds to those before it; the first stands for all. When a line and its copy are damaged, nobody
//! knows which names it had: the sums of all earlier lines are unknown then, and the names stay known.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::files::{Identity, open_regular, read_regular, write_whole};
use super::fs::{File, OpenOptions};
use super::generations::{Generations, Kind, Seal, StoredPart};
use super::line::{Unusable, number, read_sealed, seal};

/// Bytes up to which lines are always added. A longer file is written again, without what later lines replace, when it is
/// [`GROWTH_MAX`] times as long as it was then. Reason: without runs, the sums of all that is kept are about 100 KiB with their copy.
const BYTES_MAX: u64 = 512 << 10;

/// Reason: the work for a line is in proportion to the line, however many sums there are.
const GROWTH_MAX: u64 = 2;

/// Bytes that are read at the most.
const READ_MAX: u64 = 16 << 20;

/// The sum of some bytes, in hexadecimal digits: SHA-256.
pub(crate) fn sum_of(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// The sum of bytes that come in parts.
#[derive(Debug, Default)]
pub(crate) struct SumOfParts(Sha256);

impl SumOfParts {
    /// Adds the next bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The sum of all of them, as [`sum_of`] makes it.
    pub fn finish(self) -> String {
        hex::encode(self.0.finalize())
    }
}

/// Changes of sums by name; `None`: it is kept no longer.
pub(crate) type SumChange = BTreeMap<String, Option<String>>;

/// What a file of sums says.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Sums {
    /// There is a file, with a line at least.
    pub is_there: bool,
    /// Number of the newest line.
    pub last: u64,
    /// Lines are damaged, and their copies.
    pub is_damaged: bool,
    /// Why lines of it are not those of this file; in words.
    pub foreign: Option<String>,
    /// Of the newest line.
    pub seal: Option<Seal>,
    /// By name; `None`: it is kept, and its sum is unknown.
    pub by_name: BTreeMap<String, Option<String>>,
}

impl Sums {
    /// Reads a file. What cannot be read says nothing.
    pub fn read(path: &Path, kind: Kind) -> Self {
        let mut sums = Self::default();
        let bytes = match read_regular(path, READ_MAX) {
            Ok(bytes) => bytes,
            Err(error) => {
                sums.is_damaged = error.kind() != io::ErrorKind::NotFound;
                return sums;
            }
        };
        let mut lines: Vec<&[u8]> = bytes.split(|byte| *byte == b'\n').collect();
        // behind the last end of a line: nothing, or what a kill has left of a line
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
            // what its copy may still take, with a damaged end
            copy_bytes = if is_copy { 0 } else { line.len() + 2 };
            damaged_bytes = 0;
            sums.take(&whole);
            sums.seal = Some(seal);
        }
        if damaged_bytes > copy_bytes {
            sums.forget();
        }
        sums
    }

    /// Why the file cannot be used; `None`: it can.
    pub fn fault(&self) -> Option<String> {
        let fault = match (self.is_there, self.is_damaged) {
            (false, _) => "it is missing or damaged",
            (_, true) => "lines of it are damaged",
            _ => return None,
        };
        Some(self.foreign.clone().unwrap_or_else(|| fault.to_owned()))
    }

    fn take(&mut self, line: &Value) {
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

/// The text of a line and its copy. Of two ends of a line one is left when the other is damaged.
fn twice(number: u64, after: u64, sums: &impl serde::Serialize, of_line: &Seal) -> String {
    let mut line = json!({"n": number, "after": after, "sums": sums});
    of_line.put(&mut line);
    let line = seal(&line.to_string());
    format!("{line}\n{line}\n")
}

/// What seals the lines of a file.
#[derive(Debug, Clone)]
pub(crate) struct Sealer {
    pub kind: Kind,
    /// Part that the file belongs to.
    pub part: StoredPart,
    pub generations: Arc<Generations>,
}

impl Sealer {
    /// Notes that the file is on disk with this generation.
    fn note_on_disk(&self, generation: u64) {
        self.generations.note_on_disk(self.part, generation);
    }
}

/// An open file of sums.
#[derive(Debug)]
pub(crate) struct SumFile {
    sealer: Sealer,
    path: PathBuf,
    file: File,
    identity: Identity,
    bytes: u64,
    /// Bytes after the whole file was written last.
    begun_bytes: u64,
    last: u64,
    by_name: BTreeMap<String, String>,
}

impl SumFile {
    /// Writes the file anew, with these sums.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn begin(
        path: &Path,
        sealer: Sealer,
        last: u64,
        by_name: BTreeMap<String, String>,
    ) -> io::Result<Self> {
        let generation = sealer.generations.next();
        Self::begin_at(path, sealer, last, generation, by_name)
    }

    /// As [`SumFile::begin`], with this generation.
    pub fn begin_at(
        path: &Path,
        sealer: Sealer,
        last: u64,
        generation: u64,
        by_name: BTreeMap<String, String>,
    ) -> io::Result<Self> {
        let of_line = sealer.generations.seal(sealer.kind, generation);
        let text = twice(last.max(1), 0, &by_name, &of_line);
        write_whole(path, text.as_bytes())?;
        sealer.note_on_disk(generation);
        let file = open_regular(path, OpenOptions::new().append(true))?;
        Ok(Self {
            sealer,
            path: path.to_owned(),
            identity: Identity::of(&file)?,
            file,
            bytes: text.len() as u64,
            begun_bytes: text.len() as u64,
            last: last.max(1),
            by_name,
        })
    }

    /// The sum of a name.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.by_name.get(name).map(String::as_str)
    }

    /// All of them.
    pub fn all(&self) -> &BTreeMap<String, String> {
        &self.by_name
    }

    /// Checks that the file is where it was opened.
    ///
    /// # Errors
    /// It was removed or replaced.
    pub fn check(&self) -> io::Result<()> {
        self.identity.check(&self.path)
    }

    /// Adds a line of the next number, or of `number` where that is higher; it is on disk when this returns.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn add(&mut self, number: u64, change: SumChange) -> io::Result<()> {
        let generation = self.sealer.generations.next();
        self.add_at(number, generation, change)
    }

    /// As [`SumFile::add`], with this generation.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn add_at(&mut self, number: u64, generation: u64, change: SumChange) -> io::Result<()> {
        self.check()?;
        let last = number.max(self.last + 1);
        let of_line = self.sealer.generations.seal(self.sealer.kind, generation);
        let text = twice(last, self.last, &change, &of_line);
        if self.bytes > BYTES_MAX.max(self.begun_bytes * GROWTH_MAX) {
            let mut by_name = self.by_name.clone();
            apply(&mut by_name, change);
            *self = Self::begin_at(&self.path, self.sealer.clone(), last, generation, by_name)?;
            return Ok(());
        }
        let written = self
            .file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.sync_data());
        if written.is_err() {
            // The next line must not follow a part of this one.
            self.file.set_len(self.bytes)?;
        }
        written?;
        self.sealer.note_on_disk(generation);
        // Sums that are not in the file do not count.
        apply(&mut self.by_name, change);
        (self.last, self.bytes) = (last, self.bytes + text.len() as u64);
        Ok(())
    }

    /// From now on the disk refuses what is added.
    #[cfg(test)]
    pub fn refuse_all(&mut self) {
        self.file = File::open(&self.path).unwrap();
    }
}

fn apply(by_name: &mut BTreeMap<String, String>, change: SumChange) {
    for (name, sum) in change {
        match sum {
            Some(sum) => by_name.insert(name, sum),
            None => by_name.remove(&name),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealer() -> Sealer {
        Sealer {
            kind: Kind::ProgramSums,
            part: StoredPart::Programs,
            generations: Arc::new(Generations::new("mill")),
        }
    }

    fn read(path: &Path) -> Sums {
        Sums::read(path, Kind::ProgramSums)
    }

    fn change(sums: &[(&str, Option<&str>)]) -> SumChange {
        let owned = sums
            .iter()
            .map(|(name, sum)| ((*name).to_owned(), sum.map(str::to_owned)));
        owned.collect()
    }

    fn known(sums: &Sums) -> Vec<(&str, Option<&str>)> {
        let all = sums.by_name.iter();
        all.map(|(name, sum)| (name.as_str(), sum.as_deref())).collect()
    }

    #[test]
    fn sums_are_read_as_they_were_added() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        assert_eq!(read(&path), Sums::default());
        let mut file = SumFile::begin(&path, sealer(), 7, [("a".to_owned(), "1".to_owned())].into()).unwrap();
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
        let mut file = SumFile::begin(&path, sealer(), 1, many.collect()).unwrap();
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
        let mut file = SumFile::begin(&path, sealer(), 1, [("a".to_owned(), "1".to_owned())].into()).unwrap();
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
        let mut file =
            SumFile::begin(&path, sealer(), 1, [("J".to_owned(), "1*".to_owned())].into()).unwrap();
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
        SumFile::begin(&path, sealer(), 1, [("a".to_owned(), "1".to_owned())].into()).unwrap();
        let sums = Sums::read(&path, Kind::StoreSums);
        assert_eq!((known(&sums), sums.last), (vec![], 0));
        assert_eq!(sums.fault().unwrap(), "it contains lines of program_sums");
        std::fs::write(&path, seal("{\"n\":1,\"sums\":{\"a\":\"1\"}}")).unwrap();
        let fault = read(&path).fault().unwrap();
        assert!(fault.contains("of an earlier version"), "{fault}");
    }

    #[test]
    fn the_file_is_written_anew_before_it_grows_large() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = SumFile::begin(&path, sealer(), 1, BTreeMap::new()).unwrap();
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
        let mut file = SumFile::begin(&path, sealer(), 1, BTreeMap::new()).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(file.add(0, change(&[("a", Some("1"))])).is_err());
    }
}
