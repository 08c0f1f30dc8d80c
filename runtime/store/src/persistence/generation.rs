//! All stored values as one JSON document, which `store export` writes and `store import` reads. The last
//! good generation next to the store has the same form: a person can restore lost values from it. The runtime
//! never uses it automatically, because it is older than the store. Withheld values have the same form. A document
//! of the data folder is sealed: it names its kind, its machine and its generation. An exported document is not
//! sealed, because a person may import it into another machine.

use std::borrow::Cow;
use std::io::{self, Write};

use plc_protocol::execution::wire_name;
use plc_protocol::types::Timestamp;
use plc_protocol::types::data::JsonNumber;
use serde::Deserialize;
use serde_json::{Map, Value};
use tandem_model::lost::is_lost;

use super::image::{Image, PAGE_VARIABLES, Page, page_name};
use crate::disk::{
    ChecksumHasher, DiskPath, Generations, Seal, SealedFileKind, StoredPart, read_regular, write_whole_by,
};

/// Name of the last good generation in the data folder.
pub const GENERATION_FILE: &str = "state.last-good.json";

/// Maximum size of a document, bytes.
const BYTES_MAX: u64 = 256 << 20;

/// Version of the document format; only this version exists so far.
const FORM: u32 = 1;

#[derive(Debug, Deserialize)]
struct GenerationDocument {
    tandem_store: u32,
    written: Timestamp,
    /// Values by name; null for a lost value.
    values: Map<String, Value>,
    /// Seal of a document of a data folder; an exported document has none.
    #[serde(default)]
    seal: Option<Seal>,
    /// Checksum of the seal and the values; a person who edits the document must remove this field.
    #[serde(default)]
    sum: Option<String>,
}

/// The stored values at one point in time.
#[derive(Debug, Clone)]
pub struct Generation {
    /// Time at which the document was written.
    pub written: Timestamp,
    /// The values of the document.
    pub image: Image,
    /// Names of values that were lost when the document was written; they are not in the image.
    pub lost: Vec<String>,
    /// Seal of the document; `None` for an exported document.
    pub seal: Option<Seal>,
}

fn invalid(text: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, text.into())
}

fn text_of_seal(seal: Option<&Seal>) -> String {
    seal.map(|seal| serde_json::to_string(seal).unwrap_or_default())
        .unwrap_or_default()
}

fn checksum(seal: Option<&Seal>, values: &Map<String, Value>) -> String {
    let mut sum = ChecksumHasher::default();
    sum.add(text_of_seal(seal).as_bytes());
    sum.add(serde_json::to_string(values).unwrap_or_default().as_bytes());
    sum.finish()
}

impl Generation {
    /// Writes the document of an image; `written` is the time of day, `seal` that of a document of a data folder.
    /// Values are converted and written one at a time, so the text of thousands of runs is never in memory as a whole.
    ///
    /// # Errors
    /// Returns an error if the output cannot be written.
    pub fn write_text(
        image: &Image,
        written: &Timestamp,
        seal: Option<&Seal>,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        let pages = image.pages.keys();
        let pages = pages.map(|(area, place)| Cow::from(page_name(*area, *place)));
        let values = image.values.keys().map(|name| Cow::from(name.as_str()));
        let mut names: Vec<Cow<'_, str>> = pages.chain(values).collect();
        names.sort_unstable();
        let written = &written.0;
        let seal = text_of_seal(seal);
        let field = if seal.is_empty() {
            String::new()
        } else {
            format!("\"seal\":{seal},")
        };
        writeln!(
            out,
            "{{\"tandem_store\":{FORM},\"written\":\"{written}\",{field}\"values\":{{"
        )?;
        let mut sum = ChecksumHasher::default();
        sum.add(seal.as_bytes());
        sum.add(b"{");
        for (number, name) in names.iter().enumerate() {
            let payload = image.values.get(&**name).map_or(&[][..], Vec::as_slice);
            let line = format!("{}:{}", Value::from(&**name), to_json(image, name, payload));
            if number > 0 {
                out.write_all(b",\n")?;
                sum.add(b",");
            }
            sum.add(line.as_bytes());
            out.write_all(line.as_bytes())?;
        }
        sum.add(b"}");
        writeln!(out, "\n}},\"sum\":\"{}\"}}", sum.finish())
    }

