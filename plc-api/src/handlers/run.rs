//! The loop of a sequence program, which reads messages of the machine and starts handlers.

use std::collections::{HashMap, HashSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::{AbortHandle, Abortable};
use futures_util::stream::FuturesUnordered;
use futures_util::{FutureExt, StreamExt};

use plc_protocol::alarm::Alarm;
use plc_protocol::error::Result;
use plc_protocol::port::BoxFuture;
use plc_protocol::supervisor::panic_text;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{CancelReason, HandshakeStatus, OutputState, PendingOutput, Redelivery};
use plc_protocol::types::question::{Validate, ValidateResult};
use plc_protocol::types::request::Request;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use tracing::Instrument;

use crate::aux_output::{AuxOutput, CancelSender};
use crate::claim::{OutputId, decide_start, until_answered};
use crate::handler_session::{Change, Event, HandlerDeclaration, HandlerSession, Registration, open_outputs};
use crate::plc::Plc;

use super::table::{BoxedHandler, Table};

/// Largest number of started outputs of one coordinate system that are remembered. Reason: far fewer outputs
/// are started before a stale `pending` message arrives.
const STARTED_MAX: usize = 4096;

/// Largest number of pairs of boot and coordinate system whose started outputs are remembered. Each boot has
/// up to eight pairs.
const STARTED_SYSTEMS_MAX: usize = 32;

/// Time for which a stopping program waits until the machine has accepted that the program takes no further
/// output.
const LEAVE_MAX: Duration = Duration::from_secs(2);

struct RunningHandler {
    output: AuxOutput,
    abort: AbortHandle,
    cancel: CancelSender,
}

struct Runner {
    table: Table,
    on_redelivery: Option<Redelivery>,
    running: HashMap<OutputId, RunningHandler>,
    // outputs that this instance has started: a stale `pending` may still list them after their end
    started: StartedOutputs,
    work: FuturesUnordered<BoxFuture<'static, OutputId>>,
    presence: HandlerSession,
    // true once the machine has accepted the announcement of the handlers; outputs are claimed from then on
    is_known: bool,
    // true once the program takes no further output
    is_stopping: bool,
}

/// Outputs that this instance has started, by boot and coordinate system.
#[derive(Debug, Default)]
struct StartedOutputs(VecDeque<(BootId, CoordinateSystemNumber, RecentSeqs)>);

/// Started outputs of one boot and coordinate system, by `seq`. At the limit, the output that was added first
/// is forgotten, independent of its `seq`.
#[derive(Debug, Default)]
struct RecentSeqs {
    known: HashSet<u64>,
    order: VecDeque<u64>,
}

impl StartedOutputs {
    fn remember_output(&mut self, id: &OutputId) {
        let known = self.0.iter().position(|(boot, cs, _)| is_of(id, boot, *cs));
        let at = known.unwrap_or_else(|| {
            self.0
                .push_back((id.boot_id.clone(), id.cs, RecentSeqs::default()));
            if self.0.len() > STARTED_SYSTEMS_MAX {
                self.0.pop_front();
            }
            self.0.len() - 1
        });
        self.0[at].2.remember_seq(id.seq);
    }

    fn knows(&self, id: &OutputId) -> bool {
        let mut of_id = self.0.iter().filter(|(boot, cs, _)| is_of(id, boot, *cs));
        of_id.any(|(_, _, latest)| latest.known.contains(&id.seq))
    }
}

impl RecentSeqs {
    fn remember_seq(&mut self, seq: u64) {
        if !self.known.insert(seq) {
            return;
        }
        self.order.push_back(seq);
        if self.order.len() > STARTED_MAX
            && let Some(oldest) = self.order.pop_front()
        {
            self.known.remove(&oldest);
        }
    }
}

fn is_of(id: &OutputId, boot: &BootId, cs: CoordinateSystemNumber) -> bool {
    id.cs == cs && id.boot_id == *boot
}

/// Settings for the start and the end of a sequence program.
#[derive(Debug, Clone, Copy)]
pub(super) struct LifecycleOptions {
    pub(super) on_redelivery: Option<Redelivery>,
    pub(super) takes_over: bool,
    /// Time within which the program announces to return after a stop; zero if it does not return.
    pub(super) returns_within: Duration,
    /// Time limit of the handlers after the stop; `None` means no limit.
    pub(super) ends_within: Option<Duration>,
}

impl LifecycleOptions {
    pub(super) fn new() -> Self {
        Self {
            on_redelivery: None,
            takes_over: false,
            returns_within: Duration::from_mins(1),
            ends_within: None,
        }
    }
}

pub(super) async fn run<T>(
    table: Table,
    how: LifecycleOptions,
    plc: &Plc,
    handler_id: Arc<str>,
    stop: impl Future<Output = T>,
) -> Result<()> {
    let said = HandlerDeclaration {
        codes: table.codes(),
        m_codes: table.declarations(),
        alarms: table.alarms.values().cloned().collect(),
        validates: table.validates(),
        takes_over: how.takes_over,
        redelivery: how.on_redelivery,
        is_exclusive: true,
    };
    let presence = HandlerSession::new(plc, handler_id, said);
    // this guard is dropped after the runner, and thus after the handlers
    let offline = presence.offline_on_drop();
    let mut runner = Runner {
        table,
        on_redelivery: how.on_redelivery,
        running: HashMap::new(),
        started: StartedOutputs::default(),
        work: FuturesUnordered::new(),
        presence,
        is_known: false,
        is_stopping: false,
    };
    let mut stop = std::pin::pin!(stop);
    let mut late: BoxFuture<'static, ()> = Box::pin(std::future::pending());
    while !(runner.has_ended() && runner.presence.is_settled()) {
        tokio::select! {
            // messages first, so that a cancel reaches a handler before the handler is polled again
            biased;
            event = runner.presence.next() => match event? {
                Some(event) => runner.on_event(event),
                None => return Ok(()),
            },
            Some(id) = runner.work.next() => runner.on_end(&id),
            _ = &mut stop, if !runner.is_stopping => {
                runner.on_stop();
                if let Some(limit) = how.ends_within {
                    let plc = plc.clone();
                    late = Box::pin(async move { plc.sleep(limit).await });
                }
            }
            () = &mut late => {
                tracing::warn!("{} handlers had not ended at the limit", runner.running.len());
                break;
            }
            // if the machine does not answer, the end of the connection reports that the program is offline
            () = plc.sleep(LEAVE_MAX), if runner.has_ended() => break,
        }
    }
    drop(runner);
    offline.report_offline(how.returns_within).await;
    Ok(())
}

impl Drop for Runner {
    fn drop(&mut self) {
        self.cancel_where(|_| true, Some(CancelReason::Shutdown));
        for running in self.running.values() {
            running.output.forget_clean_ups();
        }
    }
}

impl Runner {
    /// Stops the program from accepting outputs: from now on the machine claims no output for this program.
    fn on_stop(&mut self) {
        self.is_stopping = true;
        self.presence.claim_by_message();
    }

    fn has_ended(&self) -> bool {
        self.is_stopping && self.running.is_empty()
    }

    fn on_event(&mut self, event: Event) {
        match event {
            Event::Message(_, Some(Change::Boot)) => {
                if let Some(boot) = &self.presence.open.online {
                    self.cancel_where(|other| other.boot_id != *boot, Some(CancelReason::Shutdown));
                }
                self.update_all_handlers();
            }
            Event::Message(_, Some(Change::Pending(cs))) => self.update_handlers(cs),
            Event::Message(message, None) => self.on_message(&message),
            Event::Announced => {
                if !std::mem::replace(&mut self.is_known, true) {
                    self.update_all_handlers();
                }
            }
            Event::Reclaimed(id, false) => self.cancel_where(|other| *other == id, None),
            Event::Reclaimed(id, true) => {
                if let Some(running) = self.running.get(&id) {
                    self.presence
                        .send_all(running.output.last_reports(), "a report was not sent again");
                }
            }
        }
    }

    fn on_message(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (Topic::CoordinateSystem(cs, CsTopic::Cancel(_)), Payload::Cancel(told)) => {
                let is_it =
                    |id: &OutputId| (id.cs, id.seq) == (*cs, told.seq) && id.boot_id == message.boot_id;
                self.cancel_where(is_it, Some(told.reason));
            }
            (Topic::CoordinateSystem(cs, CsTopic::Validate(m)), Payload::Validate(asked)) => {
                self.on_validate(*cs, *m, asked);
            }
            _ => {}
        }
    }

    /// Checks the parameters of an M code in an NC program that the machine loads, and sends the result.
    fn on_validate(&mut self, cs: CoordinateSystemNumber, m: u16, asked: &Validate) {
        if !self.table.validates() || self.table.find(cs, m).is_none() {
            return;
        }
        let refused = self.table.validate(cs, m, &asked.params).err();
        let result = ValidateResult {
            request_id: asked.request_id.clone(),
            handler_id: self.presence.by.id(),
            ok: refused.is_none(),
            text: refused.map(|alarm| alarm.text),
        };
        let request = Request::ValidateResult(cs, Some(m), result);
        self.presence
            .send(request, "the result of a validation did not arrive");
    }

    fn update_all_handlers(&mut self) {
        let systems: Vec<_> = self.presence.open.all().map(|(cs, _)| cs).collect();
        for cs in systems {
            self.update_handlers(cs);
        }
    }

    /// Ends each handler whose output is no longer open or belongs to another handler. Starts handlers for
    /// open outputs.
    fn update_handlers(&mut self, cs: CoordinateSystemNumber) {
        let Some(message) = self.presence.open.pending_message(cs).filter(|_| self.is_known) else {
            return;
        };
        let message = Arc::clone(message);
        let is_ours = |output: &PendingOutput| {
            let owner = output.handler_id.as_deref();
            owner.is_none_or(|owner| owner == &*self.presence.by.handler_id)
        };
        let is_over = |id: &OutputId| {
            let mut open = open_outputs(&message).iter();
            id.cs == cs
                && id.boot_id == message.boot_id
                && !open.any(|output| output.output.seq == id.seq && is_ours(output))
        };
        self.cancel_where(is_over, None);
        for output in open_outputs(&message) {
            let id = OutputId::from_pending(&message, cs, output);
            match output.state {
                OutputState::Output => self.start_handler(id, output, false),
                OutputState::Claimed if self.is_claimed_for_us(output) && self.is_new(&id) => {
                    self.start_handler(id, output, true);
                }
                _ => {}
            }
        }
    }

    /// Returns true if the machine has claimed the output for this instance (H20).
    fn is_claimed_for_us(&self, output: &PendingOutput) -> bool {
        let by = &self.presence.by;
        output.output.attempt == 1
            && output.handler_id.as_deref() == Some(&*by.handler_id)
            && output.instance.as_deref() == Some(&*by.instance)
    }

    /// Returns true if this instance has not started the output before.
    fn is_new(&self, id: &OutputId) -> bool {
        !self.running.contains_key(id) && !self.started.knows(id)
    }

    /// Returns true if the output was claimed for this instance (H20) but this instance has never started the
    /// output, because the message was lost.
    fn is_never_started(&self, id: &OutputId, output: &PendingOutput) -> bool {
        output.lost_instance.as_deref() == Some(&*self.presence.by.instance) && self.is_new(id)
    }

    fn start_handler(&mut self, id: OutputId, pending: &PendingOutput, is_claimed: bool) {
        if let Some(running) = self.running.get(&id) {
            // the handler still runs, because only the connection was lost
            if pending.lost && !running.abort.is_aborted() && !running.output.is_answering() {
                self.presence.reclaim(id, pending.output.m);
            }
            return;
        }
        let handler = self.table.work(id.cs, pending.output.m, &pending.output.params);
        let Some(handler) = handler.filter(|_| is_claimed || !self.is_stopping) else {
            return;
        };
        let redelivery = self.table.redelivery(Some(id.cs), pending.output.m);
        let verify = if self.is_never_started(&id, pending) {
            false
        } else if let Some(verify) = decide_start(pending, redelivery.or(self.on_redelivery)) {
            verify
        } else {
            return;
        };
        self.started.remember_output(&id);
        let (output, cancel) =
            AuxOutput::new((&self.presence, &self.table.states), id.clone(), pending, verify);
        let (abort, registration) = AbortHandle::new_pair();
        let claiming = (!is_claimed).then(|| Claiming {
            registration: self.presence.registration(),
            is_lost: pending.lost,
        });
        let work = work(output.clone(), handler, claiming);
        let work = Box::pin(Abortable::new(work, registration));
        let ending = run_to_end(work, id.clone(), output.clone());
        self.work.push(Box::pin(ending));
        let running = RunningHandler {
            output,
            abort,
            cancel,
        };
        self.running.insert(id, running);
    }

    fn cancel_where(&self, is_meant: impl Fn(&OutputId) -> bool, reason: Option<CancelReason>) {
        for (id, running) in &self.running {
            if is_meant(id) && !running.output.is_answering() && !running.abort.is_aborted() {
                running.cancel.cancel(reason);
                running.abort.abort();
            }
        }
    }

    fn on_end(&mut self, id: &OutputId) {
        let ended = self.running.remove(id);
        if ended.is_some_and(|running| running.abort.is_aborted()) {
            self.update_handlers(id.cs);
        }
    }
}

