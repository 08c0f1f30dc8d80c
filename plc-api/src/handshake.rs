//! The ledger of outputs and resets of one coordinate system.
//!
//! A pure state machine: no I/O, no clock, no task. The coordinator calls it with the time as a parameter and carries
//! out the [`Effect`]s. Every transport goes through it, so that its [`rules`] hold for all:
//!
//! ```text
//! QUEUED -> OUTPUT -> CLAIMED -> reset
//!    |        | ^--------'  |      owner lost: OUTPUT again
//!    '--------+-------------'----> cancelled | failed | timed out
//! ```
//!
//! It does some ten million operations a second on one core, however many outputs are open (`cargo bench -p plc-api`).

mod closed;
mod effect;
pub mod rules;

pub use closed::CLOSED_REMEMBERED;
pub use effect::{Closed, Effect, Full, Now, OpenOutput, OutputSpec};

use crate::alarm::Alarm;
use crate::text::cut;
use crate::types::ids::{CLIENT_ID_MAX, is_client_id};
use crate::types::output::{
    Cancel, CancelReason, Claim, HandshakeResult, HandshakeStatus, OutputNotice, OutputState, Pending,
    Progress, ProgressReport, Redeliver, Redelivery, Reset, ResetResult,
};
use crate::types::question::{Ask, OperatorAnswer, Question};
use crate::types::request::{OutputRequest, Refusal};
use crate::types::{BootId, Timestamp};

use closed::{ClosedOutputs, Fate};

/// Characters of a progress text; a longer one is cut there: it is one line of a panel.
pub const PROGRESS_TEXT_MAX: usize = 200;

/// Outputs of one coordinate system, from QUEUED to their end.
#[derive(Debug)]
pub struct Ledger {
    boot_id: BootId,
    open_outputs_max: usize,
    next_seq: u64,
    // ascending by seq
    open: Vec<OpenOutput>,
    closed: ClosedOutputs,
    effects: Vec<Effect>,
}

impl Ledger {
    /// An empty ledger; its first output has `seq` 1. `open_outputs_max` of 0 counts as 1.
    pub fn new(boot_id: BootId, open_outputs_max: usize) -> Self {
        Self {
            boot_id,
            open_outputs_max: open_outputs_max.max(1),
            next_seq: 1,
            open: Vec::new(),
            closed: ClosedOutputs::default(),
            effects: Vec::new(),
        }
    }

