//! Presence and claims of a named handler. The raw queue and sequence programs use it.
//!
//! The session announces the handler at each boot of the runtime. It announces the handler again if a late
//! last will of an earlier connection or of another instance has arrived. It repeats the claims that were
//! lost with the connection. When the handler leaves, the machine releases its claims. If another instance
//! announces the same id, the machine refuses the other instance, or the other instance takes over and this
//! session ends.

use std::collections::{BTreeMap, BTreeSet};
use std::mem::replace;
use std::sync::Arc;
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use plc_protocol::error::{Error, Result};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::BoxFuture;
use plc_protocol::types::alarm_text::AlarmText;
use plc_protocol::types::handler::{HandlerResult, HandlerStatus, RETURNS_WITHIN_MS};
use plc_protocol::types::m_code::MCodeDeclaration;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{
    HandledCode, HandlerPresence, HandshakeResult, HandshakeStatus, OutputState, PendingOutput, Redelivery,
};
use plc_protocol::types::request::{Refusal, Request, typed};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};

use crate::claim::{HandshakeAttempt, OutputId, RETRY, ask_once};
use crate::identity::Identity;
use crate::plc::Plc;

/// Number of refusals after which an announcement has failed. Reason to try again: an earlier program of this
/// name may be about to end.
const TRIES: u32 = 5;

/// Time for which a leaving handler waits until the machine has answered its offline report.
const OFFLINE_REPORT_MAX: Duration = Duration::from_secs(1);

/// An M code of one coordinate system, or of all coordinate systems (`None`).
pub(crate) type ServedCode = (Option<CoordinateSystemNumber>, u16);

/// Contents of the announcement of a handler.
#[derive(Debug, Clone, Default)]
pub(crate) struct HandlerDeclaration {
    pub(crate) codes: BTreeSet<ServedCode>,
    /// Declarations of the M codes.
    pub(crate) m_codes: Vec<MCodeDeclaration>,
    /// Texts of the alarms of the handler.
    pub(crate) alarms: Vec<AlarmText>,
    /// True if the handler checks parameters at program load.
    pub(crate) validates: bool,
    /// True if the handler takes over from another instance.
    pub(crate) takes_over: bool,
    pub(crate) redelivery: Option<Redelivery>,
    /// True if the machine claims outputs for the handler (H20).
    pub(crate) is_exclusive: bool,
}

/// A guard that reports to the machine on drop that the handler is offline.
#[derive(Debug)]
pub(crate) struct OfflineGuard {
    pub(crate) plc: Plc,
    pub(crate) by: Identity,
    is_sent: bool,
}

const NOT_SENT: &str = "the machine was not notified that the handlers are offline";

impl OfflineGuard {
    /// Reports to the machine now that the handler is offline, and waits for the answer, because the process
    /// may end next. If `returns_within` is zero, the handler does not return.
    pub(crate) async fn report_offline(mut self, returns_within: Duration) {
        self.is_sent = true;
        self.plc.levels().clear_owner();
        let ms = u64::try_from(returns_within.as_millis()).unwrap_or(u64::MAX);
        let ms = ms.min(*RETURNS_WITHIN_MS.end());
        let request = self.offline_request(RETURNS_WITHIN_MS.contains(&ms).then_some(ms));
        tokio::select! {
            answer = self.plc.port().request(request) => if let Err(refusal) = answer {
                tracing::warn!(%refusal, "{NOT_SENT}");
            },
            () = self.plc.sleep(OFFLINE_REPORT_MAX) => tracing::warn!("{NOT_SENT}"),
        }
    }

    fn offline_request(&self, returns_within_ms: Option<u64>) -> Request {
        let gone = HandlerPresence {
            returns_within_ms,
            ..HandlerPresence::offline(Some(self.by.instance()))
        };
        Request::Handler(self.by.id(), gone)
    }
}

impl Drop for OfflineGuard {
    fn drop(&mut self) {
        if !self.is_sent {
            self.plc.levels().clear_owner();
            self.plc
                .send_without_waiting(self.offline_request(None), NOT_SENT);
        }
    }
}

/// The boot of the machine that is online, and its open outputs.
#[derive(Debug, Default)]
pub(crate) struct OpenOutputs {
    pub(crate) online: Option<BootId>,
    // the last `pending` message of each coordinate system; its boot may have ended
    pending: BTreeMap<CoordinateSystemNumber, Arc<Message>>,
}