/// Runs a handler to its end, and drops its future before the end is reported. A panic in a destructor ends
/// no other handler. If the handler was cancelled, its clean-ups run before the end is reported.
async fn run_to_end(
    mut work: Pin<Box<Abortable<impl Future<Output = ()>>>>,
    id: OutputId,
    output: AuxOutput,
) -> OutputId {
    let ended = (&mut work).await;
    if let Err(panicked) = catch_unwind(AssertUnwindSafe(|| drop(work))) {
        let text = panic_text(&*panicked);
        tracing::error!(seq = id.seq, "the clean-up of a handler panicked: {text}");
    }
    if ended.is_err() {
        output.clean_up().await;
    }
    output.forget_clean_ups();
    id
}

/// Data for the claim of an output that the machine has not claimed for this handler.
struct Claiming {
    registration: Registration,
    /// True if the output was lost with the connection of its handler, and with it the registration.
    is_lost: bool,
}

impl Claiming {
    /// Claims the output; returns true if the machine has accepted the claim.
    async fn succeeds(&self, output: &AuxOutput) -> bool {
        let (m, seq) = (output.m(), output.seq());
        let claim = output.key().claim(m, output.by());
        let answer = if self.is_lost {
            self.registration.claim_lost(claim).await
        } else {
            self.registration.claim(claim).await
        };
        match answer {
            Ok(Some(result)) if result.status == HandshakeStatus::Accepted => {
                // an operator may have decided since the message from which this handler began
                if let Some(how) = result.how {
                    output.set_redelivered(how == Redelivery::Verify);
                }
                return true;
            }
            Ok(result) => tracing::debug!(m, seq, ?result, "the output is not claimed by this handler"),
            Err(refusal) => {
                tracing::warn!(m, seq, %refusal, "the output is not claimed: the registration was refused");
            }
        }
        false
    }
}

