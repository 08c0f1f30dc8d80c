//! Times of a program of ten short blocks, and of one of a million (17.6 MB), for storing it, loading it, and starting
//! it.
//!
//! - write: the program is parsed and checked, and it is on disk when the request is answered;
//! - load: the program is checked against the coordinate system's axes and limits;
//! - start: until a subscriber to the positions sees the first setpoint that differs from the start. The servo period
//!   is 1 ms; on average the first block waits for half of it. The short program shows the time that does not depend
//!   on the size.
//!
//! A text that is written again unchanged is already checked: `load` shows that case, and its p99 a first load.
//! Measured on a 2-core AMD EPYC virtual machine, bench profile, medians and p99:
//!
//! | blocks | write | load | start |
//! | --- | --- | --- | --- |
//! | 10 | 0.08 ms, 1.3 ms | 0.06 ms, 0.1 ms | 1.8 ms, 2.9 ms |
//! | 1,000,000 | 109 ms, 174 ms | 0.2 ms, 42 ms | 2.5 ms, 5.9 ms |

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use plc_api::Plc;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::typed::WriteProgram;
use plc_protocol::types::topic::{CsTopic, Topic};

use crate::machine::Machine;
use crate::table::{Durations, say};

const ROUNDS: usize = 20;

/// Time after which a start has failed.
const PATIENCE: Duration = Duration::from_secs(5);

pub async fn run() -> anyhow::Result<()> {
    let machine = Machine::start().await?;
    for blocks in [10, 1_000_000] {
        measure(&machine.in_process(), blocks).await?;
    }
    machine.stop().await;
    Ok(())
}

async fn measure(plc: &Plc, blocks: usize) -> anyhow::Result<()> {
    say(&format!("A program of {blocks} blocks"));
    let cs = plc.coordinate_system(1);
    let text = short_blocks(blocks);
    let mut durations: [Durations; 3] = Default::default();
    for _ in 0..ROUNDS {
        let program = text.clone();
        let begin = Instant::now();
        plc.port().ask(WriteProgram(1, program)).await?;
        let written = Instant::now();
        cs.load(1).await?;
        let loaded = Instant::now();
        let rest = x(plc).await?;
        let started = Instant::now();
        cs.start().await?;
        while (x(plc).await? - rest).abs() <= 0.0 {
            anyhow::ensure!(started.elapsed() < PATIENCE, "nothing moves");
            tokio::task::yield_now().await;
        }
        durations[2].push(started.elapsed());
        durations[0].push(written - begin);
        durations[1].push(loaded - written);
        cs.abort().await?;
        cs.reset().await?;
    }
    for (name, durations) in ["write", "load", "start"].iter().zip(&mut durations) {
        say(&format!("  {name:<8} {}", durations.line()));
    }
    Ok(())
}

/// Returns a spiral of short straight blocks, as a CAM system writes them.
fn short_blocks(blocks: usize) -> String {
    let mut text = String::from("G17 G91 G01 F3000 X1\n");
    for i in 2..blocks {
        let angle = i as f64 * 0.01;
        let _ = writeln!(text, "X{:.5}Y{:.5}", 0.1 * angle.cos(), 0.1 * angle.sin());
    }
    text.push_str("M30\n");
    text
}

/// Returns the machine position of X.
async fn x(plc: &Plc) -> anyhow::Result<f64> {
    let topic = Topic::cs(1, CsTopic::Position);
    let message = plc.port().read(&topic).await;
    match message.as_deref().map(|message| &message.payload) {
        Some(Payload::Position(position)) => Ok(position.machine.get("X").copied().unwrap_or_default()),
        _ => anyhow::bail!("there is no position"),
    }
}
