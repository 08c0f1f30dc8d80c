//! What is known to have been kept: a sum for each thing by its name, in a file of lines beside what they vouch for.
//!
//! Each line has a number, that of the line before it, and its own check sum, and stands there twice: one that is damaged
//! has its copy. A line adds to those before it; the first stands for all. When a line and its copy are damaged, nobody
//! knows which names it had: the sums of all earlier lines are unknown then, and the names stay known.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::files::{Identity, open_regular, read_regular, write_whole};
use super::fs::{File, OpenOptions};
use super::line::{Read, number, read, seal};

/// Bytes at which the file is written anew. Reason: the sums of all that is kept are about 100 KiB with their copy.
const BYTES_MAX: u64 = 512 << 10;

/// Bytes that are read at the most.
const READ_MAX: u64 = 16 << 20;

/// The sum of some bytes, in hexadecimal digits: SHA-256.
pub(crate) fn sum_of(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
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
    /// By name; `None`: it is kept, and its sum is unknown.
    pub by_name: BTreeMap<String, Option<String>>,
}

impl Sums {
    /// Reads a file. What cannot be read says nothing.
    pub fn read(path: &Path) -> Self {
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
            let Some(whole) = whole(line) else {
                damaged_bytes += line.len() + 1;
                continue;
            };
            let is_copy = number(&whole) == sums.last;
            if damaged_bytes > 0 && !is_copy && whole["after"] != sums.last {
                sums.forget();
            }
            // what its copy may still take, with a damaged end; older versions wrote none
            let has_copy = !is_copy && whole["after"].is_u64();
            copy_bytes = if has_copy { line.len() + 2 } else { 0 };
            damaged_bytes = 0;
            sums.take(&whole);
        }
        if damaged_bytes > copy_bytes {
            sums.forget();
        }
        sums
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

/// A line that is not damaged.
fn whole(line: &[u8]) -> Option<Value> {
    match read(line) {
        Read::Whole(line) if number(&line) > 0 => Some(line),
        _ => None,
    }
}

/// The text of a line and its copy. Of two ends of a line one is left when the other is damaged.
fn twice(number: u64, after: u64, sums: &impl serde::Serialize) -> String {
    let line = seal(&json!({"n": number, "after": after, "sums": sums}).to_string());
    format!("{line}\n{line}\n")
}

/// An open file of sums.
#[derive(Debug)]
pub(crate) struct SumFile {
    path: PathBuf,
    file: File,
    identity: Identity,
    bytes: u64,
    last: u64,
    by_name: BTreeMap<String, String>,
}

impl SumFile {
    /// Writes the file anew, with these sums.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn begin(path: &Path, last: u64, by_name: BTreeMap<String, String>) -> io::Result<Self> {
        let text = twice(last.max(1), 0, &by_name);
        write_whole(path, text.as_bytes())?;
        let file = open_regular(path, OpenOptions::new().append(true))?;
        Ok(Self {
            path: path.to_owned(),
            identity: Identity::of(&file)?,
            file,
            bytes: text.len() as u64,
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
        self.check()?;
        let last = number.max(self.last + 1);
        let text = twice(last, self.last, &change);
        if self.bytes > BYTES_MAX {
            let mut by_name = self.by_name.clone();
            apply(&mut by_name, change);
            *self = Self::begin(&self.path, last, by_name)?;
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
        assert_eq!(Sums::read(&path), Sums::default());
        let mut file = SumFile::begin(&path, 7, [("a".to_owned(), "1".to_owned())].into()).unwrap();
        file.add(0, change(&[("b", Some("2")), ("c", Some("3"))]))
            .unwrap();
        file.add(12, change(&[("a", None), ("c", Some("4"))])).unwrap();
        let sums = Sums::read(&path);
        assert_eq!(known(&sums), [("b", Some("2")), ("c", Some("4"))]);
        assert_eq!((sums.last, sums.is_there, sums.is_damaged), (12, true, false));
    }

    #[test]
    fn behind_a_damaged_line_names_are_known_and_earlier_sums_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = SumFile::begin(&path, 1, [("a".to_owned(), "1".to_owned())].into()).unwrap();
        file.add(2, change(&[("a", Some("2"))])).unwrap();
        file.add(3, change(&[("b", Some("3"))])).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("\"a\":\"2\"", "\"c\":\"2\"") + "half of a li").unwrap();
        let sums = Sums::read(&path);
        assert_eq!(known(&sums), [("a", None), ("b", Some("3"))]);
        assert!(sums.is_damaged);
    }

    #[test]
    fn any_flipped_bit_loses_no_sum() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = SumFile::begin(&path, 1, [("J".to_owned(), "1*".to_owned())].into()).unwrap();
        file.add(2, change(&[("J", Some("2*")), ("b", Some("2"))]))
            .unwrap();
        file.add(9, change(&[("b", None), ("*", Some("3"))])).unwrap();
        let (bytes, sums) = (std::fs::read(&path).unwrap(), Sums::read(&path));
        assert_eq!(known(&sums), [("*", Some("3")), ("J", Some("2*"))]);
        for place in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[place / 8] ^= 1 << (place % 8);
            std::fs::write(&path, &flipped).unwrap();
            assert_eq!(Sums::read(&path), sums, "{}", String::from_utf8_lossy(&flipped));
        }
    }

    #[test]
    fn lines_of_a_version_that_wrote_them_once_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let lines = [
            seal("{\"n\":1,\"sums\":{\"a\":\"1\"}}"),
            seal("{\"n\":2,\"sums\":{\"b\":\"2\"}}"),
        ];
        std::fs::write(&path, lines.concat()).unwrap();
        assert_eq!(known(&Sums::read(&path)), [("a", Some("1")), ("b", Some("2"))]);
        std::fs::write(&path, lines[0].clone() + "damaged\n" + &lines[1]).unwrap();
        assert_eq!(known(&Sums::read(&path)), [("a", None), ("b", Some("2"))]);
        std::fs::write(&path, lines.concat() + "damaged\n").unwrap();
        assert_eq!(known(&Sums::read(&path)), [("a", None), ("b", None)]);
    }

    #[test]
    fn the_file_is_written_anew_before_it_grows_large() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = SumFile::begin(&path, 1, BTreeMap::new()).unwrap();
        for n in 0..500 {
            let name = "x".repeat(2000);
            file.add(0, [(name, Some(n.to_string()))].into()).unwrap();
        }
        assert!(std::fs::metadata(&path).unwrap().len() <= BYTES_MAX + 4096);
        assert_eq!(known(&Sums::read(&path))[0].1, Some("499"));
    }

    #[test]
    fn a_file_that_was_removed_is_not_written_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sums");
        let mut file = SumFile::begin(&path, 1, BTreeMap::new()).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(file.add(0, change(&[("a", Some("1"))])).is_err());
    }
}
