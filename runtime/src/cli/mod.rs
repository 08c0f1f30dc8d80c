//! The command line.

mod check;
mod compile;
mod completions;
mod explain;
mod init;
mod man;
mod mqtt_acl;
mod plot;
mod serve;
mod server_ends;
mod simulate;
mod token;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tandem_runtime::program_store::read_text;
use tandem_runtime::{Config, Machine};

/// Clean, completed, or stopped in order.
const EXIT_OK: u8 = 0;
/// Errors were found, or an alarm ended the program.
const EXIT_FOUND: u8 = 1;
/// Something could not be read, or was asked for in a way that cannot be carried out.
const EXIT_UNREADABLE: u8 = 2;

#[derive(Parser)]
#[command(
    name = "tandem",
    version = concat!(env!("CARGO_PKG_VERSION"), " (", env!("TANDEM_BUILD"), ")"),
    about = "Runs NC programs and sequence programs in tandem",
    args_conflicts_with_subcommands = true
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: serve::Arguments,
}

#[derive(Subcommand)]
enum Command {
    /// Starts the machine with its MQTT broker, REST, WebSocket and HMI (this is what `tandem` alone does)
    Serve(serve::Arguments),
    /// Tells all that is wrong with NC programs, or with a configuration
    Check(check::Arguments),
    /// Writes the intermediate code of NC programs
    Compile(compile::Arguments),
    /// Tells what a diagnostic, a key of the configuration or a rule means
    Explain(explain::Arguments),
    /// Writes a machine of your own: configuration, NC program, handlers and a test
    Init(init::Arguments),
    /// Draws the tool path of an NC program
    Plot(plot::Arguments),
    /// Runs an NC program in simulated time
    Simulate(simulate::Arguments),
    /// Makes a token for an HMI, a sequence program or another system
    Token(token::Arguments),
    /// Prints the access rules of the token file for an external Mosquitto
    MqttAcl(mqtt_acl::Arguments),
    /// Prints what a shell needs to complete commands and options
    Completions(completions::Arguments),
    /// Prints a manual page
    Man(man::Arguments),
}

/// Runs the command of this process's arguments.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    let code = match cli.command {
        None => serve::run(&cli.serve),
        Some(Command::Serve(arguments)) => serve::run(&arguments),
        Some(Command::Check(arguments)) => check::run(&arguments),
        Some(Command::Compile(arguments)) => compile::run(&arguments),
        Some(Command::Explain(arguments)) => explain::run(&arguments),
        Some(Command::Init(arguments)) => init::run(&arguments),
        Some(Command::Plot(arguments)) => plot::run(&arguments),
        Some(Command::Simulate(arguments)) => simulate::run(&arguments),
        Some(Command::Token(arguments)) => token::run(&arguments),
        Some(Command::MqttAcl(arguments)) => mqtt_acl::run(&arguments),
        Some(Command::Completions(arguments)) => completions::run(&arguments),
        Some(Command::Man(arguments)) => man::run(&arguments),
    };
    ExitCode::from(code)
}

/// A line on standard output. A reader that has gone is no reason to fail.
fn say(line: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{line}");
}

/// A line on standard error.
fn complain(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// The configuration of a file, or the demo machine.
fn read_config(path: Option<&Path>) -> Result<(Config, Machine), String> {
    let config = match path {
        Some(path) => Config::read(path).map_err(|error| error.to_string())?,
        None => Config::demo(),
    };
    let machine = config.resolve().map_err(|error| match path {
        Some(path) => format!("{}: {error}", path.display()),
        None => error.to_string(),
    })?;
    Ok((config, machine))
}

/// The text of an NC program.
fn read_program(path: &Path) -> Result<String, String> {
    read_text(path).map_err(|error| format!("cannot read {}: {error}", path.display()))
}

/// Where a subprogram of a file may be: beside it, then in the store's folder.
fn find_subprogram(number: u16, beside: &Path, data_dir: Option<&Path>) -> Option<PathBuf> {
    let folder = beside.parent().unwrap_or(Path::new(""));
    let store = data_dir.map(|folder| folder.join("programs"));
    let folders = [Some(folder.to_owned()), store];
    let names = [format!("{number}.nc"), format!("O{number}.nc")];
    let places = folders
        .into_iter()
        .flatten()
        .flat_map(|folder| names.clone().map(|name| folder.join(name)));
    places.into_iter().find(|path| path.is_file())
}
