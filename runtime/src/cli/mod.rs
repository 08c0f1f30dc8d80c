//! The command line of `tandem`.

mod cert;
mod check;
mod compile;
mod completions;
mod convert;
mod diff;
mod explain;
mod findings;
mod fleet;
mod fmt;
mod init;
mod journal;
mod log;
mod lsp;
mod man;
mod memory;
mod mqtt_acl;
mod opcua;
mod os_user;
mod plot;
mod serve;
mod server_ends;
mod simulate;
mod st;
mod store;
mod token;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, ensure};
use clap::{Parser, Subcommand};
use tandem_runtime::program_store::{read_text, read_text_from};
use tandem_runtime::{Config, ConfigError, Machine};

/// Exit code: no finding, program completed, or shut down on request.
const EXIT_OK: u8 = 0;
/// Exit code: errors were found, or an alarm ended the program.
const EXIT_FOUND: u8 = 1;
/// Exit code: a file could not be read, or the arguments cannot be used.
const EXIT_UNREADABLE: u8 = 2;

/// The exit code of a command. An error is printed, and the process ends with [`EXIT_UNREADABLE`].
type CommandResult = anyhow::Result<u8>;

#[derive(Parser)]
#[command(
    name = "tandem",
    version = concat!(env!("CARGO_PKG_VERSION"), " (", env!("TANDEM_BUILD"), ")"),
    about = "Runs NC programs and sequence programs in tandem",
    // Without this, the text would depend on the features of clap that other crates in the build enable.
    term_width = 0,
    args_conflicts_with_subcommands = true
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: serve::ServeArguments,
}

#[derive(Subcommand)]
enum Command {
    /// Starts the machine with its MQTT broker, REST, WebSocket and HMI (the default command of `tandem`)
    Serve(serve::ServeArguments),
    /// Reports all errors and warnings in NC programs, or in a configuration
    Check(check::CheckArguments),
    /// Formats NC programs (spacing and letter case only)
    Fmt(fmt::FmtArguments),
    /// Converts programs of other controls to dialect nj
    Convert(convert::ConvertArguments),
    /// Serves editors: diagnostics while you type, explanations, completion, formatting, and the run time of a program
    Lsp(lsp::LspArguments),
    /// Writes the intermediate code of NC programs
    Compile(compile::CompileArguments),
    /// Explains a diagnostic, an alarm, a code, a key of the configuration or a rule
    Explain(explain::ExplainArguments),
    /// Creates a project for a machine of your own: configuration, NC program, handlers and a test
    Init(init::InitArguments),
    /// Draws the tool path of an NC program
    Plot(plot::PlotArguments),
    /// Runs an NC program in simulated time
    Simulate(simulate::SimulateCommandArguments),
    /// Compares two NC programs by path, M codes and time
    Diff(diff::DiffArguments),
    /// Checks a sequence program in Structured Text, or runs it on a machine
    St(st::StArguments),
    /// Runs many simulated machines at one broker, each with a handler and an HMI, and measures their performance
    Fleet(fleet::FleetArguments),
    /// Creates a certificate for TLS, for this machine or for a client
    Cert(cert::CertArguments),
    /// Inspects and repairs the stored data of a machine while the machine does not run
    Store(store::StoreArguments),
    /// Verifies and shows the journal: the commands of users and the events of the machine
    Journal(journal::JournalArguments),
    /// Creates a token for an HMI, a sequence program or another system
    Token(token::TokenArguments),
    /// Serves a machine over OPC UA (starts the separate program tandem-opcua)
    Opcua(opcua::OpcuaArguments),
    /// Prints the access rules of the token file for an external Mosquitto
    MqttAcl(mqtt_acl::MqttAclArguments),
    /// Prints the completion script of a shell
    Completions(completions::CompletionsArguments),
    /// Prints a manual page
    Man(man::ManArguments),
}

