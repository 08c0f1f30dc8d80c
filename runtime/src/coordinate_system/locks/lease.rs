//! The control lease: while a client holds it, only commands with its fence may start motion. The lease is optional.
//!
//! The lease orders the commands of several clients. The lease proves no identity: every operator may read the fence. A
//! run continues when the holder changes; hold, stop, abort and reset need no lease.

use plc_protocol::execution::wire_name;
use plc_protocol::handshake::Now;
use plc_protocol::types::command::{CommandMeta, CommandReply, CommandStatus, Verb};
use plc_protocol::types::lease::{
    LEASE_HOLDER_MAX, LEASE_TTL_DEFAULT_MS, LEASE_TTL_MAX_MS, LEASE_TTL_MIN_MS, Lease, LeaseRequest,
    LeaseTake,
};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::{Answer, Refusal, RefusalCode};
use plc_protocol::types::topic::CsTopic;
use plc_protocol::types::{CoordinateSystemNumber, Timestamp};
use tandem_store::journal::{Event, LeaseChange};

use crate::coordinate_system::CoordinateSystem;

/// Holder and expiry time of the lease of one coordinate system. Pure: the caller passes the time.
#[derive(Debug)]
pub(crate) struct ControlLease {
    cs: CoordinateSystemNumber,
    last_fence: u64,
    held: Option<HeldLease>,
}

#[derive(Debug)]
struct HeldLease {
    lease: Lease,
    until_s: f64,
}

impl ControlLease {
    /// Creates a lease without a holder. The first fence is the time of day in s, so fences of earlier starts of the
    /// runtime stay invalid. Condition: the computer's clock is not set back.
    pub fn new(cs: CoordinateSystemNumber, now: Now) -> Self {
        let since_epoch = now.time.duration_since(std::time::UNIX_EPOCH);
        Self {
            cs,
            last_fence: since_epoch.map_or(0, |time| time.as_secs()),
            held: None,
        }
    }

    pub fn held(&self) -> Option<&Lease> {
        self.held.as_ref().map(|held| &held.lease)
    }

    /// Returns the time in s at which the lease expires; `None` if the lease has no holder.
    pub fn until_s(&self) -> Option<f64> {
        self.held.as_ref().map(|held| held.until_s)
    }

