//! Eight coordinate systems at the same time, each with 200 M codes a second and a handler in the runtime's process.
//! Counts the overruns of the servo thread: cycles that were not finished within their period of 1 ms.
//!
//! Each program repeats `M100 VA1` and a dwell that fills the 5 ms; if an M code takes longer than its share, the
//! number of M codes a second drops. Windows of one second with and without programs alternate in one runtime, so that
//! other load of the computer affects both. Overruns of idle windows are caused by the computer; the difference is
//! caused by the M codes.
//!
//! Measured on a 2-core Xeon virtual machine with other load, bench profile, in 10 s: 249 M codes a second in each
//! coordinate system, 3 of 8035 cycles not finished in time; idle, in a separate 10 s, 9 of 9990.

use std::fmt::Write;
use std::time::{Duration, Instant};

use anyhow::Context;
use plc_api::{Execution, Plc, SequenceProgram};
use plc_protocol::server::{ServedPort, ServoTiming};
use plc_protocol::types::request::typed::WriteProgram;

use crate::m_code::{at_once, until_served};
use crate::machine::alone;
use crate::table::say;

const COORDINATE_SYSTEMS: u8 = 8;

const M_CODES_PER_S: u32 = 200;

/// Duration of a window without programs, and approximately of one with programs.
const WINDOW: Duration = Duration::from_secs(1);

/// Number of windows of each kind.
const WINDOWS: u32 = 10;

/// Dwell after each M code, ms: 5 ms for both, minus 1 ms for the output and one for the cycle that the dwell waits
/// for.
const DWELL_MS: u32 = 1000 / M_CODES_PER_S - 2;

/// Measurements of the servo thread in windows of one kind.
#[derive(Default)]
struct Windows {
    cycles: u64,
    overruns: u64,
    late_s: f64,
    took: Duration,
}

pub async fn run() -> anyhow::Result<()> {
    say("Eight coordinate systems, 1 ms period, handler in the runtime's process");
    let (runtime, _folder) = alone(&config()).await?;
    let (plc, served) = (Plc::in_process(runtime.port()), runtime.served_port());
    let handlers = plc.clone();
    let serving = tokio::spawn(async move {
        let program = SequenceProgram::new().handler_id("bench").on(100, at_once);
        program.run(&handlers).await
    });
    until_served(&plc).await?;
    let text = format!("M100 VA1\nG04 P{DWELL_MS}\n").repeat(M_CODES_PER_S.try_into()?) + "M30\n";
    plc.port().ask(WriteProgram(1, text)).await?;
    for cs in 1..=COORDINATE_SYSTEMS {
        plc.coordinate_system(cs).load(1).await?;
    }
    let (mut idle, mut loaded) = (Windows::default(), Windows::default());
    for _ in 0..WINDOWS {
        idle.measure(&*served, tokio::time::sleep(WINDOW)).await?;
        loaded.measure(&*served, run_programs(&plc)).await?;
    }
    idle.tell("idle", 0);
    loaded.tell("M codes", WINDOWS * M_CODES_PER_S);
    say(&format!(
        "  with M codes {:.0} overruns in a million cycles, idle {:.0}; a cycle begins {:.2} times as late",
        loaded.overrun_share() * 1e6,
        idle.overrun_share() * 1e6,
        loaded.mean_late_s() / idle.mean_late_s()
    ));
    serving.abort();
    runtime.shutdown().await;
    Ok(())
}

/// Runs all programs from start to end; after an error, a program does not complete.
async fn run_programs(plc: &Plc) {
    let started = (1..=COORDINATE_SYSTEMS).map(|cs| async move {
        let system = plc.coordinate_system(cs);
        system.start().await?;
        system.wait_until(Execution::ProgramCompleted).await
    });
    for ended in futures_util::future::join_all(started).await {
        if let Err(error) = ended {
            say(&format!("  a program has failed: {error}"));
        }
    }
}

impl Windows {
    async fn measure(
        &mut self,
        served: &dyn ServedPort,
        window: impl Future<Output = ()>,
    ) -> anyhow::Result<()> {
        let timing = || served.servo_timing().context("a servo thread");
        let (before, begun) = (timing()?, Instant::now());
        window.await;
        self.took += begun.elapsed();
        let after = timing()?;
        self.cycles += cycles(&after) - cycles(&before);
        self.overruns += after.overruns - before.overruns;
        self.late_s += after.lateness.sum_s - before.lateness.sum_s;
        Ok(())
    }

    fn overrun_share(&self) -> f64 {
        self.overruns as f64 / self.cycles as f64
    }

    fn mean_late_s(&self) -> f64 {
        self.late_s / self.cycles as f64
    }

    fn tell(&self, what: &str, codes: u32) {
        say(&format!(
            "  {what:<10}   {:>6.1} M codes/s in each   {} of {} cycles not finished in time, {:.1} µs late on the mean",
            f64::from(codes) / self.took.as_secs_f64(),
            self.overruns,
            self.cycles,
            self.mean_late_s() * 1e6
        ));
    }
}

fn cycles(timing: &ServoTiming) -> u64 {
    timing.lateness.buckets.iter().map(|(_, count)| count).sum()
}

/// Returns a configuration of eight coordinate systems with one axis each.
fn config() -> String {
    let mut text = "[machine]\nname = \"bench\"\n".to_owned();
    for cs in 1..=COORDINATE_SYSTEMS {
        // Writing to a String does not fail.
        let _ = write!(
            text,
            "\n[[motor]]\nnumber = {cs}\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n\
             \n[[coordinate_system]]\nnumber = {cs}\naxes = {{ X = {cs} }}\n"
        );
    }
    text
}
