//! Issue of outputs (M codes passed to the sequence program): from the interpreter to the ledger, and from the ledger to
//! the subscribers.

use plc_protocol::handshake::{Effect, Now, OutputOutcome, OutputSpec};
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::{OutputNotice, OutputState, Params, Timing};
use plc_protocol::types::topic::CsTopic;
use tandem_config::UnhandledReaction;
use tandem_model::alarm::{M_CODE_TIMEOUT, M_CODE_UNHANDLED};
use tandem_model::flow::Output;
use tandem_store::journal::Event;

use super::output_ledger::origin;
use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::run::run_state::{Phase, RunEvent, Then};
use crate::sequence::stock::{self, StockAction};

impl CoordinateSystem {
    fn timing(&self, output: &Output) -> Timing {
        self.context
            .configured
            .timing(output, self.context.m_code(output.m))
    }

    /// Returns true if an output is issued when its block is interpreted, without waiting for a standstill.
    pub(crate) fn is_issued_at_once(&self, output: &Output) -> bool {
        let settings = self.context.m_code(output.m);
        let is_compensating = self.pipeline.is_compensating();
        (self.context.configured).is_issued_at_once(output, settings, is_compensating)
    }

    /// Issues an output at a standstill. Returns false if the output must wait.
    pub(crate) fn issue_at_standstill(&mut self, output: Output) -> bool {
        match self.timing(&output) {
            Timing::AfterMotion => self.issue_after_motion(output),
            Timing::WithMotion => self.issue_with_motion(output),
        }
    }

    /// Issues an output at a standstill, and makes the run wait for its reset. Returns false if the output must wait:
    /// for the reset of an earlier output with the same M number (D32), or for a free entry in the ledger.
    pub(crate) fn issue_after_motion(&mut self, output: Output) -> bool {
        let since_s = self.context.now_s();
        self.context.view.update(|place| {
            place.executing = output.origin;
            place.since_s = since_s;
        });
        let Some(seq) = self.enqueue(output, Timing::AfterMotion) else {
            self.drive(RunEvent::Phase(Phase::Room(output)));
            return false;
        };
        self.outputs.ledger.issue_output(self.context.now(), seq);
        self.drive(RunEvent::Phase(Phase::Reset { seq }));
        self.apply_effects();
        true
    }

    /// Issues an output while motion continues. Returns false if the output must wait, as in
    /// [`Self::issue_after_motion`] (D32).
    pub(crate) fn issue_with_motion(&mut self, output: Output) -> bool {
        let Some(seq) = self.enqueue(output, Timing::WithMotion) else {
            // The next motion must wait for the reset, so the motion that the stages still hold back ends at rest.
            let phase = match self.pipeline.flush() {
                Ok(()) => Phase::Room(output),
                Err(alarm) => Phase::Standstill(Then::Alarm(alarm)),
            };
            self.drive(RunEvent::Phase(phase));
            return false;
        };
        // D18: no output is issued during a hold; the output stays QUEUED until the resume.
        if self.state.is_running() || self.leaves_thread() {
            self.outputs.ledger.issue_output(self.context.now(), seq);
        }
        self.apply_effects();
        true
    }

    /// Issues an output that had to wait. Returns false if it must still wait.
    pub(crate) fn issue_if_room(&mut self, output: Output, held: bool) -> bool {
        if self.timing(&output) == Timing::WithMotion {
            self.drive(RunEvent::Phase(Phase::Interpret));
            return self.issue_with_motion(output);
        }
        !held && self.issue_after_motion(output)
    }

    /// Issues the outputs that a hold has delayed.
    pub(crate) fn issue_queued_outputs(&mut self) {
        for seq in self.outputs.queued() {
            self.outputs.ledger.issue_output(self.context.now(), seq);
        }
        self.apply_effects();
    }

