//! NC text to a program tree, with diagnostics that never stop at the first error.
//!
//! [`parse`] accepts any text and returns a [`NcProgram`] and all its errors. The form of a dialect's text is data
//! ([`Grammar`]); the meaning of its codes is defined in `tandem-interp`.
//!
//! Decisions where the manual is silent: blanks are allowed between an address and its value (`X 10`); a
//! comment `/* */` is a blank, so that a block continues after a comment with line feeds; a single carriage
//! return is a blank.

mod address;
mod cursor;
pub mod diagnostics;
mod dialects;
mod encoding;
mod format;
mod grammar;
mod intermediate;
mod line_index;
mod parser;
mod program_code;
mod tokens;
mod tree;
mod variable;

pub use address::{Address, AddressSet};
pub use diagnostics::{DIAGNOSTICS, DiagnosticEntry};
pub use encoding::is_wide;
pub use format::format;
pub use grammar::{Grammar, ProgramForm};
pub use intermediate::{CodeRole, Codes, Header, block_bytes, compile};
pub use line_index::LineIndex;
pub use parser::{DIAGNOSTICS_MAX, NESTING_MAX, parse};
pub use program_code::{Expression, ExpressionId, Function, Keyword, Operator, ProgramCode, Statement};
pub use tokens::{Token, TokenKind, tokens};
pub use tree::{Block, Content, NcProgram, Value, Word};
pub use variable::{Variable, VariableKind};
