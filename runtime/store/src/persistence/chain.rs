//! The chain of the journal: each line ends with the SHA-256 of the previous line's hash and the line's own
//! bytes.
//!
//! A line with `"event":"chain"` marks the beginning of each file and of each chain. This line contains the
//! number of the file and the hash of the previous line, so the chain can be verified without the files that
//! rotation has removed. An anchor in the same folder records which files must exist and one line that they
//! must contain. The anchor distinguishes files removed by rotation from files removed by a person.

use std::fmt;
use std::io::{self, BufRead};

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use crate::disk::{
    DiskPath, Generations, Seal, SealedFileKind, StoredPart, number, read_regular, read_sealed, seal,
    write_whole,
};

/// Name of the anchor file in the journal's folder.
const ANCHOR_FILE: &str = "anchor";

/// Maximum bytes read from the anchor.
const ANCHOR_BYTES_MAX: u64 = 4096;

/// Maximum bytes read of a line; a longer line is treated as damaged. Reason: the runtime writes far shorter
/// lines.
const LINE_BYTES_MAX: usize = 1 << 20;

/// Text before and after the hash in a line.
const HASH: (&[u8], &[u8]) = (b",\"hash\":\"", b"\"");

/// Length of the checksum text at the end of a line, in bytes.
const SUM_BYTES: usize = ",\"crc\":\"00000000\"}".len();

/// Bytes that hash, checksum and closing brace add to a JSON object.
pub(super) const LINK_BYTES: u64 = (9 + 64 + 1 + SUM_BYTES) as u64;

/// The hash of a line, which covers all lines up to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hash([u8; 32]);

impl Hash {
    /// Hash before the first line.
    pub const ORIGIN: Self = Self([0; 32]);

    /// Parses a hash from hexadecimal digits.
    pub fn parse(text: &str) -> Option<Self> {
        let mut bytes = [0; 32];
        hex::decode_to_slice(text, &mut bytes).ok()?;
        Some(Self(bytes)).filter(|hash| hash.to_string() == text)
    }

    /// Returns the hash of a line with these bytes, if `self` is the hash of the previous line.
    pub(super) fn then(self, bytes: &[u8]) -> Self {
        let digest = Sha256::new().chain_update(self.0).chain_update(bytes);
        Self(digest.finalize().into())
    }
}

impl fmt::Display for Hash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(self.0))
    }
}

/// Returns the text of a line and its hash, if the previous line has the hash `before`. `object` is a JSON
/// object with at least one field.
pub(super) fn link(before: Hash, object: &str) -> (String, Hash) {
    let open = object.strip_suffix('}').unwrap_or(object);
    let hash = before.then(open.as_bytes());
    (seal(&format!("{open},\"hash\":\"{hash}\"}}")), hash)
}

/// A line of a journal as read.
#[derive(Debug, PartialEq)]
pub(super) struct LinkedLine<'a> {
    pub value: Value,
    /// Name of the machine that wrote the line.
    pub machine: String,
    /// The hashed bytes of the line.
    pub open: &'a [u8],
    pub hash: Hash,
}

/// Parses a line, which is passed without its line end. Returns `None` if the line is damaged or has no hash.
pub(super) fn parse_line(line: &[u8]) -> Option<LinkedLine<'_>> {
    let (value, Seal { machine, .. }) = read_sealed(SealedFileKind::Journal, line).ok()?;
    let (open, tail) = line.split_at_checked(line.len().checked_sub(SUM_BYTES + 9 + 64 + 1)?)?;
    let digits = tail.strip_prefix(HASH.0)?.get(..64)?;
    let is_closed = tail.get(9 + 64..)?.starts_with(HASH.1);
    let hash = Hash::parse(std::str::from_utf8(digits).ok()?)?;
    is_closed.then_some(LinkedLine {
        value,
        machine,
        open,
        hash,
    })
}

/// Content of a line that marks the beginning of a file or of the chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChainMark {
    /// Number of the file.
    pub file: u64,
    /// Hash of the previous line; `None` if the chain begins with this line.
    pub before: Option<Hash>,
    /// Reason why a new chain begins.
    pub why: Option<String>,
}