    /// Updates from the ledger for which output the run waits.
    pub(crate) fn look_at_outputs(&mut self) {
        let is_at_rest = self.servo.finished_segment >= self.pipeline.planner.last_segment();
        let phase = self.state.phase();
        let awaited = phase.and_then(|phase| self.outputs.awaited(phase, is_at_rest));
        if awaited != self.state.awaited() {
            for action in self.change_state(RunEvent::Awaited(awaited)) {
                self.execute_action(action);
            }
        }
    }

    /// Adds an output to the ledger as QUEUED. Returns `None` while an output of the same M number is pending (D32),
    /// and while the ledger is full.
    fn enqueue(&mut self, output: Output, timing: Timing) -> Option<u64> {
        if self.outputs.ledger.is_open(output.m) {
            return None;
        }
        let run = self.state.run_mut()?;
        run.steps.in_block = true;
        let run_id = run.id.clone();
        let settings = self.context.m_code(output.m);
        let spec = OutputSpec {
            run_id,
            m: output.m,
            params: Params::from(output.params),
            timing,
            program: output.origin.program,
            line: output.origin.line,
            timeout_s: settings
                .and_then(|settings| settings.timeout_ms)
                .map(|ms| ms as f64 / 1000.0),
            redelivery: settings.and_then(|settings| settings.redelivery),
        };
        self.outputs.ledger.enqueue(self.context.now(), spec).ok()
    }

    /// Publishes and applies the effects of changes of the ledger, until no effect is left.
    pub(crate) fn apply_effects(&mut self) {
        loop {
            self.look_at_outputs();
            let effects: Vec<Effect> = self.outputs.ledger.take_effects().collect();
            if effects.is_empty() {
                return;
            }
            self.before_effects(&effects);
            for effect in effects {
                self.apply_effect(effect);
                self.look_at_outputs();
            }
        }
    }

    /// Writes the journal before any message, because each message may reach a handler. If an output is already claimed
    /// for a handler, the handler begins when it receives the message. So the matching state is published before, too.
    fn before_effects(&mut self, effects: &[Effect]) {
        let mut is_claimed = false;
        for effect in effects {
            let Effect::Output(notice) = effect else { continue };
            if notice.attempt > 1 {
                continue;
            }
            self.context.record(Event::Output(Box::new(notice.clone())));
            let output = self.outputs.ledger.get(notice.seq);
            if let Some(handler_id) = output.and_then(|output| output.handler_id()).map(str::to_owned) {
                let seq = notice.seq;
                self.context.record(Event::Claim { seq, handler_id });
                is_claimed = true;
            }
        }
        if is_claimed {
            self.publish_changes();
        }
    }

    fn apply_effect(&mut self, effect: Effect) {
        match effect {
            Effect::PendingChanged => {
                self.context
                    .publish(CsTopic::Pending, Payload::Pending(self.outputs.ledger.pending()));
            }
            Effect::Output(notice) => self.on_output(notice),
            Effect::Result { m, result } => {
                self.context.publish(CsTopic::Result(m), Payload::Result(result));
            }
            Effect::Cancel { m, cancel } => {
                self.context.publish(CsTopic::Cancel(m), Payload::Cancel(cancel));
            }
            Effect::Closed { seq, m, how } => self.on_closed(seq, m, how),
        }
    }

    fn on_output(&mut self, notice: OutputNotice) {
        let (seq, m, is_first) = (notice.seq, notice.m, notice.attempt <= 1);
        let origin = origin(&notice);
        self.context.publish(CsTopic::Output(m), Payload::Output(notice));
        if is_first {
            self.outputs.made.insert(seq, (m, origin));
            self.outputs.since_s.insert(seq, self.context.now_s());
            self.look_for_handler(seq, m);
        }
    }

    /// Looks for the handler of a new output. Without a handler that is online, the output waits for a handler that is
    /// expected to return, or is handled by [`Self::without_handler`].
    fn look_for_handler(&mut self, seq: u64, m: u16) {
        let (shared, cs) = (&self.context.shared, self.context.number);
        if shared.is_handled(cs, m) {
            return;
        }
        if let Some(until_s) = shared.handler_back_s(cs, m) {
            self.outputs.away.push((seq, until_s));
        } else if let Some(output) = self.outputs.ledger.get(seq) {
            let notice = output.notice.clone();
            self.without_handler(&notice);
        }
    }

