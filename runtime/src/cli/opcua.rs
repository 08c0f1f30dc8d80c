//! `tandem opcua`: starts the separate program `tandem-opcua`.

use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, bail};
use clap::Args;

use super::CommandResult;

const PROGRAM: &str = "tandem-opcua";

#[derive(Args)]
#[command(after_help = "tandem-opcua --help prints all options; the book has a page on OPC UA.")]
pub struct OpcuaArguments {
    /// Options of tandem-opcua, such as --connect and --listen, each with an address
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "OPTION")]
    options: Vec<OsString>,
}

pub(super) fn run(arguments: &OpcuaArguments) -> CommandResult {
    let program = find_in_own_folder().unwrap_or_else(|| PROGRAM.into());
    let mut command = Command::new(&program);
    command.args(&arguments.options);
    match end_as(command) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => bail!(
            "{PROGRAM} is not installed: this separate program is neither in the folder of tandem nor on \
             PATH. Build it \
             with cargo build --release --manifest-path runtime/opcua/Cargo.toml, and copy it into the folder of tandem"
        ),
        ended => ended.with_context(|| format!("cannot start {}", program.display())),
    }
}

/// Returns the path of `tandem-opcua` in the folder of this executable, if it exists there.
fn find_in_own_folder() -> Option<PathBuf> {
    let beside = std::env::current_exe().ok()?.with_file_name(PROGRAM);
    let beside = beside.with_extension(std::env::consts::EXE_EXTENSION);
    beside.is_file().then_some(beside)
}

/// Replaces this process by `tandem-opcua`, so that signals reach that program directly.
#[cfg(unix)]
fn end_as(mut command: Command) -> io::Result<u8> {
    // `exec` returns only after an error.
    Err(std::os::unix::process::CommandExt::exec(&mut command))
}

#[cfg(not(unix))]
fn end_as(mut command: Command) -> io::Result<u8> {
    let code = command.status()?.code();
    Ok(code
        .and_then(|code| u8::try_from(code).ok())
        .unwrap_or(super::EXIT_UNREADABLE))
}
