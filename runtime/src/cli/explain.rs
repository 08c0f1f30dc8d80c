//! `tandem explain`: explains a diagnostic, an alarm, a code, a rule or a key of the configuration.

use std::path::PathBuf;

use clap::Args;
use tandem_interp::{Dialect, dialects};
use tandem_runtime::Machine;
use tandem_runtime::explain::{explain_here, nearest};
use tandem_syntax::DIAGNOSTICS;

use super::{CommandResult, EXIT_OK, print_line, read_config};

#[derive(Args)]
pub struct ExplainArguments {
    /// A diagnostic (E0101), an alarm (alarm 412), a code (G02), a word, function, keyword or variable of the language, a key
    /// or table of the configuration (machine.name, motor), or a rule (D31, M1b, H4); without it, all diagnostics with
    /// their titles
    what: Vec<String>,
    /// NC dialect of codes and words
    #[arg(long, value_parser = dialects::find, default_value = dialects::DEFAULT_NAME)]
    dialect: &'static Dialect,
    /// Configuration of the machine whose M codes and alarms are explained, with their names, parameters and texts
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &ExplainArguments) -> CommandResult {
    if arguments.what.is_empty() {
        for entry in DIAGNOSTICS {
            print_line(format!("{}  {}", entry.code, entry.title));
        }
        return Ok(EXIT_OK);
    }
    let what = arguments.what.join(" ");
    let machine = match &arguments.config {
        None => None,
        Some(path) => Some(read_config(Some(path))?.1),
    };
    let declared = machine.as_ref().map_or_else(Vec::new, Machine::declared_anywhere);
    let alarm_text = |code| machine.as_ref()?.alarms.get(&code).cloned();
    let Some(page) = explain_here(&what, arguments.dialect, &declared, alarm_text) else {
        anyhow::bail!(
            "{what} is unknown; did you mean {}? tandem explain lists all diagnostics",
            nearest(&what, arguments.dialect)
        );
    };
    print_line(page);
    Ok(EXIT_OK)
}
