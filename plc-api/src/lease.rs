//! The control lease, held by a client.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use plc_protocol::error::{Error, Result};
use plc_protocol::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::typed;
use tokio::task::JoinHandle;

use crate::coordinate_system::CoordinateSystem;
use crate::plc::Plc;

/// Number of renewals within one `ttl` of a lease. Reason: two of them may be lost.
const RENEWALS: u32 = 3;

/// The control lease of a coordinate system. While this client holds the lease, the commands load, start,
/// run, resume, back trace, mdi, jog and home of other clients are refused as `busy`. Hold, stop, abort,
/// reset and the end of a jog are never refused for this reason. The lease is renewed in the background until
/// it is released or dropped.
///
/// ```no_run
/// # use std::time::Duration;
/// # async fn example(plc: plc_api::Plc) -> plc_api::Result<()> {
/// let lease = plc.coordinate_system(1).take_lease(Duration::from_secs(30)).await?;
/// lease.coordinate_system().load(100).await?;
/// lease.coordinate_system().start().await?;
/// lease.release().await
/// # }
/// ```
#[derive(Debug)]
pub struct LeaseGuard {
    coordinate_system: CoordinateSystem,
    fence: u64,
    lost: Arc<AtomicBool>,
    renewal: JoinHandle<()>,
}

impl CoordinateSystem {
    /// Takes the control lease for `ttl`, 1 s to 10 min, in the name of the user or the connection of this
    /// program.
    ///
    /// # Errors
    /// Fails with `busy` while another client holds the lease, or if `ttl` is out of range.
    pub async fn take_lease(&self, ttl: Duration) -> Result<LeaseGuard> {
        self.request_lease(None, ttl).await
    }

    /// Takes the control lease as [`take_lease`](Self::take_lease) does, in the name `holder` of 1 to 64
    /// characters, which panels and refusals show.
    ///
    /// # Errors
    /// Fails as [`CoordinateSystem::take_lease`], and if the name is too long.
    pub async fn take_lease_as(&self, holder: impl Into<String>, ttl: Duration) -> Result<LeaseGuard> {
        self.request_lease(Some(holder.into()), ttl).await
    }

    async fn request_lease(&self, holder: Option<String>, ttl: Duration) -> Result<LeaseGuard> {
        let take = LeaseTake {
            holder: holder.or_else(|| self.plc().user().map(str::to_owned)),
            ttl_ms: Some(u64::try_from(ttl.as_millis()).unwrap_or(u64::MAX)),
            fence: None,
        };
        let request = self.ask(LeaseRequest::Take(take.clone()));
        let reply = self.plc().request(request).await?;
        let granted = reply.lease.ok_or_else(|| {
            let code = serde_json::from_value(reply.code.into()).unwrap_or(RefusalCode::Busy);
            Refusal::new(code, reply.text)
        })?;
        let lost = Arc::new(AtomicBool::new(false));
        let take = LeaseTake {
            fence: Some(granted.fence),
            ..take
        };
        Ok(LeaseGuard {
            coordinate_system: self.under_lease(granted.fence),
            renewal: tokio::spawn(renew(self.clone(), take, ttl / RENEWALS, Arc::clone(&lost))),
            fence: granted.fence,
            lost,
        })
    }

    fn ask(&self, request: LeaseRequest) -> typed::Lease {
        typed::Lease {
            cs: self.number(),
            request,
            meta: self.plc().command_meta(),
        }
    }
}

/// Renews the lease until the machine answers that the lease has ended. If a renewal fails for another
/// reason, the next renewal follows at its regular time.
async fn renew(
    coordinate_system: CoordinateSystem,
    take: LeaseTake,
    interval: Duration,
    lost: Arc<AtomicBool>,
) {
    let plc: &Plc = coordinate_system.plc();
    loop {
        plc.sleep(interval).await;
        let renewal = coordinate_system.ask(LeaseRequest::Take(take.clone()));
        if let Err(Error::Refused(refusal)) = plc.request(renewal).await
            && refusal.code == RefusalCode::LeaseLost
        {
            tracing::warn!("{refusal}");
            lost.store(true, Ordering::Relaxed);
            return;
        }
    }
}

impl LeaseGuard {
    /// Returns a handle to the coordinate system that sends commands under this lease.
    pub fn coordinate_system(&self) -> &CoordinateSystem {
        &self.coordinate_system
    }

    /// Returns the number of this lease; each later lease of the coordinate system has a higher number.
    pub fn fence(&self) -> u64 {
        self.fence
    }

    /// Returns true once the machine has answered that the lease has ended: an operator has broken the lease,
    /// the runtime was restarted, or no renewal arrived in time. Commands under the lease are then refused as
    /// `lease_lost`.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// Releases the lease.
    ///
    /// # Errors
    /// Fails with `lease_lost` if the lease had ended before, or if the machine cannot be reached.
    pub async fn release(self) -> Result<()> {
        self.renewal.abort();
        // prevents a second release on drop
        self.lost.store(true, Ordering::Relaxed);
        self.coordinate_system
            .plc()
            .request(self.ask_release())
            .await
            .map(|_| ())
    }

    fn ask_release(&self) -> typed::Lease {
        let fence = self.fence();
        self.coordinate_system
            .ask(LeaseRequest::Release(LeaseRelease { fence }))
    }
}

impl Drop for LeaseGuard {
    fn drop(&mut self) {
        self.renewal.abort();
        if !self.is_lost() {
            let unsent = "the control lease could not be released; it ends when its time has passed";
            self.coordinate_system
                .plc()
                .send_without_waiting(self.ask_release(), unsent);
        }
    }
}
