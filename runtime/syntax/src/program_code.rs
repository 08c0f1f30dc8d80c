//! Program codes and expressions in the tree (manual, chapter 4).

use tandem_model::Span;

use crate::tree::Variable;

/// A statement of manual chapter 4, or a part of one. Branches and repetitions stand flat among the blocks: each part
/// is a block of its own that tells where the program goes on, as an index of [`crate::NcProgram::blocks`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProgramCode {
    /// What it does.
    pub statement: Statement,
    /// Its range of bytes.
    pub span: Span,
}

/// What a program code does. Parts that no variant says more about do nothing by themselves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Statement {
    /// `L12 = P3 + 1`.
    Assignment {
        /// What is assigned to.
        target: Variable,
        /// The value.
        value: ExpressionId,
    },
    /// `if(condition)`: goes to `otherwise` when it is false.
    If {
        /// A condition.
        condition: ExpressionId,
        /// The block after the commands, past an `else`.
        otherwise: u32,
    },
    /// `else`, reached from the commands before it: goes to `end`.
    Else {
        /// The block after the commands of the last `else`.
        end: u32,
    },
    /// `while(condition)`: goes to `end` when it is false.
    While {
        /// A condition.
        condition: ExpressionId,
        /// The block after the repetition.
        end: u32,
    },
    /// The end of the commands of a `while`; no text of its own. Goes to `start`.
    Repeat {
        /// The `while`.
        start: u32,
    },
    /// `do`.
    Do,
    /// The `while(condition)` that ends a `do`: goes to `start` when it is true.
    DoWhile {
        /// A condition.
        condition: ExpressionId,
        /// The first command after `do`.
        start: u32,
    },
    /// `switch(expression)`: goes to the case of the value, truncated toward zero (D10).
    Switch {
        /// The value.
        value: ExpressionId,
        /// Index of its first case among those of the program.
        first: u32,
        /// How many cases it has.
        count: u32,
        /// `default`, or the block after the `switch`.
        otherwise: u32,
    },
    /// `case 1:`.
    Case {
        /// The label.
        label: i64,
    },
    /// `default:`.
    Default,
    /// `break`: goes to `end`.
    Break {
        /// The block after the `switch`, `while` or `do`.
        end: u32,
    },
    /// `{`.
    Open,
    /// `}`.
    Close,
}

/// A label of a `switch` and where it stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct CaseLabel {
    pub(crate) label: i64,
    pub(crate) block: u32,
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
    /// Comparison of two numbers; a condition (manual 4-1-4).
    Comparison {
        /// How they are compared.
        comparator: Comparator,
        /// Left operand.
        left: ExpressionId,
        /// Right operand.
        right: ExpressionId,
    },
    /// Two conditions; a condition (manual 4-1-5).
    Join {
        /// True for `&&`, false for `||`.
        both: bool,
        /// Left condition.
        left: ExpressionId,
        /// Right condition, read only when the left one does not decide.
        right: ExpressionId,
    },
    /// `!(condition)`; a condition.
    Not(ExpressionId),
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

/// Comparators (manual 4-1-4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Comparator {
    /// `==`
    Equal,
    /// `!=`
    NotEqual,
    /// `<`
    Less,
    /// `>`
    Greater,
    /// `<=`
    LessOrEqual,
    /// `>=`
    GreaterOrEqual,
}

impl BinaryOperator {
    /// As it is written.
    pub const fn text(self) -> &'static str {
        match self {
            BinaryOperator::Add => "+",
            BinaryOperator::Subtract => "-",
            BinaryOperator::Multiply => "*",
            BinaryOperator::Divide => "/",
            BinaryOperator::Modulo => "%",
        }
    }
}

impl Comparator {
    /// As it is written.
    pub const fn text(self) -> &'static str {
        match self {
            Comparator::Equal => "==",
            Comparator::NotEqual => "!=",
            Comparator::Less => "<",
            Comparator::Greater => ">",
            Comparator::LessOrEqual => "<=",
            Comparator::GreaterOrEqual => ">=",
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_37_functions() {
        assert_eq!(Function::ALL.len(), 37);
    }
}
