//! Heartbeats: the machine watches a program, or a program watches the machine.

use std::time::Duration;

use plc_protocol::error::Result;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::heartbeat::ClientHeartbeat;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::typed;
use plc_protocol::types::topic::Topic;
use tokio::task::JoinHandle;

use crate::coordinate_system::CoordinateSystem;
use crate::plc::Plc;

/// Number of heartbeats that are sent within one `ttl`. Reason: two of them may be lost.
const BEATS: u32 = 3;

/// Number of times that the machine's heartbeat is read within the time limit for a missing heartbeat.
const LOOKS: u32 = 4;

/// A guard that sends heartbeats to the machine in the background. If the heartbeats stop, because the
/// program has ended, hangs, or lost its connection, the machine holds every run: `FEED_HOLD`, reason
/// `CLIENT_LOST`. Dropping the guard has the same effect. [`HeartbeatGuard::release`] reports a regular end
/// of the program, after which the machine does not hold.
///
/// ```
/// # use std::time::Duration;
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// # let plc = plc_api::fake::FakePort::new([1]).plc();
/// let heartbeat = plc.heartbeat(Duration::from_millis(500)).await?;
/// // ... work without which the machine must not continue ...
/// heartbeat.release().await
/// # }
/// ```
#[derive(Debug)]
pub struct HeartbeatGuard {
    plc: Plc,
    id: String,
    cs: Option<CoordinateSystemNumber>,
    beats: JoinHandle<()>,
}

impl Plc {
    /// Requests that the machine watches this program. If the machine receives no heartbeat of the program
    /// for `ttl` (100 ms to 60 s), the machine holds every run.
    ///
    /// # Errors
    /// Fails if `ttl` is out of its range, the machine watches too many programs, or the machine cannot be
    /// reached.
    pub async fn heartbeat(&self, ttl: Duration) -> Result<HeartbeatGuard> {
        self.be_watched(None, ttl).await
    }

    async fn be_watched(&self, cs: Option<CoordinateSystemNumber>, ttl: Duration) -> Result<HeartbeatGuard> {
        let id = self.user().unwrap_or(self.client_id()).to_owned();
        let ttl_ms = u64::try_from(ttl.as_millis()).unwrap_or(u64::MAX);
        let beat = typed::Heartbeat(id.clone(), ClientHeartbeat { ttl_ms, cs });
        self.request(beat.clone()).await?;
        let plc = self.clone();
        let beats = tokio::spawn(async move {
            loop {
                plc.sleep(ttl / BEATS).await;
                if let Err(error) = plc.request(beat.clone()).await {
                    tracing::warn!(%error, "a heartbeat of this program did not reach the machine");
                }
            }
        });
        Ok(HeartbeatGuard {
            plc: self.clone(),
            id,
            cs,
            beats,
        })
    }

    /// Waits until the heartbeat of the machine has not changed for `limit`; use 400 ms or more. Then the
    /// servo gets no processor time, the runtime has ended, or the connection is lost. A handler that moves
    /// an actuator itself must then stop the actuator.
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
    /// Requests that the machine watches this program as for [`Plc::heartbeat`]. If heartbeats are missing,
    /// the machine holds only the runs of this coordinate system.
    ///
    /// # Errors
    /// Fails as [`Plc::heartbeat`], and if the coordinate system does not exist.
    pub async fn heartbeat(&self, ttl: Duration) -> Result<HeartbeatGuard> {
        self.plc().be_watched(Some(self.number()), ttl).await
    }
}

impl HeartbeatGuard {
    /// Ends the watch: the machine no longer watches this program, and does not hold a run.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached; in this case the machine will hold the runs.
    pub async fn release(self) -> Result<()> {
        self.beats.abort();
        let (id, cs) = (self.id.clone(), self.cs);
        let gone = typed::Heartbeat(id, ClientHeartbeat { ttl_ms: 0, cs });
        self.plc.request(gone).await
    }
}

impl Drop for HeartbeatGuard {
    fn drop(&mut self) {
        self.beats.abort();
    }
}
