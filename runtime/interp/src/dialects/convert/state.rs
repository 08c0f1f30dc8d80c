//! Modal state during the conversion of a program, and the words of a block.

use tandem_model::settings::{NcOptions, Unit};
use tandem_syntax::{Address, Word};

use crate::codes::WordSpec;
use crate::{Dialect, dialects, numbers};

/// Dialect of the source program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Dialect dgshape of Tandem.
    Dgshape,
    /// The common subset of milling programs for FANUC and similar controls: motions, offsets, drilling
    /// cycles, tool changes, subprogram calls by a number of four digits. Numbers have their written value,
    /// with or without a point.
    Fanuc,
}

impl Source {
    /// Returns the dialect of machines that run such programs; `None` if no dialect does.
    pub fn dialect(self) -> Option<&'static Dialect> {
        match self {
            Source::Dgshape => Some(dialects::dgshape()),
            Source::Fanuc => None,
        }
    }
}

/// Modal state on which the conversion of later words depends.
#[derive(Debug, Clone)]
pub(super) struct ConversionState {
    pub from: Source,
    pub options: NcOptions,
    pub unit: Unit,
    /// Number of the G code of the current plane. `None` if another program may have changed the plane.
    pub plane: Option<u32>,
    /// Code of the current motion; empty if a called program, or the caller of this program, may have changed
    /// it.
    pub motion: &'static str,
    /// True if axis words are positions; `None` if another program may have changed the mode.
    pub absolute: Option<bool>,
    /// True if fixed cycles return to the initial level; `None` if another program may have changed the mode.
    pub to_initial: Option<bool>,
    pub cycle: Option<CycleState>,
    /// The programmed positions of X, Y, Z and A, if known.
    pub at: [Option<f64>; 4],
    /// Shift of the coordinates by G92, mm or degrees.
    pub shift: [f64; 4],
    /// Additional shift of the coordinates by G52, mm or degrees.
    pub local: [f64; 4],
    /// True if a rotation (G68) is active.
    pub is_rotated: bool,
    pub is_scaled: bool,
    /// Positions about which X, Y and Z are mirrored, mm.
    pub mirror: [Option<f64>; 3],
    /// The M code that started the spindle; `None` if the spindle is stopped.
    pub spindle: Option<u32>,
    /// True if the end of a tapping cycle stops the spindle.
    pub is_rigid: bool,
    /// Number of the tool in the spindle.
    pub tool: Option<u32>,
    /// Number of the tool in a T word that comes before its M06.
    pub next_tool: Option<u32>,
    /// Number of the tool whose length offset is in force.
    pub offset: Option<u32>,
    /// Axes that the last return to a reference point has named.
    pub returned: Vec<Address>,
    /// A note on the block, added to its comments.
    pub note: Option<String>,
}

/// The words of a block; each word can be taken once.
pub(super) struct Words<'a> {
    pub all: Vec<Option<&'a Word>>,
}

impl<'a> Words<'a> {
    pub fn new(words: &'a [Word]) -> Self {
        Self {
            all: words.iter().map(Some).collect(),
        }
    }

    /// Takes the word with this address.
    pub fn take_word(&mut self, address: Address) -> Option<&'a Word> {
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

/// Codes of the motions; the number of a code is its index.
const MOTIONS: [&str; 4] = ["G00", "G01", "G02", "G03"];

/// Index of Z in [`POSITIONS`].
pub(super) const Z: usize = 2;

const INCH: f64 = 25.4;

/// G17, in whose plane fixed cycles drill along Z on every control.
pub(super) const PLANE_XY: u32 = 17;

const MS_PER_S: f64 = 1000.0;

impl ConversionState {
    pub fn new(from: Source, options: NcOptions, unit: Unit) -> Self {
        Self {
            from,
            options,
            unit,
            plane: Some(PLANE_XY),
            motion: "G00",
            absolute: Some(true),
            to_initial: Some(true),
            cycle: None,
            at: [None; 4],
            shift: [0.0; 4],
            local: [0.0; 4],
            is_rotated: false,
            is_scaled: false,
            mirror: [None; 3],
            spindle: None,
            is_rigid: false,
            tool: None,
            next_tool: None,
            offset: None,
            returned: Vec::new(),
            note: None,
        }
    }

    /// Discards the position of the tool, because an unknown amount has moved the tool or the coordinates.
    pub fn lose_position(&mut self) {
        self.at = [None; 4];
    }

    /// Discards the modal state, because another program may have changed it.
    pub fn lose_modal_state(&mut self) {
        self.lose_position();
        self.motion = "";
        self.plane = None;
        self.absolute = None;
        self.to_initial = None;
    }

    /// Applies the modal effect of a G code, independent of the other words of its block.
    pub fn activate_code(&mut self, code: u32) {
        match code {
            0..=3 => {
                self.motion = MOTIONS[code as usize % MOTIONS.len()];
                self.cycle = None;
            }
            80 => self.cycle = None,
            17..=19 => self.plane = Some(code),
            20 => self.unit = Unit::Inch,
            21 => self.unit = Unit::Millimetre,
            90 | 91 => self.absolute = Some(code == 90),
            98 | 99 => self.to_initial = Some(code == 98),
            _ => {}
        }
    }

