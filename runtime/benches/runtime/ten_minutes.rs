//! Ten minutes of a machine in simulated time, as a machine builder's unit tests run them (`tandem_testing`).
//!
//! Unit tests are mostly debug builds: `cargo bench --profile dev -p tandem-runtime --bench runtime -- ten_minutes`.
//!
//! Processor time, measured on a 2-core AMD EPYC virtual machine (other load on it is not included in this time):
//!
//! | ten minutes of | debug |
//! | --- | --- |
//! | a handler that sleeps | below 10 ms |
//! | the same handler while the spindle turns | 10 ms |
//! | one dwell | below 10 ms |
//! | 60 lines of 100 mm | 10 ms |
//! | a scan program each 10 ms, 60,000 scans | 1.1 s |
//! | 60,000 blended lines (17 minutes) | 5.6 s |
//!
//! Cycles without messages are skipped, with drives that follow without lag; so the time depends on the number of
//! events (blocks, outputs, scans), not on their duration.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use plc_api::scan::Image;
use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use plc_protocol::types::state::SpindleDirection;
use tandem_testing::Bench;

use crate::table::say;

const TEN_MINUTES: Duration = Duration::from_mins(10);

pub fn run() -> anyhow::Result<()> {
    say("Ten minutes in simulated time");
    let handlers = || SequenceProgram::new().on(110, wait).on(3, turn);
    measure("handler sleeps", handlers(), "M110\nM30\n")?;
    measure("spindle turns", handlers(), "M03\nM110\nM30\n")?;
    measure("dwell", handlers(), "G04 X600\nM30\n")?;
    let lines = "G01 X100 F600\nG01 X0\n".repeat(30);
    measure("60 lines", handlers(), &format!("G90\n{lines}M30\n"))?;
    let scans = SequenceProgram::new().scan(110, Duration::from_millis(10), |image: &mut Image| {
        if image.time_s() >= TEN_MINUTES.as_secs_f64() {
            image.reset(1, 110);
        }
    });
    measure("60,000 scans", scans, "M110\nM30\n")?;
    measure("60,000 lines", handlers(), &short_lines())
}

/// Returns 60,000 short lines, blended.
fn short_lines() -> String {
    let mut text = "G90 G64\n".to_owned();
    for n in 0..60_000 {
        // Writing to a String does not fail.
        let _ = writeln!(text, "G01 X{} Y{} F6000", n % 2, n % 3);
    }
    text + "M30\n"
}

async fn wait(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    plc.sleep(TEN_MINUTES).await;
    Ok(())
}

async fn turn(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let system = plc.coordinate_system(1);
    Ok(system.set_spindle(SpindleDirection::Cw, 1000.0).await?)
}

fn measure(what: &str, program: SequenceProgram, text: &str) -> anyhow::Result<()> {
    let (begun, processor_s) = (Instant::now(), processor_s()?);
    let run = Bench::new().serve(program).run(text)?.completed()?;
    say(&format!(
        "  {what:<15} {:>7.1} s simulated   {:>6.2} s of the processor   {:>6.2} s",
        run.time_s,
        self::processor_s()? - processor_s,
        begun.elapsed().as_secs_f64()
    ));
    Ok(())
}

/// Returns the processor time of this process, s; in steps of 10 ms, as Linux reports it.
fn processor_s() -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let fields = stat.rsplit(')').next().unwrap_or_default();
    let ticks = |n: usize| -> anyhow::Result<f64> {
        let field = fields.split_whitespace().nth(n);
        Ok(field
            .ok_or_else(|| anyhow!("/proc/self/stat is short"))?
            .parse()?)
    };
    Ok((ticks(11)? + ticks(12)?) / 100.0)
}
