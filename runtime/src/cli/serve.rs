//! `tandem serve`: the machine with all its server ends.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use plc_api::{Plc, TlsFiles};
use tandem_gateway::{Gateway, GatewaySettings, MqttSettings, Tokens};
use tandem_runtime::{Config, Runtime, demo_sequence_program};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing_subscriber::EnvFilter;

use super::{EXIT_OK, EXIT_UNREADABLE, complain, read_config, say};

#[derive(Args)]
pub struct Arguments {
    /// Configuration file; without one the built-in demo machine runs
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> u8 {
    let filter =
        EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn,journal=info,mqtt5=error"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr)
        .init();
    let config = match read_config(arguments.config.as_deref()) {
        Ok((config, _)) => config,
        Err(text) => {
            complain(text);
            return EXIT_UNREADABLE;
        }
    };
    let served = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(anyhow::Error::from)
        .and_then(|executor| executor.block_on(serve(config)));
    match served {
        Ok(()) => EXIT_OK,
        Err(error) => {
            complain(format!("tandem does not start: {error:#}"));
            EXIT_UNREADABLE
        }
    }
}

async fn serve(config: Config) -> anyhow::Result<()> {
    let mut signals = Signals::listen()?;
    let settings = gateway_settings(&config)?;
    let is_demo = config.is_demo;
    let runtime = Runtime::start(config).await?;
    let gateway = match Gateway::start(runtime.port(), settings.clone()).await {
        Ok(gateway) => gateway,
        Err(error) => {
            runtime.shutdown().await;
            return Err(error.into());
        }
    };
    let sequence = is_demo.then(|| {
        let plc = Plc::in_process(runtime.port());
        tokio::spawn(async move {
            if let Err(error) = demo_sequence_program().run(&plc).await {
                tracing::error!("the demo sequence program ended: {error}");
            }
        })
    });
    announce(&settings, &gateway, is_demo);
    signals.received().await;
    say("Stopping: motion comes to rest on its path.");
    runtime.shutdown().await;
    if let Some(sequence) = sequence {
        sequence.abort();
    }
    gateway.shutdown().await;
    Ok(())
}

fn gateway_settings(config: &Config) -> anyhow::Result<GatewaySettings> {
    let tokens = match &config.http.token_file {
        None => None,
        Some(path) => {
            let tokens = Tokens::read(&config.base_dir.join(path)).context("[http] token_file")?;
            Some(Arc::new(tokens))
        }
    };
    Ok(GatewaySettings {
        machine: config.machine.name.clone(),
        http_listen: config.http.listen.clone(),
        mqtt: mqtt_settings(config)?,
        tokens,
        ..GatewaySettings::default()
    })
}

/// `[mqtt]`, with the files that it names.
pub(super) fn mqtt_settings(config: &Config) -> anyhow::Result<MqttSettings> {
    let mqtt = &config.mqtt;
    let read = |key: &str, path: &Path| {
        let path = config.base_dir.join(path);
        std::fs::read_to_string(&path)
            .map_err(|error| anyhow::anyhow!("[mqtt] {key} = \"{}\": {error}", path.display()))
    };
    let password = match &mqtt.password_file {
        None => None,
        Some(path) => Some(read("password_file", path)?.trim_end().to_owned()),
    };
    let external = mqtt.broker.split_once("://");
    let (embedded_listen, host, port) = match external {
        None => (Some(mqtt.listen.clone()), String::new(), 0),
        Some((scheme, address)) => {
            let default = if scheme == "mqtts" { "8883" } else { "1883" };
            let (host, port) = address.rsplit_once(':').unwrap_or((address, default));
            let port = port
                .parse()
                .map_err(|_| anyhow::anyhow!("[mqtt] broker = \"{}\": {port} is not a port", mqtt.broker))?;
            (None, host.to_owned(), port)
        }
    };
    let file = |path: &Option<PathBuf>| path.as_ref().map(|path| config.base_dir.join(path));
    let tls = mqtt.broker.starts_with("mqtts://").then(|| TlsFiles {
        ca_file: file(&mqtt.ca_file),
        client_cert_file: file(&mqtt.client_cert_file),
        client_key_file: file(&mqtt.client_key_file),
    });
    Ok(MqttSettings {
        embedded_listen,
        host,
        port,
        tls,
        username: mqtt.username.clone(),
        password,
        prefix: mqtt.prefix.clone(),
        ..MqttSettings::default()
    })
}

fn announce(settings: &GatewaySettings, gateway: &Gateway, is_demo: bool) {
    let http = gateway.http_addr();
    let broker = if let Some(address) = gateway.mqtt_addr() {
        format!("mqtt://{address}  (embedded broker)")
    } else {
        let scheme = settings.mqtt.tls.as_ref().map_or("mqtt", |_| "mqtts");
        format!("{scheme}://{}:{}", settings.mqtt.host, settings.mqtt.port)
    };
    let prefix = match settings.mqtt.prefix.as_str() {
        "" => String::new(),
        prefix => format!("{prefix}/"),
    };
    let machine = &settings.machine;
    say(&format!(
        "Tandem {} runs machine {machine}.",
        env!("CARGO_PKG_VERSION")
    ));
    say(&format!("  HMI    http://{http}/"));
    say(&format!("  REST   http://{http}/api/v1/machine"));
    say(&format!(
        "  MQTT   {broker}  topics {prefix}tandem/v1/{machine}/#"
    ));
    if is_demo {
        let post = |what: &str| format!("  curl -X POST http://{http}/api/v1/cs/1/{what}");
        say("");
        say("Try it: open the HMI, load program 1 and press Start. Or:");
        say(&format!(
            "{} -H 'Content-Type: application/json' -d '{{\"program\": 1}}'",
            post("load")
        ));
        say(&post("start"));
        say(&format!("  curl http://{http}/api/v1/cs/1/state"));
        say("For the part transfer load 3 in coordinate system 1 and 20 in 2, and start both.");
    }
    say("Ctrl-C stops it.");
}

/// Ctrl-C and SIGTERM, listened for from the start: a signal that comes early must not end the process out of order.
struct Signals {
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    fn listen() -> std::io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    async fn received(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}
