//! `tandem fleet`: runs many simulated machines at one broker, to find the size of broker and computer that they need.
//!
//! Each machine is complete, with servo thread, data folder, REST and MQTT. In addition, it has a handler
//! that resets its M codes and an HMI that reads all its topics, each with a separate connection to the
//! broker. All machines run in this process, so the load of a machine is the load of the process divided by
//! the number of machines.

mod broker;
mod machine;

use std::time::{Duration, Instant};

use anyhow::ensure;
use clap::Args;
use futures_util::future::try_join_all;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tandem_gateway::Usage;

use super::{CommandResult, EXIT_FOUND, EXIT_OK, complain, print_line};
use broker::await_broker;
use machine::{FleetCounters, FleetMachine, Order};

/// Maximum number of machines.
const MACHINES_MAX: u64 = 1000;

/// Number of files and sockets of one machine: three connections, a listener, its data folder, and the timers of its
/// threads.
const FILES_OF_MACHINE: u64 = 32;

/// Number of machines that are started at the same time. Reason: a broker accepts this number of new
/// connections without a backlog.
const AT_ONCE: usize = 8;

#[derive(Args)]
pub struct FleetArguments {
    /// Number of machines
    #[arg(long, value_name = "COUNT", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=MACHINES_MAX))]
    machines: u64,
    /// Broker of all machines: mqtt://HOST:PORT, with further nodes after commas
    #[arg(long, value_name = "ADDRESS", default_value = "mqtt://127.0.0.1:1883")]
    broker: String,
    /// M codes of each machine per minute
    #[arg(long, value_name = "COUNT", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=600))]
    m_codes_per_minute: u32,
    /// Duration of the measurement, which begins when all machines run
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,
    /// Servo period of each machine
    #[arg(long, value_name = "MICROSECONDS", default_value_t = 4000, value_parser = clap::value_parser!(u64).range(250..=100_000))]
    servo_period_us: u64,
    /// Greatest delay of a servo cycle in motion before the machine holds
    #[arg(long, value_name = "MILLISECONDS", default_value_t = 2000, value_parser = clap::value_parser!(u64).range(10..=60_000))]
    servo_late_ms: u64,
}

pub(super) fn run(arguments: &FleetArguments) -> CommandResult {
    super::log::start_with("error");
    allow_files(arguments.machines * FILES_OF_MACHINE + 256)?;
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(anyhow::Error::from)
        .and_then(|executor| executor.block_on(fleet(arguments)))
}

/// Raises the limit of open files to the wanted number, or to the maximum that this user may set.
fn allow_files(wanted: u64) -> anyhow::Result<()> {
    let limit = getrlimit(Resource::Nofile);
    if limit.current.is_none_or(|current| current >= wanted) {
        return Ok(());
    }
    let most = limit.maximum.unwrap_or(wanted);
    ensure!(
        most >= wanted,
        "the machines need {wanted} open files, and this user may have {most}: raise the \
         limit with ulimit -Hn, or run fewer machines"
    );
    let raised = Rlimit {
        current: Some(wanted),
        maximum: limit.maximum,
    };
    Ok(setrlimit(Resource::Nofile, raised)?)
}

async fn fleet(arguments: &FleetArguments) -> anyhow::Result<u8> {
    let folder = tempfile::tempdir()?;
    let order = Order {
        broker: &arguments.broker,
        folder: folder.path(),
        servo_period_us: arguments.servo_period_us,
        servo_late_ms: arguments.servo_late_ms,
        interval: Duration::from_mins(1) / arguments.m_codes_per_minute,
        run_s: arguments.seconds,
    };
    await_broker(order.broker, &order.nodes()?).await?;
    let machines = start(&order, arguments.machines).await?;
    let measured = tokio::select! {
        measured = measure(&machines, &order) => Some(measured?),
        _ = tokio::signal::ctrl_c() => None,
    };
    let stopping = machines.into_iter().map(FleetMachine::stop);
    futures_util::future::join_all(stopping).await;
    let Some(measured) = measured else {
        complain("stopped before the end");
        return Ok(EXIT_FOUND);
    };
    Ok(measured.print_table(arguments))
}

