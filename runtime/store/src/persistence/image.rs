//! The values to store, as plain data. Only values that differ from those on disk are written.

use std::collections::BTreeMap;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::LastRun;
use plc_protocol::types::run::RUNS_KEPT;
use serde::{Deserialize, Serialize};
use tandem_model::lost::LOST;
use tandem_model::variables::VariableArray;

use crate::tables::{KeptValues, LOST_VALUE};

/// Number of variables in a page. Reason: storing a changed variable writes 1 KiB, and all P variables need
/// only 256 pages.
pub const PAGE_VARIABLES: usize = 128;

/// State of a run, and the number of the newest journal line at the time when the state was read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptRun {
    /// The last run.
    #[serde(flatten)]
    pub run: LastRun,
    /// Number of the line.
    #[serde(rename = "journal_line")]
    pub line: u64,
}

/// Prefix of the names of ended runs; the index of the run in the ring of stored runs follows.
pub const RUN_KEYS: &str = "run/";

/// Name of the production counters.
pub const PRODUCTION_KEY: &str = "production";

/// Name of the record with the numbers of the newest journal lines that the stored runs and counters include.
pub const RUN_LINES_KEY: &str = "run_lines";

/// Returns the name of a stored ended run; `n` is its number.
pub fn run_key(n: u64) -> String {
    format!("{RUN_KEYS}{}", n % RUNS_KEPT as u64)
}

/// The last run of each coordinate system.
pub type LastRuns = BTreeMap<CoordinateSystemNumber, KeptRun>;

/// Bit patterns of the values in a page of variables, in ascending order of variable number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page(pub [u64; PAGE_VARIABLES]);

impl Page {
    /// Returns the page at index `place` of an array; entries after the end of the array are zero.
    pub fn from_array(array: &VariableArray, place: u16) -> Self {
        let first = usize::from(place) * PAGE_VARIABLES;
        let bits = |index| array.get(first + index).map_or(0, f64::to_bits);
        Self(std::array::from_fn(bits))
    }

    /// Copies the page to index `place` of an array.
    pub fn set(&self, array: &VariableArray, place: u16) {
        let first = usize::from(place) * PAGE_VARIABLES;
        for (number, bits) in (first..).zip(self.0) {
            array.set(number, f64::from_bits(bits));
        }
    }

    /// Returns the bit patterns as bytes, in little-endian order.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.0.iter().flat_map(|bits| bits.to_le_bytes()).collect()
    }

    /// Parses a page; returns `None` if the number of bytes is wrong.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (chunks, rest) = bytes.as_chunks::<8>();
        let page = <&[[u8; 8]; PAGE_VARIABLES]>::try_from(chunks).ok()?;
        rest.is_empty().then(|| Self(page.map(u64::from_le_bytes)))
    }
}

/// Returns the number of pages of an array.
pub fn pages(array: &VariableArray) -> u16 {
    u16::try_from(array.len().div_ceil(PAGE_VARIABLES)).unwrap_or(u16::MAX)
}

/// Returns the name of a page: `p/PLACE` for P variables, or `q/COORDINATE SYSTEM/PLACE` for Q variables.
pub fn page_name(area: u8, place: u16) -> String {
    match area {
        0 => format!("p/{place}"),
        cs => format!("q/{cs}/{place}"),
    }
}

fn page_key(name: &str) -> Option<(u8, u16)> {
    let (letter, rest) = name.split_once('/')?;
    match letter {
        "p" => Some((0, rest.parse().ok()?)),
        "q" => {
            let (cs, place) = rest.split_once('/')?;
            Some((cs.parse().ok().filter(|cs| *cs != 0)?, place.parse().ok()?))
        }
        _ => None,
    }
}

/// All stored values, or only the changed ones.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Image {
    /// Pages of variables by area (0 for P, otherwise the coordinate system of Q) and page index.
    pub pages: BTreeMap<(u8, u16), Page>,
    /// Other values by name.
    pub values: KeptValues,
}

impl Image {
    /// Returns the values of `self` that are missing in `kept` or differ there.
    #[must_use]
    pub fn beyond(mut self, kept: &Image) -> Image {
        self.pages.retain(|key, page| kept.pages.get(key) != Some(page));
        self.values
            .retain(|key, value| kept.values.get(key) != Some(value));
        self
    }

