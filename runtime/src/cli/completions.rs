//! `tandem completions`: prints the completion script of a shell.

use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate};

use super::{Cli, EXIT_OK, print_line};

#[derive(Args)]
pub struct CompletionsArguments {
    /// Shell for which the script is printed
    shell: Shell,
}

pub(super) fn run(arguments: &CompletionsArguments) -> u8 {
    let mut script = Vec::new();
    generate(arguments.shell, &mut Cli::command(), "tandem", &mut script);
    print_line(String::from_utf8_lossy(&script).trim_end());
    EXIT_OK
}
