//! Splits a text into tokens, for display or rewriting. Every text has tokens, and unreadable parts are
//! [`TokenKind::Unknown`]; only the parser checks whether the text is valid.

use tandem_model::Span;

use crate::address::Address;
use crate::cursor::Cursor;
use crate::grammar::Grammar;
use crate::program_code::{Function, Keyword, Operator};
use crate::variable::VariableKind;

/// Kind of a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TokenKind {
    /// A comment with its delimiters.
    Comment,
    /// A line feed outside of comments.
    LineEnd,
    /// A mark before or after the blocks of the program.
    Mark,
    /// The text after the mark that follows the blocks.
    Rest,
    /// The program number with its letter.
    ProgramNumber,
    /// A block skip with its number.
    Skip,
    /// The address of a word.
    Address(Address),
    /// A number; a number in a word includes its sign.
    Number,
    /// A variable, or the name of an array of variables.
    Variable(VariableKind),
    /// A keyword such as `if` or `else`.
    Keyword(Keyword),
    /// The name of a function.
    Function(Function),
    /// `=`, or an operator with two operands.
    Operator,
    /// A sign `-` or `+` before an operand of an expression, or `!`.
    Sign,
    /// A parenthesis, bracket, brace, comma or colon.
    Punctuation(u8),
    /// Any other text.
    Unknown,
}

/// A token and its range of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Token {
    /// Kind of the token.
    pub kind: TokenKind,
    /// Range of bytes of the token.
    pub span: Span,
}

/// Returns all tokens of a text in their order. Blanks between tokens belong to no token.
pub fn tokens<'a>(source: &'a str, grammar: &'a Grammar) -> impl Iterator<Item = Token> + use<'a> {
    Lexer {
        cursor: Cursor::new(source),
        grammar,
        begun: false,
        rest: false,
        line: Line::default(),
    }
}

struct Lexer<'a> {
    cursor: Cursor<'a>,
    grammar: &'a Grammar,
    /// True if the text has an element other than a comment before the cursor.
    begun: bool,
    /// True if the mark after the blocks is before the cursor.
    rest: bool,
    line: Line,
}

/// State of the line that is being read.
#[derive(Default)]
struct Line {
    /// True if the line has an element other than a comment or a block skip before the cursor.
    begun: bool,
    /// Number of parentheses that are open at the cursor.
    parentheses: usize,
    /// True if the cursor is in the right side of an assignment.
    assigns: bool,
    /// True if the token before the cursor ends an operand.
    operand: bool,
}

impl Iterator for Lexer<'_> {
    type Item = Token;

    fn next(&mut self) -> Option<Token> {
        while let Some(b' ' | b'\t' | b'\r') = self.cursor.peek() {
            if self.rest {
                break;
            }
            self.cursor.advance(1);
        }
        let start = self.cursor.at();
        let byte = self.cursor.peek()?;
        let kind = if self.rest {
            self.cursor.finish();
            TokenKind::Rest
        } else if self.cursor.is_comment(self.grammar) {
            // a comment that is not closed ends with its line or with the text
            let _ = self.cursor.comment(self.grammar);
            TokenKind::Comment
        } else {
            self.read(byte)
        };
        Some(Token {
            kind,
            span: self.cursor.span_from(start),
        })
    }
}

