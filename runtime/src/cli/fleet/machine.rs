//! One machine of a fleet, its handler and its HMI.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context;
use parking_lot::Mutex;
use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{HandshakeStatus, OutputAct};
use plc_protocol::types::request::typed::{Handlers, WriteProgram};
use plc_protocol::types::state::Reason;
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_gateway::{Gateway, GatewaySettings};
use tandem_runtime::{Config, Runtime};
use tokio_util::task::AbortOnDropHandle;

use super::super::server_ends::settings;

/// Program of each machine, with placeholders for the number of loops and the duration of the waits.
const PROGRAM: &str = include_str!("fleet.nc");

/// Time for the motion of the program between two M codes.
const WAY: Duration = Duration::from_millis(200);

/// M code that the programs output.
const M_CODE: u16 = 100;

/// Maximum time until the handler of a machine is registered.
const PATIENCE: Duration = Duration::from_mins(2);

/// Settings that all machines of a fleet share.
pub(super) struct Order<'a> {
    pub(super) broker: &'a str,
    pub(super) folder: &'a Path,
    pub(super) servo_period_us: u64,
    pub(super) servo_late_ms: u64,
    /// Time from one M code to the next of a machine.
    pub(super) interval: Duration,
    pub(super) run_s: u32,
}

impl Order<'_> {
    /// Returns the text of a configuration for a machine with three linear axes.
    fn config(&self, name: &str) -> String {
        let motor = |number| {
            format!(
                "[[motor]]\nnumber = {number}\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n"
            )
        };
        let scheme_end = self.broker.find("://").map_or(0, |at| at + 3);
        let (scheme, nodes) = self.broker.split_at(scheme_end);
        let nodes: Vec<_> = nodes
            .split(',')
            .map(|node| format!("\"{scheme}{node}\""))
            .collect();
        format!(
            "[machine]\nname = \"{name}\"\nservo_period_us = {}\nservo_late_ms = {}\ndata_dir = \"{name}\"\n{}{}{}\
             [[coordinate_system]]\nnumber = 1\naxes = {{ X = 1, Y = 2, Z = 3 }}\n\
             [http]\nlisten = \"127.0.0.1:0\"\n[mqtt]\nbroker = [{}]\n",
            self.servo_period_us,
            self.servo_late_ms,
            motor(1),
            motor(2),
            motor(3),
            nodes.join(", ")
        )
    }

    /// Returns the settings of a machine with this name.
    fn settings(&self, name: &str) -> anyhow::Result<(Config, GatewaySettings)> {
        let config = Config::from_toml(&self.config(name), self.folder)?;
        let (settings, problems) = settings(&config);
        anyhow::ensure!(problems.is_empty(), "{}", problems.join("; "));
        Ok((config, settings))
    }

    /// Returns host and port of each node of the broker.
    pub(super) fn nodes(&self) -> anyhow::Result<Vec<(String, u16)>> {
        Ok(self.settings("fleet")?.1.mqtt.brokers)
    }

    /// Returns the text of the NC program. Each of its loops has two M codes. The loops last for the
    /// measurement and for the time in which the other machines start.
    fn program(&self) -> String {
        let dwell = self.interval.saturating_sub(WAY);
        let rounds = f64::from(self.run_s) / self.interval.as_secs_f64() / 2.0;
        PROGRAM
            .replace("{dwell_ms}", &dwell.as_millis().to_string())
            .replace("{rounds}", &(rounds.ceil() + 2.0).to_string())
    }
}

/// Counters of one machine, or the sums of all machines.
#[derive(Debug, Default)]
pub(super) struct FleetCounters {
    /// Time from each output to its reset, s.
    pub(super) m_code_s: Vec<f64>,
    /// Number of messages that the HMI has received.
    pub(super) messages: u64,
    pub(super) cycles: u64,
    pub(super) missed_cycles: u64,
    /// Number of machines whose program is not running.
    pub(super) stopped: u64,
    pub(super) handlers_lost: u64,
}

impl FleetCounters {
    pub(super) fn add(&mut self, mut other: FleetCounters) {
        self.m_code_s.append(&mut other.m_code_s);
        self.messages += other.messages;
        self.cycles += other.cycles;
        self.missed_cycles += other.missed_cycles;
        self.stopped += other.stopped;
        self.handlers_lost += other.handlers_lost;
    }
}

/// Counters of one machine since the beginning of the measurement.
#[derive(Debug, Default)]
struct Counts {
    messages: AtomicU64,
    handlers_lost: AtomicU64,
    m_code_s: Mutex<Vec<f64>>,
}

pub(super) struct FleetMachine {
    runtime: Runtime,
    gateway: Gateway,
    plc: Plc,
    counts: Arc<Counts>,
    before: Mutex<(u64, u64)>,
    _beside: [AbortOnDropHandle<()>; 3],
}

