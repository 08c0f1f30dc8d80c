//! Formats a program (spacing and letter case only). Lines keep their numbers. The intermediate code, whose
//! block numbers are line numbers, therefore stays the same.

mod nesting;

use tandem_model::limits::BLOCK_BYTES_MAX;
use tandem_model::{Diagnostic, Span};

use self::nesting::IndentTracker;
use crate::grammar::Grammar;
use crate::parser::parse;
use crate::tokens::{Token, TokenKind, tokens};

/// Number of blanks for each level of nested commands.
const INDENT: usize = 4;

/// Number of blanks between words and a comment from which on the comment keeps its column.
const APART: usize = 2;

/// Formats a program. One blank separates words, and is around operators; a word contains no blank. Addresses
/// and variables are in capitals, keywords and functions in small letters, as in the manual. The commands of
/// branches, loops and cases are indented. Comments keep their text; a comment at least two blanks after the
/// words keeps its column. All line ends are like that of the first line. Formatting a formatted program
/// changes nothing.
///
/// # Errors
/// Returns the errors of the program if it has errors; only a program without errors is formatted.
pub fn format(source: &str, grammar: &Grammar) -> Result<String, Vec<Diagnostic>> {
    let (_, diagnostics) = parse(source, grammar);
    if diagnostics.iter().any(Diagnostic::is_error) {
        return Err(diagnostics);
    }
    let mut writer = FormatWriter {
        source,
        text: String::with_capacity(source.len() + source.len() / 4),
        nesting: IndentTracker::default(),
    };
    if source.starts_with('\u{feff}') {
        writer.text.push('\u{feff}');
    }
    let mut line = Vec::new();
    for token in tokens(source, grammar) {
        if token.kind == TokenKind::LineEnd {
            writer.line(&line);
            line.clear();
        } else {
            line.push(token);
        }
    }
    writer.line(&line);
    let mut text = writer.text;
    text.truncate(text.trim_end_matches('\n').len());
    if !text.is_empty() {
        text.push('\n');
    }
    let first_line = source.split_inclusive('\n').next().unwrap_or_default();
    Ok(if first_line.ends_with("\r\n") {
        text.replace('\n', "\r\n")
    } else {
        text
    })
}

struct FormatWriter<'a> {
    source: &'a str,
    text: String,
    nesting: IndentTracker,
}

impl<'a> FormatWriter<'a> {
    /// Writes the tokens of a line, which may begin or end within a comment of several lines.
    fn line(&mut self, line: &[Token]) {
        let is_code = |token: &&Token| token.kind != TokenKind::Comment;
        let indent = INDENT
            * self
                .nesting
                .begin_line(line.iter().find(is_code).map(|token| token.kind));
        line.iter()
            .filter(is_code)
            .for_each(|token| self.nesting.pass(token.kind));
        self.nesting.end_line();
        let begin = self.text.len();
        let mut code_bytes = 0;
        for (at, token) in line.iter().enumerate() {
            let before = at.checked_sub(1).and_then(|at| line.get(at));
            let blanks = match before {
                _ if token.kind == TokenKind::Rest => 0,
                None => indent,
                Some(_) if at + 1 == line.len() && !is_code(&token) => self.blanks_before_comment(token),
                Some(before) => usize::from(is_apart(before.kind, token.kind)),
            };
            self.text.extend(std::iter::repeat_n(' ', blanks));
            let start = self.text.len();
            self.token(token);
            if is_code(&token) {
                code_bytes += if at == 0 { 0 } else { blanks } + self.text.len() - start;
            }
        }
        if let (Some(first), Some(last)) = (line.first(), line.last())
            && code_bytes > BLOCK_BYTES_MAX
        {
            // the formatted line would be too long for a block: the line stays as it is in the source
            self.text.truncate(begin);
            self.verbatim(Span::new(first.span.start, last.span.end));
        }
        self.text.push('\n');
    }

    /// Writes the text of a range, with line feeds as line ends.
    fn verbatim(&mut self, span: Span) {
        let text = self.span_text(span).replace("\r\n", "\n");
        self.text.push_str(text.trim_end_matches(['\r', ' ', '\t']));
    }

    /// Returns the number of blanks before the comment at the end of a line. A separate comment keeps its
    /// column.
    fn blanks_before_comment(&self, comment: &Token) -> usize {
        let before = self.source.get(..comment.span.start as usize).unwrap_or_default();
        let blanks = before.len() - before.trim_end_matches([' ', '\t']).len();
        if blanks < APART {
            return 1;
        }
        let column = |text: &str| text.rsplit('\n').next().unwrap_or_default().chars().count();
        column(before).saturating_sub(column(&self.text)).max(APART)
    }

    /// Returns the source text of a range.
    fn span_text(&self, span: Span) -> &'a str {
        let range = span.start as usize..span.end as usize;
        self.source.get(range).unwrap_or_default()
    }

    fn token(&mut self, token: &Token) {
        let text = self.span_text(token.span);
        match token.kind {
            TokenKind::Comment | TokenKind::Rest => self.verbatim(token.span),
            TokenKind::Address(address) => self.text.push_str(address.text()),
            TokenKind::Keyword(keyword) => self.text.push_str(keyword.text()),
            TokenKind::Function(function) => self.text.push_str(function.text()),
            TokenKind::Variable(kind) => {
                self.text.push_str(kind.prefix());
                self.text
                    .push_str(text.get(kind.prefix().len()..).unwrap_or_default());
            }
            TokenKind::ProgramNumber => self.text.push_str(&text.to_ascii_uppercase()),
            _ => self.text.push_str(text),
        }
    }
}

/// Returns true if a blank is needed between two tokens.
fn is_apart(before: TokenKind, token: TokenKind) -> bool {
    use TokenKind::{Address, Comment, Function, Number, Punctuation, Sign, Variable};
    if before == Comment || token == Comment {
        return true;
    }
    let belongs_to_before = matches!(
        (before, token),
        (Address(_), Number | Punctuation(b'[')) | (Function(_) | Variable(_), Punctuation(b'('))
    );
    let opens = matches!(before, Punctuation(b'(' | b'[') | Sign);
    let closes = matches!(token, Punctuation(b')' | b']' | b',' | b':'));
    !(belongs_to_before || opens || closes)
}
