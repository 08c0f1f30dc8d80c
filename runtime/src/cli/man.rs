//! `tandem man`: the manual pages, in the language of `man`.

use clap::{Args, CommandFactory};
use clap_mangen::Man;

use super::{Cli, EXIT_OK, EXIT_UNREADABLE, complain, say};

#[derive(Args)]
pub struct Arguments {
    /// Command whose page is printed, such as serve; without one, that of tandem itself
    command: Option<String>,
}

pub(super) fn run(arguments: &Arguments) -> u8 {
    let mut tandem = Cli::command();
    tandem.build();
    let named = match &arguments.command {
        None => Some(&tandem),
        Some(name) => tandem.find_subcommand(name),
    };
    let mut page = Vec::new();
    let rendered = named.is_some_and(|command| Man::new(command.clone()).render(&mut page).is_ok());
    if !rendered {
        complain("there is no such command; tandem -h lists all of them");
        return EXIT_UNREADABLE;
    }
    say(String::from_utf8_lossy(&page).trim_end());
    EXIT_OK
}