/// Claims the output, unless the machine has claimed it for this handler. Then runs the handler, and resets
/// the output.
async fn work(output: AuxOutput, handler: BoxedHandler, claiming: Option<Claiming>) {
    let (plc, m, seq) = (output.plc(), output.m(), output.seq());
    if let Some(claiming) = claiming
        && !claiming.succeeds(&output).await
    {
        return;
    }
    let result = call(&output, &handler).await;
    output.set_answering();
    let reset = output.key().reset(m, output.by(), result.err());
    let status = until_answered(plc, reset).await;
    // `duplicate` means that the machine received this reset twice, because its answer was late
    if !matches!(
        status,
        Some(HandshakeStatus::Accepted | HandshakeStatus::Duplicate)
    ) {
        tracing::warn!(m, seq, ?status, "the machine did not accept the reset");
    }
}

async fn call(output: &AuxOutput, handler: &BoxedHandler) -> Result<(), Alarm> {
    let span = tracing::info_span!(
        "m_code",
        cs = output.coordinate_system(),
        m = output.m(),
        seq = output.seq(),
        run_id = output.run_id()
    );
    let work = output.at_work_on(async { handler(output.clone(), output.plc().clone()).await });
    let work = work.instrument(span);
    let panicked = match AssertUnwindSafe(work).catch_unwind().await {
        Ok(result) => return result,
        Err(panicked) => panicked,
    };
    let text = format!(
        "the handler of M{} panicked: {}",
        output.m(),
        panic_text(&*panicked)
    );
    tracing::error!("{text}");
    Err(Alarm::user(Alarm::CODE_OF_PANIC, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn h20_last_started_outputs_are_remembered_at_any_boot_or_cs_order() {
        let id = |boot: &str, cs, seq| OutputId {
            boot_id: BootId(boot.into()),
            cs,
            seq,
        };
        let mut begun = StartedOutputs::default();
        for seq in 1..=STARTED_MAX as u64 + 1 {
            begun.remember_output(&id("f", 2, seq));
        }
        for early in [id("f", 1, 1), id("a", 1, 1), id("a", 1, 1), id("a", 1, 0)] {
            begun.remember_output(&early);
            assert!(begun.knows(&early));
        }
        assert!(!begun.knows(&id("f", 2, 1)) && begun.knows(&id("f", 2, 2)));
        // an output that is added again keeps its age: outputs that were added before it are forgotten first
        for again in [id("f", 2, 1), id("f", 2, 0)] {
            begun.remember_output(&again);
        }
        assert!(begun.knows(&id("f", 2, 0)) && begun.knows(&id("f", 2, 1)));
        assert!(!begun.knows(&id("f", 2, 3)) && begun.knows(&id("f", 2, 4)));
        for boot in 0..STARTED_SYSTEMS_MAX {
            begun.remember_output(&id(&boot.to_string(), 2, 1));
        }
        assert!(!begun.knows(&id("a", 1, 1)) && begun.knows(&id("0", 2, 1)));
    }
}