impl Lexer<'_> {
    fn read(&mut self, byte: u8) -> TokenKind {
        if byte == b'\n' {
            self.cursor.pass_character();
            self.line = Line::default();
            return TokenKind::LineEnd;
        }
        let first_of_line = !std::mem::replace(&mut self.line.begun, true);
        let first = !std::mem::replace(&mut self.begun, true);
        let form = self.grammar.program_form;
        if form.mark == Some(byte) && first_of_line {
            self.cursor.advance(1);
            self.rest = !first;
            return TokenKind::Mark;
        }
        if form.number_letter == Some(byte.to_ascii_uppercase()) && first_of_line {
            self.cursor.advance(1);
            self.cursor.advance(self.cursor.digits().len());
            return TokenKind::ProgramNumber;
        }
        if byte == b'/' && !self.in_expression() && self.grammar.block_skip_max > 0 {
            self.cursor.advance(1);
            self.cursor.advance(self.cursor.digits().len());
            // a line may have several block skips
            self.line.begun = !first_of_line;
            return TokenKind::Skip;
        }
        let was_operand = self.line.operand;
        let kind = match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'_' => self.name(),
            b'0'..=b'9' | b'.' => self.number(false),
            b'-' | b'+' if !self.in_expression() => self.number(true),
            _ => self.operator_or_other(byte),
        };
        self.line.operand = matches!(
            kind,
            TokenKind::Number | TokenKind::Variable(_) | TokenKind::Punctuation(b')')
        );
        if was_operand && matches!(kind, TokenKind::Keyword(_) | TokenKind::Punctuation(b'{' | b'}')) {
            self.line.assigns = false;
        }
        kind
    }

    fn in_expression(&self) -> bool {
        self.line.parentheses > 0 || self.line.assigns
    }

    fn number(&mut self, signed: bool) -> TokenKind {
        if self.cursor.number(signed).is_err() && !matches!(self.cursor.peek(), None | Some(b'\n')) {
            return TokenKind::Unknown;
        }
        TokenKind::Number
    }

    /// Reads a token that begins with a letter: a word, a variable, a keyword or a function.
    fn name(&mut self) -> TokenKind {
        if self.line.operand && self.line.assigns && self.line.parentheses == 0 {
            // an operand after an operand begins the next assignment
            self.line.assigns = false;
        }
        let programmed = self.grammar.program_codes;
        let value_follows = matches!(self.cursor.peek_second(), Some(b'0'..=b'9' | b'-' | b'.' | b'+'));
        let letters = self.cursor.letters();
        if programmed && !value_follows {
            if let Some(keyword) = Keyword::find(letters) {
                self.cursor.advance(letters.len());
                self.line.assigns = false;
                return TokenKind::Keyword(keyword);
            }
            let name = self.cursor.name();
            if self.in_expression()
                && let Some(function) = Function::find(name)
            {
                self.cursor.advance(name.len());
                return TokenKind::Function(function);
            }
        }
        if programmed && let Some(kind) = self.variable(letters) {
            return kind;
        }
        let spelled = if value_follows { &letters[..1] } else { letters };
        self.cursor.advance(spelled.len());
        match Address::find(spelled) {
            Some(address) if self.grammar.addresses.contains(address) => TokenKind::Address(address),
            _ => TokenKind::Unknown,
        }
    }

    /// Reads a variable at a position where it is allowed: in an expression, in brackets, or before `=`.
    fn variable(&mut self, letters: &str) -> Option<TokenKind> {
        let kind = VariableKind::find(letters)?;
        let mut ahead = self.cursor;
        ahead.advance(letters.len());
        ahead.advance(ahead.digits().len());
        let mut behind = ahead;
        let is_target = behind.blanks(self.grammar).is_ok() && behind.peek() == Some(b'=');
        let is_one = self.in_expression() || is_target || kind == VariableKind::CapturedPosition || {
            // the variable is in the brackets of an indirection
            behind.peek() == Some(b']')
        };
        is_one.then(|| {
            self.cursor = ahead;
            TokenKind::Variable(kind)
        })
    }

    fn operator_or_other(&mut self, byte: u8) -> TokenKind {
        let programmed = self.grammar.program_codes;
        let mut operators = Operator::ALL.iter().copied();
        let found = operators.find(|operator| self.cursor.begins_with(operator.text()));
        if let Some(operator) = found.filter(|_| programmed && self.in_expression()) {
            self.cursor.advance(operator.text().len());
            return match operator {
                Operator::Add | Operator::Subtract if !self.line.operand => TokenKind::Sign,
                _ => TokenKind::Operator,
            };
        }
        self.cursor.pass_character();
        match byte {
            b'=' if programmed && self.line.operand => {
                self.line.assigns = true;
                TokenKind::Operator
            }
            b'!' if programmed => TokenKind::Sign,
            b'(' => {
                self.line.parentheses += 1;
                TokenKind::Punctuation(byte)
            }
            b')' => {
                self.line.parentheses = self.line.parentheses.saturating_sub(1);
                TokenKind::Punctuation(byte)
            }
            b'[' | b']' | b'{' | b'}' | b',' | b':' => TokenKind::Punctuation(byte),
            _ => TokenKind::Unknown,
        }
    }
}
