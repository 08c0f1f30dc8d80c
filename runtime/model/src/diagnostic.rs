//! Findings of the checker, before anything moves. All findings of a file are reported together.

use crate::span::Span;

/// How much a diagnostic weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The program can run; the text deserves a look.
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
    /// Where in the source.
    pub span: Span,
    /// Description of the error, with the words and values of the source.
    pub message: String,
    /// How to correct it.
    pub help: String,
}

impl Diagnostic {
    /// Returns true for errors.
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }
}