/// Change of the open outputs or of the online boot that a message has caused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Change {
    /// Another boot is online than before, or no boot is online.
    Boot,
    /// The open outputs of a coordinate system have changed.
    Pending(CoordinateSystemNumber),
}

impl OpenOutputs {
    pub(crate) fn on_message(&mut self, message: &Arc<Message>) -> Option<Change> {
        match (&message.topic, &message.payload) {
            (_, Payload::Presence(presence)) => {
                let online = presence.online.then(|| message.boot_id.clone());
                let before = replace(&mut self.online, online);
                (before != self.online).then_some(Change::Boot)
            }
            (Topic::CoordinateSystem(cs, CsTopic::Pending), Payload::Pending(_)) => {
                self.pending.insert(*cs, Arc::clone(message));
                Some(Change::Pending(*cs))
            }
            _ => None,
        }
    }

    /// Returns the `pending` messages of the online boot, one for each coordinate system.
    pub(crate) fn all(&self) -> impl Iterator<Item = (CoordinateSystemNumber, &Arc<Message>)> {
        let all = self.pending.iter().map(|(&cs, message)| (cs, message));
        all.filter(|(_, message)| self.online.as_ref() == Some(&message.boot_id))
    }

    pub(crate) fn outputs(&self) -> impl Iterator<Item = (OutputId, &PendingOutput)> {
        self.all().flat_map(|(cs, message)| {
            let outputs = open_outputs(message).iter();
            outputs.map(move |output| (OutputId::from_pending(message, cs, output), output))
        })
    }

    /// Returns the `pending` message of one coordinate system of the online boot.
    pub(crate) fn pending_message(&self, cs: CoordinateSystemNumber) -> Option<&Arc<Message>> {
        self.all().find(|(of, _)| *of == cs).map(|(_, message)| message)
    }
}

/// Returns the open outputs in a `pending` message.
pub(crate) fn open_outputs(message: &Message) -> &[PendingOutput] {
    match &message.payload {
        Payload::Pending(pending) => &pending.outputs,
        _ => &[],
    }
}

#[derive(Debug)]
pub(crate) enum Event {
    /// A message of the machine, and the change that the message has caused.
    Message(Arc<Message>, Option<Change>),
    /// The machine has accepted the announcement.
    Announced,
    /// A claim was repeated. The value is true if the machine has accepted the claim.
    Reclaimed(OutputId, bool),
}

/// State of the announcement of the handler to the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Announcement {
    Never,
    Pending,
    PendingAgain,
    Done,
}

/// Session of a handler: announces the handler to the machine and repeats its lost claims.
pub(crate) struct HandlerSession {
    pub(crate) plc: Plc,
    pub(crate) by: Identity,
    pub(crate) open: OpenOutputs,
    declaration: HandlerDeclaration,
    messages: Subscription,
    systems: Vec<CoordinateSystemNumber>,
    announced: Announcement,
    reclaiming: BTreeSet<OutputId>,
    requests: FuturesUnordered<BoxFuture<'static, std::result::Result<Option<Event>, Refusal>>>,
}

impl HandlerSession {
    /// Creates a new instance of a handler.
    pub(crate) fn new(plc: &Plc, handler_id: Arc<str>, declaration: HandlerDeclaration) -> Self {
        let by = Identity::new(handler_id);
        plc.levels().set_owner(&by);
        Self {
            plc: plc.clone(),
            by,
            declaration,
            messages: plc.port().subscribe(Filter::Handshake),
            open: OpenOutputs::default(),
            systems: Vec::new(),
            announced: Announcement::Never,
            reclaiming: BTreeSet::new(),
            requests: FuturesUnordered::new(),
        }
    }

    /// Returns a guard that reports to the machine on drop that the handler is offline.
    pub(crate) fn offline_on_drop(&self) -> OfflineGuard {
        OfflineGuard {
            plc: self.plc.clone(),
            by: self.by.clone(),
            is_sent: false,
        }
    }

    /// Waits for the next event and returns it; returns `None` if the machine has ended the connection.
    /// Cancellation safe.
    ///
    /// # Errors
    /// Fails if the machine or the connection refuses the handler, or if another instance has taken over.
    pub(crate) async fn next(&mut self) -> Result<Option<Event>> {
        loop {
            tokio::select! {
                // messages first, so that a cancel reaches a handler before the handler is polled again
                biased;
                message = self.messages.next() => {
                    if let Some(text) = message.as_deref().and_then(|message| self.text_of(message, HandlerStatus::TakenOver)) {
                        return Err(Error::TakenOver { handler_id: self.by.id(), text });
                    }
                    return Ok(message.map(|message| self.on_message(message)));
                }
                Some(done) = self.requests.next() => {
                    if let Some(event) = done? {
                        self.on_done(&event);
                        return Ok(Some(event));
                    }
                }
            }
        }
    }

