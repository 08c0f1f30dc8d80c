//! Writes and parses lines of text: each is a JSON object that ends with a checksum of all preceding bytes.
//!
//! Each line of the journal has a number `n` that increases across all starts of the runtime. The numbers
//! give the order of the lines, independently of the wall clock.

use plc_protocol::execution::wire_name;
use serde_json::Value;

use super::generations::{SEAL, Seal, SealedFileKind};

/// Text before and after the checksum.
const SUM: (&str, &str) = (",\"crc\":\"", "\"}");

/// Returns the text of a line with checksum and line end; `object` is a JSON object with at least one field.
pub fn seal(object: &str) -> String {
    let open = object.strip_suffix('}').unwrap_or(object);
    let (before, after) = SUM;
    format!("{open}{before}{:08x}{after}\n", crc32fast::hash(open.as_bytes()))
}

/// Adds the checksum to a JSON object that ends at `end` in a buffer. Returns the new end, or `None` if the
/// space is not sufficient.
pub fn seal_in_place(buffer: &mut [u8], end: usize) -> Option<usize> {
    let open = end.checked_sub(1)?;
    let sum = crc32fast::hash(&buffer[..open]);
    let mut at = open;
    let mut hex = [0; 8];
    hex::encode_to_slice(sum.to_be_bytes(), &mut hex).ok()?;
    for part in [SUM.0.as_bytes(), &hex, SUM.1.as_bytes(), b"\n"] {
        buffer.get_mut(at..at + part.len())?.copy_from_slice(part);
        at += part.len();
    }
    Some(at)
}

/// Parses a line with a valid checksum into its object and its seal; returns `None` if the line is damaged.
fn open(line: &[u8]) -> Option<(Value, Option<Seal>)> {
    let mut value = serde_json::from_slice::<Value>(line).ok()?;
    let fields = value.as_object_mut()?;
    let seal = fields.remove(SEAL).map(serde_json::from_value).transpose().ok()?;
    let open = line.len().checked_sub(SUM.0.len() + 8 + SUM.1.len())?;
    let (open, sum) = line.split_at_checked(open)?;
    let expected = format!("{}{:08x}{}", SUM.0, crc32fast::hash(open), SUM.1);
    (sum == expected.as_bytes()).then_some(())?;
    fields.remove("crc");
    Some((value, seal))
}

/// Reason why a sealed line cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Unusable {
    /// The checksum of the line is wrong, or the line is not complete.
    Damaged,
    /// The line belongs to another file, or has no seal; contains the description.
    Foreign(String),
}

/// Reads a sealed line without its line end.
///
/// # Errors
/// Returns an error if the line is damaged or of another kind.
pub fn read_sealed(kind: SealedFileKind, line: &[u8]) -> Result<(Value, Seal), Unusable> {
    match open(line) {
        None => Err(Unusable::Damaged),
        Some((_, None)) => Err(Unusable::Foreign(
            "its lines have no seal, so no runtime wrote them".to_owned(),
        )),
        Some((_, Some(seal))) if seal.kind != kind => {
            let text = format!("it contains lines of {}", wire_name(&seal.kind));
            Err(Unusable::Foreign(text))
        }
        Some((value, Some(seal))) => Ok((value, seal)),
    }
}

/// Returns the number of a line; 0 if it has none.
pub fn number(line: &Value) -> u64 {
    line["n"].as_u64().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::disk::Generations;

    #[test]
    fn a_line_is_sealed_and_read_and_any_flipped_bit_makes_it_no_line() {
        let object = json!({"event": "output", "m": 100, "n": 7});
        let seal_of_line = Generations::new("mill").plain_seal(SealedFileKind::Journal);
        let mut sealed = object.clone();
        seal_of_line.put(&mut sealed);
        let text = seal(&sealed.to_string());
        let line = text.strip_suffix('\n').unwrap().as_bytes();
        assert_eq!(
            read_sealed(SealedFileKind::Journal, line),
            Ok((object, seal_of_line))
        );
        for place in 0..line.len() * 8 {
            let mut flipped = line.to_vec();
            flipped[place / 8] ^= 1 << (place % 8);
            assert_eq!(
                read_sealed(SealedFileKind::Journal, &flipped),
                Err(Unusable::Damaged),
                "{}",
                String::from_utf8_lossy(&flipped)
            );
        }
        let mut buffer = [0; 200];
        let plain = sealed.to_string();
        buffer[..plain.len()].copy_from_slice(plain.as_bytes());
        let end = seal_in_place(&mut buffer, plain.len()).unwrap();
        assert_eq!(&buffer[..end], text.as_bytes());
        assert_eq!(seal_in_place(&mut buffer[..plain.len()], plain.len()), None);
    }

    #[test]
    fn a_line_of_another_kind_and_one_without_a_seal_are_not_read_as_sealed() {
        let generations = Generations::new("mill");
        let mut line = json!({"n": 7});
        generations.seal(SealedFileKind::Anchor, 3).put(&mut line);
        let text = seal(&line.to_string());
        let line = text.trim_end().as_bytes();
        let (value, read_seal) = read_sealed(SealedFileKind::Anchor, line).unwrap();
        assert_eq!((value, read_seal.generation), (json!({"n": 7}), 3));
        let other = read_sealed(SealedFileKind::StoreSums, line);
        assert_eq!(
            other,
            Err(Unusable::Foreign("it contains lines of anchor".to_owned()))
        );
        let unsealed = seal("{\"n\":7}");
        assert!(matches!(
            read_sealed(SealedFileKind::Anchor, unsealed.trim_end().as_bytes()),
            Err(Unusable::Foreign(_))
        ));
        assert_eq!(
            read_sealed(SealedFileKind::Anchor, &line[1..]),
            Err(Unusable::Damaged)
        );
    }

    #[test]
    fn a_line_without_a_checksum_is_damaged() {
        for damaged in [
            &b"{\"event\":\"boot\"}"[..],
            b"{\"n\":7}",
            b"7",
            b"",
            b"\x80",
            b"{\"crc\":\"00000000\"}",
            b"null",
        ] {
            assert_eq!(
                read_sealed(SealedFileKind::Journal, damaged),
                Err(Unusable::Damaged)
            );
        }
    }
}
