//! `tandem token`: creates a token for an HMI, a sequence program or another system.

use std::fs::OpenOptions;
use std::io::{self, BufRead as _, IsTerminal as _, Read as _, Write};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Error};
use clap::Args;
use clap::builder::PossibleValuesParser;
use tandem_gateway::{Role, Tokens, new_token, pin_entry};
use tandem_runtime::data_folder::DataFolder;

use super::os_user::os_user;
use super::{CommandResult, EXIT_FOUND, EXIT_OK, complain, print_line, read_config};

/// Maximum size of the line with a PIN, bytes.
const PIN_LINE_MAX: u64 = 1024;

/// Number of seconds in a day.
pub(super) const DAY_S: u64 = 24 * 60 * 60;

#[derive(Args)]
pub struct TokenArguments {
    /// Name of the user, also the user name on MQTT
    name: String,
    /// Rights of the user
    #[arg(long, value_parser = PossibleValuesParser::new(Role::ALL.map(|(word, _)| word)))]
    role: String,
    /// Token file to append the entry to; created with mode 0600 if it does not exist
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
    /// Validity in days; default: unlimited
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=3650))]
    days: Option<u64>,
    /// Configuration of the machine whose journal records the token; the machine must not run
    #[arg(long, value_name = "FILE", requires = "file")]
    config: Option<PathBuf>,
    /// Creates the entry of a person, with a PIN from standard input instead of a token; for `POST
    /// /api/v1/login` and the HMI
    #[arg(long)]
    pin: bool,
}

pub(super) fn run(arguments: &TokenArguments) -> CommandResult {
    let name = &arguments.name;
    let role = Role::of_name(&arguments.role);
    let role = role.with_context(|| format!("there is no role {}", arguments.role))?;
    let until = arguments
        .days
        .map(|days| SystemTime::now() + Duration::from_secs(days * DAY_S));
    if arguments.pin {
        return of_person(arguments, role, until);
    }
    let new = new_token(name, role, until).map_err(Error::msg)?;
    let Some(path) = &arguments.file else {
        print_line(format!(
            "token: {}\nThe token is shown only once. Its entry for the token file:\n\n{}",
            new.token,
            new.entry.trim_end()
        ));
        return Ok(EXIT_OK);
    };
    let shown = path.display();
    if is_known(path, name)? {
        complain(format!(
            "{shown} has a token {name} already; remove its entry, or choose another name"
        ));
        return Ok(EXIT_FOUND);
    }
    add_entry(path, &new.entry)?;
    record_in_journal(arguments.config.as_deref(), &command(arguments));
    print_line(format!(
        "token: {}\nThe token is shown only once. Its entry is in {shown}; a running runtime with this file \
         reads \
         the entry within 5 s.",
        new.token
    ));
    Ok(EXIT_OK)
}

/// Creates the entry of a person in the token file; the PIN is the first line of standard input.
fn of_person(arguments: &TokenArguments, role: Role, until: Option<SystemTime>) -> CommandResult {
    let name = &arguments.name;
    if let Some(path) = arguments.file.as_ref().filter(|_| io::stdin().is_terminal()) {
        complain(format!(
            "PIN of {name} for {} (it is shown as you type):",
            path.display()
        ));
    }
    let mut pin = String::new();
    io::stdin()
        .lock()
        .take(PIN_LINE_MAX)
        .read_line(&mut pin)
        .context("cannot read the PIN")?;
    let entry = pin_entry(name, role, pin.trim_end_matches(['\r', '\n']), until).map_err(Error::msg)?;
    let Some(path) = &arguments.file else {
        print_line(entry.trim_end());
        return Ok(EXIT_OK);
    };
    if is_known(path, name)? {
        complain(format!(
            "{} has an entry {name} already; remove it, or choose another name",
            path.display()
        ));
        return Ok(EXIT_FOUND);
    }
    add_entry(path, &entry)?;
    record_in_journal(arguments.config.as_deref(), &command(arguments));
    print_line(format!(
        "{} has the entry of {name}; a running runtime with this token file reads it within 5 s.",
        path.display()
    ));
    Ok(EXIT_OK)
}

/// Returns the command in the form in which the journal records it.
fn command(arguments: &TokenArguments) -> String {
    let TokenArguments { name, role, pin, .. } = arguments;
    let pin = if *pin { " --pin" } else { "" };
    format!("tandem token {name} --role {role}{pin}")
}

/// Records a command that grants access in the journal of a machine. If this fails, prints the reason.
pub(super) fn record_in_journal(config: Option<&Path>, command: &str) {
    let Some(path) = config else {
        complain("This command is in no journal: --config names the machine whose journal records it.");
        return;
    };
    let told = read_config(Some(path))
        .and_then(|(_, machine)| Ok(DataFolder::record_in(&machine.stored(), os_user(), command)?));
    match told {
        Ok(true) => {}
        Ok(false) => complain("This command is in no journal: the machine has no journal yet."),
        Err(error) => complain(format!("The journal does not record this command: {error:#}.")),
    }
}

/// Returns true if the token file contains an entry with this name.
pub(super) fn is_known(path: &Path, name: &str) -> anyhow::Result<bool> {
    if !path.exists() {
        return Ok(false);
    }
    let tokens = Tokens::read(path).map_err(Error::msg)?;
    Ok(tokens.users().any(|(known, _)| known == name))
}

/// Appends an entry to the token file; creates the file if it does not exist.
pub(super) fn add_entry(path: &Path, entry: &str) -> anyhow::Result<()> {
    let gap = if path.exists() { "\n" } else { "" };
    append(path, &format!("{gap}{entry}")).with_context(|| format!("cannot write {}", path.display()))
}

fn append(path: &Path, entry: &str) -> io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options.append(true).create(true).mode(0o600).open(path)?;
    file.write_all(entry.as_bytes())?;
    file.sync_all()
}