/// Runs the command of this process's arguments.
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(help) => {
            notice_unwritten(help.print());
            return exit_code(u8::try_from(help.exit_code()).unwrap_or(EXIT_UNREADABLE));
        }
    };
    let ran = match cli.command.unwrap_or(Command::Serve(cli.serve)) {
        Command::Serve(arguments) => serve::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Fmt(arguments) => Ok(fmt::run(&arguments)),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Lsp(arguments) => lsp::run(&arguments),
        Command::Compile(arguments) => compile::run(&arguments),
        Command::Explain(arguments) => explain::run(&arguments),
        Command::Init(arguments) => init::run(&arguments),
        Command::Plot(arguments) => plot::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Diff(arguments) => diff::run(&arguments),
        Command::St(arguments) => st::run(&arguments),
        Command::Fleet(arguments) => fleet::run(&arguments),
        Command::Cert(arguments) => cert::run(&arguments),
        Command::Store(arguments) => store::run(&arguments),
        Command::Journal(arguments) => journal::run(&arguments),
        Command::Token(arguments) => token::run(&arguments),
        Command::Opcua(arguments) => opcua::run(&arguments),
        Command::MqttAcl(arguments) => mqtt_acl::run(&arguments),
        Command::Completions(arguments) => Ok(completions::run(&arguments)),
        Command::Man(arguments) => man::run(&arguments),
    };
    exit_code(ran.unwrap_or_else(|error| {
        complain(format!("{error:#}"));
        EXIT_UNREADABLE
    }))
}

/// True if a write to standard output has failed.
static UNWRITTEN: AtomicBool = AtomicBool::new(false);

/// Returns the exit code. If standard output could not be written, it is that of an error, because the result
/// is incomplete.
fn exit_code(code: u8) -> ExitCode {
    match code {
        EXIT_OK if UNWRITTEN.load(Ordering::Relaxed) => EXIT_UNREADABLE.into(),
        code => code.into(),
    }
}

/// Prints a line on standard output. A failed write is recorded for [`exit_code`], unless the reader has
/// closed the pipe.
fn print_line(line: impl std::fmt::Display) {
    notice_unwritten(writeln!(std::io::stdout().lock(), "{line}"));
}

fn notice_unwritten(written: std::io::Result<()>) {
    if let Err(error) = written
        && error.kind() != std::io::ErrorKind::BrokenPipe
        && !UNWRITTEN.swap(true, Ordering::Relaxed)
    {
        complain(format!("cannot write to standard output: {error}"));
    }
}

/// Prints a line on standard error.
fn complain(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Reads the configuration from a file; without a path, returns the configuration of the demo machine.
fn read_config(path: Option<&Path>) -> anyhow::Result<(Config, Machine)> {
    let Some(path) = path else {
        let config = Config::demo();
        let machine = config.resolve()?;
        return Ok((config, machine));
    };
    let read = || {
        let config = Config::read(path)?;
        let machine = config.resolve()?;
        Ok((config, machine))
    };
    read().map_err(|error| match error {
        ConfigError::Values(_) => anyhow::Error::from(error).context(path.display().to_string()),
        named => named.into(),
    })
}

/// File name that stands for standard input.
const STANDARD_INPUT: &str = "-";

/// True if standard input has been read to its end.
static STANDARD_INPUT_READ: AtomicBool = AtomicBool::new(false);

/// Reads the text of an NC program from a file or from standard input.
fn read_program(path: &Path) -> anyhow::Result<String> {
    let read = if path == Path::new(STANDARD_INPUT) {
        ensure!(
            !STANDARD_INPUT_READ.swap(true, Ordering::Relaxed),
            "standard input has one program; write - once"
        );
        read_text_from(std::io::stdin().lock())
    } else {
        read_text(path)
    };
    read.with_context(|| format!("cannot read {}", shown(path)))
}

/// Returns the name of an NC program's file for display.
fn shown(path: &Path) -> String {
    if path == Path::new(STANDARD_INPUT) {
        "<stdin>".to_owned()
    } else {
        path.display().to_string()
    }
}

/// Returns the path of a subprogram's file: in the folder of the calling program, otherwise in the program
/// folder of the data folder.
fn find_subprogram(number: u16, caller: &Path, data_dir: Option<&Path>) -> Option<PathBuf> {
    let folder = caller.parent().unwrap_or(Path::new("")).to_owned();
    let store = data_dir.map(|folder| folder.join("programs"));
    let names = [format!("{number}.nc"), format!("O{number}.nc")];
    let folders = std::iter::once(folder).chain(store);
    let mut files = folders.flat_map(|folder| names.clone().map(|name| folder.join(name)));
    files.find(|path| path.is_file())
}
