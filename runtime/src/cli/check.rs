//! `tandem check`: all that is wrong with NC programs, in one go.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use codespan_reporting::diagnostic::{Diagnostic as Rendered, Label};
use codespan_reporting::files::SimpleFile;
use codespan_reporting::term;
use plc_api::types::program::ProgramDiagnostic;
use serde_json::json;
use tandem_interp::{Check, CheckContext, Dialect, check, check_source, dialects};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Diagnostic, Severity};
use tandem_runtime::Machine;
use tandem_runtime::program_store::{StoredProgram, locate};
use tandem_syntax::{NcProgram, parse};

use super::server_ends::Servable;
use super::{
    EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, Ran, complain, find_subprogram, read_config, read_program, say,
};

#[derive(Args)]
pub struct Arguments {
    /// NC programs
    #[arg(required_unless_present = "config")]
    files: Vec<PathBuf>,
    /// NC dialect of the programs; without it, that of the configuration, or nj
    #[arg(long, value_parser = dialects::find)]
    dialect: Option<&'static Dialect>,
    /// Text for people, json for editors
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
}

pub(super) fn run(arguments: &Arguments) -> Ran {
    let machine = match &arguments.config {
        None => None,
        Some(path) if arguments.files.is_empty() => {
            let mut lines = vec![format!("{}: the configuration is good", path.display())];
            let notes = Servable::read(Some(path))?.machine.notes().into_iter();
            lines.extend(notes.map(|note| format!("  note: {note}")));
            let text = lines.join("\n");
            match arguments.format {
                Format::Text => say(text),
                Format::Json => {
                    say(json!({"files": []}));
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
                let checked = CheckedFile::new(path, text, dialect, machine.as_ref());
                errors |= checked.has_errors();
                if arguments.format == Format::Text {
                    checked.print();
                }
                files.push(checked.to_json());
            }
            Err(error) => {
                complain(format!("{error:#}"));
                unreadable = true;
            }
        }
    }
    if arguments.format == Format::Json {
        say(json!({"files": files}));
    }
    Ok(match (unreadable, errors) {
        (true, _) => EXIT_UNREADABLE,
        (false, true) => EXIT_FOUND,
        (false, false) => EXIT_OK,
    })
}

/// One NC program and what was found in it.
pub(super) struct CheckedFile<'a> {
    path: &'a Path,
    tree: Arc<NcProgram>,
    check: Check,
}

impl<'a> CheckedFile<'a> {
    /// Checks a program; with a machine, against the axes, limits and M codes of its first coordinate system.
    fn new(path: &'a Path, text: String, dialect: &'static Dialect, machine: Option<&Machine>) -> Self {
        let (tree, parsed) = parse(text, (dialect.grammar)());
        let called = check(&tree, dialect, &CheckContext::default()).programs;
        let first = machine.and_then(|machine| machine.coordinate_systems.first());
        let of = machine.zip(first.map(|system| &system.settings));
        Self::of_tree(path, (Arc::new(tree), parsed), &called, dialect, of)
    }

    /// Checks a program that is parsed, against a coordinate system of a machine.
    pub fn of_stored(
        path: &'a Path,
        program: &StoredProgram,
        machine: &Machine,
        settings: &CoordinateSystemSettings,
    ) -> Self {
        let parsed = (Arc::clone(&program.tree), program.parsed.clone());
        let called = &program.check.programs;
        Self::of_tree(path, parsed, called, machine.dialect(), Some((machine, settings)))
    }

    fn of_tree(
        path: &'a Path,
        (tree, parsed): (Arc<NcProgram>, Vec<Diagnostic>),
        called: &[u16],
        dialect: &'static Dialect,
        of: Option<(&Machine, &CoordinateSystemSettings)>,
    ) -> Self {
        let data_dir = of.and_then(|(machine, _)| machine.data_dir.as_deref());
        let there = |number: &u16| find_subprogram(*number, path, data_dir).is_some();
        let programs: BTreeSet<u16> = called.iter().copied().filter(there).collect();
        let m_codes: Option<BTreeSet<u16>> = of.map(|(machine, _)| machine.m_codes.keys().copied().collect());
        let context = CheckContext {
            programs: Some(&programs),
            m_codes_with_settings: m_codes.as_ref(),
            ..of.map_or_else(CheckContext::default, |(_, settings)| CheckContext::of(settings))
        };
        let mut check = check(&tree, dialect, &context);
        check.diagnostics.extend(parsed);
        check
            .diagnostics
            .sort_by_key(|found| (found.span.start, found.span.end));
        Self { path, tree, check }
    }

    /// Checks a program for no machine in particular.
    pub fn alone(path: &'a Path, text: String) -> Self {
        let (tree, check) = check_source(text, dialects::nj(), &CheckContext::default());
        let tree = Arc::new(tree);
        Self { path, tree, check }
    }

    pub fn tree(&self) -> &NcProgram {
        &self.tree
    }

    pub fn has_errors(&self) -> bool {
        self.check.diagnostics.iter().any(Diagnostic::is_error)
    }

    /// The findings with lines and columns.
    pub fn located(&self) -> Vec<ProgramDiagnostic> {
        locate(self.tree.source(), &self.check.diagnostics)
    }

    fn to_json(&self) -> serde_json::Value {
        json!({
            "file": self.path.display().to_string(),
            "diagnostics": self.located(),
            "m_codes": self.check.m_codes,
            "programs": self.check.programs,
        })
    }

    /// The findings with source line and underline.
    pub fn findings(&self) -> String {
        let file = SimpleFile::new(self.path.display().to_string(), self.tree.source().as_ref());
        let config = term::Config::default();
        let mut text = String::new();
        for found in &self.check.diagnostics {
            let rendered = match found.severity {
                Severity::Error => Rendered::error(),
                Severity::Warning => Rendered::warning(),
            };
            let range = found.span.start as usize..found.span.end as usize;
            let rendered = rendered
                .with_code(found.code)
                .with_message(&found.message)
                .with_label(Label::primary((), range))
                .with_note(format!("help: {}", found.help));
            let shown = term::emit_into_string(&config, &file, &rendered)
                .unwrap_or_else(|_| format!("{}: {}: {}", self.path.display(), found.code, found.message));
            text.push_str(shown.trim_end());
            text.push_str("\n\n");
        }
        text
    }

    /// The findings, and what the program uses.
    pub fn print(&self) {
        if let Some(findings) = self.findings().strip_suffix('\n') {
            say(findings);
        }
        let found = &self.check.diagnostics;
        let errors = found.iter().filter(|found| found.is_error()).count();
        let warnings = found.len() - errors;
        let m_codes: Vec<_> = self.check.m_codes.iter().map(|m| format!("M{m:02}")).collect();
        let programs: Vec<_> = self.check.programs.iter().map(u16::to_string).collect();
        let or_none = |list: Vec<String>| match list.join(" ") {
            none if none.is_empty() => "none".to_owned(),
            list => list,
        };
        say(format!(
            "{}: {}, {}\n  M codes: {}; programs called: {}",
            self.path.display(),
            counted(errors, "error"),
            counted(warnings, "warning"),
            or_none(m_codes),
            or_none(programs)
        ));
    }
}

fn counted(count: usize, what: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {what}{plural}")
}