/// Starts the machines, [`AT_ONCE`] at a time, and prints the progress.
async fn start(order: &Order<'_>, count: u64) -> anyhow::Result<Vec<FleetMachine>> {
    let numbers: Vec<u64> = (1..=count).collect();
    let mut machines = Vec::new();
    let mut told = Instant::now();
    for some in numbers.chunks(AT_ONCE) {
        machines.extend(try_join_all(some.iter().map(|number| FleetMachine::start(order, *number))).await?);
        if told.elapsed() >= Duration::from_secs(2) {
            print_line(format!("{} of {count} machines have started", machines.len()));
            told = Instant::now();
        }
    }
    Ok(machines)
}

/// Starts the programs at different times within the interval of the M codes, so that the machines do not run
/// in step. Then measures for the ordered duration.
async fn measure(machines: &[FleetMachine], order: &Order<'_>) -> anyhow::Result<FleetMeasurement> {
    let count = machines.len();
    let step = order.interval / u32::try_from(count)?;
    for machine in machines {
        machine.run().await?;
        tokio::time::sleep(step).await;
    }
    print_line(format!("{count} machines run; measuring for {} s", order.run_s));
    let (begun, usage) = (Instant::now(), Usage::now());
    for machine in machines {
        machine.begin_to_count();
    }
    tokio::time::sleep(Duration::from_secs(order.run_s.into())).await;
    let (took_s, now) = (begun.elapsed().as_secs_f64(), Usage::now());
    let mut all = FleetCounters::default();
    for machine in machines {
        all.add(machine.counted().await?);
    }
    let cpu_s = now.cpu_s.zip(usage.cpu_s).map(|(now, before)| now - before);
    Ok(FleetMeasurement {
        machines: count,
        took_s,
        cpu_s,
        resident_bytes: now.resident_bytes,
        all,
    })
}

/// Results of the measurement of a fleet.
struct FleetMeasurement {
    machines: usize,
    took_s: f64,
    cpu_s: Option<f64>,
    resident_bytes: Option<u64>,
    all: FleetCounters,
}

impl FleetMeasurement {
    /// Prints the table of results. Returns the exit code of an error if a machine did not complete its work.
    fn print_table(mut self, arguments: &FleetArguments) -> u8 {
        let (machines, took_s) = (self.machines as f64, self.took_s);
        let minutes = took_s / 60.0;
        let all = &mut self.all;
        all.m_code_s.sort_by(f64::total_cmp);
        let at = |per_mille: usize| {
            let place = all.m_code_s.len().saturating_sub(1) * per_mille / 1000;
            let value = all.m_code_s.get(place).copied().unwrap_or_default();
            format!("{:.2} ms", value * 1000.0)
        };
        let per_machine = |value: Option<f64>, digits: usize, unit: &str| match value {
            Some(value) => format!(
                "{value:.digits$} {unit}, {:.3} {unit} per machine",
                value / machines
            ),
            None => "unknown".to_owned(),
        };
        let cpu = self.cpu_s.map(|cpu_s| cpu_s / took_s * 100.0);
        let memory = self.resident_bytes.map(|bytes| bytes as f64 / 1024.0 / 1024.0);
        let m_codes = all.m_code_s.len();
        let lines = [
            (
                "machines",
                format!("{}, servo period {} µs", self.machines, arguments.servo_period_us),
            ),
            ("measured", format!("{took_s:.1} s")),
            (
                "M codes",
                format!(
                    "{m_codes}, {:.1} a minute per machine",
                    m_codes as f64 / minutes / machines
                ),
            ),
            (
                "output to reset",
                format!("median {}, p99 {}, largest {}", at(500), at(990), at(1000)),
            ),
            (
                "messages that HMIs read",
                format!(
                    "{:.0} a second, {:.1} a second per machine",
                    all.messages as f64 / took_s,
                    all.messages as f64 / took_s / machines
                ),
            ),
            ("processor", per_machine(cpu, 1, "% of a core")),
            ("memory", per_machine(memory, 0, "MiB")),
            (
                "servo cycles left out",
                format!("{} of {}", all.missed_cycles, all.cycles),
            ),
            ("machines that do not run", all.stopped.to_string()),
            ("handlers that were lost", all.handlers_lost.to_string()),
        ];
        for (what, value) in lines {
            print_line(format!("  {what:<26} {value}"));
        }
        if all.stopped > 0 || all.handlers_lost > 0 || m_codes == 0 {
            EXIT_FOUND
        } else {
            EXIT_OK
        }
    }
}
