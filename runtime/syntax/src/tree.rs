//! The program tree: flat arrays that refer to each other by index, so that a program of a million blocks stays
//! within a few times the size of its text.

use std::sync::Arc;

use tandem_model::{Origin, Span};

/// A parsed NC program. It exists for every text; whether it may run is for the diagnostics to say.
#[derive(Debug, Clone)]
pub struct NcProgram {
    pub(crate) source: Arc<str>,
    pub(crate) number: Option<u16>,
    pub(crate) complete: bool,
    pub(crate) blocks: Vec<Block>,
    pub(crate) words: Vec<Word>,
    pub(crate) program_codes: Vec<ProgramCode>,
    pub(crate) expressions: Vec<Expression>,
}

impl NcProgram {
    /// The text that it was parsed from.
    pub fn source(&self) -> &Arc<str> {
        &self.source
    }

    /// The program number that stands in the text, in dialects that have one there; `None` in dialect nj.
    pub fn number(&self) -> Option<u16> {
        self.number
    }

    /// False when the end of the text has not been read as blocks: it was too large, had too many errors, or an open
    /// comment or bracket reaches to its end.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// All blocks in the order of the text. Empty and comment lines have none.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// The words of a block of this program; none for a program code.
    pub fn words(&self, block: &Block) -> &[Word] {
        match block.content {
            Content::Words { first, count } => {
                let first = first as usize;
                self.words
                    .get(first..first + usize::from(count))
                    .unwrap_or_default()
            }
            Content::ProgramCode(_) => &[],
        }
    }

    /// The program code of a block of this program.
    pub fn program_code(&self, block: &Block) -> Option<&ProgramCode> {
        match block.content {
            Content::Words { .. } => None,
            Content::ProgramCode(index) => self.program_codes.get(index as usize),
        }
    }

    /// A node of an expression of this program.
    pub fn expression(&self, id: ExpressionId) -> Option<&Expression> {
        self.expressions.get(id.0 as usize)
    }

    /// The block's range of bytes: from its first word (or block skip) to the end of its last one.
    pub fn span(&self, block: &Block) -> Span {
        let end = match self.program_code(block) {
            Some(code) => code.span().end,
            None => self
                .words(block)
                .last()
                .map_or(block.start + 1, |word| word.span().end),
        };
        Span::new(block.start, end.max(block.start))
    }

    /// Where a block stands, for a program of the given number (0: none).
    pub fn origin(&self, block: &Block, program: u16) -> Origin {
        let before = self.source.get(..block.start as usize).unwrap_or_default();
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        let mut prefix = &before[line_start..];
        if line_start == 0 {
            prefix = prefix.strip_prefix('\u{feff}').unwrap_or(prefix);
        }
        Origin {
            program,
            line: block.line,
            column: u32::try_from(prefix.chars().count()).map_or(u32::MAX, |count| count.saturating_add(1)),
        }
    }
}

/// A block: the words of one line, or one program code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// First byte in the source: the block skip if there is one, else the first word.
    pub start: u32,
    /// Line of the first byte, from 1.
    pub line: u32,
    pub(crate) flags: u32,
    /// What it holds.
    pub content: Content,
}

impl Block {
    /// Bit of [`Block::flags`] that tells of errors; skip numbers end at 31 and use the bits below.
    pub(crate) const HAS_ERRORS: u32 = 1 << 31;

    /// The block skip numbers written before the block: bit `n - 1` for number `n` of 1 to 31 (D13).
    pub fn skip_numbers(&self) -> u32 {
        self.flags & !Self::HAS_ERRORS
    }

    /// True when the parser found an error in the block, so that words may be missing.
    pub fn has_errors(&self) -> bool {
        self.flags & Self::HAS_ERRORS != 0
    }
}

/// What a block holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// A range of words.
    Words {
        /// Index of the first one.
        first: u32,
        /// How many.
        count: u16,
    },
    /// Index of a program code (manual, chapter 4).
    ProgramCode(u32),
}

/// A word: an address and its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Word {
    pub(crate) value: f64,
    pub(crate) start: u32,
    pub(crate) length: u16,
    /// The address.
    pub address: Address,
    pub(crate) indirection: Option<VariableKind>,
}

impl Word {
    /// The value: a number, or the variable that holds it.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an indirection holds its index, which the parser bounds to 0..=32767"
    )]
    pub fn value(&self) -> Value {
        match self.indirection {
            None => Value::Number(self.value),
            Some(kind) => Value::Indirection(Variable {
                kind,
                index: self.value as u16,
            }),
        }
    }

    /// The value when it is a number.
    pub fn number(&self) -> Option<f64> {
        self.indirection.is_none().then_some(self.value)
    }

    /// Its range of bytes, address and value.
    pub fn span(&self) -> Span {
        Span::new(self.start, self.start + u32::from(self.length))
    }
}

