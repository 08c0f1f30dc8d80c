//! Eight coordinate systems at once, each 200 M codes a second, with a handler in the runtime's process; the servo
//! thread's overruns are counted: cycles that were not finished within their period of 1 ms.
//!
//! Each program repeats `M100 VA1` and a dwell that fills the 5 ms; what an M code takes beyond its share shows in the
//! M codes a second. A second run without any M code tells how many overruns are the computer's own.
//!
//! Measured on a 2-core AMD EPYC virtual machine, release profile, nothing else running, in 10 s: 249 M codes a second in
//! each, 7 of 8039 cycles not finished in time; idle 9 of 10,000.

use std::fmt::Write;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use plc_api::types::request::Request;
use plc_api::{Execution, Plc, SequenceProgram};
use tandem_runtime::Runtime;

use crate::m_code::{at_once, until_served};
use crate::machine::alone;
use crate::table::say;

const COORDINATE_SYSTEMS: u8 = 8;

const M_CODES_PER_S: u32 = 200;

const TIME: Duration = Duration::from_secs(10);

/// Dwell beside each M code, ms: 5 ms for both, less one for the output and one for the cycle that the dwell waits for.
const DWELL_MS: u32 = 1000 / M_CODES_PER_S - 2;

pub async fn run() -> anyhow::Result<()> {
    say("Eight coordinate systems, 1 ms period, handler in the runtime's process");
    let (runtime, _folder) = alone(&config()).await?;
    tokio::time::sleep(TIME).await;
    tell(&runtime, "idle", 0, TIME)?;
    runtime.shutdown().await;

    let (runtime, _folder) = alone(&config()).await?;
    let plc = Plc::in_process(runtime.port());
    let handlers = plc.clone();
    let serving = tokio::spawn(async move {
        let program = SequenceProgram::new().handler_id("bench").on(100, at_once);
        program.run(&handlers).await
    });
    until_served(&plc).await?;
    let codes = M_CODES_PER_S * u32::try_from(TIME.as_secs())?;
    let text = format!("M100 VA1\nG04 P{DWELL_MS}\n").repeat(codes.try_into()?) + "M30\n";
    plc.port().request(Request::WriteProgram(1, text)).await?;
    for cs in 1..=COORDINATE_SYSTEMS {
        plc.coordinate_system(cs).load(1).await?;
    }
    let begun = Instant::now();
    for cs in 1..=COORDINATE_SYSTEMS {
        plc.coordinate_system(cs).start().await?;
    }
    for cs in 1..=COORDINATE_SYSTEMS {
        plc.coordinate_system(cs)
            .wait_until(Execution::ProgramCompleted)
            .await?;
    }
    tell(&runtime, "M codes", codes, begun.elapsed())?;
    serving.abort();
    runtime.shutdown().await;
    Ok(())
}

/// Eight coordinate systems of one axis.
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

fn tell(runtime: &Runtime, what: &str, codes: u32, took: Duration) -> anyhow::Result<()> {
    let statistics = runtime
        .servo_statistics()
        .ok_or_else(|| anyhow::anyhow!("there is no servo thread"))?;
    let cycles = statistics.cycles.load(Ordering::Relaxed);
    let overruns = statistics.overruns.load(Ordering::Relaxed);
    say(&format!(
        "  {what:<10}   {:>6.1} M codes/s in each   {overruns} of {cycles} cycles not finished in time",
        f64::from(codes) / took.as_secs_f64()
    ));
    Ok(())
}
