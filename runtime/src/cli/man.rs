//! `tandem man`: prints the manual pages, in the format of `man`.

use anyhow::Context;
use clap::{Args, CommandFactory};
use clap_mangen::Man;

use super::{Cli, CommandResult, EXIT_OK, print_line};

#[derive(Args)]
pub struct ManArguments {
    /// Command whose page is printed, such as serve; default: the page of tandem itself
    command: Option<String>,
}

pub(super) fn run(arguments: &ManArguments) -> CommandResult {
    let mut tandem = Cli::command();
    tandem.build();
    let named = match &arguments.command {
        None => Some(&tandem),
        Some(name) => tandem.find_subcommand(name),
    };
    let mut page = Vec::new();
    let command = named.context("there is no such command; tandem -h lists all of them")?;
    Man::new(command.clone()).render(&mut page)?;
    print_line(String::from_utf8_lossy(&page).trim_end());
    Ok(EXIT_OK)
}
