//! The stream of positions of a moving axis, 10 a second, to 200 subscribers of the embedded broker, and its processor
//! time. The command `tandem` runs in a separate process, whose processor time is read from the system (Linux only).
//!
//! Measured on a 2-core Xeon virtual machine with other load, bench profile: 1989 messages a second to 200 subscribers
//! take 5.5 % of a processor; without subscribers it is 2.0 %.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use rumqttc::{AsyncClient, Event, MqttOptions, Packet, QoS};
use tokio::task::JoinSet;

use crate::machine::CONFIG;
use crate::table::say;

const SUBSCRIBERS: usize = 200;

const TIME: Duration = Duration::from_secs(10);

/// Longer than the whole bench, because a position is published only while it changes.
const MOTION: &str = r#"{"command_id": "move", "client_id": "bench", "args": {"text": "G01 X10000 F600"}}"#;

/// Ticks of processor time a second, as Linux reports them to programs.
const TICKS_PER_S: f64 = 100.0;

pub async fn run() -> anyhow::Result<()> {
    say("Positions, 10/s, to subscribers of the embedded broker");
    let folder = tempfile::tempdir()?;
    let served = Served::start(folder.path())?;
    let heard = Arc::new(AtomicU64::new(0));
    served.make_it_move().await?;
    served.measure(0, &heard).await?;
    let mut subscribers = JoinSet::new();
    for number in 0..SUBSCRIBERS {
        subscribers.spawn(subscribe(served.port, number, Arc::clone(&heard)));
    }
    while heard.load(Ordering::Relaxed) < SUBSCRIBERS as u64 * 10 {
        anyhow::ensure!(subscribers.try_join_next().is_none(), "a subscriber has ended");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    served.measure(SUBSCRIBERS, &heard).await?;
    anyhow::ensure!(subscribers.try_join_next().is_none(), "a subscriber has ended");
    Ok(())
}

async fn subscribe(port: u16, number: usize, heard: Arc<AtomicU64>) -> anyhow::Result<()> {
    let options = MqttOptions::new(format!("watch-{number}"), "127.0.0.1", port);
    let (client, mut events) = AsyncClient::new(options, 16);
    client
        .subscribe("tandem/v1/bench/cs/1/position", QoS::AtMostOnce)
        .await?;
    loop {
        if let Event::Incoming(Packet::Publish(_)) = events.poll().await? {
            heard.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The command, running with one coordinate system.
struct Served {
    process: Child,
    port: u16,
}

impl Served {
    fn start(folder: &Path) -> anyhow::Result<Served> {
        let listen = "[mqtt]\nlisten = \"127.0.0.1:0\"\n[http]\nlisten = \"127.0.0.1:0\"\n";
        let config = folder.join("tandem.toml");
        std::fs::write(&config, format!("{CONFIG}{listen}"))?;
        let mut process = Command::new(env!("CARGO_BIN_EXE_tandem"))
            .arg("serve")
            .arg("--config")
            .arg(config)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let output = process.stdout.take().context("its output")?;
        let mut port = None;
        for line in BufReader::new(output).lines() {
            if let Some((_, rest)) = line?.split_once("mqtt://127.0.0.1:") {
                port = rest.split(' ').next().and_then(|port| port.parse().ok());
                break;
            }
        }
        let port = port.context("the address of its broker")?;
        Ok(Served { process, port })
    }

    async fn make_it_move(&self) -> anyhow::Result<()> {
        let (client, mut events) = AsyncClient::new(MqttOptions::new("bench", "127.0.0.1", self.port), 16);
        client
            .subscribe("tandem/v1/bench/cs/1/position", QoS::AtMostOnce)
            .await?;
        client
            .publish(
                "tandem/v1/bench/cs/1/command/mdi",
                QoS::AtLeastOnce,
                false,
                MOTION,
            )
            .await?;
        let mut positions = 0;
        while positions < 10 {
            if let Event::Incoming(Packet::Publish(_)) = events.poll().await? {
                positions += 1;
            }
        }
        Ok(())
    }

    async fn measure(&self, subscribers: usize, heard: &AtomicU64) -> anyhow::Result<()> {
        let (before, from, begun) = (self.processor_s(), heard.load(Ordering::Relaxed), Instant::now());
        tokio::time::sleep(TIME).await;
        let took = begun.elapsed().as_secs_f64();
        let messages = (heard.load(Ordering::Relaxed) - from) as f64 / took;
        let cost = match (before, self.processor_s()) {
            (Some(before), Some(after)) => format!("{:.1} % of a processor", (after - before) / took * 100.0),
            _ => "processor time not known".to_owned(),
        };
        say(&format!(
            "  {subscribers:>3} subscribers   {messages:>6.0} messages/s   {cost}"
        ));
        Ok(())
    }

    /// Returns the processor time so far.
    fn processor_s(&self) -> Option<f64> {
        let text = std::fs::read_to_string(format!("/proc/{}/stat", self.process.id())).ok()?;
        // the name in parentheses may contain spaces; after it, from the state on, fields 12 and 13 are user and system
        // time
        let fields: Vec<_> = text.rsplit_once(") ")?.1.split(' ').collect();
        let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
        Some((ticks(11)? + ticks(12)?) / TICKS_PER_S)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