    /// Returns the text of a message that reports the status `wanted` to this instance. Returns `None` for
    /// any other message.
    fn text_of(&self, message: &Message, wanted: HandlerStatus) -> Option<String> {
        let (Topic::HandlerResult(id), Payload::HandlerResult(result)) = (&message.topic, &message.payload)
        else {
            return None;
        };
        let HandlerResult {
            instance,
            status,
            text,
            ..
        } = result;
        let is_it = **id == *self.by.handler_id
            && instance.as_deref() == Some(&self.by.instance)
            && *status == wanted;
        is_it.then(|| text.clone().unwrap_or_default())
    }

    fn on_message(&mut self, message: Arc<Message>) -> Event {
        let change = self.open.on_message(&message);
        let must_announce = match (&message.topic, &message.payload) {
            (_, Payload::Presence(_)) => change.is_some(),
            (_, Payload::Birth(birth)) => {
                let systems: Vec<_> = birth.coordinate_systems.iter().map(|cs| cs.number).collect();
                let before = replace(&mut self.systems, systems);
                before != self.systems
            }
            // a last will of an earlier connection or of another instance arrived after the announcement
            (Topic::HandlerPresence(id), Payload::HandlerPresence(presence)) => {
                self.announced != Announcement::Never && **id == *self.by.handler_id && !presence.online
            }
            (Topic::HandlerResult(_), Payload::HandlerResult(_)) => {
                self.text_of(&message, HandlerStatus::Confirm).is_some()
            }
            _ => false,
        };
        if must_announce {
            self.announce();
        }
        Event::Message(message, change)
    }

    fn on_done(&mut self, event: &Event) {
        match event {
            Event::Message(..) => {}
            Event::Announced => {
                if replace(&mut self.announced, Announcement::Done) == Announcement::PendingAgain {
                    // the boot that accepted the announcement may have ended meanwhile, so announce again
                    self.announce();
                } else if let Some(boot) = self.open.online.clone() {
                    let plc = self.plc.clone();
                    self.requests.push(Box::pin(async move {
                        plc.write_levels(&boot).await;
                        Ok(None)
                    }));
                }
            }
            Event::Reclaimed(id, _) => {
                self.reclaiming.remove(id);
            }
        }
    }

    /// Returns the presence message that announces the handler for the existing coordinate systems.
    fn announcement(&self) -> HandlerPresence {
        let codes = self.declaration.codes.iter().flat_map(|(cs, m)| {
            let systems = cs.as_ref().map_or(&*self.systems, std::slice::from_ref);
            systems.iter().map(|cs| (*cs, *m))
        });
        let codes: BTreeSet<_> = codes.collect();
        HandlerPresence {
            online: true,
            handles: codes.into_iter().map(|(cs, m)| HandledCode { cs, m }).collect(),
            validates: self.declaration.validates,
            instance: Some(self.by.instance()),
            take_over: self.declaration.takes_over && self.announced == Announcement::Never,
            exclusive: self.declaration.is_exclusive,
            redelivery: self.declaration.redelivery,
            m_codes: self.declaration.m_codes.clone(),
            alarms: self.declaration.alarms.clone(),
            expires_ms: None,
            returns_within_ms: None,
            connection: None,
        }
    }

    /// Announces to the machine that from now on it must not claim outputs for this handler (H20).
    pub(crate) fn claim_by_message(&mut self) {
        self.declaration.is_exclusive = false;
        if self.announced != Announcement::Never {
            self.announce();
        }
    }

    /// Returns true if no announcement waits for the answer of the machine.
    pub(crate) fn is_settled(&self) -> bool {
        matches!(self.announced, Announcement::Never | Announcement::Done)
    }

    fn announce(&mut self) {
        if self.systems.is_empty() || self.open.online.is_none() {
            return;
        }
        if matches!(self.announced, Announcement::Pending | Announcement::PendingAgain) {
            self.announced = Announcement::PendingAgain;
            return;
        }
        let online = self.announcement();
        self.announced = Announcement::Pending;
        let (plc, id) = (self.plc.clone(), self.by.id());
        self.requests.push(Box::pin(async move {
            send_presence(&plc, &id, online).await?;
            Ok(Some(Event::Announced))
        }));
    }

