//! Program codes and expressions in the tree (manual, chapter 4).

use tandem_model::Span;

use crate::variable::Variable;

/// A statement of manual chapter 4, or a part of a statement. Branches and loops are flattened: each part is
/// a separate block, with the block to which it jumps as an index of [`crate::NcProgram::blocks`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProgramCode {
    /// Effect of the program code.
    pub statement: Statement,
    /// The value to assign, the value of a `switch`, or the condition.
    pub expression: Option<ExpressionId>,
    /// Index of the block to which the program code jumps.
    pub to: Option<u32>,
    /// Range of bytes of the program code.
    pub span: Span,
}

/// Effect of a program code. Variants without a description have no effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Statement {
    /// `L12 = P3 + 1`: assigns a value to the variable.
    Assignment(Variable),
    /// `if(condition)`: if the condition is false, jumps past the commands and the keyword `else` after them.
    If,
    /// `else`, reached after the commands of an `if`: jumps past the commands of the last `else`.
    Else,
    /// `while(condition)`: if the condition is false, jumps past the loop.
    While,
    /// The end of the commands of a `while`, without text of its own: jumps to the `while`.
    Repeat,
    /// `do`: begins a loop.
    Do,
    /// The `while(condition)` that ends a `do`: if the condition is true, jumps to the first command after
    /// `do`.
    DoWhile,
    /// `switch(expression)`: jumps to the case whose label is the value, truncated toward zero (D10). Without
    /// such a case, jumps to `default`, or past the `switch`.
    Switch {
        /// Index of the first case of the `switch` among the cases of the program.
        first: u32,
        /// Number of cases of the `switch`.
        count: u32,
    },
    /// `case 1:`, a target of `switch`.
    Case {
        /// Label of the case.
        label: i64,
    },
    /// `default:`, a target of `switch`.
    Default,
    /// `break`: jumps past the innermost `switch`, `while` or `do`.
    Break,
    /// `{`: begins the commands of a branch, a loop or a `switch`.
    Open,
    /// `}`: ends the commands of a branch, a loop or a `switch`.
    Close,
}

/// Label of a `case`, and the index of its block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct CaseLabel {
    pub(crate) label: i64,
    pub(crate) block: u32,
}

/// Index of an expression node in its program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExpressionId(pub(crate) u32);

/// A node of an expression (manual 4-1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expression {
    /// A constant number.
    Number(f64),
    /// The value of a variable.
    Variable(Variable),
    /// Unary minus before an operand.
    Negation(ExpressionId),
    /// `!(condition)`: a condition that is true if the other condition is false.
    Not(ExpressionId),
    /// An operation with two operands.
    Binary {
        /// Operator of the operation.
        operator: Operator,
        /// Left operand.
        left: ExpressionId,
        /// Right operand. For `&&` and `||`, it is evaluated only if the left operand does not decide the
        /// result.
        right: ExpressionId,
    },
    /// A call of a function with one or two arguments.
    Call {
        /// The function that is called.
        function: Function,
        /// First argument.
        first: ExpressionId,
        /// Second argument, for the functions that take two.
        second: Option<ExpressionId>,
    },
}

macro_rules! spelled {
    ($(#[$doc:meta])* $name:ident { $($variant:ident $text:literal,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name { $(#[doc = concat!("`", $text, "`")] $variant,)* }

        impl $name {
            /// All values of the type.
            pub const ALL: &[$name] = &[$($name::$variant),*];

            /// Returns the text of the value in a program.
            pub const fn text(self) -> &'static str {
                match self { $($name::$variant => $text,)* }
            }
        }
    };
}

spelled! {
    /// Words that begin a program code, or belong to one.
    Keyword {
        If "if", Else "else", Switch "switch", Case "case", Default "default", Break "break", While "while", Do "do",
    }
}