impl ChainMark {
    /// Returns the mark as an event of the journal.
    pub fn to_json(&self) -> Value {
        let mut event = json!({"event": "chain", "file": self.file});
        match &self.before {
            Some(before) => event["prev"] = json!(before.to_string()),
            None => event["begins"] = json!(true),
        }
        if let Some(why) = &self.why {
            event["why"] = json!(why);
        }
        event
    }

    /// Parses the mark in a line; returns `None` for any other line.
    pub fn from_line(line: &Value) -> Option<Self> {
        let before = match line["prev"].as_str() {
            Some(text) => Some(Hash::parse(text)?),
            None if line["begins"] == true => None,
            None => return None,
        };
        (line["event"] == "chain").then_some(())?;
        Some(Self {
            file: line["file"].as_u64()?,
            before,
            why: line["why"].as_str().map(ToOwned::to_owned),
        })
    }

    /// Returns the hash to which the mark is chained: that of the previous line, or [`Hash::ORIGIN`].
    pub fn base(&self) -> Hash {
        self.before.unwrap_or(Hash::ORIGIN)
    }
}

/// State of a journal, recorded outside of its files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Anchor {
    /// Hash of a line that must exist: the newest line when the anchor was written. It is [`Hash::ORIGIN`] if
    /// there was no line.
    pub hash: Hash,
    /// Number of the line whose hash is `hash`.
    pub n: u64,
    /// Number of the newest file.
    pub file: u64,
    /// Number of the oldest file that must exist; rotation has removed the files before this one.
    pub first: u64,
}

/// Result of reading an anchor.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum AnchorRead {
    There(Anchor),
    Missing,
    Damaged,
}

impl AnchorRead {
    /// Returns the anchor if it is intact.
    pub fn there(&self) -> Option<&Anchor> {
        match self {
            Self::There(anchor) => Some(anchor),
            Self::Missing | Self::Damaged => None,
        }
    }
}

impl Anchor {
    pub fn read(folder: &DiskPath) -> AnchorRead {
        Self::read_with_seal(folder).0
    }

    /// Reads the anchor and the seal of the anchor's line.
    pub fn read_with_seal(folder: &DiskPath) -> (AnchorRead, Option<Seal>) {
        let bytes = match read_regular(&folder.join(ANCHOR_FILE), ANCHOR_BYTES_MAX) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return (AnchorRead::Missing, None),
            Err(_) => return (AnchorRead::Damaged, None),
        };
        let of_line = |line: &Value| {
            Some(Self {
                hash: Hash::parse(line["hash"].as_str()?)?,
                n: number(line),
                file: line["file"].as_u64()?,
                first: line["first"].as_u64()?,
            })
        };
        let line = bytes.strip_suffix(b"\n");
        let sealed = line.and_then(|line| read_sealed(SealedFileKind::Anchor, line).ok());
        match sealed.and_then(|(line, seal)| Some((of_line(&line)?, seal))) {
            Some((anchor, seal)) => (AnchorRead::There(anchor), Some(seal)),
            None => (AnchorRead::Damaged, None),
        }
    }

    /// Writes the anchor; the anchor is on disk when this function returns.
    pub fn write(&self, folder: &DiskPath, generations: &Generations) -> io::Result<()> {
        let mut line = json!({
            "file": self.file, "first": self.first, "hash": self.hash.to_string(), "n": self.n,
        });
        let generation = generations.next();
        generations
            .seal(SealedFileKind::Anchor, generation)
            .put(&mut line);
        write_whole(&folder.join(ANCHOR_FILE), seal(&line.to_string()).as_bytes())?;
        generations.note_on_disk(StoredPart::Journal, generation);
        Ok(())
    }
}

/// Returns the seal of a journal's anchor; `None` if there is no usable anchor.
pub fn anchor_seal(folder: &DiskPath) -> Option<Seal> {
    Anchor::read_with_seal(folder).1
}

/// Removes an incomplete anchor, left if the process was killed while it wrote the anchor.
pub(super) fn tidy_up(folder: &DiskPath) -> io::Result<()> {
    for path in folder.list_folder()? {
        let name = path.name();
        if name.starts_with("anchor.") && name.ends_with(crate::disk::UNFINISHED) {
            path.remove_file()?;
        }
    }
    Ok(())
}

