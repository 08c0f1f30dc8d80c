//! Structure of a program text: sections, foldable ranges, and the type of each token.

use lsp_types::{
    DocumentSymbol, FoldingRange, FoldingRangeKind, Position, Range, SemanticToken, SemanticTokenType,
    SymbolKind,
};
use tandem_syntax::{Address, Token, TokenKind};

use super::document::{Document, small};

/// Maximum number of numbered blocks that are listed. For a text with more numbered blocks, only the sections
/// are listed.
const NUMBERED_MAX: usize = 2000;

/// Types of tokens; a token refers to its type by the index in this list.
pub(super) const TOKEN_TYPES: [SemanticTokenType; 9] = [
    SemanticTokenType::COMMENT,
    SemanticTokenType::KEYWORD,
    SemanticTokenType::MACRO,
    SemanticTokenType::PROPERTY,
    SemanticTokenType::PARAMETER,
    SemanticTokenType::NUMBER,
    SemanticTokenType::VARIABLE,
    SemanticTokenType::FUNCTION,
    SemanticTokenType::OPERATOR,
];

/// Returns the index of a token's type in [`TOKEN_TYPES`]. A number has the type of the G or M that precedes
/// it.
fn type_of(kind: TokenKind, before: Option<TokenKind>) -> Option<u32> {
    Some(match kind {
        TokenKind::Comment | TokenKind::Rest => 0,
        TokenKind::Address(Address::G) | TokenKind::Keyword(_) => 1,
        TokenKind::Number if before == Some(TokenKind::Address(Address::G)) => 1,
        TokenKind::Address(Address::M | Address::T) => 2,
        TokenKind::Number if before == Some(TokenKind::Address(Address::M)) => 2,
        TokenKind::Mark | TokenKind::ProgramNumber | TokenKind::Skip | TokenKind::Address(Address::N) => 4,
        TokenKind::Number if before == Some(TokenKind::Address(Address::N)) => 4,
        TokenKind::Address(address) if address.parameter_index().is_some() => 2,
        TokenKind::Address(_) => 3,
        TokenKind::Number => 5,
        TokenKind::Variable(_) => 6,
        TokenKind::Function(_) => 7,
        TokenKind::Operator | TokenKind::Sign => 8,
        TokenKind::LineEnd | TokenKind::Punctuation(_) | TokenKind::Unknown => return None,
    })
}

/// Returns the tokens of the lines from `first` to `last`. The position of each token is its distance from
/// the previous token. A token that spans several lines is split into one token for each line.
pub(super) fn semantic_tokens(document: &Document, first: u32, last: u32) -> Vec<SemanticToken> {
    let mut tokens = Vec::new();
    let (mut before, mut at) = (None, Position::default());
    for token in document.tokens() {
        let kind = type_of(token.kind, before);
        before = Some(token.kind);
        let Some(kind) = kind else {
            continue;
        };
        let start = document.position(token.span.start);
        if start.line > last {
            break;
        }
        for (line, text) in document.text_at(token.span).split('\n').enumerate() {
            let line = start.line + small(line);
            let start = if line == start.line { start.character } else { 0 };
            let length = small(text.trim_end_matches('\r').chars().map(char::len_utf16).sum());
            if !(first..=last).contains(&line) || length == 0 {
                continue;
            }
            let same_line = line == at.line;
            tokens.push(SemanticToken {
                delta_line: line - at.line,
                delta_start: if same_line { start - at.character } else { start },
                length,
                token_type: kind,
                token_modifiers_bitset: 0,
            });
            at = Position::new(line, start);
        }
    }
    tokens
}

/// Returns the section titles: comment lines after an empty line or at the beginning of the text.
fn sections(document: &Document) -> Vec<(u32, String)> {
    let mut titles = Vec::new();
    let (mut line_begins, mut before_is_empty) = (true, true);
    let mut open: Option<Token> = None;
    for token in document.tokens() {
        match token.kind {
            TokenKind::LineEnd => {
                if let Some(comment) = open.take() {
                    titles.push((comment.span.start, title(document.text_at(comment.span))));
                }
                before_is_empty = line_begins;
                line_begins = true;
            }
            TokenKind::Comment if line_begins && before_is_empty => {
                open = Some(token);
                line_begins = false;
            }
            // A line that contains only the start mark or the program number is not a block.
            TokenKind::Mark | TokenKind::ProgramNumber => line_begins = false,
            _ => {
                open = None;
                line_begins = false;
            }
        }
    }
    titles.retain(|(_, title)| !title.is_empty());
    titles
}

