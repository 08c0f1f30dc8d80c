//! What is in force while a program is converted, and the words of a block.

use tandem_model::settings::{NcOptions, Unit};
use tandem_syntax::{Address, Word};

use crate::codes::WordSpec;
use crate::numbers;

/// What a program is converted from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Dialect dgshape.
    Dgshape,
    /// The milling programs that FANUC controls and those like them have in common: motions, offsets, drilling cycles, tool
    /// changes, subprogram calls by a number of four digits. Numbers mean what they say, with a point or without.
    Fanuc,
}

/// What is in force, as far as other words mean something else by it.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub from: Source,
    pub options: NcOptions,
    pub unit: Unit,
    pub motion: &'static str,
    pub absolute: bool,
    /// Fixed cycles return to the initial level.
    pub to_initial: bool,
    pub cycle: Option<Cycle>,
    /// Z as it is programmed, where it is known.
    pub z: Option<f64>,
    /// The tool in the spindle, and one that was called before its change.
    pub tool: Option<u32>,
    pub next_tool: Option<u32>,
    /// The tool whose length is in force.
    pub offset: Option<u32>,
    /// Axes that an earlier reference point return has named.
    pub returned: Vec<Address>,
    /// Local coordinates may be in force.
    pub is_local: bool,
    /// What is said of the block beside what it becomes.
    pub note: Option<String>,
}

/// The words of a block, each taken once.
pub(super) struct Words<'a> {
    pub all: Vec<Option<&'a Word>>,
}

impl<'a> Words<'a> {
    pub fn of(words: &'a [Word]) -> Self {
        Self {
            all: words.iter().map(Some).collect(),
        }
    }

    /// Takes the word of an address.
    pub fn take(&mut self, address: Address) -> Option<&'a Word> {
        let mut all = self.all.iter_mut();
        all.find(|word| word.is_some_and(|word| word.address == address))?
            .take()
    }

    pub fn has(&self, addresses: &[Address]) -> bool {
        let mut left = self.all.iter().flatten();
        left.any(|word| addresses.contains(&word.address))
    }
}

pub(super) const POSITIONS: [Address; 4] = [Address::X, Address::Y, Address::Z, Address::A];

impl State {
    pub fn new(from: Source, options: NcOptions) -> Self {
        Self {
            from,
            options,
            unit: Unit::Millimetre,
            motion: "G00",
            absolute: true,
            to_initial: true,
            cycle: None,
            z: None,
            tool: None,
            next_tool: None,
            offset: None,
            returned: Vec::new(),
            is_local: false,
            note: None,
        }
    }

    /// Something has moved the tool that is not known.
    pub fn lose_position(&mut self) {
        self.z = None;
    }

    /// What a word means, in the unit in force; for times in seconds.
    pub fn value(&self, word: &Word) -> Result<f64, String> {
        static PLAIN: WordSpec = WordSpec::new(Address::X, "a length", "mm", f64::MIN, f64::MAX);
        static ANGLE: WordSpec = WordSpec::new(Address::A, "an angle", "mm or deg", f64::MIN, f64::MAX);
        let spec = if word.address == Address::A {
            &ANGLE
        } else {
            &PLAIN
        };
        let value = word.number().ok_or("it has a variable")?;
        Ok(numbers::meant(value, spec, word, self.unit, &self.options))
    }

    /// Takes the axis words, and follows Z.
    pub fn positions(&mut self, words: &mut Words<'_>) -> Result<Vec<String>, String> {
        let mut parts = Vec::new();
        for address in POSITIONS {
            let Some(word) = words.take(address) else { continue };
            let value = self.value(word)?;
            if address == Address::Z {
                self.z = if self.absolute {
                    Some(value)
                } else {
                    self.z.map(|z| z + value)
                };
            }
            parts.push(format!("{}{}", address.text(), shown(value)));
        }
        Ok(parts)
    }

    /// How far above the last depth a peck begins, in the unit in force.
    pub fn clearance(&self) -> f64 {
        const INCH: f64 = 25.4;
        match self.unit {
            Unit::Millimetre => self.options.peck_clearance_mm,
            Unit::Inch => self.options.peck_clearance_mm / INCH,
        }
    }
}

/// The words of a fixed cycle that stay in force, in the unit of their blocks.
#[derive(Debug, Clone)]
pub(super) struct Cycle {
    pub code: u32,
    /// Z where it began, where that is known.
    pub initial: Option<f64>,
    /// Its words are positions.
    pub absolute: bool,
    /// How far Z is from the initial level, with words that are distances.
    pub at: f64,
    pub z: Option<f64>,
    pub r: Option<f64>,
    pub dwell_ms: Option<f64>,
    pub depth: Option<f64>,
}

impl Cycle {
    /// A code, behind another one that keeps its words.
    pub fn new(code: u32, before: Option<Cycle>, z: Option<f64>, absolute: bool) -> Self {
        let begins = Cycle {
            code,
            initial: z,
            absolute,
            at: 0.0,
            z: None,
            r: None,
            dwell_ms: None,
            depth: None,
        };
        before.map_or(begins, |before| Cycle { code, ..before })
    }
}

/// A value in at most seven decimals.
pub(super) fn shown(value: f64) -> String {
    let text = format!("{value:.7}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}
