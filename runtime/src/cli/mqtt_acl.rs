//! `tandem mqtt-acl`: prints the access rules of the token file for an external Mosquitto.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use clap::Args;
use tandem_gateway::mosquitto_acl;

use super::server_ends::settings;
use super::{CommandResult, EXIT_OK, print_line, read_config};

#[derive(Args)]
pub struct MqttAclArguments {
    /// Configuration file, for the machine's name, the topic prefix, the runtime's user and the token file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

pub(super) fn run(arguments: &MqttAclArguments) -> CommandResult {
    let (config, _) = read_config(Some(&arguments.config))?;
    let (settings, problems) = settings(&config);
    ensure!(problems.is_empty(), problems.join("\n"));
    let tokens = settings.tokens.as_ref().context(
        "[http] token_file is not set: there are no users; run tandem token NAME --role ROLE --file FILE",
    )?;
    let root = settings.mqtt.root(&settings.machine);
    print_line(mosquitto_acl(&root, settings.mqtt.username.as_deref(), tokens).trim_end());
    Ok(EXIT_OK)
}
