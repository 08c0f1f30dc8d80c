//! `tandem token`: makes a token for an HMI, a sequence program or another system.

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Error};
use clap::Args;
use clap::builder::PossibleValuesParser;
use tandem_gateway::{Role, Tokens, new_token};

use super::{EXIT_FOUND, EXIT_OK, Ran, complain, say};

#[derive(Args)]
pub struct Arguments {
    /// Name of the user: who it is, and the user name on MQTT
    name: String,
    /// What it may do
    #[arg(long, value_parser = PossibleValuesParser::new(Role::ALL.map(|(word, _)| word)))]
    role: String,
    /// Token file to append its entry to; made with mode 0600 where there is none
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Ran {
    let name = &arguments.name;
    let role = Role::of_word(&arguments.role);
    let role = role.with_context(|| format!("there is no role {}", arguments.role))?;
    let new = new_token(name, role).map_err(Error::msg)?;
    let Some(path) = &arguments.file else {
        say(format!(
            "token: {}\nIt is shown once. Its entry of the token file:\n\n{}",
            new.token,
            new.entry.trim_end()
        ));
        return Ok(EXIT_OK);
    };
    let shown = path.display();
    let exists = path.exists();
    let is_taken = |tokens: Tokens| tokens.users().any(|(known, _)| known == name);
    if exists && Tokens::read(path).map(is_taken).map_err(Error::msg)? {
        complain(format!(
            "{shown} has a token {name} already; remove its entry, or choose another name"
        ));
        return Ok(EXIT_FOUND);
    }
    let gap = if exists { "\n" } else { "" };
    append(path, &format!("{gap}{}", new.entry)).with_context(|| format!("cannot write {shown}"))?;
    say(format!(
        "token: {}\nIt is shown once. {shown} has its entry; a runtime that runs with the file reads it within 5 s.",
        new.token
    ));
    Ok(EXIT_OK)
}

fn append(path: &Path, entry: &str) -> io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options.append(true).create(true).mode(0o600).open(path)?;
    file.write_all(entry.as_bytes())?;
    file.sync_all()
}
