//! `tandem check`: all that is wrong with NC programs, in one go.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use tandem_interp::{CheckContext, Dialect, check, dialects};
use tandem_model::Diagnostic;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_runtime::Machine;
use tandem_runtime::program_store::StoredProgram;
use tandem_syntax::{NcProgram, parse};

use super::findings::{Findings, as_json, as_sarif};
use super::server_ends::Servable;
use super::{
    EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, Ran, complain, find_subprogram, read_config, read_program, say,
};

#[derive(Args)]
pub struct Arguments {
    /// NC programs; - is standard input, whose subprograms are looked for in the current folder
    #[arg(required_unless_present = "config")]
    files: Vec<PathBuf>,
    /// NC dialect of the programs; without it, that of the configuration, or nj
    #[arg(long, value_parser = dialects::find)]
    dialect: Option<&'static Dialect>,
    /// Text for people, json for editors, sarif (2.1.0) for code hosts and other tools
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    /// Alone: checks this configuration and the files that it names, as serve does; with programs: checks them against it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Text,
    Json,
    Sarif,
}

impl Format {
    /// All findings in one piece; none where they are printed file by file.
    fn write(self, all: &[Findings], is_whole: bool) -> Option<serde_json::Value> {
        match self {
            Self::Text => None,
            Self::Json => Some(as_json(all)),
            Self::Sarif => Some(as_sarif(all, is_whole)),
        }
    }
}

pub(super) fn run(arguments: &Arguments) -> Ran {
    let machine = match &arguments.config {
        None => None,
        Some(path) if arguments.files.is_empty() => {
            let mut lines = vec![format!("{}: the configuration is good", path.display())];
            let notes = Servable::read(Some(path))?.machine.notes().into_iter();
            lines.extend(notes.map(|note| format!("  note: {note}")));
            let text = lines.join("\n");
            match arguments.format.write(&[], true) {
                None => say(text),
                Some(nothing) => {
                    say(nothing);
                    complain(text);
                }
            }
            return Ok(EXIT_OK);
        }
        Some(path) => Some(read_config(Some(path))?.1),
    };
    let of_machine = || machine.as_ref().map_or_else(dialects::nj, Machine::dialect);
    let dialect = arguments.dialect.unwrap_or_else(of_machine);
    let mut files = Vec::new();
    let (mut errors, mut unreadable) = (false, false);
    for path in &arguments.files {
        match read_program(path) {
            Ok(text) => {
                let findings = check_text(path, text, dialect, machine.as_ref());
                errors |= findings.has_errors();
                if arguments.format == Format::Text {
                    findings.print();
                }
                files.push(findings);
            }
            Err(error) => {
                complain(format!("{error:#}"));
                unreadable = true;
            }
        }
    }
    if let Some(all) = arguments.format.write(&files, !unreadable) {
        say(all);
    }
    Ok(match (unreadable, errors) {
        (true, _) => EXIT_UNREADABLE,
        (false, true) => EXIT_FOUND,
        (false, false) => EXIT_OK,
    })
}

/// Checks a program; with a machine, against the axes, limits and M codes of its first coordinate system.
fn check_text(path: &Path, text: String, dialect: &'static Dialect, machine: Option<&Machine>) -> Findings {
    let (tree, parsed) = parse(text, (dialect.grammar)());
    let called = check(&tree, dialect, &CheckContext::default()).programs;
    let first = machine.and_then(|machine| machine.coordinate_systems.first());
    let of = machine.zip(first.map(|system| &system.settings));
    check_tree(path, (&tree, parsed), &called, dialect, of)
}

/// Checks a program that is parsed, against a coordinate system of a machine.
pub(super) fn check_stored(
    path: &Path,
    program: &StoredProgram,
    machine: &Machine,
    settings: &CoordinateSystemSettings,
) -> Findings {
    let parsed = (&*program.tree, program.parsed.clone());
    let called = &program.check.programs;
    check_tree(path, parsed, called, machine.dialect(), Some((machine, settings)))
}

fn check_tree(
    path: &Path,
    (tree, parsed): (&NcProgram, Vec<Diagnostic>),
    called: &[u16],
    dialect: &'static Dialect,
    of: Option<(&Machine, &CoordinateSystemSettings)>,
) -> Findings {
    let data_dir = of.and_then(|(machine, _)| machine.data_dir.as_deref());
    let there = |number: &u16| find_subprogram(*number, path, data_dir).is_some();
    let programs: BTreeSet<u16> = called.iter().copied().filter(there).collect();
    let m_codes: Option<BTreeSet<u16>> = of.map(|(machine, _)| machine.m_codes.keys().copied().collect());
    let context = CheckContext {
        programs: Some(&programs),
        m_codes_with_settings: m_codes.as_ref(),
        ..of.map_or_else(CheckContext::default, |(_, settings)| CheckContext::of(settings))
    };
    let check = check(tree, dialect, &context);
    Findings::new(path, tree.source(), check, parsed)
}