    /// Returns the programmed Z, if known.
    pub fn z(&self) -> Option<f64> {
        self.at[Z]
    }

    /// Returns the number of mm or degrees in one unit of an axis word.
    pub fn unit_of(&self, axis: usize) -> f64 {
        let is_inch = self.unit == Unit::Inch && POSITIONS[axis] != Address::A;
        if is_inch { INCH } else { 1.0 }
    }

    /// Returns the value of a word with a length, a feedrate or an angle, in the current unit.
    pub fn value(&self, word: &Word) -> Result<f64, String> {
        static PLAIN: WordSpec = WordSpec::new(Address::X, "a length", "mm", f64::MIN, f64::MAX);
        static ANGLE: WordSpec = WordSpec::new(Address::A, "an angle", "mm or deg", f64::MIN, f64::MAX);
        let spec = if word.address == Address::A {
            &ANGLE
        } else {
            &PLAIN
        };
        let value = word.number().ok_or("it has a variable")?;
        Ok(numbers::convert_written_value(
            value,
            spec,
            word,
            self.unit,
            &self.options,
        ))
    }

    /// Returns the time in the X word of a dwell, s.
    pub fn seconds(&self, word: &Word) -> Result<f64, String> {
        static TIME: WordSpec = WordSpec::new(Address::X, "a time", "s", 0.0, f64::MAX);
        let value = word.number().ok_or("it has a variable")?;
        if self.from == Source::Fanuc && word.is_whole() && value != 0.0 {
            return Err(format!(
                "X{value} of a dwell has no decimal point: with calculator input it is {value} s, otherwise {} s. Write X with a decimal point for seconds, or P for milliseconds.",
                shown(value / MS_PER_S)
            ));
        }
        Ok(numbers::convert_written_value(
            value,
            &TIME,
            word,
            self.unit,
            &self.options,
        ))
    }

    /// Returns the time in the P word of a dwell, s. P is in milliseconds; controls of source `Fanuc` that
    /// accept a P with a decimal point read it in seconds.
    pub fn dwell_of_p(&self, word: &Word) -> Result<f64, String> {
        let value = word.number().ok_or("it has a variable")?;
        let is_seconds = self.from == Source::Fanuc && !word.is_whole();
        Ok(if is_seconds { value } else { value / MS_PER_S })
    }

    /// Returns a feedrate in the current unit, raised to the least feedrate of the machine for dialect
    /// dgshape.
    pub fn feedrate_within(&self, feedrate: f64) -> f64 {
        let unit = match self.unit {
            Unit::Millimetre => 1.0,
            Unit::Inch => INCH,
        };
        match self.from {
            Source::Dgshape => feedrate.max(self.options.min_feedrate_mm_min / unit),
            Source::Fanuc => feedrate,
        }
    }

    /// Converts the axis words, and updates the programmed positions.
    pub fn positions(&mut self, words: &mut Words<'_>) -> Result<Vec<String>, String> {
        let mut parts = Vec::new();
        for (axis, address) in POSITIONS.into_iter().enumerate() {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            let value = self.value(word)?;
            self.at[axis] = match self.absolute {
                Some(true) => Some(value),
                Some(false) => self.at[axis].map(|at| at + value),
                None => None,
            };
            parts.push(format!("{}{}", address.text(), shown(value)));
        }
        Ok(parts)
    }

    /// Returns the distance above the last depth at which a peck begins, in the current unit.
    pub fn clearance(&self) -> f64 {
        match self.unit {
            Unit::Millimetre => self.options.peck_clearance_mm,
            Unit::Inch => self.options.peck_clearance_mm / INCH,
        }
    }
}

/// The modal words of a fixed cycle, in the unit of their blocks.
#[derive(Debug, Clone)]
pub(super) struct CycleState {
    pub code: u32,
    /// Z at the start of the cycle, if known.
    pub initial: Option<f64>,
    /// True if the words of the cycle are positions.
    pub absolute: bool,
    /// Distance of Z from the initial level, if the words are distances.
    pub at: f64,
    pub z: Option<f64>,
    pub r: Option<f64>,
    pub dwell_s: Option<f64>,
    pub depth: Option<f64>,
}

impl CycleState {
    /// Creates a cycle from a code. After another cycle (`before`), keeps the words of that cycle.
    pub fn new(code: u32, before: Option<CycleState>, z: Option<f64>, absolute: bool) -> Self {
        let begins = CycleState {
            code,
            initial: z,
            absolute,
            at: 0.0,
            z: None,
            r: None,
            dwell_s: None,
            depth: None,
        };
        before.map_or(begins, |before| CycleState { code, ..before })
    }

    /// Returns true for a cycle that cuts threads.
    pub fn taps(&self) -> bool {
        matches!(self.code, 74 | 84)
    }
}

/// Returns a value as text with at most seven decimals.
pub(super) fn shown(value: f64) -> String {
    let text = format!("{value:.7}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}
