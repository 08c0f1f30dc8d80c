//! `tandem token`: makes a token for an HMI, a sequence program or another system.

use std::io::Write;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::PossibleValuesParser;
use tandem_gateway::{Role, Tokens, new_token};

use super::{EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, complain, say};

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

pub(super) fn run(arguments: &Arguments) -> u8 {
    let Some(role) = Role::of_word(&arguments.role) else {
        complain(format!("there is no role {}", arguments.role));
        return EXIT_UNREADABLE;
    };
    let new = match new_token(&arguments.name, role) {
        Ok(new) => new,
        Err(error) => {
            complain(error);
            return EXIT_UNREADABLE;
        }
    };
    match &arguments.file {
        None => {
            say(&format!("token: {}", new.token));
            say("It is shown once. Its entry of the token file:");
            say("");
            say(new.entry.trim_end());
        }
        Some(path) => {
            if let Err((code, text)) = append(path, &arguments.name, &new.entry) {
                complain(text);
                return code;
            }
            say(&format!("token: {}", new.token));
            say(&format!(
                "It is shown once. {} has its entry; a runtime that runs with the file reads it within 5 s.",
                path.display()
            ));
        }
    }
    EXIT_OK
}

/// Appends an entry to a token file that stays one.
fn append(path: &Path, name: &str, entry: &str) -> Result<(), (u8, String)> {
    let exists = path.exists();
    if exists {
        let tokens = Tokens::read(path).map_err(|error| (EXIT_UNREADABLE, error.to_string()))?;
        if tokens.users().any(|(known, _)| known == name) {
            let text = format!(
                "{} has a token {name} already; remove its entry, or choose another name",
                path.display()
            );
            return Err((EXIT_FOUND, text));
        }
    }
    let write = || {
        let mut file = std::fs::OpenOptions::new()
            .append(true)
            .create(true)
            .mode(0o600)
            .open(path)?;
        let gap = if exists { "\n" } else { "" };
        file.write_all(format!("{gap}{entry}").as_bytes())?;
        file.sync_all()
    };
    write().map_err(|error| {
        (
            EXIT_UNREADABLE,
            format!("cannot write {}: {error}", path.display()),
        )
    })
}
