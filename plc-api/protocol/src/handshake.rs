//! The ledger: a state machine for the outputs of one coordinate system and their resets.
//!
//! The ledger has no I/O, no clock and no task. The runtime calls the ledger with the time as a parameter,
//! and executes the [`Effect`]s. All transports use the ledger, so its [`rules`] apply to all transports:
//!
//! ```text
//! QUEUED -> OUTPUT -> CLAIMED -> reset
//!    |        | ^--------'  |      owner lost: OUTPUT again
//!    '--------+-------------'----> cancelled | failed | timed out
//! ```
//!
//! The ledger executes about ten million operations per second on one core, independent of the number of open
//! outputs (`cargo bench -p plc-api`).

mod closed;
mod effect;
mod identity;
mod invariants;
mod open_output;
mod reports;
mod result;
pub mod rules;

pub use closed::CLOSED_REMEMBERED;
pub use effect::{Effect, Full, Now, OutputOutcome, OutputSpec};
pub use identity::strictest;
pub(crate) use identity::{handler_in_use_text, unnamed_text};
pub use open_output::OpenOutput;
pub use reports::PROGRESS_TEXT_MAX;
pub use result::reset_of;

use std::time::SystemTime;

use crate::alarm::Alarm;
use crate::types::ids::is_client_id;
use crate::types::output::{
    Cancel, CancelReason, Claim, HandledCode, HandlerPresence, HandshakeResult, HandshakeStatus, OutputAct,
    OutputNotice, OutputState, Pending, Redeliver, Redelivery, Reset, ResetResult,
};
use crate::types::request::{OutputRequest, Refusal};
use crate::types::{BootId, CoordinateSystemNumber};

use closed::{ClosedOutputs, Fate};
use identity::{Denial, LiveHandlers};
use open_output::{IssuedOutput, OutputOwner, OutputStage, Ownership, UnclaimedOutput};
use result::{check_code, fault_alarm, result_of, status_of};

/// All outputs of one coordinate system, with their states.
#[derive(Debug)]
pub struct Ledger {
    boot_id: BootId,
    cs: CoordinateSystemNumber,
    /// Prefix of the output ids: `boot_id.cs.`. This prefix and `seq` identify an output permanently, because
    /// boot ids are never reused.
    id_prefix: String,
    open_outputs_max: usize,
    next_seq: u64,
    // ascending by `seq`
    open: Vec<OpenOutput>,
    closed: ClosedOutputs,
    handlers: LiveHandlers,
    effects: Vec<Effect>,
}

impl Ledger {
    /// Creates an empty ledger; its first output has `seq` 1. An `open_outputs_max` of 0 is treated as 1.
    pub fn new(boot_id: BootId, cs: CoordinateSystemNumber, open_outputs_max: usize) -> Self {
        Self {
            id_prefix: format!("{}.{cs}.", boot_id.0),
            boot_id,
            cs,
            open_outputs_max: open_outputs_max.max(1),
            next_seq: 1,
            open: Vec::new(),
            closed: ClosedOutputs::default(),
            handlers: LiveHandlers::default(),
            effects: Vec::new(),
        }
    }

    /// Adds an output as QUEUED, and returns its `seq`, which is greater than the `seq` of each earlier
    /// output.
    ///
    /// # Errors
    /// Returns [`Full`] if `open_outputs_max` outputs are open. The ledger drops nothing: the caller waits
    /// and tries again.
    pub fn enqueue(&mut self, now: Now, spec: OutputSpec) -> Result<u64, Full> {
        if self.open.len() >= self.open_outputs_max {
            return Err(Full);
        }
        let seq = self.next_seq;
        self.next_seq += 1;
        self.open.push(OpenOutput {
            notice: OutputNotice {
                id: [&*self.id_prefix, &seq.to_string()].concat(),
                seq,
                run_id: spec.run_id,
                m: spec.m,
                params: spec.params,
                timing: spec.timing,
                program: spec.program,
                line: spec.line,
                attempt: 0,
                redelivered: false,
            },
            since: now.time,
            redelivery: spec.redelivery,
            stage: OutputStage::Queued {
                timeout_s: spec.timeout_s,
            },
        });
        self.pending_changed();
        self.assert_invariants();
        Ok(seq)
    }