    /// Takes the lease for a client, or renews it if the client gives its fence.
    fn claim_lease(&mut self, now: Now, take: &LeaseTake, client_id: &str) -> Result<Lease, Refusal> {
        let holder = take.holder.as_deref().unwrap_or(client_id);
        if !(1..=LEASE_HOLDER_MAX).contains(&holder.chars().count()) {
            let text = format!("holder: write 1 to {LEASE_HOLDER_MAX} characters");
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        let ttl_ms = take.ttl_ms.unwrap_or(LEASE_TTL_DEFAULT_MS);
        if !(LEASE_TTL_MIN_MS..=LEASE_TTL_MAX_MS).contains(&ttl_ms) {
            let text = format!("ttl_ms {ttl_ms}: write {LEASE_TTL_MIN_MS} to {LEASE_TTL_MAX_MS}");
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        self.authorize_fence(take.fence, "taking it")?;
        let fence = take.fence.unwrap_or(self.last_fence + 1);
        self.last_fence = self.last_fence.max(fence);
        let ttl = std::time::Duration::from_millis(ttl_ms);
        let lease = Lease {
            holder: holder.to_owned(),
            fence,
            expires_at: Timestamp::from_system_time(now.time + ttl),
        };
        self.held = Some(HeldLease {
            lease: lease.clone(),
            until_s: now.monotonic_s + ttl.as_secs_f64(),
        });
        self.assert_invariants();
        Ok(lease)
    }

    fn release(&mut self, fence: u64) -> Result<(), Refusal> {
        self.authorize_fence(Some(fence), "the release")?;
        self.held = None;
        self.assert_invariants();
        Ok(())
    }

    /// Removes the holder, and returns true if a client held the lease.
    fn revoke(&mut self) -> bool {
        let was_held = self.held.take().is_some();
        self.assert_invariants();
        was_held
    }

    /// Removes the holder if the lease has expired, and returns the expired lease.
    fn expire(&mut self, now_s: f64) -> Option<Lease> {
        let expired = self.held.take_if(|held| held.until_s <= now_s + 1e-9);
        self.assert_invariants();
        expired.map(|held| held.lease)
    }

    /// Asserts the invariants of the lease in debug builds: the holder has the newest fence and a valid name, and its
    /// time is limited.
    fn assert_invariants(&self) {
        let Some(HeldLease { lease, until_s }) = &self.held else {
            return;
        };
        debug_assert_eq!(lease.fence, self.last_fence, "the holder has an old fence");
        let length = lease.holder.chars().count();
        debug_assert!(
            (1..=LEASE_HOLDER_MAX).contains(&length),
            "the name of the holder has {length} characters"
        );
        debug_assert!(until_s.is_finite(), "the lease never expires");
    }

    /// Refuses requests that do not come from the holder, and requests with the fence of an ended lease.
    fn authorize_fence(&self, fence: Option<u64>, what: &str) -> Result<(), Refusal> {
        let cs = self.cs;
        let holder = self.held().map_or_else(
            || "no client holds it now".to_owned(),
            |held| {
                format!(
                    "{} holds it until {}",
                    held.holder,
                    held.expires_at.to_the_second()
                )
            },
        );
        match (fence, self.held()) {
            (None, None) => Ok(()),
            (Some(fence), Some(held)) if held.fence == fence => Ok(()),
            (Some(fence), _) => {
                let text = format!(
                    "{what} is refused: the control lease {fence} of coordinate system {cs} has ended, and {holder}; \
                     check the state of the machine, then take the lease again"
                );
                Err(Refusal::new(RefusalCode::LeaseLost, text))
            }
            (None, Some(_)) => {
                let text = format!(
                    "{what} is refused: coordinate system {cs} is under a control lease, and {holder}; wait \
                     for the end of the lease, \
                     or ask an administrator to break it; hold, stop, abort and reset need no lease"
                );
                Err(Refusal::new(RefusalCode::Busy, text))
            }
        }
    }
}

/// Returns true for commands that start motion or prepare the next start.
pub(crate) fn needs_lease(verb: Verb) -> bool {
    match verb {
        Verb::Load
        | Verb::Start
        | Verb::Run
        | Verb::Resume
        | Verb::BackTrace
        | Verb::Mdi
        | Verb::Jog
        | Verb::Home => true,
        Verb::Hold | Verb::Stop | Verb::Abort | Verb::Reset | Verb::AlarmAcknowledge => false,
    }
}

impl CoordinateSystem {
    /// Refuses commands that start motion while another client holds the lease.
    pub(crate) fn authorize_by_lease(&self, verb: Verb, meta: &CommandMeta) -> Result<(), Refusal> {
        if !needs_lease(verb) {
            return Ok(());
        }
        self.lease.authorize_fence(meta.fence, &wire_name(&verb))
    }

    pub(crate) fn ask_lease(
        &mut self,
        request: &LeaseRequest,
        meta: &CommandMeta,
    ) -> Result<Answer, Refusal> {
        // A second copy of the request may arrive before the first is executed; its caller receives the stored reply.
        if let Some(said) = self.context.shared.replied(&meta.memory) {
            return Ok(Answer::Command(said));
        }
        let before = self.lease.held().cloned();
        let (what, lease) = self
            .change_lease(request, &meta.client_id)
            .map_err(|refusal| self.context.reject(meta, refusal))?;
        if let (Some(what), Some(of)) = (what, lease.as_ref().or(before.as_ref())) {
            self.record_lease(what, of, Some(&meta.client_id));
        }
        self.publish_lease();
        let reply = CommandReply {
            lease,
            ..self.context.reply_to(meta, CommandStatus::Done, "ok", "")
        };
        Ok(Answer::Command(self.context.shared.reply(meta, reply)))
    }

    /// Changes the lease. Returns the kind of change, if the journal records it, and the resulting lease.
    fn change_lease(
        &mut self,
        request: &LeaseRequest,
        client_id: &str,
    ) -> Result<(Option<LeaseChange>, Option<Lease>), Refusal> {
        match request {
            LeaseRequest::Take(take) => {
                let lease = self.lease.claim_lease(self.context.now(), take, client_id)?;
                Ok((take.fence.is_none().then_some(LeaseChange::Taken), Some(lease)))
            }
            LeaseRequest::Release(release) => {
                self.lease.release(release.fence)?;
                Ok((Some(LeaseChange::Released), None))
            }
            LeaseRequest::Break => Ok((self.lease.revoke().then_some(LeaseChange::Broken), None)),
        }
    }

    pub(crate) fn expire_lease(&mut self, now_s: f64) {
        if let Some(lease) = self.lease.expire(now_s) {
            self.record_lease(LeaseChange::Expired, &lease, None);
            self.publish_lease();
        }
    }

    fn record_lease(&self, what: LeaseChange, lease: &Lease, client_id: Option<&str>) {
        let event = Event::Lease {
            what,
            holder: lease.holder.clone(),
            fence: lease.fence,
            client_id: client_id.map(str::to_owned),
        };
        self.context.record(event);
    }

    pub(crate) fn publish_lease(&self) {
        let state = self.lease.held().cloned().into();
        self.context.publish(CsTopic::Lease, Payload::Lease(state));
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, UNIX_EPOCH};

    use tandem_testing::{Bench, kept_journal};

    use super::*;

    fn at(s: f64) -> Now {
        Now {
            monotonic_s: s,
            time: UNIX_EPOCH + Duration::from_secs_f64(1000.0 + s),
        }
    }

    fn lease_request(fence: Option<u64>, ttl_ms: Option<u64>) -> LeaseTake {
        LeaseTake {
            holder: None,
            ttl_ms,
            fence,
        }
    }

    #[test]
    fn nobody_needs_a_lease_that_nobody_holds() {
        let lease = ControlLease::new(1, at(0.0));
        assert_eq!(lease.authorize_fence(None, "start"), Ok(()));
        let refusal = lease.authorize_fence(Some(7), "start").unwrap_err();
        assert_eq!(refusal.code, RefusalCode::LeaseLost);
    }

    #[test]
    fn each_lease_has_a_larger_fence_and_a_renewal_keeps_its_own() {
        let mut lease = ControlLease::new(1, at(0.0));
        let first = lease
            .claim_lease(at(0.0), &lease_request(None, None), "a")
            .unwrap();
        let renewed = lease
            .claim_lease(at(10.0), &lease_request(Some(first.fence), Some(1000)), "a")
            .unwrap();
        assert_eq!(renewed.fence, first.fence);
        assert_eq!(renewed.expires_at.0, "1970-01-01T00:16:51.000000Z");
        lease.release(first.fence).unwrap();
        let second = lease
            .claim_lease(at(11.0), &lease_request(None, None), "b")
            .unwrap();
        assert!(second.fence > first.fence);
        let stale = lease
            .claim_lease(at(11.0), &lease_request(Some(first.fence), None), "a")
            .unwrap_err();
        assert_eq!(stale.code, RefusalCode::LeaseLost);
        assert_eq!(
            lease.release(first.fence).unwrap_err().code,
            RefusalCode::LeaseLost
        );
        assert_eq!(lease.held().unwrap().holder, "b");
    }

    #[test]
    fn a_fence_of_an_earlier_start_of_the_runtime_is_not_one_of_this() {
        let mut before = ControlLease::new(1, at(0.0));
        let old = before
            .claim_lease(at(1.0), &lease_request(None, None), "a")
            .unwrap();
        let mut now = ControlLease::new(1, at(5.0));
        let new = now.claim_lease(at(6.0), &lease_request(None, None), "b").unwrap();
        assert!(new.fence > old.fence);
        assert_eq!(
            now.authorize_fence(Some(old.fence), "start").unwrap_err().code,
            RefusalCode::LeaseLost
        );
    }

    #[test]
    fn a_lease_ends_by_its_time_and_not_before() {
        let mut lease = ControlLease::new(1, at(0.0));
        lease
            .claim_lease(at(0.0), &lease_request(None, None), "a")
            .unwrap();
        assert_eq!(lease.until_s(), Some(30.0), "30 s if no ttl is given");
        assert_eq!(lease.expire(29.999), None);
        let refusal = lease
            .claim_lease(at(29.0), &lease_request(None, None), "b")
            .unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Busy);
        assert!(
            refusal.text.contains("a holds it until 1970-01-01T00:17:10"),
            "{}",
            refusal.text
        );
        assert_eq!(lease.expire(30.0).unwrap().holder, "a");
        assert!(
            lease
                .claim_lease(at(30.0), &lease_request(None, None), "b")
                .is_ok()
        );
    }

    #[test]
    fn its_time_and_the_name_of_its_holder_are_bounded() {
        let mut lease = ControlLease::new(1, at(0.0));
        for ttl_ms in [0, 999, 600_001, u64::MAX] {
            let refusal = lease
                .claim_lease(at(0.0), &lease_request(None, Some(ttl_ms)), "a")
                .unwrap_err();
            assert_eq!(refusal.code, RefusalCode::Invalid);
            assert!(refusal.text.contains("1000 to 600000"), "{}", refusal.text);
        }
        for holder in [String::new(), "x".repeat(65)] {
            let named = LeaseTake {
                holder: Some(holder),
                ..LeaseTake::default()
            };
            assert_eq!(
                lease.claim_lease(at(0.0), &named, "a").unwrap_err().code,
                RefusalCode::Invalid
            );
        }
        assert!(
            lease
                .claim_lease(at(0.0), &lease_request(None, Some(600_000)), "a")
                .is_ok()
        );
    }

    #[test]
    fn a_lease_that_nobody_renews_ends_by_its_time_and_the_journal_tells() {
        let (journal, lines) = kept_journal();
        let play = Bench::new().journal(journal).play(async |scene, _| {
            let plc = scene.plc();
            let ask = plc_protocol::types::request::Request::Lease {
                cs: 1,
                request: LeaseRequest::Take(LeaseTake {
                    holder: Some("mes".to_owned()),
                    ttl_ms: Some(5000),
                    fence: None,
                }),
                meta: CommandMeta {
                    command_id: "t".to_owned(),
                    client_id: "c".to_owned(),
                    ..CommandMeta::default()
                },
            };
            plc.port().request(ask).await.unwrap();
            let system = plc.coordinate_system(1);
            plc.sleep(Duration::from_millis(4990)).await;
            assert_eq!(system.lease().await.unwrap().holder.as_deref(), Some("mes"));
            assert!(system.home(&[]).await.is_err());
            plc.sleep(Duration::from_millis(20)).await;
            assert_eq!(system.lease().await.unwrap().holder, None);
            system.home(&[]).await.unwrap();
            // coordinate system 2 has a lease of its own
            assert_eq!(plc.coordinate_system(2).lease().await.unwrap().holder, None);
        });
        play.unwrap();
        let lines = lines.lock().unwrap();
        let told = lines.iter().filter_map(|line| match &line.event {
            Event::Lease { what, holder, .. } => Some((*what, holder.as_str())),
            _ => None,
        });
        assert!(told.eq([(LeaseChange::Taken, "mes"), (LeaseChange::Expired, "mes")]));
    }

    #[test]
    fn a_jog_ends_when_another_takes_the_lease() {
        let play = Bench::new().play(async |scene, _| {
            let plc = scene.plc();
            let (jogger, system) = (plc.coordinate_system(1), plc.coordinate_system(1));
            let jog = tokio::spawn(async move { jogger.jog('X', 600.0, None, "j").await });
            plc.sleep(Duration::from_millis(100)).await;
            let lease = system.take_lease(Duration::from_secs(30)).await.unwrap();
            assert!(
                system.jog('X', 600.0, None, "j").await.is_err(),
                "its refresh is refused"
            );
            jog.await.unwrap().unwrap();
            let x = system.position().await.unwrap().machine["X"];
            assert!(
                x < 0.2 * 10.0 + 0.5,
                "it stops 200 ms after the last refresh that counts: {x}"
            );
            lease.release().await.unwrap();
        });
        play.unwrap();
    }
}