/// The value of a word (D04).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A number as written.
    Number(f64),
    /// `X[L12]`: the variable that holds the value.
    Indirection(Variable),
}

/// A variable by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variable {
    /// Which array.
    pub kind: VariableKind,
    /// Index in it.
    pub index: u16,
}

/// The arrays of variables (manual 4-3), and the captured positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum VariableKind {
    /// L0 to L255: of one call.
    Local,
    /// Q0 to Q4095: of the coordinate system.
    CoordinateSystem,
    /// P0 to P32767: of the controller.
    Global,
    /// `_CNC_CapturedPosition<n>`, read only; n counts the motors of the coordinate system from 0 (D16).
    CapturedPosition,
}

/// Highest index of a captured position: one for each axis that a coordinate system can have.
const CAPTURED_POSITION_MAX: u16 = 7;
const _: () = assert!(CAPTURED_POSITION_MAX as usize + 1 == tandem_model::AXES_MAX);

impl VariableKind {
    /// Highest index (manual, table of parameters; captured positions: one for each axis that is possible).
    pub const fn index_max(self) -> u16 {
        match self {
            VariableKind::Local => 255,
            VariableKind::CoordinateSystem => 4095,
            VariableKind::Global => 32767,
            VariableKind::CapturedPosition => CAPTURED_POSITION_MAX,
        }
    }

    /// The name before the index.
    pub const fn prefix(self) -> &'static str {
        match self {
            VariableKind::Local => "L",
            VariableKind::CoordinateSystem => "Q",
            VariableKind::Global => "P",
            VariableKind::CapturedPosition => "_CNC_CapturedPosition",
        }
    }
}

/// A statement of manual chapter 4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProgramCode {
    /// `L12 = P3 + 1`.
    Assignment {
        /// What is assigned to.
        target: Variable,
        /// The value.
        value: ExpressionId,
        /// Its range of bytes.
        span: Span,
    },
    /// A branch or a repetition with all that belongs to it. It is recognised and not taken apart.
    Control {
        /// The word that it begins with.
        keyword: Keyword,
        /// Its range of bytes.
        span: Span,
    },
}

impl ProgramCode {
    /// Its range of bytes.
    pub fn span(&self) -> Span {
        match self {
            ProgramCode::Assignment { span, .. } | ProgramCode::Control { span, .. } => *span,
        }
    }
}

/// Words that begin or belong to a program code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keyword {
    /// `if`
    If,
    /// `else`
    Else,
    /// `switch`
    Switch,
    /// `case`
    Case,
    /// `default`
    Default,
    /// `break`
    Break,
    /// `while`
    While,
    /// `do`
    Do,
}

impl Keyword {
    pub(crate) const ALL: [Keyword; 8] = [
        Keyword::If,
        Keyword::Else,
        Keyword::Switch,
        Keyword::Case,
        Keyword::Default,
        Keyword::Break,
        Keyword::While,
        Keyword::Do,
    ];

    /// As it is written.
    pub const fn text(self) -> &'static str {
        match self {
            Keyword::If => "if",
            Keyword::Else => "else",
            Keyword::Switch => "switch",
            Keyword::Case => "case",
            Keyword::Default => "default",
            Keyword::Break => "break",
            Keyword::While => "while",
            Keyword::Do => "do",
        }
    }
}

/// Index of a node of an expression.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExpressionId(pub(crate) u32);

/// A node of an expression (manual 4-1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expression {
    /// A number.
    Number(f64),
    /// A variable.
    Variable(Variable),
    /// Unary minus.
    Negation(ExpressionId),
    /// Two operands.
    Binary {
        /// What is done.
        operator: BinaryOperator,
        /// Left operand.
        left: ExpressionId,
        /// Right operand.
        right: ExpressionId,
    },
    /// A function of one or two arguments.
    Call {
        /// Which.
        function: Function,
        /// First argument.
        first: ExpressionId,
        /// Second argument, for the functions that take two.
        second: Option<ExpressionId>,
    },
}

/// Arithmetic operators (manual 4-1-2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BinaryOperator {
    /// `+`
    Add,
    /// `-`
    Subtract,
    /// `*`
    Multiply,
    /// `/`
    Divide,
    /// `%` (D07)
    Modulo,
}

macro_rules! functions {
    ($($name:ident $text:literal $arguments:literal,)*) => {
        /// The functions (manual 4-1-3); a name that ends in `d` takes or gives degrees, the others radians.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Function { $(#[doc = concat!("`", $text, "`")] $name,)* }

        impl Function {
            /// All functions.
            pub const ALL: &[Function] = &[$(Function::$name),*];

            /// As it is written.
            pub const fn text(self) -> &'static str {
                match self { $(Function::$name => $text,)* }
            }

            /// How many arguments it takes: 1 or 2.
            pub const fn arguments(self) -> u8 {
                match self { $(Function::$name => $arguments,)* }
            }
        }
    };
}

