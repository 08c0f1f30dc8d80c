//! Converts tokens to the tree. After a mistake, the parser continues with the next statement, so that it
//! finds all mistakes of a text.

mod declarations;
mod expressions;
mod statements;

use tandem_model::Span;

use crate::finding::{FindingEntry, Findings, NOT_IN_SUBSET, RESERVED, SYNTAX, TOO_DEEP, TOO_LARGE};
use crate::limits::{NESTING_MAX, UNITS_MAX};
use crate::tokens::{Token, TokenKind};
use crate::tree::{File, Name, UnitKind};

/// Error of parsing functions: a finding was reported.
#[derive(Debug)]
struct ParseFailure;

type ParseResult<T> = Result<T, ParseFailure>;

/// Keywords of the language, which cannot be names.
const KEYWORDS: [&str; 62] = [
    "AND",
    "ARRAY",
    "AT",
    "BY",
    "CASE",
    "CLASS",
    "CONFIGURATION",
    "CONSTANT",
    "CONTINUE",
    "DO",
    "ELSE",
    "ELSIF",
    "END_CASE",
    "END_CLASS",
    "END_CONFIGURATION",
    "END_FOR",
    "END_FUNCTION",
    "END_FUNCTION_BLOCK",
    "END_IF",
    "END_INTERFACE",
    "END_METHOD",
    "END_NAMESPACE",
    "END_PROGRAM",
    "END_REPEAT",
    "END_RESOURCE",
    "END_STRUCT",
    "END_TYPE",
    "END_VAR",
    "END_WHILE",
    "EXIT",
    "FALSE",
    "FOR",
    "FUNCTION",
    "FUNCTION_BLOCK",
    "IF",
    "INTERFACE",
    "METHOD",
    "MOD",
    "NAMESPACE",
    "NOT",
    "OF",
    "OR",
    "PROGRAM",
    "REPEAT",
    "RESOURCE",
    "RETAIN",
    "RETURN",
    "STRUCT",
    "THEN",
    "TO",
    "TRUE",
    "TYPE",
    "UNTIL",
    "USING",
    "VAR",
    "VAR_EXTERNAL",
    "VAR_GLOBAL",
    "VAR_INPUT",
    "VAR_OUTPUT",
    "VAR_IN_OUT",
    "WHILE",
    "XOR",
];

/// Symbols of the standard that are not part of this subset: symbol, meaning, and remedy.
const OUTSIDE_SYMBOLS: [(&str, &str, &str); 3] = [
    (
        "%",
        "addresses with %",
        "use the function blocks of the machine, such as MCODE and INTERLOCK",
    ),
    ("^", "references", "pass the variable by VAR_IN_OUT"),
    ("{", "pragmas", "remove the pragma"),
];

/// Words of the standard, or of other implementations, that are not part of this subset, and what to write instead.
const OUTSIDE: [(&str, &str); 34] = [
    (
        "RETAIN",
        "remove it, and keep the value in a P variable: P(100), SET_P(100, value)",
    ),
    (
        "PERSISTENT",
        "remove it, and keep the value in a P variable: P(100), SET_P(100, value)",
    ),
    ("NON_RETAIN", "remove it; no variable is retained"),
    (
        "AT",
        "remove it; function blocks such as MCODE read and write the machine",
    ),
    (
        "VAR_GLOBAL",
        "declare the variable in the PROGRAM, and pass it by VAR_INPUT or VAR_IN_OUT",
    ),
    ("VAR_EXTERNAL", "pass the variable by VAR_INPUT or VAR_IN_OUT"),
    ("VAR_ACCESS", "remove it"),
    ("VAR_CONFIG", "remove it"),
    (
        "CONFIGURATION",
        "remove it; the option --period-ms of tandem st sets the period",
    ),
    (
        "RESOURCE",
        "remove it; the option --period-ms of tandem st sets the period",
    ),
    (
        "TASK",
        "remove it; the option --period-ms of tandem st sets the period",
    ),
    ("CLASS", "write a FUNCTION_BLOCK"),
    ("INTERFACE", "write a FUNCTION_BLOCK"),
    ("METHOD", "write a FUNCTION, or a FUNCTION_BLOCK of its own"),
    ("PROPERTY", "write VAR_OUTPUT"),
    ("EXTENDS", "declare the other function block as a variable"),
    ("IMPLEMENTS", "remove it"),
    ("ABSTRACT", "remove it"),
    ("FINAL", "remove it"),
    ("NAMESPACE", "remove it"),
    ("USING", "remove it"),
    ("POINTER", "pass the variable by VAR_IN_OUT"),
    ("REFERENCE", "pass the variable by VAR_IN_OUT"),
    ("REF_TO", "pass the variable by VAR_IN_OUT"),
    ("R_EDGE", "use an R_TRIG"),
    ("F_EDGE", "use an F_TRIG"),
    ("INITIAL_STEP", "write a CASE over the steps"),
    ("STEP", "write a CASE over the steps"),
    ("TRANSITION", "write an IF"),
    ("ACTION", "write a FUNCTION_BLOCK"),
    ("UNION", "write a STRUCT"),
    ("JMP", "write an IF or a loop"),
    ("GOTO", "write an IF or a loop"),
    ("LABEL", "write an IF or a loop"),
];