    /// Applies the values of a change to this image.
    pub fn take_over(&mut self, change: Image) {
        self.pages.extend(change.pages);
        self.values.extend(change.values);
    }

    /// Returns every value as a record: its name and its bytes.
    pub fn records(&self) -> impl Iterator<Item = (String, Vec<u8>)> {
        let pages = self.pages.iter();
        let pages = pages.map(|((area, place), page)| (page_name(*area, *place), page.to_bytes()));
        let values = self.values.iter();
        pages.chain(values.map(|(name, bytes)| (name.clone(), bytes.clone())))
    }

    /// Adds a record to this image. Returns false if the form of the record is unknown.
    pub fn take_record(&mut self, name: &str, payload: &[u8]) -> bool {
        if let Some(key) = page_key(name) {
            let page = Page::from_bytes(payload);
            return page.is_some_and(|page| {
                self.pages.insert(key, page);
                true
            });
        }
        self.values.insert(name.to_owned(), payload.to_vec());
        true
    }

    /// Marks a value as lost.
    pub fn lose(&mut self, name: &str) {
        match page_key(name) {
            Some(key) => {
                self.pages.insert(key, Page([LOST.to_bits(); PAGE_VARIABLES]));
            }
            None => {
                self.values.insert(name.to_owned(), LOST_VALUE.to_vec());
            }
        }
    }

    /// Returns true if the value exists or is marked as lost.
    pub fn has(&self, name: &str) -> bool {
        match page_key(name) {
            Some(key) => self.pages.contains_key(&key),
            None => self.values.contains_key(name),
        }
    }

    /// Returns a page of variables by its name.
    pub fn page(&self, name: &str) -> Option<&Page> {
        self.pages.get(&page_key(name)?)
    }

    /// Returns true for the name of a page of variables.
    pub fn is_page(name: &str) -> bool {
        page_key(name).is_some()
    }

    /// Returns the names of all values.
    pub fn names(&self) -> Vec<String> {
        let pages = self.pages.keys().map(|(area, place)| page_name(*area, *place));
        pages.chain(self.values.keys().cloned()).collect()
    }

    /// Returns true if the image contains no value.
    pub fn is_empty(&self) -> bool {
        self.pages.is_empty() && self.values.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_taken_over_under_its_name_or_lost() {
        let mut image = Image::default();
        assert!(image.take_record("p/3", &[0; 1024]) && image.take_record("q/2/0", &[1; 1024]));
        assert!(image.take_record("tool/1", b"7"));
        assert!(!image.take_record("p/3", b"7"));
        assert_eq!(image.names(), ["p/3", "q/2/0", "tool/1"]);
        let mut again = Image::default();
        for (name, payload) in image.records() {
            assert!(again.take_record(&name, &payload));
        }
        assert_eq!(again, image);
        image.lose("p/3");
        image.lose("tool/1");
        assert!(
            image
                .page("p/3")
                .unwrap()
                .0
                .iter()
                .all(|bits| *bits == LOST.to_bits())
        );
        assert_eq!(
            (&*image.values["tool/1"], image.has("tool/2")),
            (LOST_VALUE, false)
        );
    }

    #[test]
    fn pages_hold_an_array_and_give_it_back_bit_by_bit() {
        let (array, other) = (VariableArray::new(300), VariableArray::new(300));
        for (number, value) in [(0, -0.0), (127, f64::NAN), (128, f64::INFINITY), (299, 1.0 / 3.0)] {
            array.set(number, value);
        }
        assert_eq!(pages(&array), 3);
        for place in 0..pages(&array) {
            let page = Page::from_array(&array, place);
            Page::from_bytes(&page.to_bytes()).unwrap().set(&other, place);
        }
        let bits = |array: &VariableArray, number| array.get(number).map(f64::to_bits);
        assert!((0..300).all(|number| bits(&array, number) == bits(&other, number)));
        assert_eq!(
            (Page::from_bytes(&[0; 1023]), Page::from_bytes(&[0; 1032])),
            (None, None)
        );
    }
}