impl Keyword {
    /// Returns the syntax of the keyword with all parts of its program code, and its effect (manual 4-2).
    pub const fn meaning(self) -> (&'static str, &'static str) {
        match self {
            Keyword::If => (
                "if (condition) command\nelse command",
                "Executes the command if the condition is true, otherwise the command after `else`, if \
                 present. Several commands are written in braces.",
            ),
            Keyword::Else => (
                "if (condition) command\nelse command",
                "Begins the command that is executed if the condition of its `if` is false; `else if` tests \
                 a further condition.",
            ),
            Keyword::Switch => (
                "switch (value) {\n    case 1:\n        commands\n        break\n    default:\n        commands\n}",
                "Continues at the `case` with the value as its label, otherwise at `default`, otherwise \
                 after the closing brace. `break` leaves the `switch`; without `break`, the commands of the \
                 next case follow.",
            ),
            Keyword::Case => (
                "case 1:",
                "Position in a `switch` at which the program continues if the value is this whole number.",
            ),
            Keyword::Default => (
                "default:",
                "Position in a `switch` at which the program continues if no `case` has the value.",
            ),
            Keyword::Break => (
                "break",
                "Leaves the innermost `switch`, `while` or `do` around it.",
            ),
            Keyword::While => (
                "while (condition) command",
                "Repeats the command while the condition is true; the condition is read before each \
                 repetition. After `do`, it ends that loop. An endless loop that neither moves nor waits is \
                 an alarm (21).",
            ),
            Keyword::Do => (
                "do command\nwhile (condition)",
                "Executes the command, and repeats it while the condition is true; the condition is read \
                 after each repetition.",
            ),
        }
    }
}

spelled! {
    /// Operators with two operands: logical operators (manual 4-1-5), comparison operators (4-1-4) and
    /// arithmetic operators (4-1-2; for `%` D07). An operator such as `<=`, which begins with another
    /// operator, is listed before it.
    Operator {
        Or "||", And "&&",
        Equal "==", NotEqual "!=", LessOrEqual "<=", GreaterOrEqual ">=", Less "<", Greater ">",
        Add "+", Subtract "-",
        Multiply "*", Divide "/", Modulo "%",
    }
}

impl Keyword {
    /// Returns the keyword with these letters; upper and lower case are equal (D01).
    pub(crate) fn find(letters: &str) -> Option<Self> {
        if letters.len() < 2 {
            return None;
        }
        let mut keywords = Self::ALL.iter().copied();
        keywords.find(|keyword| keyword.text().eq_ignore_ascii_case(letters))
    }
}

impl Function {
    /// Returns the function with this name; upper and lower case are equal (D01).
    pub(crate) fn find(name: &str) -> Option<Self> {
        let mut functions = Self::ALL.iter().copied();
        functions.find(|function| function.text().eq_ignore_ascii_case(name))
    }
}

impl Operator {
    pub(crate) const PRIORITY_MAX: u8 = 5;

    /// Returns the priority of the operator by the manual: from 1 to [`Operator::PRIORITY_MAX`].
    pub(crate) const fn priority(self) -> u8 {
        match self {
            Operator::Or => 1,
            Operator::And => 2,
            Operator::Add | Operator::Subtract => 4,
            Operator::Multiply | Operator::Divide | Operator::Modulo => Operator::PRIORITY_MAX,
            _ => 3,
        }
    }

    /// Returns true for a comparison operator, such as `==` or `<`.
    pub const fn compares(self) -> bool {
        self.priority() == 3
    }
}

macro_rules! functions {
    ($($name:ident $text:literal $arguments:literal $meaning:literal, $domain:literal;)*) => {
        /// The functions (manual 4-1-3). A function whose name ends in `d` takes or gives degrees, any other
        /// radians.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Function { $(#[doc = concat!("`", $text, "`: ", $meaning, ".")] $name,)* }

        impl Function {
            /// All functions.
            pub const ALL: &[Function] = &[$(Function::$name),*];

            /// Returns the name of the function in a program.
            pub const fn text(self) -> &'static str {
                match self { $(Function::$name => $text,)* }
            }

            /// Returns the number of arguments: 1 or 2.
            pub const fn arguments(self) -> u8 {
                match self { $(Function::$name => $arguments,)* }
            }

            /// Returns a description of the result.
            pub const fn meaning(self) -> &'static str {
                match self { $(Function::$name => $meaning,)* }
            }

            /// Returns a description of the permitted arguments.
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
    Isnan "isnan" 1 "1 if x is not a number, otherwise 0; also a condition", "any";
    Log "log" 1 "the natural logarithm", "above 0";
    Log10 "log10" 1 "the logarithm of base 10", "above 0";
    Log2 "log2" 1 "the logarithm of base 2", "above 0";
    Pow "pow" 2 "x to the power of y", "any; if x is below 0, y must be whole";
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
