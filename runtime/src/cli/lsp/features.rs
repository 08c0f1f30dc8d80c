//! Answers requests of the editor about a position: hover text, definition, diagnostics and formatting.

use std::str::FromStr as _;

use lsp_types::{
    DiagnosticSeverity, Hover, HoverContents, Location, MarkupContent, MarkupKind, NumberOrString, Position,
    Range, TextEdit, Uri,
};
use tandem_interp::codes::Code;
use tandem_interp::meaning::Role;
use tandem_model::{Diagnostic, Severity};
use tandem_runtime::Machine;
use tandem_runtime::explain::explain_here;
use tandem_syntax::{Address, Token, TokenKind};

use super::super::find_subprogram;
use super::super::findings::uri;
use super::document::{Document, small};

/// Returns the diagnostics of a document in the form that the editor shows.
pub(super) fn diagnostics(document: &Document) -> Vec<lsp_types::Diagnostic> {
    let shown = |found: &Diagnostic| lsp_types::Diagnostic {
        range: document.range(found.span),
        severity: Some(match found.severity {
            Severity::Error => DiagnosticSeverity::ERROR,
            Severity::Warning => DiagnosticSeverity::WARNING,
        }),
        code: Some(NumberOrString::String(found.code.to_owned())),
        source: Some("tandem".to_owned()),
        message: format!("{}\nhelp: {}", found.message, found.help),
        ..lsp_types::Diagnostic::default()
    };
    document.found.iter().map(shown).collect()
}

/// Returns the explanations of the token and of the diagnostics at a position.
pub(super) fn hover(document: &Document, at: Position) -> Option<Hover> {
    let byte = document.offset(at);
    let line = document.line_at(byte);
    let here = |token: &Token| token.span.start as usize <= byte && byte < token.span.end as usize;
    let index = line.iter().position(here);
    let name = index.and_then(|index| name_of(document, &line, index));
    let found = document.found.iter().filter(|found| {
        let (start, end) = (found.span.start as usize, found.span.end as usize);
        start <= byte && byte < end
    });
    let machine = document.target.machine.as_deref();
    let declared = machine.map_or_else(Vec::new, Machine::declared_anywhere);
    let names = name.into_iter().chain(found.map(|found| found.code.to_owned()));
    let pages: Vec<String> = names
        .filter_map(|name| explain_here(&name, document.target.dialect, &declared, |_| None))
        .collect();
    (!pages.is_empty()).then(|| Hover {
        contents: HoverContents::Markup(MarkupContent {
            kind: MarkupKind::Markdown,
            value: pages.join("\n\n---\n\n"),
        }),
        range: index.map(|index| document.range(line[index].span)),
    })
}

/// Returns the name under which `explain` has a page for a token: a code, address, variable, keyword or
/// function.
fn name_of(document: &Document, line: &[Token], index: usize) -> Option<String> {
    let token = line.get(index)?;
    let text = document.text_at(token.span);
    match token.kind {
        TokenKind::Address(Address::G | Address::M) => {
            let number = line.get(index + 1).filter(|next| next.kind == TokenKind::Number);
            Some(format!(
                "{text}{}",
                number.map_or("", |next| document.text_at(next.span))
            ))
        }
        TokenKind::Address(address) => Some(address.text().to_owned()),
        TokenKind::Number => match line.get(index.checked_sub(1)?)?.kind {
            TokenKind::Address(_) => name_of(document, line, index - 1),
            _ => None,
        },
        TokenKind::Variable(_) | TokenKind::Keyword(_) | TokenKind::Function(_) => Some(text.to_owned()),
        _ => None,
    }
}

/// Returns the G and M codes in a line.
pub(super) fn codes(document: &Document, line: &[Token]) -> Vec<&'static Code> {
    let dialect = document.target.dialect;
    let pairs = line.windows(2).filter_map(|pair| {
        let TokenKind::Address(address @ (Address::G | Address::M)) = pair[0].kind else {
            return None;
        };
        let number = (pair[1].kind == TokenKind::Number).then(|| document.text_at(pair[1].span))?;
        dialect.code(address, number.parse().ok()?)
    });
    pairs.collect()
}

/// Returns the location of the file of the subprogram that the block at a position calls.
pub(super) fn definition(document: &Document, at: Position) -> Option<Location> {
    let line = document.line_at(document.offset(at));
    if !codes(document, &line).iter().any(|code| code.role == Role::Call) {
        return None;
    }
    let call = line
        .windows(2)
        .find(|pair| pair[0].kind == TokenKind::Address(Address::P))?;
    let number = document.text_at(call[1].span).parse().ok()?;
    let data_dir = document
        .target
        .machine
        .as_ref()
        .and_then(|machine| machine.data_dir.as_deref());
    let file = find_subprogram(number, &document.path, data_dir)?;
    let file = std::path::absolute(file).ok()?;
    Some(Location {
        uri: Uri::from_str(&uri(&file.display().to_string())).ok()?,
        range: Range::default(),
    })
}

/// Returns the lines that formatting changes, as one edit; empty if the program has errors.
pub(super) fn formatting(document: &Document) -> Vec<TextEdit> {
    let Ok(new) = tandem_syntax::format(document.text(), (document.target.dialect.grammar)()) else {
        return Vec::new();
    };
    let old: Vec<&str> = document.text().split_inclusive('\n').collect();
    let new: Vec<&str> = new.split_inclusive('\n').collect();
    let same = old.iter().zip(&new).take_while(|(old, new)| old == new).count();
    let behind = old[same..].iter().rev().zip(new[same..].iter().rev());
    let same_behind = behind.take_while(|(old, new)| old == new).count();
    let (old_end, new_end) = (old.len() - same_behind, new.len() - same_behind);
    if same == old_end && same == new_end {
        return Vec::new();
    }
    vec![TextEdit {
        range: Range::new(
            Position::new(small(same), 0),
            document.position(small(old[..old_end].iter().map(|line| line.len()).sum())),
        ),
        new_text: new[same..new_end].concat(),
    }]
}
