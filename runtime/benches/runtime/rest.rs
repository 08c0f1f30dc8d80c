//! REST: `GET /api/v1/cs/1/state`, repeatedly on connections that stay open. The clients run in the same process and
//! use part of the processor time.
//!
//! Measured on a 2-core AMD EPYC virtual machine, release profile, without other load.
//!
//! | connections | requests/s | median | p99 |
//! | --- | --- | --- | --- |
//! | 1 | 47,000 | 19 µs | 49 µs |
//! | 8 | 89,000 | 86 µs | 179 µs |
//! | 64 | 92,000 | 684 µs | 1.1 ms |

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;

use crate::http::{Client, STATE};
use crate::machine::Machine;
use crate::table::{Durations, say};

const TIME: Duration = Duration::from_secs(3);

pub async fn run() -> anyhow::Result<()> {
    say("REST: GET /api/v1/cs/1/state");
    let machine = Machine::start().await?;
    for connections in [1, 8, 64] {
        let address = machine.gateway.http_addr();
        let begun = Instant::now();
        let mut durations = load(address, connections, TIME).await?;
        let per_second = durations.len() as f64 / begun.elapsed().as_secs_f64();
        say(&format!(
            "  {connections:>2} connections   {per_second:>6.0} requests/s   {}",
            durations.line()
        ));
    }
    machine.stop().await;
    Ok(())
}

/// Sends requests as fast as possible, and returns the time of each answer.
pub async fn load(address: SocketAddr, connections: usize, time: Duration) -> anyhow::Result<Durations> {
    let mut clients = JoinSet::new();
    let end = Instant::now() + time;
    for _ in 0..connections {
        let mut client = Client::connect(address, STATE).await?;
        clients.spawn(async move {
            let mut durations = Durations::default();
            while Instant::now() < end {
                let begun = Instant::now();
                client.get().await?;
                durations.push(begun.elapsed());
            }
            anyhow::Ok(durations)
        });
    }
    let mut all = Durations::default();
    while let Some(durations) = clients.join_next().await {
        all.append(durations??);
    }
    Ok(all)
}