    /// Takes an output as QUEUED, and gives its `seq`, greater than all before.
    ///
    /// # Errors
    /// [`Full`] when `open_outputs_max` outputs are open: the caller waits and asks again; nothing is dropped.
    pub fn enqueue(&mut self, now: Now, spec: OutputSpec) -> Result<u64, Full> {
        if self.open.len() >= self.open_outputs_max {
            return Err(Full);
        }
        let seq = self.next_seq;
        self.next_seq += 1;
        self.open.push(OpenOutput {
            notice: OutputNotice {
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
            state: OutputState::Queued,
            handler_id: None,
            since: now.time,
            lost: false,
            how: None,
            progress: None,
            question: None,
            deadline_s: None,
            timeout_s: spec.timeout_s,
        });
        self.pending_changed();
        Ok(seq)
    }

    /// QUEUED to OUTPUT: publishes it, and starts its time limit. Without effect in any other state.
    pub fn put_out(&mut self, now: Now, seq: u64) {
        let Some(place) = self.place(seq) else { return };
        let output = &mut self.open[place];
        if output.state != OutputState::Queued {
            return;
        }
        output.state = OutputState::Output;
        output.since = now.time;
        output.deadline_s = output.timeout_s.map(|timeout_s| now.monotonic_s + timeout_s);
        output.notice.attempt = 1;
        let notice = output.notice.clone();
        self.pending_changed();
        self.effects.push(Effect::Output(notice));
    }

    /// Carries out what is said of an output. `m` is the M number that the transport names, if it does.
    ///
    /// # Errors
    /// Text or choices of a question are out of their limits.
    pub fn carry_out(
        &mut self,
        now: Now,
        m: Option<u16>,
        request: &OutputRequest,
    ) -> Result<HandshakeResult, Refusal> {
        let (handler_id, status) = match request {
            OutputRequest::Claim(claim) => return Ok(self.claim(now, m, claim)),
            OutputRequest::Reset(reset) => return Ok(self.reset(now, m, reset)),
            OutputRequest::Progress(report) => (report.handler_id.as_str(), self.progress(now, m, report)),
            OutputRequest::Redeliver(redeliver) => ("", self.redeliver(now, m, redeliver)),
            OutputRequest::Ask(ask) => (ask.handler_id.as_str(), self.ask(now, m, ask)?),
            OutputRequest::AnswerQuestion(answer) => ("", self.answer_question(now, m, answer)),
        };
        Ok(HandshakeResult {
            seq: request.seq(),
            handler_id: handler_id.to_owned(),
            status,
        })
    }

    /// A handler takes an output (H4).
    ///
    /// `m` is the M number that the transport names, if it does: another than the output's is `unknown` (H3).
    pub fn claim(&mut self, now: Now, m: Option<u16>, claim: &Claim) -> HandshakeResult {
        let found = self.find(&claim.boot_id, claim.seq, m);
        let status = match found {
            Err(status) => status,
            Ok(_) if !is_client_id(&claim.handler_id) => HandshakeStatus::NotOwner,
            Ok(place) => self.claim_open(now, place, &claim.handler_id),
        };
        self.answer(m, claim.seq, &claim.handler_id, status)
    }

    /// A handler or an operator answers an output (H5, H6).
    pub fn reset(&mut self, _now: Now, m: Option<u16>, reset: &Reset) -> HandshakeResult {
        let place = match self.find(&reset.boot_id, reset.seq, m) {
            Ok(place) => place,
            Err(status) => return self.answer(m, reset.seq, &reset.handler_id, status),
        };
        let (force, output) = (reset.force == Some(true), &self.open[place]);
        let owner = output.handler_id.as_deref();
        let foreign = owner.is_some_and(|owner| owner != reset.handler_id);
        if !is_client_id(&reset.handler_id) || (foreign && !force) {
            return self.answer(m, reset.seq, &reset.handler_id, HandshakeStatus::NotOwner);
        }
        let output_m = output.notice.m;
        let how = match reset.result {
            ResetResult::Ok => Closed::Reset,
            ResetResult::Fault => Closed::Failed {
                alarm: fault_alarm(output_m, reset),
            },
        };
        let cancel = foreign.then_some(CancelReason::Operator);
        self.close(place, how, cancel);
        // the answer follows the pending topic that no longer shows the output, and the end of the output itself
        self.answer(
            m.or(Some(output_m)),
            reset.seq,
            &reset.handler_id,
            HandshakeStatus::Accepted,
        )
    }

    /// The owner tells how far it is (H13). `not_owner` from anyone else, also while nobody owns the output.
    pub fn progress(&mut self, _now: Now, m: Option<u16>, report: &ProgressReport) -> HandshakeStatus {
        let place = match self.find(&report.boot_id, report.seq, m) {
            Ok(place) => place,
            Err(status) => return status,
        };
        let output = &mut self.open[place];
        if output.handler_id.as_deref() != Some(report.handler_id.as_str()) {
            return HandshakeStatus::NotOwner;
        }
        let mut text = report.text.clone();
        cut(&mut text, PROGRESS_TEXT_MAX);
        let percent = report.percent.filter(|percent| percent.is_finite());
        output.progress = Some(Progress {
            text,
            percent: percent.map(|percent| percent.clamp(0.0, 100.0)),
        });
        self.pending_changed();
        HandshakeStatus::Accepted
    }

    /// The owner asks the operator, in place of the question before, or without choices takes its question back. Asked
    /// again with the same id it is the same question. `not_owner` from anyone else (H14).
    ///
    /// # Errors
    /// Text or choices are out of their limits.
    pub fn ask(&mut self, now: Now, m: Option<u16>, ask: &Ask) -> Result<HandshakeStatus, Refusal> {
        ask.check()?;
        let place = match self.find(&ask.boot_id, ask.seq, m) {
            Ok(place) => place,
            Err(status) => return Ok(status),
        };
        let output = &mut self.open[place];
        if output.handler_id.as_deref() != Some(ask.handler_id.as_str()) {
            return Ok(HandshakeStatus::NotOwner);
        }
        let is_asked = output
            .question
            .as_ref()
            .is_some_and(|question| question.id == ask.question_id);
        if is_asked == ask.choices.is_empty() {
            output.question = (!is_asked).then(|| Question {
                id: ask.question_id.clone(),
                text: ask.text.clone(),
                choices: ask.choices.clone(),
                since: Timestamp::from_system_time(now.time),
                answer: None,
            });
            self.pending_changed();
        }
        Ok(HandshakeStatus::Accepted)
    }

    /// An operator answers. `unknown` when there is no such question or choice, `duplicate` when it has an answer.
    pub fn answer_question(&mut self, _now: Now, m: Option<u16>, answer: &OperatorAnswer) -> HandshakeStatus {
        let place = match self.find(&answer.boot_id, answer.seq, m) {
            Ok(place) => place,
            Err(status) => return status,
        };
        let asked = self.open[place].question.as_mut();
        let Some(question) = asked.filter(|question| {
            question.id == answer.question_id && question.choices.contains(&answer.choice)
        }) else {
            return HandshakeStatus::Unknown;
        };
        if question.answer.is_some() {
            return HandshakeStatus::Duplicate;
        }
        question.answer = Some(answer.choice.clone());
        self.pending_changed();
        HandshakeStatus::Accepted
    }

    /// An operator decides about an output that nobody owns: it is published again with `how`, and `ask` takes an
    /// earlier decision back. `not_owner` while a handler owns it.
    pub fn redeliver(&mut self, _now: Now, m: Option<u16>, redeliver: &Redeliver) -> HandshakeStatus {
        let place = match self.find(&redeliver.boot_id, redeliver.seq, m) {
            Ok(place) => place,
            Err(status) => return status,
        };
        let output = &mut self.open[place];
        if output.state == OutputState::Claimed {
            return HandshakeStatus::NotOwner;
        }
        if redeliver.how == Redelivery::Ask {
            output.how = None;
            self.pending_changed();
        } else {
            output.how = Some(redeliver.how);
            self.publish_again(|output| output.notice.seq == redeliver.seq);
        }
        HandshakeStatus::Accepted
    }

    /// A handler has gone: each output that it owns is OUTPUT again, `redelivered` and `lost` (H11).
    pub fn handler_lost(&mut self, now: Now, handler_id: &str) {
        let mut any = false;
        for output in &mut self.open {
            if output.handler_id.as_deref() != Some(handler_id) {
                continue;
            }
            output.state = OutputState::Output;
            output.handler_id = None;
            output.since = now.time;
            output.lost = true;
            output.how = None;
            output.progress = None;
            output.question = None;
            output.notice.redelivered = true;
            any = true;
        }
        if any {
            self.pending_changed();
        }
    }

    /// Publishes the unclaimed outputs whose M number `handles` names again, as `redelivered` with `attempt` one
    /// higher: a handler for them came online, or the connection to the broker was made anew.
    pub fn republish(&mut self, _now: Now, handles: impl Fn(u16) -> bool) {
        self.publish_again(|output| handles(output.notice.m));
    }

    /// The runtime fails an output, such as one that nobody handles; its owner is told.
    pub fn fail(&mut self, _now: Now, seq: u64, alarm: Alarm) {
        if let Some(place) = self.place(seq) {
            let cancel = self.made(place).then_some(CancelReason::Alarm);
            self.close(place, Closed::Failed { alarm }, cancel);
        }
    }

    /// Cancels every open output (H9).
    pub fn cancel_all(&mut self, _now: Now, reason: CancelReason) {
        if self.open.is_empty() {
            return;
        }
        let open = std::mem::take(&mut self.open);
        for output in open.iter().filter(|output| output.state != OutputState::Queued) {
            let (seq, m) = (output.notice.seq, output.notice.m);
            let cancel = Cancel { seq, reason };
            self.effects.push(Effect::Cancel { m, cancel });
        }
        self.pending_changed();
        for output in open {
            self.end(&output, Closed::Cancelled(reason));
        }
    }

    /// Ends the outputs whose time limit has passed (H10).
    pub fn expire(&mut self, now: Now) {
        let late = |output: &OpenOutput| {
            output
                .deadline_s
                .is_some_and(|deadline_s| deadline_s <= now.monotonic_s)
        };
        while let Some(place) = self.open.iter().position(late) {
            self.close(place, Closed::TimedOut, Some(CancelReason::Timeout));
        }
    }

    /// When [`Ledger::expire`] has something to do next, seconds on the monotonic clock.
    pub fn next_deadline_s(&self) -> Option<f64> {
        self.open
            .iter()
            .filter_map(|output| output.deadline_s)
            .reduce(f64::min)
    }

    /// All open outputs, ascending by `seq`.
    pub fn pending(&self) -> Pending {
        Pending {
            outputs: self.open.iter().map(OpenOutput::to_pending).collect(),
        }
    }

    /// An open output.
    pub fn get(&self, seq: u64) -> Option<&OpenOutput> {
        self.place(seq).map(|place| &self.open[place])
    }

    /// All open outputs, ascending by `seq`.
    pub fn open(&self) -> &[OpenOutput] {
        &self.open
    }

    /// True while an output of this M number is open, queued ones included (D32).
    pub fn is_open(&self, m: u16) -> bool {
        self.open.iter().any(|output| output.notice.m == m)
    }

    /// True when no output is open.
    pub fn is_empty(&self) -> bool {
        self.open.is_empty()
    }

    /// True while the output waits after its owner has gone (`HANDLER_LOST`).
    pub fn is_lost(&self, seq: u64) -> bool {
        self.get(seq).is_some_and(|output| output.lost)
    }

    /// What is to be published or done since the last call, in order. To be taken after each call that changes.
    pub fn take_effects(&mut self) -> impl Iterator<Item = Effect> + use<> {
        std::mem::take(&mut self.effects).into_iter()
    }
}

impl Ledger {
    fn place(&self, seq: u64) -> Option<usize> {
        self.open
            .binary_search_by_key(&seq, |output| output.notice.seq)
            .ok()
    }

