//! Parses NC text to a program tree, and reports all errors of the text.
//!
//! [`parse`] accepts any text and returns a [`NcProgram`] and all its errors. The form of a dialect's text is
//! data ([`Grammar`]); `tandem-interp` defines the meaning of its codes.
//!
//! Decisions where the manual is silent: blanks are allowed between an address and its value (`X 10`); a
//! comment `/* */` acts like a blank, so that a block continues after a comment with line feeds; a single
//! carriage return acts like a blank.

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