    /// Returns the document of an image for an export; `written` is the time of day.
    pub fn text(image: &Image, written: &Timestamp) -> String {
        let mut text = Vec::new();
        // writing into memory never fails
        let _ = Self::write_text(image, written, None, &mut text);
        String::from_utf8_lossy(&text).into_owned()
    }

    /// Writes the last good generation of a folder; `written` is the time of day.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails; the previous generation then remains.
    pub fn write(
        folder: &DiskPath,
        image: &Image,
        written: &Timestamp,
        generations: &Generations,
    ) -> io::Result<()> {
        let generation = generations.next();
        let seal = generations.seal(SealedFileKind::LastGood, generation);
        write_whole_by(&folder.join(GENERATION_FILE), |out| {
            Self::write_text(image, written, Some(&seal), out)
        })?;
        generations.note_on_disk(StoredPart::LastGood, generation);
        Ok(())
    }

    /// Reads the last good generation of a folder.
    ///
    /// # Errors
    /// Returns an error if the generation does not exist, is damaged, or belongs to another machine, or if the other
    /// files name a newer one.
    pub fn read(folder: &DiskPath, generations: &Generations) -> io::Result<Self> {
        let on_disk = generations.on_disk();
        let known = on_disk.get(&StoredPart::LastGood).copied().unwrap_or(0);
        let read = Self::read_sealed(&folder.join(GENERATION_FILE), SealedFileKind::LastGood)?;
        read.check_seal(generations.machine(), known)?;
        Ok(read)
    }

    /// Reads a generation of this kind from a file of a data folder. The caller compares its seal.
    ///
    /// # Errors
    /// Returns an error if the file does not exist, is damaged or has no seal of this kind.
    pub fn read_sealed(path: &DiskPath, kind: SealedFileKind) -> io::Result<Self> {
        let bytes = read_regular(path, BYTES_MAX)?;
        let read = Self::of_text(&String::from_utf8_lossy(&bytes), true)?;
        match &read.seal {
            Some(seal) if seal.kind == kind => Ok(read),
            Some(seal) => Err(invalid(format!(
                "the file is of another kind, {}",
                wire_name(&seal.kind)
            ))),
            None => Err(invalid("the file has no seal, so no runtime wrote it")),
        }
    }

    /// Checks that this machine wrote the document, and that it is not older than the generation `known`.
    ///
    /// # Errors
    /// Returns an error if the document belongs to another machine or is an older copy.
    pub fn check_seal(&self, machine: &str, known: u64) -> io::Result<()> {
        let checked = self
            .seal
            .as_ref()
            .map_or(Ok(()), |seal| seal.check(machine, known));
        checked.map_err(|(_, text)| invalid(text))
    }

    /// Reads a generation from a text. With `needs_sum`, a text without a checksum is treated as damaged.
    ///
    /// # Errors
    /// Returns an error if the text is not such a document, or if the checksum does not match the values.
    pub fn of_text(text: &str, needs_sum: bool) -> io::Result<Self> {
        let document: GenerationDocument =
            serde_json::from_str(text).map_err(|error| invalid(error.to_string()))?;
        if document.tandem_store != FORM {
            let text = format!(
                "the document has form {}; this version reads form {FORM}",
                document.tandem_store
            );
            return Err(invalid(text));
        }
        let is_whole = match &document.sum {
            Some(noted) => *noted == checksum(document.seal.as_ref(), &document.values),
            None => !needs_sum,
        };
        if !is_whole {
            return Err(invalid(
                "the checksum is wrong, so the document is damaged; if you have edited it, remove \"sum\"",
            ));
        }
        let (mut image, mut lost) = (Image::default(), Vec::new());
        for (name, value) in &document.values {
            let taken = match value {
                Value::Null => {
                    lost.push(name.clone());
                    continue;
                }
                value if Image::is_page(name) => {
                    page_of(value).is_some_and(|page| image.take_record(name, &page.to_bytes()))
                }
                value => image.take_record(name, value.to_string().as_bytes()),
            };
            if !taken {
                return Err(invalid(format!("{name} has an unknown format")));
            }
        }
        Ok(Self {
            written: document.written,
            image,
            lost,
            seal: document.seal,
        })
    }
}

fn to_json(image: &Image, name: &str, payload: &[u8]) -> Value {
    let Some(page) = image.page(name) else {
        return serde_json::from_slice(payload).unwrap_or(Value::Null);
    };
    let number = |bits: &u64| {
        let value = f64::from_bits(*bits);
        if is_lost(value) {
            return Value::Null;
        }
        serde_json::to_value(JsonNumber(value)).unwrap_or_default()
    };
    Value::Array(page.0.iter().map(number).collect())
}