    /// True when the output has been shown to handlers.
    fn made(&self, place: usize) -> bool {
        self.open[place].state != OutputState::Queued
    }

    /// The open output of these names, or why there is none.
    fn find(&self, boot_id: &BootId, seq: u64, m: Option<u16>) -> Result<usize, HandshakeStatus> {
        if *boot_id != self.boot_id {
            return Err(HandshakeStatus::Stale);
        }
        if seq == 0 || seq >= self.next_seq {
            return Err(HandshakeStatus::Unknown);
        }
        let Some(place) = self.place(seq) else {
            return Err(self.closed.answer(seq, m));
        };
        let output = &self.open[place];
        if output.state == OutputState::Queued || m.is_some_and(|m| m != output.notice.m) {
            return Err(HandshakeStatus::Unknown);
        }
        Ok(place)
    }

    fn claim_open(&mut self, now: Now, place: usize, handler_id: &str) -> HandshakeStatus {
        let output = &mut self.open[place];
        match output.handler_id.as_deref() {
            Some(owner) if owner == handler_id => return HandshakeStatus::Accepted,
            Some(_) => return HandshakeStatus::NotOwner,
            None => {}
        }
        output.state = OutputState::Claimed;
        output.handler_id = Some(handler_id.to_owned());
        output.since = now.time;
        output.lost = false;
        output.how = None;
        self.pending_changed();
        HandshakeStatus::Accepted
    }

