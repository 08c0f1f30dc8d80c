//! `tandem serve`: the machine with all its server ends.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use plc_api::Plc;
use plc_protocol::server::ServedPort;
use tandem_gateway::{Gateway, GatewayError, GatewaySettings, HTTP_LISTEN};
use tandem_runtime::{Config, ExternalBroker, Runtime, demo_sequence_program, open_demo};
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::server_ends::Servable;
use super::{CommandResult, EXIT_OK, print_line};

#[derive(Args)]
pub struct ServeArguments {
    /// Configuration file; without it, the built-in demo machine runs
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address of the HMI and REST, overrides listen in the table http; the demo uses a free port if 8080 is in use
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<String>,
    /// Address of the embedded broker, overrides listen in the table mqtt; the demo uses a free port if 1883 is in use
    #[arg(long, value_name = "ADDRESS")]
    mqtt_listen: Option<String>,
    /// Folder for persistent data, overrides that of the configuration
    #[arg(long, value_name = "FOLDER")]
    data_dir: Option<PathBuf>,
    /// Runs the demo's handlers, also with another configuration
    #[arg(long)]
    demo: bool,
}

impl ServeArguments {
    /// Overrides settings of the configuration with the arguments.
    fn change(&self, config: &mut Config) -> anyhow::Result<()> {
        if let Some(listen) = &self.listen {
            config.http.listen.clone_from(listen);
        }
        if let Some(listen) = &self.mqtt_listen {
            config.mqtt.listen = Some(listen.clone());
        }
        if let Some(folder) = &self.data_dir {
            // The path is relative to the current folder, not to the folder of the configuration.
            config.machine.data_dir = std::path::absolute(folder)?;
        }
        config.is_demo |= self.demo;
        Ok(())
    }

    /// Opens the server ends. If a default port of the built-in demo is in use, a free port replaces it. Also
    /// returns the addresses of the replaced listeners.
    async fn open(
        &self,
        port: Arc<dyn ServedPort>,
        mut settings: GatewaySettings,
    ) -> Result<(Gateway, Vec<SocketAddr>), GatewayError> {
        let mut taken = Vec::new();
        loop {
            let (setting, address) = match Gateway::start(Arc::clone(&port), settings.clone()).await {
                Err(GatewayError::PortTaken { setting, address }) if self.leaves_open(setting) => {
                    (setting, address)
                }
                opened => return opened.map(|gateway| (gateway, taken)),
            };
            let free = SocketAddr::new(address.ip(), 0).to_string();
            if setting == HTTP_LISTEN {
                settings.http_listen = free;
            } else {
                settings.mqtt.embedded_listen = Some(free);
            }
            taken.push(address);
        }
    }

    /// Returns true for a listener of the built-in demo if the user has given no address for it.
    fn leaves_open(&self, setting: &str) -> bool {
        let named = if setting == HTTP_LISTEN {
            &self.listen
        } else {
            &self.mqtt_listen
        };
        self.config.is_none() && named.is_none()
    }
}

/// Exit code after a stop because of an internal fault, so that a service manager starts the runtime again.
const EXIT_FAULT: u8 = 70;

pub(super) fn run(arguments: &ServeArguments) -> CommandResult {
    super::log::start();
    let servable = Servable::read(arguments.config.as_deref(), |config| arguments.change(config))?;
    let is_in_order = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(anyhow::Error::from)
        .and_then(|executor| executor.block_on(serve(servable, arguments)))
        .map_err(|error| anyhow::anyhow!("tandem does not start: {error}"))?;
    Ok(if is_in_order { EXIT_OK } else { EXIT_FAULT })
}

/// Serves the machine until it stops. Returns false if a fault has stopped it.
async fn serve(servable: Servable, arguments: &ServeArguments) -> anyhow::Result<bool> {
    let mut signals = Signals::listen()?;
    let Servable { config, settings, .. } = servable;
    let is_demo = config.is_demo;
    let runtime = Runtime::start(config).await?;
    let (gateway, taken) = match arguments.open(runtime.served_port(), settings.clone()).await {
        Ok(open) => open,
        Err(error) => {
            runtime.shutdown().await;
            return Err(error.into());
        }
    };
    let plc = Plc::in_process(runtime.port());
    let supervisor = runtime.served_port().supervisor();
    let sequence = run_demo(plc, arguments.config.is_none());
    let sequence =
        is_demo.then(|| tokio::spawn(supervisor.contained("sequence program of the demo", sequence)));
    let _memory = super::memory::give_back();
    announce(&settings, &gateway, is_demo);
    for address in taken {
        print_line(format!(
            "{address} is in use by another program; the demo uses a free port instead."
        ));
    }
    let failed = until_stop(&runtime, &gateway, &mut signals).await;
    print_line("Stopping: the axes decelerate along the path.");
    runtime.shutdown().await;
    if let Some(sequence) = sequence {
        sequence.abort();
    }
    gateway.shutdown().await;
    Ok(failed.is_none())
}