fn page_of(value: &Value) -> Option<Page> {
    let numbers: Vec<Option<JsonNumber>> = Vec::deserialize(value).ok()?;
    let bits = numbers.into_iter().map(|number| match number {
        Some(number) => number.0.to_bits(),
        None => tandem_model::lost::LOST.to_bits(),
    });
    let bits: Vec<u64> = bits.collect();
    <[u64; PAGE_VARIABLES]>::try_from(bits).ok().map(Page)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> Image {
        let mut image = Image::default();
        let mut page = Page([0; PAGE_VARIABLES]);
        page.0[1] = 1.5_f64.to_bits();
        page.0[2] = f64::NAN.to_bits();
        page.0[3] = (-0.0_f64).to_bits();
        image.pages.insert((0, 3), page);
        image.values.insert("tool/1".to_owned(), b"7".to_vec());
        image
    }

    #[test]
    fn what_is_exported_is_imported_again() {
        let text = Generation::text(&image(), &Timestamp::default());
        assert_eq!(Generation::of_text(&text, true).unwrap().image, image());
        let edited = text.replace("\"tool/1\":7", "\"tool/1\":8");
        assert!(
            Generation::of_text(&edited, false).is_err(),
            "the checksum is wrong"
        );
        let mut without: Value = serde_json::from_str(&edited).unwrap();
        without.as_object_mut().unwrap().remove("sum");
        let read = Generation::of_text(&without.to_string(), false).unwrap();
        assert_eq!(read.image.values["tool/1"], b"8");
        assert!(Generation::of_text(&without.to_string(), true).is_err());
    }

    #[test]
    fn a_lost_value_is_null_and_is_not_imported() {
        let mut image = image();
        image.lose("tool/1");
        image.pages.get_mut(&(0, 3)).unwrap().0[1] = tandem_model::lost::LOST.to_bits();
        let text = Generation::text(&image, &Timestamp::default());
        let read = Generation::of_text(&text, true).unwrap().image;
        assert!(!read.has("tool/1"));
        assert!(is_lost(f64::from_bits(read.pages[&(0, 3)].0[1])));
    }

    #[test]
    fn last_generation_is_read_back_and_a_flipped_bit_rejects_it() {
        let folder = tempfile::tempdir().unwrap();
        let (path, mill): (DiskPath, _) = (folder.path().into(), Generations::new("mill"));
        assert!(Generation::read(&path, &mill).is_err());
        Generation::write(&path, &image(), &Timestamp::default(), &mill).unwrap();
        assert_eq!(Generation::read(&path, &mill).unwrap().image, image());
        let path_of_file = folder.path().join(GENERATION_FILE);
        let text = std::fs::read_to_string(&path_of_file).unwrap();
        for (whole, changed) in [("1.5", "1.7"), ("\"mill\"", "\"mall\"")] {
            std::fs::write(&path_of_file, text.replace(whole, changed)).unwrap();
            let error = Generation::read(&path, &mill).unwrap_err().to_string();
            assert!(error.contains("the checksum is wrong"), "{whole}: {error}");
        }
    }

    #[test]
    fn last_generation_of_another_kind_machine_or_age_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (path, mill): (DiskPath, _) = (folder.path().into(), Generations::new("mill"));
        let write = |seal: Option<&Seal>| {
            write_whole_by(&path.join(GENERATION_FILE), |out| {
                Generation::write_text(&image(), &Timestamp::default(), seal, out)
            })
            .unwrap();
            Generation::read(&path, &mill)
                .map(drop)
                .map_err(|error| error.to_string())
        };
        mill.learn(&[(StoredPart::LastGood, 9)].into());
        assert_eq!(write(Some(&mill.seal(SealedFileKind::LastGood, 9))), Ok(()));
        let lathe = Generations::new("lathe").seal(SealedFileKind::LastGood, 9);
        for (seal, how) in [
            (None, "no seal"),
            (
                Some(mill.seal(SealedFileKind::Withheld, 9)),
                "another kind, withheld",
            ),
            (Some(lathe), "belongs to machine lathe"),
            (
                Some(mill.seal(SealedFileKind::LastGood, 8)),
                "an older copy, of generation 8",
            ),
        ] {
            let refused = write(seal.as_ref()).unwrap_err();
            assert!(refused.contains(how), "{refused}");
        }
    }
}
