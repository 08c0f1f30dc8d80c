//! A checked program: variables are places in the memory, types fit.

use std::sync::Arc;

use tandem_model::Span;

use crate::blocks::BuiltIn;
use crate::functions::FunctionBody;
use crate::machine::MachineFunction;
use crate::tree::Binary;
use crate::types::Elementary;
use crate::value::Value;

/// An expression with its position in the source.
#[derive(Debug, Clone)]
pub(crate) struct Expr {
    pub kind: ExprKind,
    pub span: Span,
}

#[derive(Debug, Clone)]
pub(crate) enum ExprKind {
    Constant(Value),
    Load(Box<VariableLocation>),
    /// NOT of a `BOOL` or a bit string.
    Not(Box<Expr>, Elementary),
    Minus(Box<Expr>, Elementary),
    /// An operator; both sides have this type.
    Calculate(Binary, Elementary, Box<(Expr, Expr)>),
    /// A `TIME` multiplied or divided by a number.
    ScaleTime(Binary, Box<(Expr, Expr)>),
    Compare(Binary, Box<(Expr, Expr)>),
    /// A value converted to another type.
    Convert(Box<Expr>, Elementary, Elementary),
    Truncate(Box<Expr>, Elementary),
    Standard(FunctionBody, Elementary, Vec<Expr>),
    Machine(&'static MachineFunction, Vec<Expr>),
    Call(Box<FunctionCall>),
}

/// Address of a variable.
#[derive(Debug, Clone)]
pub(crate) struct VariableLocation {
    pub root: Root,
    /// Number of slots after the root.
    pub offset: usize,
    pub indices: Vec<IndexOf>,
    pub span: Span,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Root {
    /// The variables of the unit that runs.
    Frame,
    /// The variables of a function, by the number of its unit.
    Function(usize),
    /// The variable passed as a `VAR_IN_OUT`; its address is in this slot of the frame.
    Reference(usize),
}

/// One index of an array.
#[derive(Debug, Clone)]
pub(crate) struct IndexOf {
    pub value: Expr,
    pub low: i64,
    pub high: i64,
    /// Slots from one element to the next.
    pub stride: usize,
}

#[derive(Debug, Clone)]
pub(crate) enum Stmt {
    Assign {
        to: VariableLocation,
        value: Expr,
        /// Characters of a `STRING` variable.
        text_max: Option<usize>,
    },
    /// Copies an array or a structure.
    Copy {
        to: VariableLocation,
        from: VariableLocation,
        size: usize,
    },
    Block(Box<BlockCall>),
    /// A function call for its effect.
    Evaluate(Expr),
    If(Vec<(Expr, Vec<Stmt>)>, Vec<Stmt>),
    Case {
        selector: Expr,
        branches: Vec<Branch>,
        otherwise: Vec<Stmt>,
    },
    For(Box<ForLoop>),
    While(Expr, Vec<Stmt>),
    Repeat(Vec<Stmt>, Expr),
    Exit,
    Continue,
    Return,
}

/// A branch of CASE: its ranges of values, and its statements.
pub(crate) type Branch = (Vec<(i128, i128)>, Vec<Stmt>);

#[derive(Debug, Clone)]
pub(crate) struct ForLoop {
    pub variable: VariableLocation,
    pub of: Elementary,
    pub from: Expr,
    pub to: Expr,
    pub by: Option<Expr>,
    pub body: Vec<Stmt>,
}

/// A call of an instance of a function block.
#[derive(Debug, Clone)]
pub(crate) struct BlockCall {
    pub instance: VariableLocation,
    pub inputs: Vec<Stmt>,
    pub block: BlockOf,
    /// Slots of `VAR_IN_OUT` in the instance, with the passed variables.
    pub references: Vec<(usize, VariableLocation)>,
    pub outputs: Vec<Stmt>,
    pub span: Span,
}

#[derive(Debug, Clone)]
pub(crate) enum BlockOf {
    Unit(usize),
    BuiltIn(&'static BuiltIn),
}

#[derive(Debug, Clone)]
pub(crate) struct FunctionCall {
    pub unit: usize,
    /// Slots of inputs, with their operands.
    pub inputs: Vec<(usize, Operand)>,
    pub references: Vec<(usize, VariableLocation)>,
    pub outputs: Vec<Stmt>,
    /// Slot of the result.
    pub result: Option<usize>,
}

#[derive(Debug, Clone)]
pub(crate) enum Operand {
    Value(Expr, Option<usize>),
    Copy(VariableLocation, usize),
}

/// A program organization unit.
#[derive(Debug, Clone, Default)]
pub(crate) struct CodeUnit {
    pub body: Vec<Stmt>,
    /// Values at the start; for a function, at the start of each call.
    pub initial: Arc<[Value]>,
    /// Temporary variables of a function block: slots with their values at each call.
    pub temporary: Vec<(usize, Value)>,
    /// Address of the variables of a function in the memory.
    pub base: usize,
}

/// All units, and which of them is the program.
#[derive(Debug, Default)]
pub(crate) struct Code {
    pub units: Vec<CodeUnit>,
    pub program: usize,
    /// Number of slots of the memory.
    pub memory: usize,
    /// Variables of the program with one value: their slots and types.
    #[cfg(test)]
    pub names: std::collections::HashMap<String, (usize, Elementary)>,
}
