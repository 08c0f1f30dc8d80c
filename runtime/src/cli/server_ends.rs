//! Reads the tables `[http]` and `[mqtt]` of a configuration, with the files that they name. `check` and
//! `serve` share this code, so `serve` starts with each configuration that `check` accepts.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use plc_api::TlsFiles;
use plc_protocol::wire::hmi::Hmi;
use tandem_gateway::{
    GatewayError, GatewaySettings, HmiSettings, MqttSettings, MtconnectSettings, ServerTls, Tokens,
};
use tandem_runtime::{Broker, Config, Machine, StartError};

use super::read_config;

/// Default address of the embedded broker.
const MQTT_LISTEN_DEFAULT: &str = "127.0.0.1:1883";

/// A configuration that can be served.
pub(super) struct Servable {
    pub(super) config: Config,
    pub(super) machine: Machine,
    pub(super) settings: GatewaySettings,
}

impl Servable {
    /// Reads the configuration of a file, or of the demo machine, with all files that it names, and applies
    /// `change` to it. Writes no file and opens no port.
    ///
    /// # Errors
    /// Returns all problems as text for a person.
    pub(super) fn read(
        path: Option<&Path>,
        change: impl FnOnce(&mut Config) -> anyhow::Result<()>,
    ) -> anyhow::Result<Self> {
        let (mut config, _) = read_config(path)?;
        change(&mut config)?;
        let machine = config.resolve()?;
        let (settings, mut problems) = settings(&config);
        if let Some(folder) = &machine.data_dir
            && let Some(there) = folder.ancestors().find(|path| path.exists())
            && !there.is_dir()
        {
            problems.push(format!(
                "[machine] data_dir = \"{}\": {} is not a folder",
                folder.display(),
                there.display()
            ));
        }
        let programs = StartError::of_unreadable_programs(&machine);
        problems.extend(programs.iter().map(ToString::to_string));
        if !problems.is_empty() {
            let place = path.map_or_else(String::new, |path| format!("{}: ", path.display()));
            let problems = problems.join("\n  ");
            anyhow::bail!("{place}the configuration cannot be served:\n  {problems}");
        }
        Ok(Self {
            config,
            machine,
            settings,
        })
    }
}

/// Returns the settings of the server ends and all problems in them.
pub(super) fn settings(config: &Config) -> (GatewaySettings, Vec<String>) {
    let mut problems = Vec::new();
    let file = &config.http.token_file;
    let tokens = file.as_ref().and_then(|file| {
        let tokens = Tokens::read(&config.base_dir.join(file));
        let tokens = tokens.map_err(|error| problems.push(format!("[http] token_file: {error}")));
        tokens.ok().map(Arc::new)
    });
    let tokens_missing = file.is_some() && tokens.is_none();
    let settings = GatewaySettings {
        machine: config.machine.name.clone(),
        http_listen: config.http.listen.clone(),
        tls: config.tls.as_ref().map(|tls| ServerTls {
            cert_file: config.base_dir.join(&tls.cert_file),
            key_file: config.base_dir.join(&tls.key_file),
        }),
        mqtt: mqtt_settings(config, &mut problems),
        tokens,
        mtconnect: config.mtconnect.as_ref().map(|mtconnect| MtconnectSettings {
            version: mtconnect.version,
            emergency_stop: mtconnect.emergency_stop.clone(),
            shdr_listen: mtconnect.shdr_listen.clone(),
        }),
        login_idle: (config.http.login_idle_s > 0)
            .then(|| Duration::from_secs(config.http.login_idle_s.into())),
        allow_origins: config.http.allow_origins.clone(),
        public_url: config.http.public_url.clone(),
        hmi: hmi_settings(config),
        ..GatewaySettings::default()
    };
    let found = settings.problems();
    // Errors that only follow from an unreadable token file are not reported.
    let found = found
        .iter()
        .filter(|problem| !(tokens_missing && matches!(problem, GatewayError::NotLoopback { .. })));
    problems.extend(found.map(ToString::to_string));
    (settings, problems)
}

/// Returns the additions to the HMI, and the files and folders that the HMI server must not serve.
fn hmi_settings(config: &Config) -> HmiSettings {
    let in_folder = |path: &PathBuf| config.base_dir.join(path);
    let secrets = [
        Some(&config.machine.data_dir),
        config.http.token_file.as_ref(),
        config.mqtt.password_file.as_ref(),
        config.mqtt.client_key_file.as_ref(),
        config.tls.as_ref().map(|tls| &tls.key_file),
    ];
    HmiSettings {
        dir: config.hmi.dir.as_ref().map(in_folder),
        machines: config.hmi.machines.clone(),
        secrets: secrets.into_iter().flatten().map(in_folder).collect(),
        stop_without_login: config.hmi.stop_without_login,
        added: Hmi {
            jog_step_max: config.hmi.jog_step_max,
            buttons: config.hmi.button.clone(),
            cards: config.hmi.card.clone(),
        },
    }
}

fn mqtt_settings(config: &Config, problems: &mut Vec<String>) -> MqttSettings {
    let mqtt = &config.mqtt;
    let in_folder = |path: &PathBuf| config.base_dir.join(path);
    let password = mqtt.password_file.as_ref().map(in_folder).and_then(|path| {
        let read = std::fs::read_to_string(&path).map_err(|error| {
            problems.push(format!("[mqtt] password_file = \"{}\": {error}", path.display()));
        });
        read.ok().map(|text| text.trim_end().to_owned())
    });
    let settings = MqttSettings {
        username: mqtt.username.clone(),
        password,
        prefix: mqtt.prefix.clone(),
        websocket: mqtt.websocket,
        accept_unverified_senders: mqtt.accept_unverified_senders,
        ..MqttSettings::default()
    };
    match &mqtt.broker {
        Broker::External(nodes) => MqttSettings {
            embedded_listen: None,
            brokers: nodes.iter().map(|node| (node.host.clone(), node.port)).collect(),
            tls: nodes.iter().any(|node| node.tls).then(|| TlsFiles {
                ca_file: mqtt.ca_file.as_ref().map(in_folder),
                client_cert_file: mqtt.client_cert_file.as_ref().map(in_folder),
                client_key_file: mqtt.client_key_file.as_ref().map(in_folder),
            }),
            ..settings
        },
        Broker::Embedded => {
            let listen = mqtt.listen.as_deref().unwrap_or(MQTT_LISTEN_DEFAULT);
            MqttSettings {
                embedded_listen: Some(listen.to_owned()),
                ..settings
            }
        }
    }
}
