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
    ($($name:ident $text:literal $arguments:literal $meaning:literal, $domain:literal;)*) => {
        /// The functions (manual 4-1-3); a name that ends in `d` takes or gives degrees, the others radians.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Function { $(#[doc = concat!("`", $text, "`: ", $meaning, ".")] $name,)* }

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

            /// What it gives.
            pub const fn meaning(self) -> &'static str {
                match self { $(Function::$name => $meaning,)* }
            }

            /// For which arguments.
            pub const fn domain(self) -> &'static str {
                match self { $(Function::$name => $domain,)* }
            }
        }
    };
}

functions! {
    Abs "abs" 1 "the absolute value", "any";
    Acos "acos" 1 "the arc cosine, radians", "-1 to 1";
    Acosd "acosd" 1 "the arc cosine, degrees", "-1 to 1";
    Acosh "acosh" 1 "the inverse hyperbolic cosine", "1 or more";
    Asin "asin" 1 "the arc sine, radians", "-1 to 1";
    Asind "asind" 1 "the arc sine, degrees", "-1 to 1";
    Asinh "asinh" 1 "the inverse hyperbolic sine", "any";
    Atan "atan" 1 "the arc tangent, radians", "any";
    Atan2 "atan2" 2 "the angle of the point (y, x), radians", "any, but not both 0";
    Atan2d "atan2d" 2 "the angle of the point (y, x), degrees", "any, but not both 0";
    Atand "atand" 1 "the arc tangent, degrees", "any";
    Atanh "atanh" 1 "the inverse hyperbolic tangent", "-1 to 1";
    Cbrt "cbrt" 1 "the cube root", "any";
    Ceil "ceil" 1 "the next whole number upward", "any";
    Cos "cos" 1 "the cosine of radians", "any";
    Cosd "cosd" 1 "the cosine of degrees", "any";
    Cosh "cosh" 1 "the hyperbolic cosine", "any";
    Exp "exp" 1 "e to the power of x", "any";
    Exp2 "exp2" 1 "2 to the power of x", "any";
    Floor "floor" 1 "the next whole number downward", "any";
    Int "int" 1 "the next whole number downward", "any";
    Isnan "isnan" 1 "1 for what is not a number, 0 for a number; a condition too", "any";
    Log "log" 1 "the natural logarithm", "above 0";
    Log10 "log10" 1 "the logarithm of base 10", "above 0";
    Log2 "log2" 1 "the logarithm of base 2", "above 0";
    Pow "pow" 2 "x to the power of y", "any; a whole y where x is below 0";
    Qnrt "qnrt" 1 "the fifth root", "any";
    Qrrt "qrrt" 1 "the fourth root", "0 or more";
    Rint "rint" 1 "the nearest whole number, half to even", "any";
    Sin "sin" 1 "the sine of radians", "any";
    Sind "sind" 1 "the sine of degrees", "any";
    Sinh "sinh" 1 "the hyperbolic sine", "any";
    Sgn "sgn" 1 "-1, 0 or 1", "any";
    Sqrt "sqrt" 1 "the square root", "0 or more";
    Tan "tan" 1 "the tangent of radians", "any but odd quarter turns";
    Tand "tand" 1 "the tangent of degrees", "any but odd quarter turns";
    Tanh "tanh" 1 "the hyperbolic tangent", "any";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_37_functions() {
        assert_eq!(Function::ALL.len(), 37);
    }
}
