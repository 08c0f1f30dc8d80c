//! A line as text: a JSON object that ends with a check sum of all before it, and the way back.
//!
//! Each line of the journal has a number `n` that rises over all starts of the runtime: it orders lines, whatever the clock of the day
//! says.

use serde_json::Value;

/// What the check sum stands behind, and ends with.
const SUM: (&str, &str) = (",\"crc\":\"", "\"}");

/// The text of a line with its check sum and its end; `object` is a JSON object with a field.
pub(crate) fn seal(object: &str) -> String {
    let open = object.strip_suffix('}').unwrap_or(object);
    let (before, after) = SUM;
    format!("{open}{before}{:08x}{after}\n", crc32fast::hash(open.as_bytes()))
}

/// Seals a JSON object that stands in a buffer up to `end`; gives the new end. `None`: there is no room.
pub(crate) fn seal_in_place(buffer: &mut [u8], end: usize) -> Option<usize> {
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

/// What stands in a line.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Read {
    /// What was written, without the check sum.
    Whole(Value),
    /// It is damaged, or was never written by a runtime.
    Damaged,
}

/// Reads a line without its end. Lines of versions before 0.2 have neither number nor check sum.
pub(crate) fn read(line: &[u8]) -> Read {
    let Ok(mut value) = serde_json::from_slice::<Value>(line) else {
        return Read::Damaged;
    };
    let is_old = value.is_object() && value.get("n").is_none() && value.get("crc").is_none();
    if is_old {
        return Read::Whole(value);
    }
    let open = line.len().checked_sub(SUM.0.len() + 8 + SUM.1.len());
    let sealed = open.and_then(|open| line.split_at_checked(open));
    let is_whole = sealed.is_some_and(|(open, sum)| {
        let expected = format!("{}{:08x}{}", SUM.0, crc32fast::hash(open), SUM.1);
        sum == expected.as_bytes()
    });
    match value.as_object_mut().filter(|_| is_whole) {
        Some(fields) => {
            fields.remove("crc");
            Read::Whole(value)
        }
        None => Read::Damaged,
    }
}

/// The number of a line; 0 for one without.
pub(crate) fn number(line: &Value) -> u64 {
    line["n"].as_u64().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_line_is_sealed_and_read_and_any_flipped_bit_makes_it_no_line() {
        let object = json!({"event": "output", "m": 100, "n": 7});
        let text = seal(&object.to_string());
        let line = text.strip_suffix('\n').unwrap().as_bytes();
        assert_eq!(read(line), Read::Whole(object.clone()));
        for place in 0..line.len() * 8 {
            let mut flipped = line.to_vec();
            flipped[place / 8] ^= 1 << (place % 8);
            assert_eq!(
                read(&flipped),
                Read::Damaged,
                "{}",
                String::from_utf8_lossy(&flipped)
            );
        }
        let mut buffer = [0; 100];
        let plain = object.to_string();
        buffer[..plain.len()].copy_from_slice(plain.as_bytes());
        let end = seal_in_place(&mut buffer, plain.len()).unwrap();
        assert_eq!(&buffer[..end], text.as_bytes());
        assert_eq!(seal_in_place(&mut buffer[..plain.len()], plain.len()), None);
    }

    #[test]
    fn a_line_of_an_older_version_is_read_and_what_is_none_is_not() {
        assert_eq!(
            read(b"{\"event\":\"boot\"}"),
            Read::Whole(json!({"event": "boot"}))
        );
        for damaged in [
            &b"{\"n\":7}"[..],
            b"7",
            b"",
            b"\x80",
            b"{\"crc\":\"00000000\"}",
            b"null",
        ] {
            assert_eq!(read(damaged), Read::Damaged);
        }
    }
}