/// Returns the first line of a comment without the comment's delimiters.
fn title(comment: &str) -> String {
    let inside = |c: char| !"/*()-=#".contains(c) && !c.is_whitespace();
    let line = comment
        .lines()
        .find(|line| line.contains(inside))
        .unwrap_or_default();
    line.trim_matches(|c| !inside(c)).to_owned()
}

/// Returns the symbols of a text: the program number, the sections, and the numbered blocks of each section.
pub(super) fn symbols(document: &Document) -> Vec<DocumentSymbol> {
    let end = document.position(u32::MAX);
    let mut symbols: Vec<DocumentSymbol> = document
        .tokens()
        .filter(|token| token.kind == TokenKind::ProgramNumber)
        .map(|token| {
            symbol(
                document.text_at(token.span).to_owned(),
                SymbolKind::MODULE,
                document.range(token.span),
            )
        })
        .collect();
    let sections = sections(document);
    let ends = sections
        .iter()
        .skip(1)
        .map(|(start, _)| document.position(*start));
    let ends: Vec<Position> = ends.chain([end]).collect();
    for ((start, title), end) in sections.into_iter().zip(ends) {
        let range = Range::new(document.position(start), end);
        symbols.push(symbol(title, SymbolKind::STRING, range));
    }
    let mut numbered = Vec::new();
    let mut before: Option<Token> = None;
    for token in document.tokens() {
        if let Some(letter) = before.filter(|before| before.kind == TokenKind::Address(Address::N))
            && token.kind == TokenKind::Number
        {
            let at = document.position(letter.span.start);
            let line = document.line_text(at.line as usize);
            let range = Range::new(
                at,
                Position::new(at.line, small(line.chars().map(char::len_utf16).sum())),
            );
            let name = format!("N{}", document.text_at(token.span));
            numbered.push(symbol(name, SymbolKind::KEY, range));
            if numbered.len() > NUMBERED_MAX {
                return symbols;
            }
        }
        before = Some(token);
    }
    for block in numbered {
        let mut parents = symbols.iter_mut().rev();
        let within = parents.find(|of| of.kind == SymbolKind::STRING && of.range.start <= block.range.start);
        match within {
            Some(section) => section.children.get_or_insert_default().push(block),
            None => symbols.push(block),
        }
    }
    symbols
}

#[expect(deprecated, reason = "the type has a field that is replaced by another one")]
fn symbol(name: String, kind: SymbolKind, range: Range) -> DocumentSymbol {
    DocumentSymbol {
        name,
        detail: None,
        kind,
        tags: None,
        deprecated: None,
        range,
        selection_range: Range::new(range.start, range.start),
        children: None,
    }
}

/// Returns the foldable ranges: commands in braces, comments of several lines, and sections.
pub(super) fn folding(document: &Document) -> Vec<FoldingRange> {
    let mut folds = Vec::new();
    let mut open = Vec::new();
    for token in document.tokens() {
        let line = document.position(token.span.start).line;
        match token.kind {
            TokenKind::Punctuation(b'{') => open.push(line),
            // The folded range ends before the line of the closing brace, so that line stays visible.
            TokenKind::Punctuation(b'}') => {
                let begin = open.pop();
                folds.extend(
                    begin.and_then(|begin| fold(begin, line.checked_sub(1)?, FoldingRangeKind::Region)),
                );
            }
            TokenKind::Comment => {
                let end = document.position(token.span.end).line;
                folds.extend(fold(line, end, FoldingRangeKind::Comment));
            }
            _ => {}
        }
    }
    let starts: Vec<u32> = (sections(document).iter())
        .map(|(start, _)| document.position(*start).line)
        .collect();
    let last = document.position(u32::MAX).line + 1;
    let ends = starts.iter().skip(1).copied().chain([last]);
    for (start, next) in starts.iter().zip(ends) {
        let empty = |line: &u32| document.line_text(*line as usize).trim().is_empty();
        let end = (*start..next).rev().find(|line| !empty(line));
        folds.extend(end.and_then(|end| fold(*start, end, FoldingRangeKind::Region)));
    }
    folds
}

fn fold(start_line: u32, end_line: u32, kind: FoldingRangeKind) -> Option<FoldingRange> {
    (start_line < end_line).then(|| FoldingRange {
        start_line,
        end_line,
        kind: Some(kind),
        ..FoldingRange::default()
    })
}
