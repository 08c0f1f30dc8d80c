//! Heartbeats: a program that the machine watches, and one that watches the machine.

use std::time::Duration;

use tokio::task::JoinHandle;

use crate::coordinate_system::CoordinateSystem;
use crate::error::Result;
use crate::plc::Plc;
use crate::types::CoordinateSystemNumber;
use crate::types::heartbeat::ClientHeartbeat;
use crate::types::message::Payload;
use crate::types::request::typed;
use crate::types::topic::Topic;

/// Heartbeats within the time of one, so that two may be lost.
const BEATS: u32 = 3;

/// How often the machine's heartbeat is looked at within the time that it may stand still.
const LOOKS: u32 = 4;

/// The machine watches this program: while this is held, heartbeats are sent in the background. When they fail to come, such
/// as when the program has died, hangs, or is cut off, every run is held: `FEED_HOLD`, reason `CLIENT_LOST`. Dropping it counts
/// as that; [`Heartbeat::end`] says that the program goes as it should.
///
/// ```
/// # use std::time::Duration;
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// # let plc = plc_api::fake::FakePort::new([1]).plc();
/// let heartbeat = plc.heartbeat(Duration::from_millis(500)).await?;
/// // ... what the machine must not go on without ...
/// heartbeat.end().await
/// # }
/// ```
#[derive(Debug)]
pub struct Heartbeat {
    plc: Plc,
    id: String,
    cs: Option<CoordinateSystemNumber>,
    beats: JoinHandle<()>,
}

impl Plc {
    /// Asks the machine to watch this program: it holds every run when it does not hear of it for `ttl`, 100 ms to 60 s.
    ///
    /// # Errors
    /// `ttl` is out of its range; the machine watches too many, or cannot be reached.
    pub async fn heartbeat(&self, ttl: Duration) -> Result<Heartbeat> {
        self.be_watched(None, ttl).await
    }

    async fn be_watched(&self, cs: Option<CoordinateSystemNumber>, ttl: Duration) -> Result<Heartbeat> {
        let id = self.user().unwrap_or(self.client_id()).to_owned();
        let ttl_ms = u64::try_from(ttl.as_millis()).unwrap_or(u64::MAX);
        let beat = typed::Heartbeat(id.clone(), ClientHeartbeat { ttl_ms, cs });
        self.request(beat.clone()).await?;
        let plc = self.clone();
        let beats = tokio::spawn(async move {
            loop {
                plc.sleep(ttl / BEATS).await;
                if let Err(error) = plc.request(beat.clone()).await {
                    tracing::warn!(%error, "the machine was not told that this program is alive");
                }
            }
        });
        Ok(Heartbeat {
            plc: self.clone(),
            id,
            cs,
            beats,
        })
    }

    /// Returns when the machine's heartbeat has stood still for `limit`, 400 ms or more: its servo gets no processor time, the
    /// runtime has ended, or the connection is lost. A handler that moves something by itself stops it then.
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # async fn turn_table() {}
    /// # async fn example(plc: plc_api::Plc) {
    /// tokio::select! {
    ///     () = turn_table() => {}
    ///     () = plc.until_silent(Duration::from_millis(500)) => { /* brake the table */ }
    /// }
    /// # }
    /// ```
    pub async fn until_silent(&self, limit: Duration) {
        let mut last = None;
        let mut heard_s = self.now_s();
        loop {
            let message = self.port().read(&Topic::Heartbeat).await;
            if let Some(Payload::Heartbeat(beat)) = message.as_deref().map(|message| &message.payload)
                && last.replace(*beat) != Some(*beat)
            {
                heard_s = self.now_s();
            } else if self.now_s() - heard_s >= limit.as_secs_f64() {
                return;
            }
            self.sleep(limit / LOOKS).await;
        }
    }
}

impl CoordinateSystem {
    /// As [`Plc::heartbeat`], for this coordinate system alone.
    ///
    /// # Errors
    /// As [`Plc::heartbeat`]; there is no such coordinate system.
    pub async fn heartbeat(&self, ttl: Duration) -> Result<Heartbeat> {
        self.plc().be_watched(Some(self.number()), ttl).await
    }
}

impl Heartbeat {
    /// The machine watches this program no more, and holds nothing.
    ///
    /// # Errors
    /// The machine cannot be reached: it will hold.
    pub async fn end(self) -> Result<()> {
        self.beats.abort();
        let (id, cs) = (self.id.clone(), self.cs);
        let gone = typed::Heartbeat(id, ClientHeartbeat { ttl_ms: 0, cs });
        self.plc.request(gone).await
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.beats.abort();
    }
}
