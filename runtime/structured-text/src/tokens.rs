//! Converts source text to tokens.

mod literal;

use tandem_model::Span;

use crate::finding::{CHARACTER, Findings, LITERAL, NOT_CLOSED, NOT_IN_SUBSET};
use crate::types::Elementary;
use literal::LiteralFault;

/// A literal's value.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Literal {
    Bool(bool),
    Integer(i128),
    Real(f64),
    Text(String),
    /// A time in nanoseconds.
    Time(i128),
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum TokenKind {
    /// A name or a keyword, in upper case.
    Name(String),
    /// A literal, with the type before it.
    Literal(Literal, Option<Elementary>),
    Symbol(&'static str),
    /// A text that was rejected with a finding.
    Refused,
    End,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Token {
    pub kind: TokenKind,
    pub span: Span,
}

/// Symbols, the longest first.
const SYMBOLS: [&str; 29] = [
    ":=", "=>", "<=", ">=", "<>", "**", "..", "(", ")", "[", "]", ",", ";", ":", ".", "+", "-", "*", "/",
    "=", "<", ">", "&", "#", "^", "%", "@", "{", "}",
];

/// Reads tokens; text that is not a token is a finding, and is omitted. The last token is `End`.
pub(crate) fn tokens(source: &str, findings: &mut Findings) -> Vec<Token> {
    let mut lexer = Lexer {
        source,
        at: 0,
        findings,
    };
    let mut tokens = Vec::new();
    loop {
        let start = lexer.at;
        if !lexer.skip_blanks() {
            let span = lexer.span_from(start);
            tokens.push(Token {
                kind: TokenKind::Refused,
                span,
            });
        }
        let start = lexer.at;
        if lexer.rest().is_empty() {
            tokens.push(Token {
                kind: TokenKind::End,
                span: lexer.span_from(start),
            });
            return tokens;
        }
        if let Some(kind) = lexer.token() {
            let span = lexer.span_from(start);
            tokens.push(Token { kind, span });
        }
    }
}

struct Lexer<'a> {
    source: &'a str,
    /// Position of the next byte.
    at: usize,
    findings: &'a mut Findings,
}

impl<'a> Lexer<'a> {
    fn rest(&self) -> &'a str {
        self.source.get(self.at..).unwrap_or_default()
    }

    fn span_from(&self, start: usize) -> Span {
        // the size of a source is limited
        let byte = |at: usize| u32::try_from(at).unwrap_or(u32::MAX);
        Span::new(byte(start), byte(self.at))
    }

    /// Takes the leading characters for which `fits` returns true.
    fn take_while(&mut self, fits: impl Fn(char) -> bool) -> &'a str {
        let rest = self.rest();
        let end = rest.find(|letter| !fits(letter)).unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }

    /// Skips blanks and comments; returns false if a comment has no end.
    fn skip_blanks(&mut self) -> bool {
        loop {
            self.take_while(|letter| letter.is_whitespace() || letter == '\u{feff}');
            let rest = self.rest();
            if rest.starts_with("//") {
                self.take_while(|letter| letter != '\n');
            } else if rest.starts_with("(*") {
                if !self.skip_comment("(*", "*)") {
                    return false;
                }
            } else if rest.starts_with("/*") {
                if !self.skip_comment("/*", "*/") {
                    return false;
                }
            } else {
                return true;
            }
        }
    }

    /// Skips a comment; comments may be nested.
    fn skip_comment(&mut self, open: &str, close: &str) -> bool {
        let start = self.at;
        let mut depth = 0_usize;
        loop {
            let rest = self.rest();
            if rest.starts_with(open) {
                depth += 1;
                self.at += open.len();
            } else if rest.starts_with(close) {
                depth -= 1;
                self.at += close.len();
                if depth == 0 {
                    return true;
                }
            } else if let Some(letter) = rest.chars().next() {
                self.at += letter.len_utf8();
            } else {
                let span = Span::new(self.span_from(start).start, self.span_from(start).start + 2);
                let help = format!("end it with {close}");
                self.findings
                    .push(&NOT_CLOSED, span, "the comment has no end", help);
                return false;
            }
        }
    }

    fn token(&mut self) -> Option<TokenKind> {
        let start = self.at;
        let first = self.rest().chars().next()?;
        if first.is_ascii_alphabetic() || first == '_' {
            return Some(self.word(start));
        }
        if first.is_ascii_digit() {
            let text = self.take_number();
            return Some(self.number(start, text, None));
        }
        if first == '\'' {
            return Some(self.text(start));
        }
        if let Some(symbol) = SYMBOLS.iter().find(|symbol| self.rest().starts_with(**symbol)) {
            self.at += symbol.len();
            return Some(TokenKind::Symbol(symbol));
        }
        self.at += first.len_utf8();
        if first == '"' {
            self.take_while(|letter| letter != '"' && letter != '\n');
            self.at += usize::from(self.rest().starts_with('"'));
            let (what, help) = ("a string in \" is a WSTRING", "write a STRING: '...'");
            self.findings
                .push(&NOT_IN_SUBSET, self.span_from(start), what, help);
            return Some(TokenKind::Refused);
        }
        self.take_while(|letter| !letter.is_ascii() && !letter.is_whitespace());
        let what = format!("{:?} is not part of the language", &self.source[start..self.at]);
        let help = "names have the letters a to z, digits and _";
        self.findings.push(&CHARACTER, self.span_from(start), what, help);
        Some(TokenKind::Refused)
    }

    /// Reads a name, or a literal with a type before it.
    fn word(&mut self, start: usize) -> TokenKind {
        let word = self.take_while(|letter| letter.is_ascii_alphanumeric() || letter == '_');
        let word = word.to_ascii_uppercase();
        if !self.rest().starts_with('#') {
            return match word.as_str() {
                "TRUE" => TokenKind::Literal(Literal::Bool(true), None),
                "FALSE" => TokenKind::Literal(Literal::Bool(false), None),
                _ => TokenKind::Name(word),
            };
        }
        let is_time = ["T", "TIME"].contains(&word.as_str());
        let is_other_time = [
            "D",
            "DATE",
            "TOD",
            "TIME_OF_DAY",
            "DT",
            "DATE_AND_TIME",
            "LT",
            "LTIME",
            "LD",
            "LDATE",
            "LTOD",
            "LDT",
        ]
        .contains(&word.as_str());
        let of = Elementary::named(&word);
        if !is_time && !is_other_time && of.is_none() {
            return TokenKind::Name(word);
        }
        self.at += 1;
        if is_other_time {
            self.take_while(|letter| letter.is_ascii_alphanumeric() || "_.:-".contains(letter));
            let what = format!("{word}# is not part of this subset");
            let help = "write a TIME: T#1h30m";
            self.findings
                .push(&NOT_IN_SUBSET, self.span_from(start), what, help);
            return TokenKind::Refused;
        }
        if self.rest().starts_with('\'') {
            return match (of, self.text(start)) {
                (Some(Elementary::String), TokenKind::Literal(text, _)) => {
                    TokenKind::Literal(text, Some(Elementary::String))
                }
                (_, TokenKind::Refused) => TokenKind::Refused,
                _ => self.malformed(
                    start,
                    &LiteralFault::new("a string is not a value of this type", "write STRING#'...'"),
                ),
            };
        }
        let sign_end = self.at + usize::from(self.rest().starts_with(['+', '-']));
        self.at = sign_end;
        if is_time {
            self.take_while(|letter| letter.is_ascii_alphanumeric() || letter == '_' || letter == '.');
            return match literal::time(&self.source[sign_end..self.at]) {
                Ok(ns) if self.source[..sign_end].ends_with('-') => {
                    TokenKind::Literal(Literal::Time(-ns), None)
                }
                Ok(ns) => TokenKind::Literal(Literal::Time(ns), None),
                Err(malformed) => self.malformed(start, &malformed),
            };
        }
        let text = self.take_number();
        self.number(start, text, of)
    }

    /// Takes the text of a number: `1_000`, `1.5e-3`, `16#FF`; also a word such as TRUE.
    fn take_number(&mut self) -> &'a str {
        let start = self.at;
        let is_part = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        self.take_while(is_part);
        let has_fraction = self
            .rest()
            .strip_prefix('.')
            .is_some_and(|rest| rest.starts_with(|letter: char| letter.is_ascii_digit()));
        if self.rest().starts_with('#') || has_fraction {
            self.at += 1;
            self.take_while(is_part);
        }
        let so_far = &self.source[start..self.at];
        if !so_far.contains('#') && so_far.ends_with(['e', 'E']) && self.rest().starts_with(['+', '-']) {
            self.at += 1;
            self.take_while(is_part);
        }
        &self.source[start..self.at]
    }

    /// Reads a number; `start` is the position of its type, and a sign is before `text`.
    fn number(&mut self, start: usize, text: &str, of: Option<Elementary>) -> TokenKind {
        let before = &self.source[start..self.at - text.len()];
        match literal::number(text, before.ends_with('-'), of) {
            Ok(literal) => TokenKind::Literal(literal, of),
            Err(malformed) => self.malformed(start, &malformed),
        }
    }

    fn text(&mut self, start: usize) -> TokenKind {
        self.at += 1;
        let from = self.at;
        let mut letters = self.rest().char_indices();
        let end = loop {
            match letters.next() {
                Some((end, '\'')) => break end,
                Some((_, '$')) => {
                    letters.next();
                }
                Some((_, letter)) if letter != '\n' => {}
                _ => {
                    self.take_while(|letter| letter != '\n');
                    let help = "end it with '; a ' within it is written $'";
                    self.findings.push(
                        &NOT_CLOSED,
                        self.span_from(start),
                        "the string has no end in its line",
                        help,
                    );
                    return TokenKind::Refused;
                }
            }
        };
        self.at = from + end + 1;
        match literal::text(&self.source[from..from + end]) {
            Ok(text) => TokenKind::Literal(Literal::Text(text), None),
            Err(malformed) => self.malformed(start, &malformed),
        }
    }

    fn malformed(&mut self, start: usize, malformed: &LiteralFault) -> TokenKind {
        let what = format!("{} {}", &self.source[start..self.at], malformed.what);
        self.findings
            .push(&LITERAL, self.span_from(start), what, malformed.help);
        TokenKind::Refused
    }
}
