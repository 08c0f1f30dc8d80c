//! The adapter: observations as lines of SHDR, for an agent of another manufacturer.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

use crate::Agent;
use crate::buffer::{Observation, Value};
use crate::device::Device;

/// Largest number of readers; a further connection is refused.
const READERS_MAX: usize = 16;

/// Period at which the adapter requests pings from a reader, ms.
const HEARTBEAT_MS: u64 = 10_000;

/// Longest line that a reader may send, bytes.
const LINE_MAX: u64 = 1024;

/// Time limit for a reader to receive sent data; then the connection is closed.
const WRITE_MAX: Duration = Duration::from_secs(10);

/// Serves readers until the agent ends.
pub async fn serve(listener: Arc<TcpListener>, agent: Agent) {
    let places = Arc::new(Semaphore::new(READERS_MAX));
    loop {
        let accepted = tokio::select! {
            () = agent.inner.stop.cancelled() => return,
            accepted = listener.accept() => accepted,
        };
        let Ok((stream, _)) = accepted else {
            if !agent.sleep(Duration::from_millis(100)).await {
                return;
            }
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            continue;
        };
        let supervisor = agent.inner.supervisor.clone();
        let agent = agent.clone();
        let reading = async move {
            // an error of one reader does not affect the others
            let _ = read_by(stream, &agent).await;
            drop(place);
        };
        tokio::spawn(supervisor.contained("reader of SHDR", reading));
    }
}

/// Sends the current state, then the changes; answers pings.
async fn read_by(stream: TcpStream, agent: &Agent) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let (reader, mut writer) = stream.into_split();
    let mut commands = BufReader::new(reader.take(LINE_MAX));
    let mut news = agent.inner.news.subscribe();
    let (text, mut next) = {
        let feed = agent.inner.feed.lock();
        (lines(&feed.device, &feed.buffer.current()), feed.buffer.next())
    };
    send(&mut writer, &text).await?;
    let mut command = Vec::new();
    loop {
        tokio::select! {
            () = agent.inner.stop.cancelled() => return Ok(()),
            read = commands.read_until(b'\n', &mut command) => {
                if read? == 0 {
                    return Ok(());
                }
                if command.starts_with(b"* PING") {
                    send(&mut writer, &format!("* PONG {HEARTBEAT_MS}\n")).await?;
                }
                command.clear();
                commands.get_mut().set_limit(LINE_MAX);
            }
            changed = news.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let text = {
                    let feed = agent.inner.feed.lock();
                    // a reader that was too slow continues with the oldest stored observation
                    let from = next.max(feed.buffer.first());
                    let (observations, goes_on) = feed.buffer.sample(from, usize::MAX, &|_| true);
                    next = goes_on;
                    lines(&feed.device, &observations)
                };
                send(&mut writer, &text).await?;
            }
        }
    }
}

async fn send(writer: &mut (impl AsyncWriteExt + Unpin), text: &str) -> std::io::Result<()> {
    let late = |_| std::io::Error::from(std::io::ErrorKind::TimedOut);
    tokio::time::timeout(WRITE_MAX, writer.write_all(text.as_bytes()))
        .await
        .map_err(late)?
}

/// Returns a line for each observation.
fn lines(device: &Device, observations: &[Observation]) -> String {
    observations.iter().map(|one| line(device, one)).collect()
}

fn line(device: &Device, one: &Observation) -> String {
    let (at, key) = (&one.timestamp, &device.items[one.item].id);
    let value = match &one.value {
        Value::Unavailable => "UNAVAILABLE".to_owned(),
        Value::Text(text) => plain(text),
        Value::Normal(code) => {
            let code = code.map(|code| code.to_string()).unwrap_or_default();
            format!("NORMAL|{code}|||")
        }
        Value::Active(alarm) => {
            let level = if alarm.is_fault { "FAULT" } else { "WARNING" };
            format!("{level}|{}|||{}", alarm.native_code, plain(&alarm.text))
        }
    };
    format!("{at}|{key}|{value}\n")
}

/// Removes characters that end a field or a line.
fn plain(text: &str) -> String {
    text.chars()
        .map(|c| if c == '|' || c.is_control() { ' ' } else { c })
        .collect()
}
