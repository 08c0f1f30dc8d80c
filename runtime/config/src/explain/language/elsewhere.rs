//! Pages for words of other controls, and for names that resemble names of the dialect.

use tandem_interp::Dialect;
use tandem_syntax::{Address, DiagnosticEntry, Grammar, VariableKind, diagnostics};

use super::super::{of_diagnostic, page};

/// Number of digits of a diagnostic's number that is written without its leading zero.
const SHORTENED: usize = 3;

/// Returns the page for a word that the dialect does not have: the replacement, or the reason why the word is
/// an error.
pub(in super::super) fn page_of(what: &str, dialect: &Dialect) -> Option<String> {
    let grammar = (dialect.grammar)();
    let (letters, value) = parted(what);
    if let Some(entry) = shortened(letters, value) {
        return Some(of_diagnostic(entry, dialect));
    }
    if is_diagnostic(letters) && value.len() > SHORTENED {
        return None;
    }
    let help = match letters {
        "#" => grammar.foreign_variable(value),
        "(" | ")" => comment(grammar),
        _ => grammar
            .foreign(&format!("{letters}{}", value.trim_start_matches('0')), "")
            .or_else(|| grammar.foreign(letters, value)),
    };
    match help {
        Some(help) => {
            let title = format!("of other controls, not of dialect {}", grammar.name);
            Some(page(&what.to_uppercase(), &title, &[help]))
        }
        None => none_of_its_kind(letters, value, grammar).map(|entry| of_diagnostic(entry, dialect)),
    }
}

/// Returns the name that a user means: `X10` means the word X, `_CNC_CapturedPosition(2)` the variable with
/// this index.
pub(in super::super) fn meant(what: &str) -> Option<String> {
    if let Some((name, index)) = what.strip_suffix(')').and_then(|what| what.split_once('(')) {
        return Some(format!("{name}{index}"));
    }
    let (letters, value) = parted(what);
    let is_word = Address::find(letters).is_some() && !is_code(letters) && !value.is_empty();
    is_word.then(|| letters.to_owned())
}

/// Splits a name into its leading letters (or one other character) and the rest.
fn parted(what: &str) -> (&str, &str) {
    let letters = what.find(|character: char| !character.is_ascii_alphabetic());
    let first = what.chars().next().map_or(0, char::len_utf8);
    let (letters, value) = what.split_at(letters.unwrap_or(what.len()).max(first));
    (letters, value.trim())
}

fn is_code(letters: &str) -> bool {
    ["G", "M"].iter().any(|code| code.eq_ignore_ascii_case(letters))
}

fn is_diagnostic(letters: &str) -> bool {
    ["E", "W"].iter().any(|kind| kind.eq_ignore_ascii_case(letters))
}

/// Returns the diagnostic E0101 for the shortened number `E101`, for example.
fn shortened(letters: &str, digits: &str) -> Option<&'static DiagnosticEntry> {
    let entry = DiagnosticEntry::find(&format!("{letters}0{digits}"));
    entry.filter(|_| digits.len() == SHORTENED)
}

/// Returns the diagnostic that reports a code or variable that does not exist.
fn none_of_its_kind(letters: &str, value: &str, grammar: &Grammar) -> Option<&'static DiagnosticEntry> {
    value.parse::<f64>().ok()?;
    let is_variable = |kind: VariableKind| kind.prefix().eq_ignore_ascii_case(letters);
    match letters {
        "G" | "g" => Some(&diagnostics::G_UNKNOWN),
        "M" | "m" => Some(&diagnostics::M_UNKNOWN),
        _ if grammar.program_codes && VariableKind::ALL.into_iter().any(is_variable) => {
            Some(&diagnostics::VARIABLE_UNKNOWN)
        }
        _ => None,
    }
}

/// Returns the page about comments in parentheses, if comments of this dialect have another form.
fn comment(grammar: &Grammar) -> Option<String> {
    let open = grammar.line_comment?;
    Some(format!("Write a comment after {open}."))
}