/// Parses a text; mistakes become findings.
pub(crate) fn parse(tokens: &[Token], findings: &mut Findings) -> File {
    let mut parser = Parser {
        tokens,
        at: 0,
        depth: 0,
        findings,
    };
    parser.file()
}

struct Parser<'a> {
    /// The tokens; the last one is `End`.
    tokens: &'a [Token],
    at: usize,
    /// Number of statements and expressions around the parsed element.
    depth: usize,
    findings: &'a mut Findings,
}

impl Parser<'_> {
    fn file(&mut self) -> File {
        let mut file = File::default();
        while !self.is_end() {
            let before = self.at;
            if self.top_level(&mut file).is_err() {
                self.skip_to_top_level(before);
            }
            if file.types.len() + file.units.len() > UNITS_MAX {
                let what = format!("the text has more than {UNITS_MAX} types, functions and function blocks");
                self.findings
                    .push(&TOO_LARGE, self.span(), what, "write a smaller program");
                return file;
            }
        }
        file
    }

    fn top_level(&mut self, file: &mut File) -> ParseResult<()> {
        if self.accept("TYPE") {
            return self.types(&mut file.types);
        }
        let kind = if self.accept("PROGRAM") {
            UnitKind::Program
        } else if self.accept("FUNCTION_BLOCK") {
            UnitKind::FunctionBlock
        } else if self.accept("FUNCTION") {
            UnitKind::Function
        } else {
            return Err(self.expected("PROGRAM, FUNCTION_BLOCK, FUNCTION or TYPE"));
        };
        let unit = self.unit(kind)?;
        file.units.push(unit);
        Ok(())
    }

    fn skip_to_top_level(&mut self, before: usize) {
        if self.at == before {
            self.advance();
        }
        while !self.is_end()
            && !["PROGRAM", "FUNCTION_BLOCK", "FUNCTION", "TYPE"]
                .iter()
                .any(|word| self.is(word))
        {
            self.advance();
        }
    }

    // --- tokens

    fn token(&self) -> Option<&Token> {
        self.tokens.get(self.at)
    }

    fn span(&self) -> Span {
        self.token()
            .or(self.tokens.last())
            .map(|token| token.span)
            .unwrap_or_default()
    }

    /// Returns the range of the token before.
    fn last_span(&self) -> Span {
        let last = self.at.checked_sub(1).and_then(|at| self.tokens.get(at));
        last.map(|token| token.span).unwrap_or_default()
    }

    fn advance(&mut self) {
        self.at += 1;
    }

    fn is_end(&self) -> bool {
        self.token().is_none_or(|token| token.kind == TokenKind::End)
    }

    fn is_text(token: &Token, text: &str) -> bool {
        match &token.kind {
            TokenKind::Name(name) => name == text,
            TokenKind::Symbol(symbol) => *symbol == text,
            TokenKind::Literal(..) | TokenKind::Refused | TokenKind::End => false,
        }
    }

    /// Returns true if the token is this keyword or symbol.
    fn is(&self, text: &str) -> bool {
        self.token().is_some_and(|token| Self::is_text(token, text))
    }

    fn is_any(&self, texts: &[&str]) -> bool {
        texts.iter().any(|text| self.is(text))
    }

    /// Returns true if the next token is this keyword or symbol.
    fn is_next(&self, text: &str) -> bool {
        self.tokens
            .get(self.at + 1)
            .is_some_and(|token| Self::is_text(token, text))
    }

    fn accept(&mut self, text: &str) -> bool {
        let is = self.is(text);
        if is {
            self.advance();
        }
        is
    }

    fn expect(&mut self, text: &str) -> ParseResult<()> {
        if self.accept(text) {
            Ok(())
        } else {
            Err(self.expected(text))
        }
    }

    /// Reads a name that may be declared.
    fn name(&mut self) -> ParseResult<Name> {
        let span = self.span();
        let Some(TokenKind::Name(text)) = self.token().map(|token| token.kind.clone()) else {
            return Err(self.expected("a name"));
        };
        if KEYWORDS.contains(&text.as_str()) {
            let what = format!("{text} is a word of the language, not a name");
            return Err(self.found(&RESERVED, span, what, "take another name"));
        }
        self.advance();
        Ok(Name { text, span })
    }

    // --- findings

    fn found(
        &mut self,
        entry: &'static FindingEntry,
        span: Span,
        what: impl Into<String>,
        help: impl Into<String>,
    ) -> ParseFailure {
        self.findings.push(entry, span, what, help);
        ParseFailure
    }

    /// Reports that another token is expected.
    fn expected(&mut self, what: &str) -> ParseFailure {
        let span = self.span();
        let kind = self.token().map(|token| token.kind.clone());
        if let Some((what, help)) = kind.as_ref().and_then(outside) {
            return self.found(&NOT_IN_SUBSET, span, what, help);
        }
        let is = match kind {
            Some(TokenKind::Name(name)) => name,
            Some(TokenKind::Symbol(symbol)) => symbol.to_owned(),
            Some(TokenKind::Literal(..)) => "a literal".to_owned(),
            Some(TokenKind::Refused) => return ParseFailure,
            // for example a comment without an end, which contains the whole rest
            Some(TokenKind::End) | None if self.follows_refused_token() => return ParseFailure,
            Some(TokenKind::End) | None => "the end of the text".to_owned(),
        };
        self.found(
            &SYNTAX,
            span,
            format!("{what} is expected here, not {is}"),
            format!("write {what}"),
        )
    }

    fn follows_refused_token(&self) -> bool {
        let before = self.at.checked_sub(1).and_then(|at| self.tokens.get(at));
        before.is_some_and(|token| token.kind == TokenKind::Refused)
    }

    /// Parses a nested element; reports a finding if the nesting is too deep.
    fn deeper<T>(&mut self, parse: impl FnOnce(&mut Self) -> ParseResult<T>) -> ParseResult<T> {
        if self.depth >= NESTING_MAX {
            let what = format!("statements and expressions are nested more than {NESTING_MAX} deep");
            let span = self.span();
            return Err(self.found(
                &TOO_DEEP,
                span,
                what,
                "move inner statements into a FUNCTION, or assign part of the expression to a variable",
            ));
        }
        self.depth += 1;
        let parsed = parse(self);
        self.depth -= 1;
        parsed
    }
}

/// Returns the message and the help for a token of the language that this subset does not have.
fn outside(kind: &TokenKind) -> Option<(String, &'static str)> {
    match kind {
        TokenKind::Name(name) => {
            let (_, help) = OUTSIDE.iter().find(|(word, _)| word == name)?;
            Some((format!("{name} is not part of this subset"), help))
        }
        TokenKind::Symbol(symbol) => {
            let (_, what, help) = OUTSIDE_SYMBOLS.iter().find(|(outside, ..)| outside == symbol)?;
            Some((format!("{what} are not part of this subset"), help))
        }
        TokenKind::Literal(..) | TokenKind::Refused | TokenKind::End => None,
    }
}
