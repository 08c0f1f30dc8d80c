//! `tandem mqtt-acl`: the access rules of the token file for an external Mosquitto.

use std::path::PathBuf;

use clap::Args;
use tandem_gateway::mosquitto_acl;

use super::server_ends::settings;
use super::{EXIT_OK, EXIT_UNREADABLE, complain, read_config, say};

#[derive(Args)]
pub struct Arguments {
    /// Configuration file, for the machine's name, the topic prefix, the runtime's user and the token file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> u8 {
    let made = read_config(Some(&arguments.config)).and_then(|(config, _)| {
        let (settings, problems) = settings(&config);
        if !problems.is_empty() {
            return Err(problems.join("\n"));
        }
        let tokens = settings.tokens.as_ref().ok_or(
            "[http] token_file is not set: there are no users; make one with tandem token NAME --role ROLE --file FILE",
        )?;
        let root = settings.mqtt.root(&settings.machine);
        Ok(mosquitto_acl(&root, settings.mqtt.username.as_deref(), tokens))
    });
    match made {
        Ok(text) => {
            say(text.trim_end());
            EXIT_OK
        }
        Err(text) => {
            complain(text);
            EXIT_UNREADABLE
        }
    }
}
