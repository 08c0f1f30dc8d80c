//! The values to keep, as plain data: only what differs from the values on disk is written.

use std::collections::BTreeMap;
use std::io;

use plc_api::types::CoordinateSystemNumber;
use plc_api::types::data::LastRun;
use serde::{Deserialize, Serialize};
use tandem_model::variables::VariableArray;

use crate::tables::KeptValues;

/// Variables of one page. Reason: one that changes costs 1 KiB on disk, all of P 256 entries.
pub(crate) const PAGE_VARIABLES: usize = 128;

/// A run, and which line of the journal was the newest when it was looked at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptRun {
    #[serde(flatten)]
    pub run: LastRun,
    /// Number of the line; 0: it was kept by a version without numbers.
    #[serde(rename = "journal_line", default)]
    pub line: u64,
}

/// Last runs by coordinate system.
pub(crate) type LastRuns = BTreeMap<CoordinateSystemNumber, KeptRun>;

/// Bits of the variables of a page, ascending by number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Page(pub [u64; PAGE_VARIABLES]);

impl Page {
    /// The page of an array; what lies beyond the array is zero.
    pub fn of(array: &VariableArray, place: u16) -> Self {
        let first = usize::from(place) * PAGE_VARIABLES;
        let bits = |index| array.get(first + index).map_or(0, f64::to_bits);
        Self(std::array::from_fn(bits))
    }

    /// Sets the variables of an array.
    pub fn set(&self, array: &VariableArray, place: u16) {
        let first = usize::from(place) * PAGE_VARIABLES;
        for (number, bits) in (first..).zip(self.0) {
            array.set(number, f64::from_bits(bits));
        }
    }

    pub fn to_bytes(&self) -> Vec<u8> {
        self.0.iter().flat_map(|bits| bits.to_le_bytes()).collect()
    }

    pub fn from_bytes(bytes: &[u8]) -> io::Result<Self> {
        let (chunks, rest) = bytes.as_chunks::<8>();
        match <&[[u8; 8]; PAGE_VARIABLES]>::try_from(chunks) {
            Ok(page) if rest.is_empty() => Ok(Self(page.map(u64::from_le_bytes))),
            _ => Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "a page of variables is not of its length; the file is of another version",
            )),
        }
    }
}

/// How many pages an array fills.
pub(crate) fn pages(array: &VariableArray) -> u16 {
    u16::try_from(array.len().div_ceil(PAGE_VARIABLES)).unwrap_or(u16::MAX)
}

/// All that is kept, or a change of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Image {
    /// By area (0: P, else the coordinate system of Q) and place.
    pub pages: BTreeMap<(u8, u16), Page>,
    /// Values by their names.
    pub values: KeptValues,
}

impl Image {
    /// What of `self` is not in `kept`.
    pub fn beyond(mut self, kept: &Image) -> Image {
        self.pages.retain(|key, page| kept.pages.get(key) != Some(page));
        self.values
            .retain(|key, value| kept.values.get(key) != Some(value));
        self
    }

    /// Takes a change over.
    pub fn take_over(&mut self, change: Image) {
        self.pages.extend(change.pages);
        self.values.extend(change.values);
    }

    pub fn is_empty(&self) -> bool {
        self.pages.is_empty() && self.values.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_hold_an_array_and_give_it_back_bit_by_bit() {
        let (array, other) = (VariableArray::new(300), VariableArray::new(300));
        for (number, value) in [(0, -0.0), (127, f64::NAN), (128, f64::INFINITY), (299, 1.0 / 3.0)] {
            array.set(number, value);
        }
        assert_eq!(pages(&array), 3);
        for place in 0..pages(&array) {
            let page = Page::of(&array, place);
            Page::from_bytes(&page.to_bytes()).unwrap().set(&other, place);
        }
        let bits = |array: &VariableArray, number| array.get(number).map(f64::to_bits);
        assert!((0..300).all(|number| bits(&array, number) == bits(&other, number)));
        assert!(Page::from_bytes(&[0; 1023]).is_err() && Page::from_bytes(&[0; 1032]).is_err());
    }
}
