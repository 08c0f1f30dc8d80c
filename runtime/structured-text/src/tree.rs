//! The tree of a source text. Names are not yet looked up, and types not yet compared.

use tandem_model::Span;

use crate::tokens::Literal;
use crate::types::Elementary;

/// A name in upper case.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Name {
    pub text: String,
    pub span: Span,
}

/// A source text.
#[derive(Debug, Default)]
pub(crate) struct File {
    pub types: Vec<TypeDeclaration>,
    pub units: Vec<Unit>,
}

#[derive(Debug)]
pub(crate) struct TypeDeclaration {
    pub name: Name,
    pub definition: Definition,
}

#[derive(Debug)]
pub(crate) enum Definition {
    /// Another name for a type.
    Alias(TypeName),
    Struct(Vec<Variable>),
    Enumeration(Vec<Name>),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum UnitKind {
    Program,
    FunctionBlock,
    Function,
}

/// A program organization unit.
#[derive(Debug)]
pub(crate) struct Unit {
    pub kind: UnitKind,
    pub name: Name,
    /// Type of the result of a function.
    pub result: Option<TypeName>,
    pub variables: Vec<Variable>,
    pub body: Vec<Statement>,
}

/// The section of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Section {
    Local,
    Temporary,
    Input,
    Output,
    InOut,
}

#[derive(Debug)]
pub(crate) struct Variable {
    pub name: Name,
    pub section: Section,
    pub is_constant: bool,
    pub of: TypeName,
    pub initial: Option<Initial>,
}

#[derive(Debug, Clone)]
pub(crate) enum TypeName {
    Named(Name),
    /// `STRING`, with its length.
    Text(Option<Box<Expression>>, Span),
    Array {
        bounds: Vec<(Expression, Expression)>,
        element: Box<TypeName>,
        span: Span,
    },
}

#[derive(Debug, Clone)]
pub(crate) enum Initial {
    Value(Expression),
    /// `[1, 2, 3(0)]`.
    List(Vec<Initial>, Span),
    /// `(A := 1, B := 2)`.
    Fields(Vec<(Name, Initial)>, Span),
    /// `3(0)` in a list.
    Repeated(Expression, Box<Initial>),
}

#[derive(Debug)]
pub(crate) enum Statement {
    Assign {
        to: Expression,
        value: Expression,
    },
    Call(Expression),
    /// Conditions with their statements, and the statements of ELSE.
    If(Vec<(Expression, Vec<Statement>)>, Vec<Statement>),
    Case {
        selector: Expression,
        branches: Vec<(Vec<Label>, Vec<Statement>)>,
        otherwise: Vec<Statement>,
    },
    For {
        variable: Name,
        from: Expression,
        to: Expression,
        by: Option<Expression>,
        body: Vec<Statement>,
    },
    While(Expression, Vec<Statement>),
    Repeat(Vec<Statement>, Expression),
    Exit(Span),
    Continue(Span),
    Return,
}

/// A label of CASE: a value, or a range of values.
#[derive(Debug)]
pub(crate) struct Label {
    pub from: Expression,
    pub to: Option<Expression>,
}

#[derive(Debug, Clone)]
pub(crate) struct Expression {
    pub kind: ExpressionKind,
    pub span: Span,
    /// Nesting depth of the expression, including itself.
    pub height: usize,
}

impl Expression {
    pub fn new(kind: ExpressionKind, span: Span) -> Self {
        let height = match &kind {
            ExpressionKind::Literal(..) | ExpressionKind::Name(_) | ExpressionKind::OfEnumeration(..) => 0,
            ExpressionKind::Field(of, _)
            | ExpressionKind::Unary(_, of)
            | ExpressionKind::Parenthesized(of) => of.height,
            ExpressionKind::Index(of, indices) => indices
                .iter()
                .map(|index| index.height)
                .fold(of.height, usize::max),
            ExpressionKind::Call(of, arguments) => {
                let heights = arguments.iter().map(|argument| argument.value.height);
                heights.fold(of.height, usize::max)
            }
            ExpressionKind::Binary(_, left, right) => left.height.max(right.height),
        };
        Self {
            kind,
            span,
            height: height + 1,
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) enum ExpressionKind {
    Literal(Literal, Option<Elementary>),
    Name(String),
    /// `Colour#Red`.
    OfEnumeration(Name, Name),
    Field(Box<Expression>, Name),
    Index(Box<Expression>, Vec<Expression>),
    Call(Box<Expression>, Vec<Argument>),
    Unary(Unary, Box<Expression>),
    Binary(Binary, Box<Expression>, Box<Expression>),
    Parenthesized(Box<Expression>),
}

#[derive(Debug, Clone)]
pub(crate) struct Argument {
    pub name: Option<Name>,
    /// True for `=>`: `value` is the variable that receives the output.
    pub is_output: bool,
    pub value: Expression,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unary {
    Plus,
    Minus,
    Not,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Binary {
    Power,
    Multiply,
    Divide,
    Modulo,
    Add,
    Subtract,
    Less,
    Greater,
    LessOrEqual,
    GreaterOrEqual,
    Equal,
    NotEqual,
    And,
    Xor,
    Or,
}

impl Binary {
    /// Returns the text of the operator.
    pub fn text(self) -> &'static str {
        match self {
            Self::Power => "**",
            Self::Multiply => "*",
            Self::Divide => "/",
            Self::Modulo => "MOD",
            Self::Add => "+",
            Self::Subtract => "-",
            Self::Less => "<",
            Self::Greater => ">",
            Self::LessOrEqual => "<=",
            Self::GreaterOrEqual => ">=",
            Self::Equal => "=",
            Self::NotEqual => "<>",
            Self::And => "AND",
            Self::Xor => "XOR",
            Self::Or => "OR",
        }
    }

    pub fn is_comparison(self) -> bool {
        matches!(
            self,
            Self::Less
                | Self::Greater
                | Self::LessOrEqual
                | Self::GreaterOrEqual
                | Self::Equal
                | Self::NotEqual
        )
    }
}