    /// Returns the open outputs that have lost their handler, each with its M number.
    pub(crate) fn lost_outputs(&self) -> Vec<(OutputId, u16)> {
        let outputs = self.open.outputs();
        let lost = outputs.filter(|(_, output)| output.lost && output.state == OutputState::Output);
        lost.map(|(id, output)| (id, output.output.m)).collect()
    }

    /// Claims an output again that was lost with the connection while this instance still works on the
    /// output.
    pub(crate) fn reclaim(&mut self, id: OutputId, m: u16) {
        if !self.reclaiming.insert(id.clone()) {
            return;
        }
        let (claim, registration) = (id.claim(m, &self.by), self.registration());
        self.requests.push(Box::pin(async move {
            let answer = registration.claim_lost(claim).await?;
            let is_ours = answer.is_some_and(|result| result.status == HandshakeStatus::Accepted);
            Ok(Some(Event::Reclaimed(id, is_ours)))
        }));
    }

    /// Returns a registration that contains the current announcement.
    pub(crate) fn registration(&self) -> Registration {
        Registration {
            plc: self.plc.clone(),
            by: self.by.clone(),
            presence: self.announcement(),
        }
    }

    /// Sends a request without waiting for its answer.
    pub(crate) fn send(&mut self, request: Request, what_if_not: &'static str) {
        self.send_all(vec![request], what_if_not);
    }

    /// Sends requests one after the other. The caller does not wait for the answers.
    pub(crate) fn send_all(&mut self, requests: Vec<Request>, what_if_not: &'static str) {
        let plc = self.plc.clone();
        self.requests.push(Box::pin(async move {
            for request in requests {
                if let Err(refusal) = plc.port().request(request).await {
                    tracing::warn!(%refusal, "{what_if_not}");
                }
            }
            Ok(None)
        }));
    }
}

/// Registration of a handler. The machine accepts no claim without a registration, and drops the registration
/// if the connection is lost.
#[derive(Debug)]
pub(crate) struct Registration {
    plc: Plc,
    by: Identity,
    presence: HandlerPresence,
}

impl Registration {
    /// Claims an output, and repeats the claim until the machine answers. Returns `None` if the machine
    /// refuses the claim permanently. Before each repetition the handler registers again, because the
    /// connection may have been lost meanwhile.
    ///
    /// # Errors
    /// Fails if the machine refuses the registration permanently.
    pub(crate) async fn claim(
        &self,
        claim: typed::Claim,
    ) -> std::result::Result<Option<HandshakeResult>, Refusal> {
        match ask_once(&self.plc, claim.clone()).await {
            HandshakeAttempt::Answered(result) => Ok(Some(result)),
            HandshakeAttempt::Refused => Ok(None),
            HandshakeAttempt::NotYet => self.claim_lost(claim).await,
        }
    }

    /// Claims an output that was lost with the connection, as [`claim`](Self::claim) does. The handler also
    /// registers before the first claim.
    ///
    /// # Errors
    /// Fails if the machine refuses the registration permanently.
    pub(crate) async fn claim_lost(
        &self,
        claim: typed::Claim,
    ) -> std::result::Result<Option<HandshakeResult>, Refusal> {
        loop {
            send_presence(&self.plc, &self.by.handler_id, self.presence.clone()).await?;
            match ask_once(&self.plc, claim.clone()).await {
                HandshakeAttempt::Answered(result) => return Ok(Some(result)),
                HandshakeAttempt::Refused => return Ok(None),
                HandshakeAttempt::NotYet => {}
            }
        }
    }
}

/// Announces a presence, and repeats the announcement until the machine has accepted it.
///
/// # Errors
/// Fails after 5 refusals by the machine or the connection; temporary errors are not counted.
async fn send_presence(plc: &Plc, id: &str, presence: HandlerPresence) -> std::result::Result<(), Refusal> {
    let mut tries = 0;
    loop {
        let request = Request::Handler(id.to_owned(), presence.clone());
        let Err(refusal) = plc.port().request(request).await else {
            return Ok(());
        };
        tries += u32::from(!refusal.code.may_pass());
        if tries == TRIES {
            return Err(refusal);
        }
        tracing::warn!(%refusal, "handler presence not delivered yet");
        plc.sleep(RETRY).await;
    }
}