    /// After a change of the handlers, lets unclaimed outputs wait until their handler returns. If no handler of an
    /// output returns, such as after a take-over by an instance that does not serve it, handles it without a handler.
    pub(crate) fn await_handler(&mut self) {
        let (shared, cs) = (&self.context.shared, self.context.number);
        let open = self.outputs.ledger.open().iter();
        // an output that has lost its owner waits for a claim or an operator instead
        let unclaimed = open.filter(|open| {
            open.state() == OutputState::Output && !open.is_lost() && !shared.is_handled(cs, open.notice.m)
        });
        let (mut away, mut unhandled) = (Vec::new(), Vec::new());
        for open in unclaimed {
            match shared.handler_back_s(cs, open.notice.m) {
                Some(until_s) => away.push((open.notice.seq, until_s)),
                None if self.outputs.has_stock_work(open.notice.seq) => {}
                None => unhandled.push(open.notice.clone()),
            }
        }
        self.outputs.away = away;
        for notice in unhandled {
            self.without_handler(&notice);
        }
    }

    /// Ends the wait for handlers that have not returned within their time limit, and handles their outputs without
    /// them.
    pub(crate) fn expire_handler_waits(&mut self, now: Now) {
        for (seq, m) in self.outputs.take_overdue(now.monotonic_s) {
            self.look_for_handler(seq, m);
        }
    }

    /// Handles an output without a handler: by the stock sequence program, or by the `unhandled` setting of the M code.
    fn without_handler(&mut self, notice: &OutputNotice) {
        let settings = self.context.m_code(notice.m).cloned().unwrap_or_default();
        let has_spindle = self.context.configured.settings.spindle.is_some();
        match stock::action(notice, &settings, has_spindle) {
            Some(Ok(action)) => self.start_stock_work(notice.seq, action, settings.simulated_s),
            Some(Err(text)) => self.fail_unhandled(notice, &text),
            None => match settings
                .unhandled
                .unwrap_or(self.context.shared.machine.unhandled)
            {
                UnhandledReaction::Wait => {}
                UnhandledReaction::AutoReset => {
                    self.start_stock_work(notice.seq, StockAction::Nothing, settings.simulated_s);
                }
                UnhandledReaction::Alarm => {
                    self.fail_unhandled(notice, &format!("M{:02} has no handler", notice.m));
                }
            },
        }
    }

    fn fail_unhandled(&mut self, notice: &OutputNotice, text: &str) {
        let alarm = plc_api::Alarm {
            number: M_CODE_UNHANDLED.number,
            text: format!("{}: {text}", M_CODE_UNHANDLED.title),
        };
        self.outputs.ledger.fail(self.context.now(), notice.seq, alarm);
    }

    fn on_closed(&mut self, seq: u64, m: u16, how: OutputOutcome) {
        let origin = self.outputs.made.remove(&seq).map(|(_, origin)| origin);
        let since_s = self.outputs.since_s.remove(&seq);
        match how {
            OutputOutcome::Reset => {
                if let Some(since_s) = since_s {
                    let took_s = self.context.now_s() - since_s;
                    self.context
                        .shared
                        .note_m_code_wait(self.context.number, m, took_s);
                }
            }
            OutputOutcome::Cancelled(_) => {}
            OutputOutcome::Failed { alarm } => self.raise(alarm.number, alarm.text, origin),
            OutputOutcome::TimedOut => {
                let timeout_ms = (self.context.m_code(m))
                    .and_then(|settings| settings.timeout_ms)
                    .unwrap_or_default();
                let text = format!("M{m:02} was not reset within {timeout_ms} ms");
                self.raise_entry(&M_CODE_TIMEOUT, &text, origin);
            }
        }
    }
}