    /// Issues a queued output: publishes the output to handlers and starts its time limit. The state changes
    /// to CLAIMED if only one handler serves the M code and this handler is exclusive (H20), otherwise to
    /// OUTPUT. The output must be QUEUED: otherwise a debug build panics, and nothing changes.
    pub fn issue_output(&mut self, now: Now, seq: u64) {
        let place = self.index_of(seq);
        let issued = place.is_some_and(|place| {
            let output = &mut self.open[place];
            let owner = self.handlers.owner_at_once(output.notice.m);
            output.issue(now, owner)
        });
        debug_assert!(issued, "output {seq} cannot be issued, because it is not QUEUED");
        let Some(place) = place.filter(|_| issued) else {
            return;
        };
        let notice = self.open[place].notice.clone();
        self.pending_changed();
        self.effects.push(Effect::Output(notice));
        self.assert_invariants();
    }

    /// Executes a request about an output. `m` is the M number of the request, if the request has one.
    ///
    /// # Errors
    /// Fails if the code of a fault, a checkpoint, or the text or choices of a question, are out of range.
    pub fn execute_request(
        &mut self,
        now: Now,
        m: Option<u16>,
        request: &OutputRequest,
    ) -> Result<HandshakeResult, Refusal> {
        let (of, handler_id, instance, changed) = match request {
            OutputRequest::Claim(claim) => return Ok(self.claim(now, m, claim)),
            OutputRequest::Reset(reset) => {
                check_code(reset)?;
                return Ok(self.reset(now, m, reset));
            }
            OutputRequest::Progress(report) => {
                let changed = self.report(m, report);
                (
                    OutputAct::Progress,
                    &*report.handler_id,
                    &report.instance,
                    changed,
                )
            }
            OutputRequest::Checkpoint(report) => {
                let changed = self.store_checkpoint(m, report)?;
                (
                    OutputAct::Checkpoint,
                    &*report.handler_id,
                    &report.instance,
                    changed,
                )
            }
            OutputRequest::Redeliver(redeliver) => {
                (OutputAct::Redeliver, "", &None, self.decide(m, redeliver))
            }
            OutputRequest::Ask(ask) => {
                let changed = self.put_question(now, m, ask)?;
                (OutputAct::Ask, &*ask.handler_id, &ask.instance, changed)
            }
            OutputRequest::AnswerQuestion(answer) => {
                (OutputAct::Answer, "", &None, self.take_answer(m, answer))
            }
        };
        let result = result_of(of, (request.seq(), handler_id, instance), &changed);
        if changed.is_err() {
            self.publish_result(m, &result);
        }
        Ok(result)
    }

    /// Executes the claim of a handler (H4).
    ///
    /// `m` is the M number of the request, if the request has one. If this number differs from the M number
    /// of the output, the answer is `unknown` (H3).
    pub fn claim(&mut self, now: Now, m: Option<u16>, claim: &Claim) -> HandshakeResult {
        let who = (claim.seq, &*claim.handler_id, &claim.instance);
        let taken = self.try_claim(now, m, claim);
        let how = taken.as_ref().ok().copied().flatten();
        let mut result = result_of(OutputAct::Claim, who, &taken.map(|_| ()));
        result.how = how;
        self.publish_result(m, &result);
        result
    }

    fn try_claim(&mut self, now: Now, m: Option<u16>, claim: &Claim) -> Result<Option<Redelivery>, Denial> {
        let (place, issued) = self.find(&claim.boot_id, claim.seq, m)?;
        if !is_client_id(&claim.handler_id) {
            return Err((HandshakeStatus::NotOwner, None));
        }
        let instance = self
            .handlers
            .claimant(&claim.handler_id, claim.instance.as_ref())?;
        let output = &self.open[place];
        let how = match &issued.ownership {
            Ownership::Claimed(claimed) => {
                let owner = &claimed.owner;
                owner.check_sender(output.since, &claim.handler_id, instance.as_ref())?;
                return Ok(None);
            }
            Ownership::Unclaimed(unclaimed) => {
                self.handlers
                    .check_claim(output, unclaimed, &claim.handler_id, instance.as_ref())?
            }
        };
        let owner = OutputOwner {
            handler_id: claim.handler_id.clone(),
            instance,
        };
        self.open[place].set_owner(now, owner);
        self.pending_changed();
        self.assert_invariants();
        Ok(how)
    }

