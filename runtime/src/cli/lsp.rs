//! `tandem lsp`: the language server of NC programs, for editors.

mod completion;
mod document;
mod features;
mod outline;
mod server;
mod setup;
#[cfg(test)]
mod tests;
mod timing;
mod transport;

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use tandem_interp::{Dialect, dialects};

use self::setup::Setup;
use super::{CommandResult, EXIT_FOUND, EXIT_OK};

#[derive(Args)]
pub struct LspArguments {
    /// Configuration of the machine that runs the programs; default: the nearest tandem.toml in the folder of a program
    /// or above
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// NC dialect of the programs; default: that of the configuration, or nj
    #[arg(long, value_parser = dialects::find)]
    dialect: Option<&'static Dialect>,
    /// Uses standard input and output (always on; editors may pass this option)
    #[arg(long, hide = true)]
    stdio: bool,
}

pub(super) fn run(arguments: &LspArguments) -> CommandResult {
    let command = std::env::current_exe().context("cannot find the path of this executable")?;
    let setup = Setup::new(arguments.config.clone(), arguments.dialect);
    let (connection, writer) = transport::stdio();
    let ended = server::serve(&connection, setup, command);
    drop(connection);
    let in_order = ended?;
    if let Ok(written) = writer.join() {
        written.context("standard output")?;
    }
    Ok(if in_order { EXIT_OK } else { EXIT_FOUND })
}