/// Serves until a signal or a fault requires a stop. Returns the description of the fault.
async fn until_stop(runtime: &Runtime, gateway: &Gateway, signals: &mut Signals) -> Option<String> {
    loop {
        let received = tokio::select! {
            received = signals.received() => received,
            why = runtime.failed() => {
                tracing::error!("the runtime stops after a fault: {why}");
                return Some(why);
            }
        };
        match received {
            ProcessSignal::Stop => return None,
            ProcessSignal::HangUp => {
                tracing::warn!("SIGHUP: the token file is read again; SIGTERM stops the machine");
                gateway.read_tokens_again();
            }
        }
    }
}

/// Runs the handlers of the demo. If the machine is the built-in one, also loads a program.
async fn run_demo(plc: Plc, is_built_in: bool) {
    let opening = async {
        if is_built_in && let Err(error) = open_demo(&plc).await {
            tracing::warn!("the demo starts without a loaded program: {error}");
        }
    };
    let (ran, ()) = tokio::join!(demo_sequence_program().run(&plc), opening);
    if let Err(error) = ran {
        tracing::error!("the demo sequence program ended: {error}");
    }
}

fn announce(settings: &GatewaySettings, gateway: &Gateway, is_demo: bool) {
    let (scheme, of_broker) = if settings.tls.is_some() {
        ("https", "mqtts")
    } else {
        ("http", "mqtt")
    };
    let http = format!("{scheme}://{}", gateway.http_addr());
    let broker = if let Some(address) = gateway.mqtt_addr() {
        format!("{of_broker}://{address}  (embedded broker)")
    } else {
        let nodes = settings.mqtt.brokers.iter().map(|(host, port)| {
            let node = ExternalBroker {
                tls: settings.mqtt.tls.is_some(),
                host: host.clone(),
                port: *port,
            };
            node.to_string()
        });
        nodes.collect::<Vec<_>>().join(" or ")
    };
    let prefix = match settings.mqtt.prefix.as_str() {
        "" => String::new(),
        prefix => format!("{prefix}/"),
    };
    let machine = &settings.machine;
    print_line(format!(
        "Tandem {} runs machine {machine}.\n  HMI    {http}/\n  REST   {http}/api/v1/machine\n  MQTT   {broker}  topics {prefix}tandem/v1/{machine}/#",
        env!("CARGO_PKG_VERSION")
    ));
    if is_demo {
        let system = format!("{http}/api/v1/cs/1");
        print_line(format!(
            "\nTry it: open the HMI and press Start. Or:\n  curl -X POST {system}/load -H 'Content-Type: application/json' -d '{{\"program\": 1}}'\n  curl -X POST {system}/start\n  curl {system}/state\nFor the part transfer load 3 in coordinate system 1 and 20 in 2, and start both."
        ));
    }
    print_line("Ctrl-C stops it.");
}

/// Signals that this process has received since its start. Without this, an early signal would kill the
/// process without an orderly stop.
pub(super) struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hang_up: Signal,
}

pub(super) enum ProcessSignal {
    /// Ctrl-C or SIGTERM: an orderly stop.
    Stop,
    /// SIGHUP: the runtime reads files again, as other servers do. A closed terminal also sends it, which
    /// must not stop a machine.
    HangUp,
}

impl Signals {
    pub(super) fn listen() -> std::io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
        })
    }

    pub(super) async fn received(&mut self) -> ProcessSignal {
        tokio::select! {
            _ = self.interrupt.recv() => ProcessSignal::Stop,
            _ = self.terminate.recv() => ProcessSignal::Stop,
            _ = self.hang_up.recv() => ProcessSignal::HangUp,
        }
    }
}