    fn publish_again(&mut self, which: impl Fn(&OpenOutput) -> bool) {
        let mut notices = Vec::new();
        for output in &mut self.open {
            if output.state == OutputState::Output && which(output) {
                output.notice.redelivered = true;
                output.notice.attempt = output.notice.attempt.saturating_add(1);
                notices.push(Effect::Output(output.notice.clone()));
            }
        }
        if !notices.is_empty() {
            self.pending_changed();
            self.effects.append(&mut notices);
        }
    }

    fn close(&mut self, place: usize, how: Closed, cancel: Option<CancelReason>) {
        let output = self.open.remove(place);
        if let Some(reason) = cancel {
            let (seq, m) = (output.notice.seq, output.notice.m);
            let cancel = Cancel { seq, reason };
            self.effects.push(Effect::Cancel { m, cancel });
        }
        self.pending_changed();
        self.end(&output, how);
    }

    fn end(&mut self, output: &OpenOutput, how: Closed) {
        let (seq, m) = (output.notice.seq, output.notice.m);
        let fate = match (&how, output.state) {
            (_, OutputState::Queued) => Fate::NeverMade,
            (Closed::Reset, _) => Fate::Reset,
            _ => Fate::Ended,
        };
        self.closed.remember(seq, m, fate);
        self.effects.push(Effect::Closed { seq, m, how });
    }

    fn answer(
        &mut self,
        m: Option<u16>,
        seq: u64,
        handler_id: &str,
        status: HandshakeStatus,
    ) -> HandshakeResult {
        let mut handler_id = handler_id.to_owned();
        cut(&mut handler_id, CLIENT_ID_MAX);
        let result = HandshakeResult {
            seq,
            handler_id,
            status,
        };
        let known = || {
            self.get(seq)
                .map(|output| output.notice.m)
                .or_else(|| self.closed.m(seq))
        };
        if let Some(m) = m.or_else(known) {
            let result = result.clone();
            self.effects.push(Effect::Result { m, result });
        }
        result
    }

    fn pending_changed(&mut self) {
        if self.effects.last() != Some(&Effect::PendingChanged) {
            self.effects.push(Effect::PendingChanged);
        }
    }
}

fn fault_alarm(m: u16, reset: &Reset) -> Alarm {
    let text = reset.text.clone().unwrap_or_else(|| {
        let mut handler_id = reset.handler_id.clone();
        cut(&mut handler_id, CLIENT_ID_MAX);
        format!("M{m} failed; {handler_id} gave no reason")
    });
    Alarm::user(reset.code.unwrap_or(0), text)
}

#[cfg(test)]
mod simulation;
#[cfg(test)]
mod tests;
