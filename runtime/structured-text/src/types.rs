//! Types of values.

use std::fmt;
use std::sync::Arc;

use crate::limits::STRING_DEFAULT;

macro_rules! elementary {
    ($($name:ident = $text:literal,)*) => {
        /// Elementary types.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Elementary {
            $(#[doc = concat!("`", $text, "`.")] $name,)*
        }

        impl Elementary {
            /// All of them.
            pub const ALL: &[Elementary] = &[$(Elementary::$name),*];

            /// Returns the text of the type.
            pub fn text(self) -> &'static str {
                match self {
                    $(Elementary::$name => $text,)*
                }
            }
        }
    };
}

elementary! {
    Bool = "BOOL",
    Sint = "SINT",
    Int = "INT",
    Dint = "DINT",
    Lint = "LINT",
    Usint = "USINT",
    Uint = "UINT",
    Udint = "UDINT",
    Ulint = "ULINT",
    Byte = "BYTE",
    Word = "WORD",
    Dword = "DWORD",
    Lword = "LWORD",
    Real = "REAL",
    Lreal = "LREAL",
    Time = "TIME",
    String = "STRING",
}

impl Elementary {
    /// Returns the type of a name in upper case.
    pub(crate) fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|kind| kind.text() == name)
    }

    /// Returns true for `ANY_INT`.
    pub(crate) fn is_int(self) -> bool {
        self.is_signed() || matches!(self, Self::Usint | Self::Uint | Self::Udint | Self::Ulint)
    }

    pub(crate) fn is_signed(self) -> bool {
        matches!(self, Self::Sint | Self::Int | Self::Dint | Self::Lint)
    }

    /// Returns true for `BYTE` to `LWORD`.
    pub(crate) fn is_bits(self) -> bool {
        matches!(self, Self::Byte | Self::Word | Self::Dword | Self::Lword)
    }

    /// Returns true for `ANY_REAL`.
    pub(crate) fn is_real(self) -> bool {
        matches!(self, Self::Real | Self::Lreal)
    }

    /// Returns true for `ANY_NUM`.
    pub(crate) fn is_num(self) -> bool {
        self.is_int() || self.is_real()
    }

    /// Returns the number of bits of an integer or a bit string; 1 for `BOOL`, 0 for other types.
    pub(crate) fn bits(self) -> u32 {
        match self {
            Self::Bool => 1,
            Self::Sint | Self::Usint | Self::Byte => 8,
            Self::Int | Self::Uint | Self::Word => 16,
            Self::Dint | Self::Udint | Self::Dword => 32,
            Self::Lint | Self::Ulint | Self::Lword => 64,
            Self::Real | Self::Lreal | Self::Time | Self::String => 0,
        }
    }

    /// Returns the smallest and the largest value of an integer, a bit string or a time.
    pub(crate) fn range(self) -> Option<(i128, i128)> {
        if self == Self::Time {
            return Some((i64::MIN.into(), i64::MAX.into()));
        }
        if self.is_signed() {
            let half = 1_i128 << (self.bits() - 1);
            return Some((-half, half - 1));
        }
        (self.is_int() || self.is_bits()).then(|| (0, (1_i128 << self.bits()) - 1))
    }

    /// Returns true if every value of this type is a value of `other`, so that the conversion is implicit
    /// (IEC 61131-3).
    pub(crate) fn widens_to(self, other: Self) -> bool {
        if self == other {
            return true;
        }
        match (self, other) {
            (from, to) if from.is_bits() && to.is_bits() => from.bits() < to.bits(),
            (from, to) if from.is_int() && to.is_int() => {
                from.bits() < to.bits() && (from.is_signed() == to.is_signed() || to.is_signed())
            }
            (from, Self::Real) if from.is_int() => from.bits() <= 16,
            (from, Self::Lreal) if from.is_int() => from.bits() <= 32,
            (Self::Real, Self::Lreal) => true,
            _ => false,
        }
    }

    /// Returns the narrowest type to which both are converted implicitly.
    pub(crate) fn common(self, other: Self) -> Option<Self> {
        if self.widens_to(other) {
            return Some(other);
        }
        if other.widens_to(self) {
            return Some(self);
        }
        let mut both = Self::ALL.iter().copied();
        both.find(|kind| self.widens_to(*kind) && other.widens_to(*kind))
    }
}

/// The type of a variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Type {
    Elementary(Elementary),
    /// A `STRING` of this length.
    Text(usize),
    Array(Arc<ArrayType>),
    /// A structure, by its number in the program.
    Struct(usize, Arc<str>),
    /// An enumeration, by its number.
    Enumeration(usize, Arc<str>),
    /// A function block of the program, by the number of its unit.
    Block(usize, Arc<str>),
    /// A function block that is built in, by its name.
    BuiltIn(&'static str),
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) struct ArrayType {
    /// The lowest and the highest index of each dimension.
    pub bounds: Vec<(i64, i64)>,
    pub element: Type,
}

impl Type {
    pub const BOOL: Type = Type::Elementary(Elementary::Bool);
    pub const STRING: Type = Type::Text(STRING_DEFAULT);

    /// Returns the elementary type of a single value.
    pub fn elementary(&self) -> Option<Elementary> {
        match self {
            Type::Elementary(kind) => Some(*kind),
            Type::Text(_) => Some(Elementary::String),
            _ => None,
        }
    }

    /// Returns true if its value is one slot of the memory.
    pub fn is_single(&self) -> bool {
        matches!(self, Type::Elementary(_) | Type::Text(_) | Type::Enumeration(..))
    }

    pub fn is_block(&self) -> bool {
        matches!(self, Type::Block(..) | Type::BuiltIn(_))
    }
}

impl From<Elementary> for Type {
    fn from(kind: Elementary) -> Self {
        match kind {
            Elementary::String => Type::STRING,
            kind => Type::Elementary(kind),
        }
    }
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Type::Elementary(kind) => f.write_str(kind.text()),
            Type::Text(length) if *length == STRING_DEFAULT => f.write_str("STRING"),
            Type::Text(length) => write!(f, "STRING[{length}]"),
            Type::Array(array) => {
                f.write_str("ARRAY[")?;
                for (number, (low, high)) in array.bounds.iter().enumerate() {
                    let comma = if number == 0 { "" } else { ", " };
                    write!(f, "{comma}{low}..{high}")?;
                }
                write!(f, "] OF {}", array.element)
            }
            Type::Struct(_, name) | Type::Enumeration(_, name) | Type::Block(_, name) => f.write_str(name),
            Type::BuiltIn(name) => f.write_str(name),
        }
    }
}
