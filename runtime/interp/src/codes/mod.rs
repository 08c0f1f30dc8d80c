//! Codes of the NC language. Each file contains one code, or a family of codes that differ in one value.
//!
//! A file defines a `pub static` [`Code`]: number, modal group, words with ranges and units, text for the
//! reference, and effect. The checker, the interpreter and the reference pages read the same statics. To add
//! a code, write a file for it, and name the code here and in the list of the dialect.

pub mod cycle_words;
pub mod feed_words;
pub mod g00_rapid;
pub mod g01_linear;
pub mod g02_g03_arc;
pub mod g04_dwell;
pub mod g09_exact_stop;
pub mod g10_data;
pub mod g17_g18_g19_plane;
pub mod g20_g21_unit;
pub mod g28_g30_reference;
pub mod g31_skip;
pub mod g39_corner;
pub mod g40_g41_g42_cutter_compensation;
pub mod g43_g44_g49_tool_offset;
pub mod g500_g501_multi_block;
pub mod g50_1_g51_1_mirroring;
pub mod g50_g51_scaling;
pub mod g52_local;
pub mod g53_machine;
pub mod g61_g64_path_control;
pub mod g68_g69_rotation;
pub mod g74_g84_tapping;
pub mod g81_g89_drilling;
pub mod g90_g91_distance;
pub mod g92_coordinates;
pub mod g98_g99_return_level;
pub mod m00_m01_stop;
pub mod m02_m30_end;
pub mod m03_m17_machine;
pub mod m98_call;
pub mod m99_return;
pub mod m_auxiliary;
mod speed_codes;
mod table;
pub mod usual_outputs;
pub(crate) mod value;
pub mod work_offset;

use tandem_model::Axis;
use tandem_model::flow::AxisWords;
use tandem_syntax::{Address, AddressSet, DiagnosticEntry};

pub(crate) use table::tenths;
pub use table::{CodeTable, Example};

use crate::block_words::BlockWords;
use crate::execution::{Execution, axis_of};
use crate::meaning::{ModalValue, Role, Shape};

/// A G or M code.
#[derive(Debug)]
pub struct Code {
    /// The code as the manual writes it: `G50.1`, `M30`. Programs refer to a code by its number.
    pub code: &'static str,
    /// Name of the code in the manual.
    pub name: &'static str,
    /// Modal group of the code; M codes are [`ModalGroup::NonModal`].
    pub group: ModalGroup,
    /// Value that the code sets in its modal group, if the interpreter and checker use this value.
    pub sets: Option<ModalValue>,
    /// Role of the code in a block.
    pub role: Role,
    /// Words that the code takes itself. If a code of another group takes axis words, the active motion takes
    /// no axis words of the block.
    pub words: &'static [WordSpec],
    /// Description of the effect, for the reference.
    pub docs: &'static str,
    /// Check of the words of a block with the code, beyond their ranges.
    pub check: Option<BlockCheck>,
    /// Effect of the code in its block, in addition to its modal value.
    pub select: Effect,
    /// Effect of a block with axis words while the code is active; only for motions and fixed cycles.
    pub motion: Option<Motion>,
}

/// Function that finds a fault in the words of a block that has the code.
pub type BlockCheck = fn(&BlockWords) -> Option<Refusal>;

/// A fault that a [`BlockCheck`] finds.
#[derive(Debug)]
pub struct Refusal {
    /// The diagnostic that reports the fault.
    pub entry: &'static DiagnosticEntry,
    /// Address of the word at which the fault is shown.
    pub address: Address,
    /// Error text for the fault.
    pub message: String,
    /// Text on how to correct the fault.
    pub help: String,
}

/// Function that applies the effect of a code in its block.
pub type Effect = fn(&mut Execution<'_>);

/// Function that applies the axis words of a block.
pub type Motion = fn(&mut Execution<'_>, AxisWords);

impl PartialEq for Code {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other) || self.code == other.code
    }
}

impl Code {
    /// A code without words and effect, from which the other codes are built.
    pub const BASE: Self = Self {
        code: "",
        name: "",
        group: ModalGroup::NonModal,
        sets: None,
        role: Role::Plain,
        words: &[],
        docs: "",
        check: None,
        select: |_| {},
        motion: None,
    };

    /// Creates a modal code that sets a value.
    pub const fn setting(
        value: ModalValue,
        code: &'static str,
        name: &'static str,
        docs: &'static str,
    ) -> Self {
        Self {
            code,
            name,
            group: ModalGroup::for_value(value),
            sets: Some(value),
            docs,
            ..Self::BASE
        }
    }

    /// Returns ten times the number of the code: 501 for G50.1.
    pub const fn tenths(&self) -> u16 {
        let name = self.code.as_bytes();
        let (mut number, mut factor, mut at) = (0, 10, 1);
        while at < name.len() {
            if name[at] == b'.' {
                factor = 1;
            } else {
                number = 10 * number + (name[at] - b'0') as u16;
            }
            at += 1;
        }
        number * factor
    }

    /// Returns true if the code ends a program or a subprogram.
    pub(crate) fn ends(&self) -> bool {
        matches!(self.role, Role::End | Role::Return)
    }

    /// Returns the addresses of the words that the code takes itself.
    pub const fn addresses(&self) -> AddressSet {
        WordSpec::addresses(self.words)
    }

    /// Returns true if the code takes a word for this axis.
    pub fn takes(&self, axis: Axis) -> bool {
        self.words.iter().any(|word| axis_of(word.address) == Some(axis))
    }

    /// Returns the description of a word that the code takes itself; `None` if the code does not take such a
    /// word.
    pub fn word(&self, address: Address) -> Option<&'static WordSpec> {
        self.words.iter().find(|word| word.address == address)
    }
}

