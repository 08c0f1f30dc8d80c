//! An open text and its diagnostics. Positions are a line and a UTF-16 column, as editors count.

use std::path::{Path, PathBuf};

use lsp_types::{Position, Range, TextDocumentContentChangeEvent, Uri};
use percent_encoding::percent_decode_str;
use tandem_model::{Diagnostic, Span};
use tandem_syntax::{Token, TokenKind, tokens};

use super::setup::Target;

/// A text that is open in the editor.
pub(super) struct Document {
    pub uri: Uri,
    /// Path of the text's file, or a substitute name for a text without a file.
    pub path: PathBuf,
    pub version: i32,
    pub target: Target,
    /// Findings of the last check; their positions refer to the text at that time.
    pub found: Vec<Diagnostic>,
    text: String,
    /// Byte offset of the beginning of each line.
    starts: Vec<u32>,
}

impl Document {
    pub fn new(uri: Uri, version: i32, text: String, target: Target) -> Self {
        Self {
            path: path_of(&uri),
            uri,
            version,
            target,
            found: Vec::new(),
            starts: starts(&text),
            text,
        }
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    /// Applies a change that the editor reports.
    pub fn change(&mut self, change: TextDocumentContentChangeEvent) {
        match change.range {
            Some(range) => {
                let (start, end) = (self.offset(range.start), self.offset(range.end));
                self.text.replace_range(start..end.max(start), &change.text);
            }
            None => self.text = change.text,
        }
        self.starts = starts(&self.text);
    }

    /// Returns the byte offset of a position. Positions after the end of a line or of the text become that
    /// end.
    pub fn offset(&self, at: Position) -> usize {
        let line = at.line as usize;
        let Some(start) = self.starts.get(line) else {
            return self.text.len();
        };
        let text = self.line_text(line);
        let mut left = at.character as usize;
        let mut bytes = 0;
        for character in text.chars() {
            let width = character.len_utf16();
            if left < width {
                break;
            }
            left -= width;
            bytes += character.len_utf8();
        }
        *start as usize + bytes
    }

    /// Returns the position of a byte offset.
    pub fn position(&self, byte: u32) -> Position {
        let line = self
            .starts
            .partition_point(|start| *start <= byte)
            .saturating_sub(1);
        let start = self.starts.get(line).copied().unwrap_or_default();
        let mut end = (byte as usize).min(self.text.len());
        while !self.text.is_char_boundary(end) {
            end -= 1;
        }
        let before = self.text.get(start as usize..end).unwrap_or_default();
        let columns: usize = before.chars().map(char::len_utf16).sum();
        Position::new(small(line), small(columns))
    }

    pub fn range(&self, span: Span) -> Range {
        Range::new(self.position(span.start), self.position(span.end))
    }

    /// Returns the text of a line without its line end; the first line is line 0.
    pub fn line_text(&self, line: usize) -> &str {
        let start = self
            .starts
            .get(line)
            .map_or(self.text.len(), |start| *start as usize);
        let end = self
            .starts
            .get(line + 1)
            .map_or(self.text.len(), |next| *next as usize);
        let text = self.text.get(start..end).unwrap_or_default();
        text.trim_end_matches(['\n', '\r'])
    }

    pub fn text_at(&self, span: Span) -> &str {
        let range = span.start as usize..span.end as usize;
        self.text.get(range).unwrap_or_default()
    }

    pub fn tokens(&self) -> impl Iterator<Item = Token> {
        tokens(&self.text, (self.target.dialect.grammar)())
    }

    /// Returns the tokens of the line that contains a byte offset, without comments and line ends.
    pub fn line_at(&self, byte: usize) -> Vec<Token> {
        let mut line = Vec::new();
        for token in self.tokens() {
            match token.kind {
                TokenKind::LineEnd if token.span.start as usize >= byte => break,
                TokenKind::LineEnd => line.clear(),
                TokenKind::Comment
                    if (token.span.start as usize) < byte && byte < token.span.end as usize =>
                {
                    return Vec::new();
                }
                TokenKind::Comment => {}
                _ => line.push(token),
            }
        }
        line
    }
}

fn starts(text: &str) -> Vec<u32> {
    let ends = text.bytes().zip(1_u32..).filter(|(byte, _)| *byte == b'\n');
    std::iter::once(0).chain(ends.map(|(_, next)| next)).collect()
}

/// Returns the path of a file URI; for any other URI, returns the URI as a path.
pub(super) fn path_of(uri: &Uri) -> PathBuf {
    let text = uri.as_str();
    let path = text
        .strip_prefix("file://")
        .map(|path| percent_decode_str(path).decode_utf8_lossy());
    path.map_or_else(|| Path::new(text).to_owned(), |path| PathBuf::from(path.as_ref()))
}

/// Converts a line or column number to 32 bits; it fits, because texts have at most 64 MiB.
pub(super) fn small(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