    /// Executes the reset of a handler or an operator (H5, H6).
    pub fn reset(&mut self, _now: Now, m: Option<u16>, reset: &Reset) -> HandshakeResult {
        let who = (reset.seq, &*reset.handler_id, &reset.instance);
        let (place, foreign) = match self.check_reset(m, reset) {
            Ok(judged) => judged,
            Err(denied) => {
                let result = result_of(OutputAct::Reset, who, &Err(denied));
                self.publish_result(m, &result);
                return result;
            }
        };
        let output_m = self.open[place].notice.m;
        let how = match reset.result {
            ResetResult::Ok => OutputOutcome::Reset,
            ResetResult::Fault => OutputOutcome::Failed {
                alarm: fault_alarm(output_m, reset),
            },
        };
        let cancel = foreign.then_some(CancelReason::Operator);
        self.close(place, how, cancel);
        // the answer follows the `pending` that no longer lists the output, and the end of the output
        let result = result_of(OutputAct::Reset, who, &Ok(()));
        self.publish_result(m.or(Some(output_m)), &result);
        result
    }

    /// Returns the index of the output that a reset ends, and true if another handler owns this output.
    fn check_reset(&self, m: Option<u16>, reset: &Reset) -> Result<(usize, bool), Denial> {
        let (place, issued) = self.find(&reset.boot_id, reset.seq, m)?;
        let (force, output) = (reset.force == Some(true), &self.open[place]);
        if !is_client_id(&reset.handler_id) {
            return Err((HandshakeStatus::NotOwner, None));
        }
        let judged = self
            .handlers
            .speaker(&reset.handler_id, reset.instance.as_ref())
            .and_then(|instance| match &issued.ownership {
                Ownership::Claimed(claimed) => {
                    let owner = &claimed.owner;
                    owner.check_sender(output.since, &reset.handler_id, reset.instance.as_ref())
                }
                Ownership::Unclaimed(unclaimed) => self.handlers.check_unclaimed_reset(
                    output,
                    unclaimed,
                    &reset.handler_id,
                    instance.as_ref(),
                ),
            });
        match judged {
            Ok(()) => Ok((place, false)),
            Err(_) if force => Ok((place, issued.claimed().is_some())),
            Err(denied) => Err(denied),
        }
    }

    /// Applies an operator's decision about an output without an owner: the output is published again with
    /// the decision `how`. The decision `ask` withdraws an earlier decision. Returns `not_owner` while a
    /// handler owns the output.
    pub fn redeliver(&mut self, _now: Now, m: Option<u16>, redeliver: &Redeliver) -> HandshakeStatus {
        status_of(&self.decide(m, redeliver))
    }

    fn decide(&mut self, m: Option<u16>, redeliver: &Redeliver) -> Result<(), Denial> {
        let how = Some(redeliver.how).filter(|how| *how != Redelivery::Ask);
        self.change(
            &redeliver.boot_id,
            redeliver.seq,
            m,
            |output, _| match &mut output.ownership {
                Ownership::Claimed(_) => Err((HandshakeStatus::NotOwner, None)),
                Ownership::Unclaimed(unclaimed) => {
                    unclaimed.decision = how;
                    Ok(true)
                }
            },
        )?;
        if how.is_some() {
            self.publish_again(|_, output, _| output.notice.seq == redeliver.seq);
        }
        Ok(())
    }

    /// Registers the online instance of a handler. Publishes the unclaimed outputs again that this instance
    /// may claim (H12).
    pub fn handler_online(&mut self, now: Now, handler_id: &str, presence: &HandlerPresence) {
        let cs = self.cs;
        self.handlers.insert_handler(cs, handler_id, presence, now.time);
        self.publish_again(|handlers, output, unclaimed| {
            let m = output.notice.m;
            presence.handles.contains(&HandledCode { cs, m })
                && handlers
                    .check_claim(output, unclaimed, handler_id, presence.instance.as_ref())
                    .is_ok()
        });
    }

