//! Findings of the checker, before any motion. All findings of a file are reported together.

use crate::span::Span;

/// Severity of a diagnostic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The program can run, but the text should be examined.
    Warning,
    /// The program cannot run.
    Error,
}

/// A finding of the lexer, the parser or the checker.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostic {
    /// Code from the diagnostic table: `E0123` or `W0123`.
    pub code: &'static str,
    /// Error or warning.
    pub severity: Severity,
    /// Bytes of the source text to which the finding refers.
    pub span: Span,
    /// Description of the finding, with the words and values of the source.
    pub message: String,
    /// Instruction for correcting the program.
    pub help: String,
}

impl Diagnostic {
    /// Returns true for errors.
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }
}