/// How a line of a file ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ending {
    /// The line ends with a line end.
    Whole,
    /// The line ends with the file: the line is still being written, or was cut short.
    Cut,
    /// The line is longer than allowed; the rest was skipped.
    TooLong,
}

/// Reads the next line into `line`, without the line end; returns `None` at the end of the file.
pub(super) fn next_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<Option<Ending>> {
    line.clear();
    let (mut is_too_long, mut has_begun) = (false, false);
    loop {
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            return Ok(has_begun.then_some(Ending::Cut));
        }
        has_begun = true;
        let end = bytes.iter().position(|byte| *byte == b'\n');
        let part = &bytes[..end.unwrap_or(bytes.len())];
        is_too_long |= line.len() + part.len() > LINE_BYTES_MAX;
        if !is_too_long {
            line.extend_from_slice(part);
        }
        let used = part.len() + usize::from(end.is_some());
        reader.consume(used);
        if end.is_some() {
            return Ok(Some(if is_too_long {
                Ending::TooLong
            } else {
                Ending::Whole
            }));
        }
    }
}

/// Returns the path of the journal file of this age in a folder; age 0 is the newest file.
pub fn journal_file_path(folder: &DiskPath, age: usize) -> DiskPath {
    folder.join(match age {
        0 => "journal.jsonl".to_owned(),
        age => format!("journal.{age}.jsonl"),
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_line_carries_the_hash_of_the_one_before_it_and_of_its_own_bytes() {
        let mut object = json!({"event": "boot", "n": 1});
        Generations::default()
            .plain_seal(SealedFileKind::Journal)
            .put(&mut object);
        let object = object.to_string();
        let (first, hash) = link(Hash::ORIGIN, &object);
        // SHA-256 of 32 zeros and the bytes of the object without its last brace
        let by_hand = Sha256::digest([&[0; 32][..], object.strip_suffix('}').unwrap().as_bytes()].concat());
        assert_eq!(hash.to_string(), hex::encode(by_hand));
        assert!(
            first.contains(&format!(",\"hash\":\"{hash}\",\"crc\":\"")),
            "{first}"
        );
        assert_eq!(first.len() as u64, object.len() as u64 + LINK_BYTES);
        let (second, _) = link(hash, &object);
        assert_ne!(first, second);
        let line = parse_line(first.trim_end().as_bytes()).unwrap();
        assert_eq!((line.hash, Hash::ORIGIN.then(line.open)), (hash, hash));
        assert_eq!(line.value["event"], "boot");
        for damaged in [
            seal(&object).trim_end(),
            "{\"event\":\"boot\"}",
            "{\"event\":\"bo",
        ] {
            assert_eq!(parse_line(damaged.as_bytes()), None);
        }
    }

    #[test]
    fn an_anchor_is_read_as_written_and_any_flipped_bit_makes_it_damaged() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Anchor::read(&folder.path().into()), AnchorRead::Missing);
        let anchor = Anchor {
            hash: Hash::ORIGIN.then(b"a"),
            n: 7,
            file: 9,
            first: 2,
        };
        anchor
            .write(&folder.path().into(), &Generations::default())
            .unwrap();
        assert_eq!(Anchor::read(&folder.path().into()), AnchorRead::There(anchor));
        let path = folder.path().join(ANCHOR_FILE);
        let bytes = fs::read(&path).unwrap();
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, flipped).unwrap();
            assert_eq!(
                Anchor::read(&folder.path().into()),
                AnchorRead::Damaged,
                "bit {bit}"
            );
        }
    }

    #[test]
    fn a_line_without_an_end_is_bounded_and_what_follows_is_read() {
        let text = [&vec![b'x'; 3 << 20][..], b"\nshort\ncut"].concat();
        let (mut reader, mut line) = (io::BufReader::new(&text[..]), Vec::new());
        assert_eq!(next_line(&mut reader, &mut line).unwrap(), Some(Ending::TooLong));
        assert!(line.len() <= LINE_BYTES_MAX);
        assert_eq!(next_line(&mut reader, &mut line).unwrap(), Some(Ending::Whole));
        assert_eq!(line, b"short");
        assert_eq!(next_line(&mut reader, &mut line).unwrap(), Some(Ending::Cut));
        assert_eq!(next_line(&mut reader, &mut line).unwrap(), None);
    }
}