    /// Handles the loss of a handler: each output that the handler owns changes to OUTPUT, and is marked
    /// `redelivered` and `lost` (H11). `instance` limits this to the outputs of one instance; `None` means
    /// the outputs of all instances.
    pub fn handler_lost(&mut self, now: Now, handler_id: &str, instance: Option<&str>) {
        let is_its = |output: &&mut OpenOutput| output.is_owned_by(handler_id, instance);
        let mut any = false;
        for output in self.open.iter_mut().filter(is_its) {
            let said = self.handlers.redelivery(handler_id, output.notice.m);
            output.lose_owner(now);
            output.redelivery = strictest(output.redelivery, said);
            any = true;
        }
        self.handlers.remove_handler(handler_id, instance);
        if any {
            self.pending_changed();
        }
        self.assert_invariants();
    }

    /// Publishes unclaimed outputs again after a new connection to the broker. Selects the outputs that are
    /// not withheld and for whose M number `handles` returns true. Each of them is marked `redelivered`, and
    /// its `attempt` increases by one.
    pub fn republish(&mut self, _now: Now, handles: impl Fn(u16) -> bool) {
        self.publish_again(|handlers, output, unclaimed| {
            handles(output.notice.m) && handlers.check_claim(output, unclaimed, "", None).is_ok()
        });
    }

    /// Ends an open output as failed, for example because no handler serves it. If the output has been issued, a
    /// cancel notifies its handler. If the output is not open, a debug build panics, and nothing changes.
    pub fn fail(&mut self, _now: Now, seq: u64, alarm: Alarm) {
        let Some(place) = self.index_of(seq) else {
            debug_assert!(false, "output {seq} cannot fail, because it is not open");
            return;
        };
        let cancel = self.is_issued(place).then_some(CancelReason::Alarm);
        self.close(place, OutputOutcome::Failed { alarm }, cancel);
    }

    /// Cancels every open output (H9).
    pub fn cancel_all(&mut self, _now: Now, reason: CancelReason) {
        if self.open.is_empty() {
            return;
        }
        let open: Vec<_> = self.open.drain(..).map(|output| output.in_short()).collect();
        for (seq, m, state) in &open {
            if *state != OutputState::Queued {
                self.cancel((*seq, *m), reason);
            }
        }
        self.pending_changed();
        for output in open {
            self.record_outcome(output, OutputOutcome::Cancelled(reason));
        }
        self.assert_invariants();
    }

    /// Ends the outputs whose time limit has passed as timed out (H10).
    pub fn expire(&mut self, now: Now) {
        let late = |output: &OpenOutput| {
            output
                .deadline_s()
                .is_some_and(|deadline_s| deadline_s <= now.monotonic_s)
        };
        while let Some(place) = self.open.iter().position(late) {
            self.close(place, OutputOutcome::TimedOut, Some(CancelReason::Timeout));
        }
    }

    /// Returns the earliest time at which [`Ledger::expire`] ends an output, seconds on the monotonic clock.
    pub fn next_deadline_s(&self) -> Option<f64> {
        self.open
            .iter()
            .filter_map(OpenOutput::deadline_s)
            .reduce(f64::min)
    }

    /// Returns all open outputs as the payload of `m_code/pending`, ascending by `seq`.
    pub fn pending(&self) -> Pending {
        Pending {
            outputs: self.open.iter().map(OpenOutput::to_pending).collect(),
        }
    }

    /// Returns the open output with this `seq`, or `None` if no such output is open.
    pub fn get(&self, seq: u64) -> Option<&OpenOutput> {
        self.index_of(seq).map(|place| &self.open[place])
    }

    /// Returns all open outputs, ascending by `seq`.
    pub fn open(&self) -> &[OpenOutput] {
        &self.open
    }

    /// Returns true while an output with this M number is open, including a queued output (D32).
    pub fn is_open(&self, m: u16) -> bool {
        self.open.iter().any(|output| output.notice.m == m)
    }

    /// Returns true if no output is open.
    pub fn is_empty(&self) -> bool {
        self.open.is_empty()
    }

    /// Returns true while the output waits because its owner was lost (`HANDLER_LOST`).
    pub fn is_lost(&self, seq: u64) -> bool {
        self.get(seq).is_some_and(OpenOutput::is_lost)
    }

    /// Returns the effects since the last call, in order. Call this method after each call that changes the
    /// ledger.
    pub fn take_effects(&mut self) -> impl Iterator<Item = Effect> {
        self.effects.drain(..)
    }
}

