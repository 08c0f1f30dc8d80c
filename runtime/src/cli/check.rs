//! `tandem check`: reports all errors and warnings in NC programs at once.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use clap::Args;
use plc_protocol::types::CoordinateSystemNumber;
use tandem_interp::{Check, CheckContext, Dialect, Programs, check, dialects};
use tandem_model::Diagnostic;
use tandem_model::limits::M_CODE_MAX;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_runtime::declared::{unserved, wrong_params};
use tandem_runtime::program_store::StoredProgram;
use tandem_runtime::trial::Trial;
use tandem_runtime::{ConfiguredSystem, Machine};
use tandem_syntax::diagnostics::{FEEDRATE_OPEN, STOPS_IF, WRONG_IN_SOME};
use tandem_syntax::{NcProgram, parse};

use super::findings::{FileFindings, as_json, as_sarif};
use super::server_ends::Servable;
use super::{
    CommandResult, EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, complain, find_subprogram, print_line, read_config,
    read_program,
};

#[derive(Args)]
pub struct CheckArguments {
    /// NC programs; - is standard input, whose subprograms are searched for in the current folder
    #[arg(required_unless_present = "config")]
    files: Vec<PathBuf>,
    /// NC dialect of the programs; default: that of the configuration, or nj
    #[arg(long, value_parser = dialects::find)]
    dialect: Option<&'static Dialect>,
    /// Text for people, json for editors, sarif (2.1.0) for code hosts and other tools
    #[arg(long, value_enum, default_value = "text")]
    format: CheckFormat,
    /// Without programs: checks this configuration and the files that it names, as serve does; with programs: checks
    /// them against it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Coordinate system of --config that runs the programs; default: the one whose `programs` name the file, otherwise
    /// the first one with its dialect
    #[arg(long, requires = "config")]
    cs: Option<CoordinateSystemNumber>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum CheckFormat {
    Text,
    Json,
    Sarif,
}

impl CheckFormat {
    /// Returns all findings as one JSON value; `None` if the format prints the findings of each file
    /// separately.
    fn write(self, all: &[FileFindings], is_whole: bool, dialect: &Dialect) -> Option<serde_json::Value> {
        match self {
            Self::Text => None,
            Self::Json => Some(as_json(all)),
            Self::Sarif => Some(as_sarif(all, is_whole, dialect)),
        }
    }
}

pub(super) fn run(arguments: &CheckArguments) -> CommandResult {
    let machine = match &arguments.config {
        None => None,
        Some(path) if arguments.files.is_empty() => {
            let mut lines = vec![format!("{}: the configuration is good", path.display())];
            let machine = Servable::read(Some(path), |_| Ok(()))?.machine;
            let (notes, served) = (machine.notes().into_iter(), machine.served_text().into_iter());
            lines.extend(notes.map(|note| format!("  note: {note}")));
            lines.extend(served.map(|served| format!("  {served}")));
            let text = lines.join("\n");
            match arguments.format.write(&[], true, machine.dialect()) {
                None => print_line(text),
                Some(nothing) => {
                    print_line(nothing);
                    complain(text);
                }
            }
            return Ok(EXIT_OK);
        }
        Some(path) => Some(read_config(Some(path))?.1),
    };
    let named = arguments.cs.zip(machine.as_ref()).map(|(cs, machine)| {
        let mut systems = machine.coordinate_systems.iter();
        let system = systems.find(|system| system.settings.number == cs);
        system.with_context(|| format!("the machine has no coordinate system {cs}"))
    });
    let named = named.transpose()?;
    let default = machine
        .as_ref()
        .map_or_else(dialects::default_dialect, Machine::dialect);
    let dialect_of = |system: Option<&ConfiguredSystem>| {
        let of_system = || system.map_or(default, |system| system.dialect);
        arguments.dialect.unwrap_or_else(of_system)
    };
    let mut files = Vec::new();
    let (mut errors, mut unreadable) = (false, false);
    for path in &arguments.files {
        match read_program(path) {
            Ok(text) => {
                let assigned = || machine.as_ref()?.system_of_program(path);
                let system = named.or_else(assigned);
                let dialect = dialect_of(system);
                for findings in check_text(path, &text, dialect, machine.as_ref(), system) {
                    errors |= findings.has_errors();
                    if arguments.format == CheckFormat::Text {
                        findings.print();
                    }
                    files.push(findings);
                }
            }
            Err(error) => {
                complain(format!("{error:#}"));
                unreadable = true;
            }
        }
    }
    if let Some(all) = arguments.format.write(&files, !unreadable, dialect_of(named)) {
        print_line(all);
    }
    Ok(match (unreadable, errors) {
        (true, _) => EXIT_UNREADABLE,
        (false, true) => EXIT_FOUND,
        (false, false) => EXIT_OK,
    })
}

/// Checks a program; returns its findings, followed by those of each called program that has findings. With a
/// machine, the program is checked against the axes, limits and M codes of the coordinate system `named`, or
/// of the first one with its dialect.
pub(super) fn check_text(
    path: &Path,
    text: &str,
    dialect: &'static Dialect,
    machine: Option<&Machine>,
    named: Option<&ConfiguredSystem>,
) -> Vec<FileFindings> {
    let (tree, parsed) = parse(text, (dialect.grammar)());
    let tree = Arc::new(tree);
    let systems = machine.map_or(&[][..], |machine| &machine.coordinate_systems);
    let of_dialect = systems.iter().find(|system| system.dialect.name == dialect.name);
    let first = named.or(of_dialect).or(systems.first());
    let of = machine.zip(first.map(|system| &system.settings));
    check_tree(path, (&tree, parsed), dialect, of, true)
}

/// Checks a parsed program as [`check_text`] does, against a coordinate system of a machine.
pub(super) fn check_stored(
    path: &Path,
    program: &StoredProgram,
    machine: &Machine,
    settings: &CoordinateSystemSettings,
) -> Vec<FileFindings> {
    let parsed = (&program.tree, program.parsed.clone());
    check_tree(path, parsed, program.dialect, Some((machine, settings)), false)
}

fn check_tree(
    path: &Path,
    (tree, parsed): (&Arc<NcProgram>, Vec<Diagnostic>),
    dialect: &'static Dialect,
    of: Option<(&Machine, &CoordinateSystemSettings)>,
    calculates: bool,
) -> Vec<FileFindings> {
    let programs = ProgramSearch {
        caller: path,
        data_dir: of.and_then(|(machine, _)| machine.data_dir.as_deref()),
        dialect,
        read: RefCell::default(),
    };
    let m_codes = of.map(|(machine, settings)| known_m_codes(machine, settings));
    let system = of.and_then(|(machine, settings)| {
        let mut systems = machine.coordinate_systems.iter();
        Some((
            machine,
            systems.find(|system| system.settings.number == settings.number)?,
        ))
    });
    let context = CheckContext {
        programs: Some(&programs),
        m_codes_with_settings: m_codes.as_ref(),
        calculates,
        ..of.map_or_else(CheckContext::default, |(_, settings)| {
            CheckContext::from_settings(settings)
        })
    };
    let mut check = check(tree, dialect, &context);
    let mut called = std::mem::take(&mut check.called);
    let read = programs.read.into_inner();
    if let Some((machine, system)) = system {
        let of_m_codes = |tree: &NcProgram| check_m_codes(tree, dialect, machine, system);
        check.diagnostics.extend(of_m_codes(tree));
        for (number, check) in &mut called {
            let program = read.get(number).and_then(Option::as_ref);
            check
                .diagnostics
                .extend(program.map_or_else(Vec::new, |program| of_m_codes(&program.tree)));
        }
    }
    let of_called = read.values().flatten().flat_map(|called| &called.parsed);
    let has_errors = [&check].into_iter().chain(called.values()).any(Check::has_errors)
        || parsed.iter().chain(of_called).any(Diagnostic::is_error);
    if has_errors {
        // Findings about missing settings with a default are reported only for programs that can run.
        for of in [&mut check].into_iter().chain(called.values_mut()) {
            of.diagnostics.retain(|found| found.code != FEEDRATE_OPEN.code);
        }
    }
    if calculates && !has_errors {
        let called_trees = read
            .iter()
            .filter_map(|(number, called)| Some((*number, Arc::clone(&called.as_ref()?.tree))));
        let trial = Trial {
            program: tree,
            programs: &called_trees.collect(),
            dialect,
            machine: system,
        };
        add_findings(&trial, &mut check, &mut called);
    }
    let main = FileFindings::new(path, tree.source(), check, parsed);
    all_findings(main, called, read)
}

/// Adds the findings of a trial run. A warning is omitted if another finding overlaps it. A possible alarm is
/// omitted only if another finding reports an alarm. Errors of a trial replace warnings about errors that
/// occur only on some paths.
fn add_findings(trial: &Trial<'_>, main: &mut Check, called: &mut BTreeMap<u16, Check>) {
    for (number, finding) in trial.run().findings(trial) {
        let of = called.get_mut(&number).unwrap_or(main);
        let is_new =
            |known: &Diagnostic| known.span.end <= finding.span.start || finding.span.end <= known.span.start;
        if finding.is_error() {
            let is_sure = |known: &Diagnostic| known.code != WRONG_IN_SOME.code || is_new(known);
            of.diagnostics.retain(is_sure);
            of.diagnostics.push(finding);
        } else {
            // A possible alarm is omitted only if another finding reports an alarm for the same block.
            let reports_it = |known: &Diagnostic| {
                finding.code != STOPS_IF.code
                    || known.is_error()
                    || known.code == WRONG_IN_SOME.code
                    || known.code == finding.code
            };
            if of
                .diagnostics
                .iter()
                .all(|known| is_new(known) || !reports_it(known))
            {
                of.diagnostics.push(finding);
            }
        }
    }
}

/// Returns the findings of a program, followed by those of each called program that has findings.
fn all_findings(
    main: FileFindings,
    called: BTreeMap<u16, Check>,
    mut read: BTreeMap<u16, Option<CalledProgram>>,
) -> Vec<FileFindings> {
    let mut all = vec![main];
    for (number, check) in called {
        let Some(Some(called)) = read.remove(&number) else {
            continue;
        };
        if !(check.diagnostics.is_empty() && called.parsed.is_empty()) {
            let source = called.tree.source();
            all.push(FileFindings::new(&called.path, source, check, called.parsed));
        }
    }
    all
}

/// Returns the M codes that need no settings. If the configuration names the file of the sequence side, these
/// are all M codes, because that file states exactly which M codes handlers serve.
fn known_m_codes(machine: &Machine, settings: &CoordinateSystemSettings) -> BTreeSet<u16> {
    let all = (0..=M_CODE_MAX).filter(|_| machine.served.is_some());
    let stock = Machine::stock_m_codes(settings).iter().copied();
    machine.m_codes.keys().copied().chain(stock).chain(all).collect()
}

/// Checks the M codes of a program against the declarations of handlers and configuration, as far as files
/// contain them.
fn check_m_codes(
    tree: &NcProgram,
    dialect: &'static Dialect,
    machine: &Machine,
    system: &ConfiguredSystem,
) -> Vec<Diagnostic> {
    let mut found = wrong_params(tree, dialect, &machine.declared(system.settings.number));
    found.extend(unserved(tree, dialect, |m| machine.is_unserved(system, m)));
    found
}

/// Programs that may be called, from the folder of the file and from the data folder. Each file is read once.
#[derive(Debug)]
struct ProgramSearch<'a> {
    caller: &'a Path,
    data_dir: Option<&'a Path>,
    dialect: &'static Dialect,
    read: RefCell<BTreeMap<u16, Option<CalledProgram>>>,
}

#[derive(Debug)]
struct CalledProgram {
    path: PathBuf,
    tree: Arc<NcProgram>,
    parsed: Vec<Diagnostic>,
}

impl ProgramSearch<'_> {
    fn read(&self, number: u16) -> Option<CalledProgram> {
        let path = find_subprogram(number, self.caller, self.data_dir)?;
        let text = read_program(&path).ok()?;
        let (tree, parsed) = parse(text, (self.dialect.grammar)());
        Some(CalledProgram {
            path,
            tree: Arc::new(tree),
            parsed,
        })
    }
}

impl Programs for ProgramSearch<'_> {
    fn find(&self, number: u16) -> Option<Arc<NcProgram>> {
        let mut read = self.read.borrow_mut();
        let called = read.entry(number).or_insert_with(|| self.read(number));
        called.as_ref().map(|called| Arc::clone(&called.tree))
    }
}
