//! `tandem explain`: what a diagnostic, an alarm, a code, a rule or a key of the configuration means.

use clap::Args;
use tandem_interp::{Dialect, dialects};
use tandem_runtime::explain::{explain, nearest};
use tandem_syntax::DIAGNOSTICS;

use super::{EXIT_OK, Ran, say};

#[derive(Args)]
pub struct Arguments {
    /// A diagnostic (E0101), an alarm (alarm 412), a code (G02), a word, function, keyword or variable of the language, a key
    /// or table of the configuration (machine.name, motor), or a rule (D31, M1b, H4); without it, all diagnostics with
    /// their titles
    what: Vec<String>,
    /// NC dialect of codes and words
    #[arg(long, value_parser = dialects::find, default_value = "nj")]
    dialect: &'static Dialect,
}

pub(super) fn run(arguments: &Arguments) -> Ran {
    if arguments.what.is_empty() {
        for entry in DIAGNOSTICS {
            say(format!("{}  {}", entry.code, entry.title));
        }
        return Ok(EXIT_OK);
    }
    let what = arguments.what.join(" ");
    let Some(page) = explain(&what, arguments.dialect) else {
        anyhow::bail!(
            "nothing here is called {what}; did you mean {}? tandem explain lists all diagnostics",
            nearest(&what, arguments.dialect)
        );
    };
    say(page);
    Ok(EXIT_OK)
}