functions! {
    Abs "abs" 1, Acos "acos" 1, Acosd "acosd" 1, Acosh "acosh" 1, Asin "asin" 1, Asind "asind" 1, Asinh "asinh" 1,
    Atan "atan" 1, Atan2 "atan2" 2, Atan2d "atan2d" 2, Atand "atand" 1, Atanh "atanh" 1, Cbrt "cbrt" 1,
    Ceil "ceil" 1, Cos "cos" 1, Cosd "cosd" 1, Cosh "cosh" 1, Exp "exp" 1, Exp2 "exp2" 1, Floor "floor" 1,
    Int "int" 1, Isnan "isnan" 1, Log "log" 1, Log10 "log10" 1, Log2 "log2" 1, Pow "pow" 2, Qnrt "qnrt" 1,
    Qrrt "qrrt" 1, Rint "rint" 1, Sin "sin" 1, Sind "sind" 1, Sinh "sinh" 1, Sgn "sgn" 1, Sqrt "sqrt" 1,
    Tan "tan" 1, Tand "tand" 1, Tanh "tanh" 1,
}

macro_rules! addresses {
    ($($name:ident $text:literal,)*) => {
        /// The address of a word: one letter, or one of the pairs of dialect nj.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        #[expect(missing_docs, reason = "a letter is its own name")]
        pub enum Address { $($name,)* }

        impl Address {
            /// How many addresses there are.
            pub const COUNT: usize = Address::ALL.len();

            /// All addresses; the 26 letters first, in order.
            pub const ALL: &[Address] = &[$(Address::$name),*];

            /// As the manual writes it: `X`, `ta`, `VA`.
            pub const fn text(self) -> &'static str {
                match self { $(Address::$name => $text,)* }
            }
        }
    };
}

addresses! {
    A "A", B "B", C "C", D "D", E "E", F "F", G "G", H "H", I "I", J "J", K "K", L "L", M "M", N "N", O "O", P "P",
    Q "Q", R "R", S "S", T "T", U "U", V "V", W "W", X "X", Y "Y", Z "Z",
    Ta "ta", Td "td", Ts "ts",
    Va "VA", Vb "VB", Vc "VC", Vd "VD", Ve "VE", Vf "VF", Vg "VG", Vh "VH",
}

impl Address {
    /// Place of VA to VH among the parameters of an M code, 0 to 7.
    pub const fn parameter_index(self) -> Option<usize> {
        let index = self as u8;
        if index >= Address::Va as u8 && index <= Address::Vh as u8 {
            Some((index - Address::Va as u8) as usize)
        } else {
            None
        }
    }
}

/// A set of addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct AddressSet(u64);

impl AddressSet {
    /// The empty set.
    pub const EMPTY: AddressSet = AddressSet(0);

    /// The set of these addresses.
    pub const fn of(addresses: &[Address]) -> AddressSet {
        let mut bits = 0;
        let mut i = 0;
        while i < addresses.len() {
            bits |= 1 << addresses[i] as u8;
            i += 1;
        }
        AddressSet(bits)
    }

    /// Adds an address.
    pub const fn insert(&mut self, address: Address) {
        self.0 |= 1 << address as u8;
    }

    /// True when the address is in the set.
    pub const fn contains(self, address: Address) -> bool {
        self.0 & (1 << address as u8) != 0
    }

    /// True when nothing is in the set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// What is in either set.
    #[must_use]
    pub const fn union(self, other: AddressSet) -> AddressSet {
        AddressSet(self.0 | other.0)
    }

    /// What is in both sets.
    #[must_use]
    pub const fn intersection(self, other: AddressSet) -> AddressSet {
        AddressSet(self.0 & other.0)
    }

    /// What is in this set and not in the other.
    #[must_use]
    pub const fn without(self, other: AddressSet) -> AddressSet {
        AddressSet(self.0 & !other.0)
    }

    /// The addresses of the set, ascending.
    pub fn iter(self) -> impl Iterator<Item = Address> {
        let mut bits = self.0;
        std::iter::from_fn(move || {
            let lowest = bits.trailing_zeros() as usize;
            bits &= bits.wrapping_sub(1);
            Address::ALL.get(lowest).copied()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_stays_small() {
        assert_eq!(size_of::<Word>(), 16);
        assert_eq!(size_of::<Block>(), 20);
    }

    #[test]
    fn there_are_37_functions() {
        assert_eq!(Function::ALL.len(), 37);
    }
}
