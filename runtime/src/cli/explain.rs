//! `tandem explain`: what a diagnostic means.

use clap::Args;
use tandem_syntax::{DIAGNOSTICS, DiagnosticEntry};

use super::{EXIT_OK, EXIT_UNREADABLE, complain, say};

#[derive(Args)]
pub struct Arguments {
    /// Code of a diagnostic, such as E0101; without one, all codes with their titles
    code: Option<String>,
}

pub(super) fn run(arguments: &Arguments) -> u8 {
    let Some(code) = &arguments.code else {
        for entry in DIAGNOSTICS {
            say(&format!("{}  {}", entry.code, entry.title));
        }
        return EXIT_OK;
    };
    let Some(entry) = DiagnosticEntry::find(&code.to_uppercase()) else {
        complain(format!(
            "there is no diagnostic {code}; tandem explain lists all of them"
        ));
        return EXIT_UNREADABLE;
    };
    say(&format!(
        "{}: {}\n\n{}\n\nExample:\n",
        entry.code, entry.title, entry.explanation
    ));
    for line in entry.example.lines() {
        say(&format!("    {line}"));
    }
    EXIT_OK
}
