//! Files of NC programs: reads the text, and finds the program number in the file name.

use std::fs;
use std::io::{self, Read as _};
use std::path::Path;

use tandem_model::limits::{PROGRAM_BYTES_MAX, PROGRAM_NUMBER_MAX};

/// Reads the text of an NC program's file. Bytes that are not UTF-8 become replacement characters, which the
/// checker reports.
///
/// # Errors
/// Returns an error if the file cannot be read, or has more than [`PROGRAM_BYTES_MAX`] bytes; a longer file
/// is not read to its end.
pub fn read_text(path: &Path) -> io::Result<String> {
    read_text_from(fs::File::open(path)?)
}

/// Reads the text of an NC program from any source of bytes, with the same rules as [`read_text`].
///
/// # Errors
/// Returns the same errors as [`read_text`].
pub fn read_text_from(from: impl io::Read) -> io::Result<String> {
    let most = PROGRAM_BYTES_MAX as u64;
    let mut bytes = Vec::new();
    from.take(most + 1).read_to_end(&mut bytes)?;
    check_bytes(bytes.len() as u64)?;
    Ok(text_of(bytes))
}

pub(super) fn text_of(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned())
}

/// Checks whether [`read_text`] would accept a file, without reading its text.
///
/// # Errors
/// Returns the same errors as [`read_text`].
pub fn check_readable(path: &Path) -> io::Result<()> {
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
    let text = format!("the file has more than {PROGRAM_BYTES_MAX} bytes, the maximum for a program");
    Err(io::Error::new(io::ErrorKind::FileTooLarge, text))
}

/// Returns the program number in a file name: `<number>.nc` or `O<number>.nc`.
pub fn program_number(path: &Path) -> Option<u16> {
    if !path.extension()?.eq_ignore_ascii_case("nc") {
        return None;
    }
    let stem = path.file_stem()?.to_str()?;
    let number = stem.strip_prefix(['O', 'o']).unwrap_or(stem).parse().ok()?;
    (1..=PROGRAM_NUMBER_MAX).contains(&number).then_some(number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_tell_program_numbers() {
        let number = |name: &str| program_number(Path::new(name));
        assert_eq!(number("12.nc"), Some(12));
        assert_eq!(number("O1000.NC"), Some(1000));
        assert_eq!(number("main.nc"), None);
        assert_eq!(number("0.nc"), None);
    }
}
