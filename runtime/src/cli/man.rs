//! `tandem man`: prints the manual pages, in the format of `man`.

use anyhow::Context;
use clap::{Args, CommandFactory};
use clap_mangen::Man;

use super::{Cli, EXIT_OK, Ran, say};

#[derive(Args)]
pub struct Arguments {
    /// Command whose page is printed, such as serve; default: the page of tandem itself
    command: Option<String>,
}

pub(super) fn run(arguments: &Arguments) -> Ran {
    let mut tandem = Cli::command();
    tandem.build();
    let named = match &arguments.command {
        None => Some(&tandem),
        Some(name) => tandem.find_subcommand(name),
    };
    let mut page = Vec::new();
    let command = named.context("there is no such command; tandem -h lists all of them")?;
    Man::new(command.clone()).render(&mut page)?;
    say(String::from_utf8_lossy(&page).trim_end());
    Ok(EXIT_OK)
}