impl Ledger {
    fn index_of(&self, seq: u64) -> Option<usize> {
        self.open
            .binary_search_by_key(&seq, |output| output.notice.seq)
            .ok()
    }

    /// Returns true if the output has been published to handlers.
    fn is_issued(&self, place: usize) -> bool {
        self.open[place].issued().is_some()
    }

    /// Returns an open output that has been published, with its index, or the status that rejects a request
    /// about the output.
    fn find(&self, boot_id: &BootId, seq: u64, m: Option<u16>) -> Result<(usize, &IssuedOutput), Denial> {
        if *boot_id != self.boot_id {
            return Err((HandshakeStatus::Stale, None));
        }
        if seq == 0 || seq >= self.next_seq {
            return Err((HandshakeStatus::Unknown, None));
        }
        let Some(place) = self.index_of(seq) else {
            return Err((self.closed.answer(seq, m), None));
        };
        let output = &self.open[place];
        match output.issued() {
            Some(issued) if m.is_none_or(|m| m == output.notice.m) => Ok((place, issued)),
            _ => Err((HandshakeStatus::Unknown, None)),
        }
    }

    /// Calls `change` with an open output that has been published, and with the time at which the output entered
    /// its state. `change` returns true if `pending` shows the change.
    fn change(
        &mut self,
        boot_id: &BootId,
        seq: u64,
        m: Option<u16>,
        change: impl FnOnce(&mut IssuedOutput, SystemTime) -> Result<bool, Denial>,
    ) -> Result<(), Denial> {
        let (place, _) = self.find(boot_id, seq, m)?;
        let output = &mut self.open[place];
        let since = output.since;
        let issued = output.issued_mut().ok_or((HandshakeStatus::Unknown, None))?;
        if change(issued, since)? {
            self.pending_changed();
            self.assert_invariants();
        }
        Ok(())
    }

    fn publish_again(&mut self, which: impl Fn(&LiveHandlers, &OpenOutput, &UnclaimedOutput) -> bool) {
        let mut notices = Vec::new();
        for output in &mut self.open {
            if let Some(unclaimed) = output.unclaimed()
                && which(&self.handlers, output, unclaimed)
            {
                output.notice.redelivered = true;
                output.notice.attempt = output.notice.attempt.saturating_add(1);
                notices.push(Effect::Output(output.notice.clone()));
            }
        }
        if !notices.is_empty() {
            self.pending_changed();
            self.effects.append(&mut notices);
            self.assert_invariants();
        }
    }

    fn close(&mut self, place: usize, how: OutputOutcome, cancel: Option<CancelReason>) {
        let (seq, m, state) = self.open[place].in_short();
        self.open.drain(place..=place);
        if let Some(reason) = cancel {
            self.cancel((seq, m), reason);
        }
        self.pending_changed();
        self.record_outcome((seq, m, state), how);
        self.assert_invariants();
    }

    fn cancel(&mut self, (seq, m): (u64, u16), reason: CancelReason) {
        let cancel = Cancel { seq, reason };
        self.effects.push(Effect::Cancel { m, cancel });
    }

    fn record_outcome(&mut self, (seq, m, state): (u64, u16, OutputState), how: OutputOutcome) {
        let fate = match (&how, state) {
            (_, OutputState::Queued) => Fate::NeverIssued,
            (OutputOutcome::Reset, _) => Fate::Reset,
            _ => Fate::Ended,
        };
        self.closed.remember(seq, m, fate);
        self.effects.push(Effect::Closed { seq, m, how });
    }

    /// Publishes a result on the topic of the M number in the request, otherwise of the M number of the
    /// output.
    fn publish_result(&mut self, m: Option<u16>, result: &HandshakeResult) {
        let open = || self.get(result.seq).map(|output| output.notice.m);
        let known = || open().or_else(|| self.closed.m(result.seq));
        if let Some(m) = m.or_else(known) {
            let result = result.clone();
            self.effects.push(Effect::Result { m, result });
        }
    }

    fn pending_changed(&mut self) {
        if !matches!(self.effects.last(), Some(Effect::PendingChanged)) {
            self.effects.push(Effect::PendingChanged);
        }
    }
}

#[cfg(test)]
mod simulation;
#[cfg(test)]
mod tests;
