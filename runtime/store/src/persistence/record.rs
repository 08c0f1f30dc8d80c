//! A stored value as bytes: its name, its content, and a checksum over both. The checksum detects damage, and
//! the name prevents confusion with another record.

use redb::TableDefinition;
use sha2::{Digest as _, Sha256};

/// Table of records by name: the values of an [`Image`] under their names there, and the number of the last
/// change.
pub(super) const RECORDS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("records");

/// Name of the record with the number of the last change.
pub(super) const CHANGE: &str = "change";

/// Name of the record with the seal of the last change.
pub(super) const SEAL: &str = "seal";

/// Size of the store's cache, in bytes. Reason: all stored values fit into it.
pub(super) const CACHE_BYTES: usize = 4 << 20;

/// First bytes of a record. Reason: they allow the runtime to find records in a file with damaged structure.
const MAGIC: [u8; 8] = *b"\xf7tandem\x01";

/// Length of a record's checksum, in bytes.
const SUM_BYTES: usize = 8;

/// Maximum sizes of a name and of its content, bytes.
const NAME_MAX: usize = 256;
const PAYLOAD_MAX: usize = 16 << 20;

fn checksum_record(name: &str, payload: &[u8]) -> [u8; SUM_BYTES] {
    let mut digest = Sha256::new();
    digest.update((name.len() as u64).to_le_bytes());
    digest.update(name);
    digest.update(payload);
    let mut sum = [0; SUM_BYTES];
    sum.copy_from_slice(&digest.finalize()[..SUM_BYTES]);
    sum
}

/// Returns the checksum of a record as hexadecimal digits.
pub(super) fn record_checksum_hex(name: &str, payload: &[u8]) -> String {
    hex::encode(checksum_record(name, payload))
}

/// Returns the bytes of a record with this name and content.
pub(super) fn write(name: &str, payload: &[u8]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend((name.len() as u64).to_le_bytes());
    bytes.extend((payload.len() as u64).to_le_bytes());
    bytes.extend(name.as_bytes());
    bytes.extend(payload);
    bytes.extend(checksum_record(name, payload));
    bytes
}

/// Parses the record at the beginning of `bytes`; returns its name, its content and its length in bytes.
fn parse_record(bytes: &[u8]) -> Option<(&str, &[u8], usize)> {
    let rest = bytes.strip_prefix(&MAGIC)?;
    let (name_len, rest) = rest.split_first_chunk::<8>()?;
    let (payload_len, rest) = rest.split_first_chunk::<8>()?;
    let length = |bytes: &[u8; 8], most: usize| {
        let length = usize::try_from(u64::from_le_bytes(*bytes)).ok();
        length.filter(|length| *length <= most)
    };
    let (name_len, payload_len) = (length(name_len, NAME_MAX)?, length(payload_len, PAYLOAD_MAX)?);
    let (name, rest) = rest.split_at_checked(name_len)?;
    let (payload, rest) = rest.split_at_checked(payload_len)?;
    let name = std::str::from_utf8(name).ok()?;
    let is_whole = rest.first_chunk() == Some(&checksum_record(name, payload));
    let length = bytes.len() - rest.len() + SUM_BYTES;
    is_whole.then_some((name, payload, length))
}

/// Returns the content of a record; `None` if the record is damaged or its name is not `name`.
pub(super) fn read<'a>(name: &str, bytes: &'a [u8]) -> Option<&'a [u8]> {
    let (found, payload, length) = parse_record(bytes)?;
    (found == name && length == bytes.len()).then_some(payload)
}

/// Finds all intact records in `bytes`, at any offset; returns their names and contents.
pub(super) fn scan(bytes: &[u8]) -> Vec<(&str, &[u8])> {
    let (mut found, mut at) = (Vec::new(), 0);
    while let Some(rest) = bytes.get(at..) {
        let Some(next) = rest.iter().position(|byte| *byte == MAGIC[0]) else {
            break;
        };
        at += next;
        match parse_record(&bytes[at..]) {
            Some((name, payload, length)) => {
                found.push((name, payload));
                at += length;
            }
            None => at += 1,
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn record_read_under_its_own_name_only_and_not_with_a_flipped_bit() {
        let bytes = write("p/3", b"values");
        assert_eq!(read("p/3", &bytes), Some(&b"values"[..]));
        assert_eq!(read("p/4", &bytes), None);
        for place in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[place / 8] ^= 1 << (place % 8);
            assert_eq!(read("p/3", &flipped), None, "bit {place}");
        }
        for length in 0..bytes.len() {
            assert_eq!(read("p/3", &bytes[..length]), None);
        }
    }

    #[test]
    fn records_are_found_among_other_bytes() {
        let (a, b) = (write("a", b"1"), write("b", &[0xf7; 100]));
        let mut bytes = vec![0xf7; 10];
        bytes.extend(&a);
        bytes.extend(&MAGIC);
        bytes.extend([0xff; 20]);
        bytes.extend(&b);
        bytes.extend(&a[..a.len() - 1]);
        assert_eq!(scan(&bytes), [("a", &b"1"[..]), ("b", &[0xf7; 100])]);
    }
}
