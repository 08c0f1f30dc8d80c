//! Delay of the servo thread's wake-ups, with a servo period of 1 ms: while idle, and while eight REST clients in the
//! same process send requests as fast as they can. The thread has real-time priority if that is allowed.
//!
//! Measured on a 2-core AMD EPYC virtual machine without a real-time kernel, release profile, with real-time priority.
//! The tails are caused by the host, which withdraws the processors for milliseconds: the idle machine has them, too.
//!
//! | | median | p99 | p99.9 | latest | not finished in time |
//! | --- | --- | --- | --- | --- | --- |
//! | idle | below 64 µs | below 512 µs | below 4.1 ms | 5 ms | 31 of 9967 |
//! | REST load | below 32 µs | below 64 µs | below 2 ms | 36 ms | 26 of 9987 |
//!
//! Before the thread requested that priority, a cycle of the loaded machine was below 1 ms at p99.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tandem_runtime::{JITTER_BUCKETS, ServoStatistics};

use crate::machine::Machine;
use crate::rest;
use crate::table::say;

const TIME: Duration = Duration::from_secs(10);

const CONNECTIONS: usize = 8;

pub async fn run() -> anyhow::Result<()> {
    say("Servo thread, 1 ms period: wake-ups by lateness");
    let machine = Machine::start().await?;
    tokio::time::sleep(TIME).await;
    tell(&machine, "idle")?;
    machine.stop().await;

    let machine = Machine::start().await?;
    rest::load(machine.gateway.http_addr(), CONNECTIONS, TIME).await?;
    tell(&machine, "REST load")?;
    machine.stop().await;
    Ok(())
}

fn tell(machine: &Machine, what: &str) -> anyhow::Result<()> {
    let statistics = machine
        .runtime
        .servo_statistics()
        .ok_or_else(|| anyhow::anyhow!("there is no servo thread"))?;
    let cycles = statistics.cycles.load(Ordering::Relaxed);
    let overruns = statistics.overruns.load(Ordering::Relaxed);
    let latest_us = statistics.lateness.max_ns.load(Ordering::Relaxed) / 1000;
    say(&format!(
        "  {what:<10}   median < {} µs   p99 < {} µs   p99.9 < {} µs   max {latest_us} µs   {overruns} of {cycles} \
         not finished in time",
        within_us(&statistics, 500),
        within_us(&statistics, 990),
        within_us(&statistics, 999),
    ));
    Ok(())
}

/// Returns the end of the histogram's bucket below which this share of the wake-ups stays.
fn within_us(statistics: &ServoStatistics, per_mille: u64) -> u64 {
    let counts: Vec<u64> = statistics
        .lateness
        .buckets
        .iter()
        .map(|count| count.load(Ordering::Relaxed))
        .collect();
    let all: u64 = counts.iter().sum();
    let mut sum = 0;
    let bucket = counts.iter().position(|count| {
        sum += count;
        sum * 1000 >= all * per_mille
    });
    2 << bucket.unwrap_or(JITTER_BUCKETS - 1)
}