/// Description of a word that a code takes.
#[derive(Debug, Clone, PartialEq)]
pub struct WordSpec {
    /// Address of the word.
    pub address: Address,
    /// Meaning of the value.
    pub meaning: &'static str,
    /// Unit of the value; empty for numbers without a unit.
    pub unit: &'static str,
    /// Smallest permitted value (manual, table of instruction parameters).
    pub min: f64,
    /// Largest permitted value.
    pub max: f64,
    /// True if the value must be a whole number.
    pub integer: bool,
    /// True if the code requires the word.
    pub required: bool,
}

impl WordSpec {
    /// Creates an optional word with any value from `min` to `max`.
    pub const fn new(
        address: Address,
        meaning: &'static str,
        unit: &'static str,
        min: f64,
        max: f64,
    ) -> Self {
        Self {
            address,
            meaning,
            unit,
            min,
            max,
            integer: false,
            required: false,
        }
    }

    /// Returns the word with its values restricted to whole numbers.
    #[must_use]
    pub const fn whole(mut self) -> Self {
        self.integer = true;
        self
    }

    /// Returns the word as a word that its code requires.
    #[must_use]
    pub const fn needed(mut self) -> Self {
        self.required = true;
        self
    }

    /// Returns the set of addresses of these words.
    pub const fn addresses(words: &[WordSpec]) -> AddressSet {
        let mut set = AddressSet::EMPTY;
        let mut i = 0;
        while i < words.len() {
            set.insert(words[i].address);
            i += 1;
        }
        set
    }

    /// Returns true for a value within the range; false for NaN.
    pub fn holds(&self, value: f64) -> bool {
        value >= self.min && value <= self.max
    }

    /// Returns the range as text, with the unit.
    pub fn range_text(&self) -> String {
        let unit = if self.unit.is_empty() {
            String::new()
        } else {
            format!(" {}", self.unit)
        };
        if self.max.is_finite() {
            format!("{} to {}{unit}", self.min, self.max)
        } else if self.min.is_infinite() {
            "any number".to_owned()
        } else {
            format!("{}{unit} or more", self.min)
        }
    }
}

macro_rules! modal_groups {
    ($($name:ident $number:literal $text:literal,)*) => {
        /// The modal groups (manual, table of G codes).
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum ModalGroup { $(#[doc = concat!("Group ", $number, ": ", $text, ".")] $name,)* }

        impl ModalGroup {
            /// All groups, ascending by number.
            pub const ALL: &[ModalGroup] = &[$(ModalGroup::$name),*];

            /// Number of modal groups.
            pub const COUNT: usize = ModalGroup::ALL.len();

            /// Returns the number of the group in two digits, as HMIs show it.
            pub const fn number(self) -> &'static str {
                match self { $(ModalGroup::$name => $number,)* }
            }

            /// Returns the manual's name of the group.
            pub const fn text(self) -> &'static str {
                match self { $(ModalGroup::$name => $text,)* }
            }
        }
    };
}

modal_groups! {
    NonModal "00" "non-modal",
    Motion "01" "motion",
    Plane "02" "plane",
    Distance "03" "distance",
    Unit "06" "unit",
    ToolRadius "07" "tool radius",
    ToolLength "08" "tool length offset",
    FixedCycle "09" "fixed cycle",
    ReturnLevel "10" "return level",
    Scaling "11" "scaling",
    WorkCoordinates "14" "coordinate system selection",
    PathControl "15" "path control",
    Rotation "16" "rotation",
    Mirroring "22" "mirroring",
    MultiBlock "23" "multi-block acceleration/deceleration rate",
}

impl ModalGroup {
    /// Returns the modal group of the codes that set such a value.
    const fn for_value(value: ModalValue) -> Self {
        match value {
            ModalValue::Plane(_) => Self::Plane,
            ModalValue::Distance(_) => Self::Distance,
            ModalValue::Unit(_) => Self::Unit,
            ModalValue::Side(_) => Self::ToolRadius,
            ModalValue::Length(_) => Self::ToolLength,
            ModalValue::Cycle(_) => Self::FixedCycle,
            ModalValue::ReturnLevel(_) => Self::ReturnLevel,
            ModalValue::PathControl(_) => Self::PathControl,
            ModalValue::MultiBlock(_) => Self::MultiBlock,
            ModalValue::Spindle(_) => Self::NonModal,
            ModalValue::Shape(Shape::Scaling, _) => Self::Scaling,
            ModalValue::Shape(Shape::Mirroring, _) => Self::Mirroring,
            ModalValue::Shape(Shape::Rotation, _) => Self::Rotation,
        }
    }
}

/// Addresses of the axes.
pub const AXIS_ADDRESSES: AddressSet = AddressSet::from_addresses(&[
    Address::X,
    Address::Y,
    Address::Z,
    Address::A,
    Address::B,
    Address::C,
]);

/// Largest absolute value of a position or distance, command units (manual, table of instruction parameters).
pub(crate) const POSITION_MAX: f64 = 1_000_000.0;

pub(crate) const fn axis_word(address: Address) -> WordSpec {
    WordSpec::new(
        address,
        "target position or distance",
        "mm or deg",
        -POSITION_MAX,
        POSITION_MAX,
    )
}

/// Words of a motion: one for each axis.
pub static AXIS_WORDS: [WordSpec; 6] = [
    axis_word(Address::X),
    axis_word(Address::Y),
    axis_word(Address::Z),
    axis_word(Address::A),
    axis_word(Address::B),
    axis_word(Address::C),
];
