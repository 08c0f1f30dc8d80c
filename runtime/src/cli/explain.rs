//! `tandem explain`: what a diagnostic, a rule or a key of the configuration means.

use clap::Args;
use tandem_runtime::{Config, ConfigKey};
use tandem_syntax::{DIAGNOSTICS, DiagnosticEntry};

use super::{EXIT_OK, Ran, say};

#[derive(Args)]
pub struct Arguments {
    /// A diagnostic (E0101), a key or table of the configuration (machine.name, motor), or a rule (D31, M1b, H4); without
    /// it, all diagnostics with their titles
    code: Option<String>,
}

/// Tables of rules: number and text.
const RULES: [&[(&str, &str)]; 3] = [
    tandem_interp::decisions::DECISIONS,
    tandem_motion::rules::RULES,
    plc_api::handshake::rules::RULES,
];

pub(super) fn run(arguments: &Arguments) -> Ran {
    let Some(code) = &arguments.code else {
        for entry in DIAGNOSTICS {
            say(format!("{}  {}", entry.code, entry.title));
        }
        return Ok(EXIT_OK);
    };
    let keys = Config::keys();
    let pages: Vec<String> = match DiagnosticEntry::find(&code.to_uppercase()) {
        Some(entry) => vec![diagnostic(entry)],
        None => rules(code)
            .chain(keys.iter().filter(|key| is_named(key, code)).map(of_key))
            .collect(),
    };
    if pages.is_empty() {
        anyhow::bail!(
            "there is no diagnostic, key or rule {code}; did you mean {}? tandem explain lists all diagnostics",
            nearest(code, &keys)
        );
    }
    say(pages.join("\n\n"));
    Ok(EXIT_OK)
}

fn diagnostic(entry: &DiagnosticEntry) -> String {
    let example: Vec<String> = entry.example.lines().map(|line| format!("    {line}")).collect();
    format!(
        "{}: {}\n\n{}\n\nExample:\n\n{}",
        entry.code,
        entry.title,
        entry.explanation,
        example.join("\n")
    )
}

/// The rule of this number, and those of its group.
fn rules(number: &str) -> impl Iterator<Item = String> {
    let is_named = move |row: &str| {
        let group = row.split('.').next().unwrap_or(row);
        [row, group].iter().any(|name| name.eq_ignore_ascii_case(number))
    };
    let rows = RULES.into_iter().flatten().filter(move |(row, _)| is_named(row));
    rows.map(|(row, text)| format!("{row}: {text}"))
}

/// True for a key by its own name or with its table's, and for all keys of the table of this name.
fn is_named(key: &ConfigKey, name: &str) -> bool {
    key.path == name || key.path.split('.').any(|part| part == name)
}

fn of_key(key: &ConfigKey) -> String {
    let value = match key.default.as_str() {
        _ if key.is_needed => "needed".to_owned(),
        "" => "may be left out".to_owned(),
        default => format!("default {default}"),
    };
    let mut facts = vec![key.kind.clone(), key.unit.clone(), key.range_text(), value];
    facts.retain(|fact| !fact.is_empty());
    let mut lines = vec![format!("{}: {}\n\n{}", key.path, facts.join(", "), key.text)];
    let words = key.words.iter();
    lines.extend(words.map(|word| format!("    \"{}\"  {}", word.word, word.text)));
    lines.join("\n")
}

/// What a name that is none comes nearest to.
fn nearest(name: &str, keys: &[ConfigKey]) -> String {
    let diagnostics = DIAGNOSTICS.iter().map(|entry| entry.code);
    let rules = RULES.into_iter().flatten().map(|(row, _)| *row);
    let keys = keys.iter().flat_map(|key| {
        let of_table = key.path.rsplit('.').next().unwrap_or_default();
        [key.path.as_str(), of_table]
    });
    let all = keys.chain(diagnostics).chain(rules);
    let distance = |known: &&str| strsim::damerau_levenshtein(&name.to_lowercase(), &known.to_lowercase());
    all.min_by_key(distance).unwrap_or_default().to_owned()
}