async fn at_once(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

impl FleetMachine {
    /// Starts the machine. Waits until the handler is registered and the HMI has received the states.
    pub(super) async fn start(order: &Order<'_>, number: u64) -> anyhow::Result<Self> {
        let name = format!("fleet-{number}");
        let (config, settings) = order.settings(&name)?;
        let runtime = Runtime::start(config).await?;
        let gateway = Gateway::start(runtime.served_port(), settings).await?;
        let plc = Plc::in_process(runtime.port());
        let address = format!("{}/{name}", order.broker);
        let (handlers, hmi) = (connect(&address).await?, connect(&address).await?);
        let counts = Arc::<Counts>::default();
        let serving = tokio::spawn(async move {
            let program = SequenceProgram::new().handler_id("fleet").on(M_CODE, at_once);
            if let Err(error) = program.run(&handlers).await {
                tracing::error!("the handler of a machine of the fleet ended: {error}");
            }
        });
        let reading = tokio::spawn(read(hmi.port().subscribe(Filter::All), Arc::clone(&counts), hmi));
        let handshake = [CsTopic::Output(M_CODE), CsTopic::Result(M_CODE), CsTopic::State];
        let handshake = handshake.map(|topic| Topic::cs(1, topic)).to_vec();
        let handshake = plc.port().subscribe(Filter::Topics(handshake));
        let timing = tokio::spawn(time(handshake, Arc::clone(&counts)));
        tokio::time::timeout(PATIENCE, until_served(&plc))
            .await
            .with_context(|| format!("{name}: its handler is not known after {} s", PATIENCE.as_secs()))??;
        plc.port().ask(WriteProgram(1, order.program())).await?;
        plc.coordinate_system(1).load(1).await?;
        Ok(Self {
            runtime,
            gateway,
            plc,
            counts,
            before: Mutex::default(),
            _beside: [serving, reading, timing].map(AbortOnDropHandle::new),
        })
    }

    /// Starts the program of the machine.
    pub(super) async fn run(&self) -> anyhow::Result<()> {
        Ok(self.plc.coordinate_system(1).start().await?)
    }

    pub(super) fn begin_to_count(&self) {
        self.counts.messages.store(0, Ordering::Relaxed);
        self.counts.handlers_lost.store(0, Ordering::Relaxed);
        self.counts.m_code_s.lock().clear();
        *self.before.lock() = self.servo();
    }

    /// Returns the number of servo cycles, and the number of missed ones.
    fn servo(&self) -> (u64, u64) {
        let timing = self.runtime.served_port().servo_timing();
        timing.map_or((0, 0), |timing| {
            let cycles = timing.lateness.buckets.iter().map(|(_, count)| count).sum();
            (cycles, timing.missed)
        })
    }

    pub(super) async fn counted(&self) -> anyhow::Result<FleetCounters> {
        let state = self.plc.coordinate_system(1).state().await?;
        let is_running = matches!(state.execution, Execution::Active | Execution::Wait);
        let (before, now) = (*self.before.lock(), self.servo());
        Ok(FleetCounters {
            m_code_s: std::mem::take(&mut *self.counts.m_code_s.lock()),
            messages: self.counts.messages.load(Ordering::Relaxed),
            cycles: now.0 - before.0,
            missed_cycles: now.1 - before.1,
            stopped: u64::from(!is_running),
            handlers_lost: self.counts.handlers_lost.load(Ordering::Relaxed),
        })
    }

    pub(super) async fn stop(self) {
        self.runtime.shutdown().await;
        self.gateway.shutdown().await;
    }
}

/// Connects to the machine, which may need some time to connect to its broker.
async fn connect(address: &str) -> anyhow::Result<Plc> {
    let end = Instant::now() + PATIENCE;
    loop {
        match Plc::connect(address).await {
            Err(error) if Instant::now() < end => tracing::debug!("{address}: {error}"),
            plc => return Ok(plc?),
        }
    }
}

/// Waits until the handler is registered at the machine.
async fn until_served(plc: &Plc) -> anyhow::Result<()> {
    loop {
        let handlers = plc.port().ask(Handlers).await?;
        if handlers.get("fleet").is_some_and(|handler| handler.online) {
            return Ok(());
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Reads all topics as an HMI does, and counts the messages.
async fn read(mut topics: Subscription, counts: Arc<Counts>, _connection: Plc) {
    while topics.next().await.is_some() {
        counts.messages.fetch_add(1, Ordering::Relaxed);
    }
}

/// Measures the time from each output to its reset, from the time stamps in the runtime's messages.
async fn time(mut topics: Subscription, counts: Arc<Counts>) {
    let mut open: Option<(u64, SystemTime)> = None;
    while let Some(message) = topics.next().await {
        let Message { payload, ts, .. } = &*message;
        match payload {
            Payload::Output(output) => open = ts.to_system_time().map(|at| (output.seq, at)),
            Payload::Result(result)
                if result.of == Some(OutputAct::Reset) && result.status == HandshakeStatus::Accepted =>
            {
                let took = open
                    .take()
                    .filter(|(seq, _)| *seq == result.seq)
                    .and_then(|(_, since)| {
                        let at = ts.to_system_time()?;
                        at.duration_since(since).ok()
                    });
                counts.m_code_s.lock().extend(took.map(|took| took.as_secs_f64()));
            }
            Payload::State(state) if state.reason == Some(Reason::HandlerLost) => {
                counts.handlers_lost.fetch_add(1, Ordering::Relaxed);
            }
            _ => {}
        }
    }
}
