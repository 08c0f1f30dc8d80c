//! All kept values as one JSON document: what `store export` writes and `store import` reads, and the last good generation
//! beside the store, from which a person may restore lost values. It is never used
//! automatically, because it is older than the store.

use std::io;
use std::path::Path;

use plc_api::types::Timestamp;
use plc_api::types::data::Number;
use serde::Deserialize;
use serde_json::{Map, Value};
use tandem_model::lost::is_lost;

use super::image::{Image, PAGE_VARIABLES, Page};
use crate::clock::time_of_day;
use crate::disk::{read_regular, sum_of, write_whole};

/// Name of the last good generation in the data folder.
pub(crate) const GENERATION_FILE: &str = "state.last-good.json";

/// Maximum size of a document, bytes.
const BYTES_MAX: u64 = 256 << 20;

/// The only form of the document so far.
const FORM: u32 = 1;

#[derive(Debug, Deserialize)]
struct Document {
    tandem_store: u32,
    written: Timestamp,
    /// By name; null: the value is lost.
    values: Map<String, Value>,
    /// Checksum of the values; whoever edits the document by hand removes it.
    #[serde(default)]
    sum: Option<String>,
}

/// The kept values at one point in time.
#[derive(Debug, Clone)]
pub(crate) struct Generation {
    pub written: Timestamp,
    pub image: Image,
}

fn invalid(text: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, text.into())
}

fn sum(values: &Map<String, Value>) -> String {
    sum_of(Value::Object(values.clone()).to_string().as_bytes())
}

impl Generation {
    /// The text of what is kept now.
    pub fn text(image: &Image) -> String {
        let values: Map<String, Value> = image
            .records()
            .map(|(name, payload)| {
                let value = to_json(image, &name, &payload);
                (name, value)
            })
            .collect();
        let line = |(name, value): (&String, &Value)| format!("{}:{value}", Value::from(name.as_str()));
        let lines: Vec<String> = values.iter().map(line).collect();
        let (written, sum) = (Timestamp::from_system_time(time_of_day()).0, sum(&values));
        let head = format!("\"tandem_store\":{FORM},\"written\":\"{written}\",\"sum\":\"{sum}\"");
        format!("{{{head},\"values\":{{\n{}\n}}}}\n", lines.join(",\n"))
    }

    /// Writes the last good generation of a folder.
    ///
    /// # Errors
    /// The disk refuses; the previous generation remains.
    pub fn write(folder: &Path, image: &Image) -> io::Result<()> {
        write_whole(&folder.join(GENERATION_FILE), Self::text(image).as_bytes())
    }

    /// The last good generation of a folder.
    ///
    /// # Errors
    /// There is none, or it is damaged.
    pub fn read(folder: &Path) -> io::Result<Self> {
        let bytes = read_regular(&folder.join(GENERATION_FILE), BYTES_MAX)?;
        Self::of_text(&String::from_utf8_lossy(&bytes), true)
    }

    /// The values of a text. With `needs_sum` one without a sum is damaged.
    ///
    /// # Errors
    /// It is not such a document, or its checksum does not match.
    pub fn of_text(text: &str, needs_sum: bool) -> io::Result<Self> {
        let document: Document = serde_json::from_str(text).map_err(|error| invalid(error.to_string()))?;
        if document.tandem_store != FORM {
            let text = format!("its form is {}; this version knows {FORM}", document.tandem_store);
            return Err(invalid(text));
        }
        let is_whole = match &document.sum {
            Some(noted) => *noted == sum(&document.values),
            None => !needs_sum,
        };
        if !is_whole {
            return Err(invalid(
                "its sum is wrong: it is damaged; one that was edited by hand has no \"sum\"",
            ));
        }
        let mut image = Image::default();
        for (name, value) in &document.values {
            let taken = match value {
                Value::Null => continue,
                value if Image::is_page(name) => {
                    page_of(value).is_some_and(|page| image.take_record(name, &page.to_bytes()))
                }
                value => image.take_record(name, value.to_string().as_bytes()),
            };
            if !taken {
                return Err(invalid(format!("{name} is of no known form")));
            }
        }
        Ok(Self {
            written: document.written,
            image,
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
        serde_json::to_value(Number(value)).unwrap_or_default()
    };
    Value::Array(page.0.iter().map(number).collect())
}

fn page_of(value: &Value) -> Option<Page> {
    let numbers: Vec<Option<Number>> = Vec::deserialize(value).ok()?;
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
        let text = Generation::text(&image());
        assert_eq!(Generation::of_text(&text, true).unwrap().image, image());
        let edited = text.replace("\"tool/1\":7", "\"tool/1\":8");
        assert!(Generation::of_text(&edited, false).is_err(), "its sum is wrong");
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
        let text = Generation::text(&image);
        let read = Generation::of_text(&text, true).unwrap().image;
        assert!(!read.has("tool/1"));
        assert!(is_lost(f64::from_bits(read.pages[&(0, 3)].0[1])));
    }

    #[test]
    fn the_last_good_generation_is_read_back_and_with_a_flipped_bit_it_is_none() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Generation::read(folder.path()).is_err());
        Generation::write(folder.path(), &image()).unwrap();
        assert_eq!(Generation::read(folder.path()).unwrap().image, image());
        let path = folder.path().join(GENERATION_FILE);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("1.5", "1.7")).unwrap();
        assert!(Generation::read(folder.path()).is_err());
    }
}
