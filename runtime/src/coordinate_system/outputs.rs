//! Outputs and resets: from the interpreter to the ledger, and from the ledger to whoever listens.

use plc_api::handshake::{Closed, Effect, Now, OutputSpec};
use plc_api::types::message::Payload;
use plc_api::types::output::{
    Claim, HandlerPresence, HandshakeResult, HandshakeStatus, OutputNotice, OutputState, Params, Reset,
    ResetResult, Timing,
};
use plc_api::types::question::{Ask, OperatorAnswer};
use plc_api::types::request::{Answer, Refusal, RefusalCode};
use plc_api::types::state::SpindleDirection;
use plc_api::types::topic::CsTopic;
use tandem_model::alarm::{HANDLER_LOST, M_CODE_TIMEOUT, M_CODE_UNHANDLED};
use tandem_model::flow::Output;
use tandem_model::{Alarm, Origin};
use tandem_servo::Control;

use super::CoordinateSystem;
use super::run_state::{Awaited, Phase, RunEvent, Then};
use crate::config::Unhandled;
use crate::journal::{Event, ResetOutcome};
use crate::sequence::stock::{self, StockAction};

/// Who resets what the stock sequence program does.
const STOCK_HANDLER: &str = "stock";

/// An output that the stock sequence program works on.
#[derive(Debug, Clone, Copy)]
pub(super) struct StockWork {
    seq: u64,
    /// When it resets; `None`: when the spindle is oriented.
    pub due_s: Option<f64>,
}

pub(super) fn handshake_answer(seq: u64, handler_id: &str, status: HandshakeStatus) -> Answer {
    Answer::Handshake(HandshakeResult {
        seq,
        handler_id: handler_id.to_owned(),
        status,
    })
}

impl CoordinateSystem {
    /// An output with parameters is always `after_motion` (D30).
    pub(super) fn is_with_motion(&self, output: &Output) -> bool {
        let settings = self.shared.machine.m_codes.get(&output.m);
        !output.has_params() && settings.is_some_and(|settings| settings.timing == Timing::WithMotion)
    }

    /// Puts out at a standstill; false when it has to wait for the reset of the same M number (D32), or for room.
    pub(super) fn put_out_after_motion(&mut self, output: Output) -> bool {
        self.view.update(|place| place.executing = output.origin);
        let Some(seq) = self.enqueue(output, Timing::AfterMotion) else {
            self.drive(RunEvent::Phase(Phase::Room(output)));
            return false;
        };
        self.ledger.put_out(self.shared.now(), seq);
        self.drive(RunEvent::Phase(Phase::Reset { seq }));
        self.carry_out_effects();
        true
    }

    /// Puts out while motion goes on; false when it has to wait (D32).
    pub(super) fn put_out_with_motion(&mut self, output: Output) -> bool {
        let Some(seq) = self.enqueue(output, Timing::WithMotion) else {
            // Nothing follows soon: what is held back comes to rest here.
            let phase = match self.pipeline.flush() {
                Ok(()) => Phase::Room(output),
                Err(alarm) => Phase::Standstill(Then::Alarm(alarm)),
            };
            self.drive(RunEvent::Phase(phase));
            return false;
        };
        // D18: while held no output is made; it stays QUEUED until the resume.
        if self.state.is_running() || self.pipeline.in_thread() {
            self.ledger.put_out(self.shared.now(), seq);
        }
        self.carry_out_effects();
        true
    }

    /// Puts out what had to wait; false when it still has to.
    pub(super) fn put_out_if_room(&mut self, output: Output, held: bool) -> bool {
        if self.is_with_motion(&output) {
            self.drive(RunEvent::Phase(Phase::Interpret));
            return self.put_out_with_motion(output);
        }
        !held && self.put_out_after_motion(output)
    }

    /// Makes the outputs that a hold kept back.
    pub(super) fn put_out_queued(&mut self) {
        let queued: Vec<u64> = (self.ledger.open().iter())
            .filter(|open| open.state == OutputState::Queued)
            .map(|open| open.notice.seq)
            .collect();
        for seq in queued {
            self.ledger.put_out(self.shared.now(), seq);
        }
        self.carry_out_effects();
    }

    /// Tells the run which output it waits for, as the ledger has it.
    pub(super) fn look_at_outputs(&mut self) {
        let open = self.ledger.open();
        let awaited = match self.state.phase() {
            Some(Phase::Reset { seq }) => self.ledger.get(*seq),
            Some(Phase::Room(output)) if self.servo.finished_segment >= self.pipeline.last_segment() => {
                let same = open.iter().find(|open| open.notice.m == output.m);
                same.or(open.first())
            }
            Some(Phase::LastOutputs) => open.first(),
            _ => None,
        };
        let awaited = awaited.map(|open| Awaited {
            seq: open.notice.seq,
            is_lost: open.lost,
        });
        if awaited != self.state.awaited() {
            self.change_state(RunEvent::Awaited(awaited));
        }
    }

    /// `None` while an output of the same M number is open (D32), and while there is no room.
    fn enqueue(&mut self, output: Output, timing: Timing) -> Option<u64> {
        if self.ledger.is_open(output.m) {
            return None;
        }
        let run = self.run.as_mut()?;
        run.steps.in_block = true;
        let run_id = run.id.clone();
        let settings = self.shared.machine.m_codes.get(&output.m);
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
        };
        self.ledger.enqueue(self.shared.now(), spec).ok()
    }

    pub(super) fn claim(&mut self, m: Option<u16>, claim: &Claim) -> HandshakeResult {
        let result = self.ledger.claim(self.shared.now(), m, claim);
        if result.status == HandshakeStatus::Accepted {
            let event = Event::Claim {
                seq: claim.seq,
                handler_id: claim.handler_id.clone(),
            };
            self.shared.record(self.number, event);
        }
        result
    }

    pub(super) fn reset_output(&mut self, m: Option<u16>, reset: &Reset) -> HandshakeResult {
        let result = self.ledger.reset(self.shared.now(), m, reset);
        if result.status == HandshakeStatus::Accepted {
            let event = Event::Reset {
                seq: reset.seq,
                m: self.notices.get(&reset.seq).map(|notice| notice.m),
                handler_id: reset.handler_id.clone(),
                outcome: match reset.result {
                    ResetResult::Ok => ResetOutcome::Ok,
                    ResetResult::Fault => ResetOutcome::Fault {
                        code: reset.code,
                        text: reset.text.clone(),
                    },
                },
                force: reset.force == Some(true),
            };
            self.shared.record(self.number, event);
        }
        result
    }

    pub(super) fn ask(&mut self, m: Option<u16>, ask: &Ask) -> Result<Answer, Refusal> {
        let status = self.ledger.ask(self.shared.now(), m, ask)?;
        if status == HandshakeStatus::Accepted && !ask.choices.is_empty() {
            let event = Event::Question {
                seq: ask.seq,
                text: ask.text.clone(),
                choices: ask.choices.clone(),
            };
            self.shared.record(self.number, event);
        }
        Ok(handshake_answer(ask.seq, &ask.handler_id, status))
    }

    pub(super) fn answer_question(&mut self, m: Option<u16>, answer: &OperatorAnswer) -> Answer {
        let status = self.ledger.answer_question(self.shared.now(), m, answer);
        if status == HandshakeStatus::Accepted {
            let event = Event::Answer {
                seq: answer.seq,
                choice: answer.choice.clone(),
                client_id: answer.client_id.clone(),
            };
            self.shared.record(self.number, event);
        }
        handshake_answer(answer.seq, "", status)
    }

    pub(super) fn handler_changed(&mut self, id: &str, presence: &HandlerPresence) {
        let now = self.shared.now();
        if presence.online {
            let number = self.number;
            let handles = |m| {
                presence
                    .handles
                    .iter()
                    .any(|code| code.cs == number && code.m == m)
            };
            self.ledger.republish(now, handles);
        } else {
            let owned = self.ledger.open().iter();
            let owned: Vec<_> = owned
                .filter(|output| output.handler_id.as_deref() == Some(id))
                .map(|output| (origin(&output.notice), format!("M{:02} of {id}", output.notice.m)))
                .collect();
            self.ledger.handler_lost(now, id);
            for (origin, text) in owned {
                self.warn_of(&HANDLER_LOST, origin, &text);
            }
        }
    }

    /// Publishes and does what the ledger's last changes ask for, until nothing is left.
    pub(super) fn carry_out_effects(&mut self) {
        loop {
            self.look_at_outputs();
            let effects: Vec<Effect> = self.ledger.take_effects().collect();
            if effects.is_empty() {
                return;
            }
            for effect in effects {
                self.carry_out(effect);
                self.look_at_outputs();
            }
        }
    }

    fn carry_out(&mut self, effect: Effect) {
        match effect {
            Effect::PendingChanged => {
                self.shared.publish(
                    self.topic(CsTopic::Pending),
                    Payload::Pending(self.ledger.pending()),
                );
            }
            Effect::Output(notice) => self.made(&notice),
            Effect::Result { m, result } => {
                self.shared
                    .publish(self.topic(CsTopic::Result(m)), Payload::Result(result));
            }
            Effect::Cancel { m, cancel } => {
                self.shared
                    .publish(self.topic(CsTopic::Cancel(m)), Payload::Cancel(cancel));
            }
            Effect::Closed { seq, how, .. } => self.closed(seq, how),
        }
    }

    fn made(&mut self, notice: &OutputNotice) {
        self.shared.publish(
            self.topic(CsTopic::Output(notice.m)),
            Payload::Output(notice.clone()),
        );
        if notice.attempt == 1 {
            self.shared
                .record(self.number, Event::Output(Box::new(notice.clone())));
        }
        let first = self.notices.insert(notice.seq, notice.clone()).is_none();
        if first && !self.shared.is_handled(self.number, notice.m) {
            self.without_handler(notice);
        }
    }

    /// True when a handler that is there or the stock sequence program resets this M code.
    pub(super) fn is_served(&self, m: u16) -> bool {
        let stock = self
            .shared
            .machine
            .m_codes
            .get(&m)
            .and_then(|settings| settings.stock);
        let has_spindle = self.configured.settings.spindle.is_some();
        stock.is_some() || has_spindle && stock::is_spindle_code(m) || self.shared.is_handled(self.number, m)
    }

    /// No handler is registered: the stock sequence program, or the M code's policy.
    fn without_handler(&mut self, notice: &OutputNotice) {
        let settings = self
            .shared
            .machine
            .m_codes
            .get(&notice.m)
            .cloned()
            .unwrap_or_default();
        let has_spindle = self.configured.settings.spindle.is_some();
        match stock::action(notice, &settings, has_spindle) {
            Some(Ok(action)) => self.start_stock_work(notice.seq, action, settings.simulated_s),
            Some(Err(text)) => self.fail_unhandled(notice, text),
            None => match settings.unhandled.unwrap_or(self.shared.machine.unhandled) {
                Unhandled::Wait => {}
                Unhandled::AutoReset => {
                    self.start_stock_work(notice.seq, StockAction::Nothing, settings.simulated_s);
                }
                Unhandled::Alarm => {
                    let text = format!("M{:02} has no handler", notice.m);
                    self.fail_unhandled(notice, text);
                }
            },
        }
    }

    fn fail_unhandled(&mut self, notice: &OutputNotice, text: String) {
        let origin = origin(notice);
        let alarm = Alarm::new(&M_CODE_UNHANDLED, text).at(origin);
        self.ledger.fail(
            self.shared.now(),
            notice.seq,
            plc_api::Alarm {
                number: alarm.entry.number,
                text: format!("{}: {}", alarm.entry.title, alarm.text),
            },
        );
    }

    fn start_stock_work(&mut self, seq: u64, action: StockAction, simulated_s: f64) {
        let due_s = Some(self.shared.clock.now_s() + simulated_s);
        let due_s = match action {
            StockAction::Nothing => due_s,
            StockAction::SelectTool(id) => {
                self.inputs.tool = id;
                self.publish_tool();
                due_s
            }
            StockAction::Spindle(SpindleDirection::Orient) => {
                self.turn_spindle(SpindleDirection::Orient, 0.0);
                None
            }
            StockAction::Spindle(direction) => {
                let rpm = self.pipeline.interpreter.modal().spindle_speed_r_min;
                self.turn_spindle(direction, rpm);
                if matches!(direction, SpindleDirection::Cw | SpindleDirection::Ccw) {
                    self.inputs.spindle_at_s_from = Some(self.pipeline.next_segment());
                }
                due_s
            }
        };
        self.stock.push(StockWork { seq, due_s });
    }

    pub(super) fn do_stock_work(&mut self, now: Now) {
        self.finish_stock_work(|work| work.due_s.is_some_and(|due_s| due_s <= now.monotonic_s + 1e-9));
    }

    pub(super) fn stock_oriented(&mut self) {
        self.publish_spindle();
        self.finish_stock_work(|work| work.due_s.is_none());
    }

    fn finish_stock_work(&mut self, is_done: impl Fn(&StockWork) -> bool) {
        let (done, left): (Vec<_>, Vec<_>) = self.stock.drain(..).partition(is_done);
        self.stock = left;
        for work in done {
            let reset = Reset {
                boot_id: self.shared.boot_id.clone(),
                seq: work.seq,
                handler_id: STOCK_HANDLER.to_owned(),
                result: ResetResult::Ok,
                code: None,
                text: None,
                force: None,
            };
            self.reset_output(None, &reset);
            self.carry_out_effects();
        }
    }

    fn closed(&mut self, seq: u64, how: Closed) {
        let notice = self.notices.remove(&seq);
        let origin = notice.as_ref().map(origin);
        match how {
            Closed::Reset | Closed::Cancelled(_) => {}
            Closed::Failed { alarm } => self.raise(alarm.number, alarm.text, origin),
            Closed::TimedOut => {
                let m = notice.map_or(0, |notice| notice.m);
                let timeout_ms = (self.shared.machine.m_codes.get(&m))
                    .and_then(|settings| settings.timeout_ms)
                    .unwrap_or_default();
                let text = format!("M{m:02} was not reset within {timeout_ms} ms");
                self.raise_entry(&M_CODE_TIMEOUT, &text, origin);
            }
        }
    }

    /// Commands the spindle, from a sequence program.
    pub(super) fn command_spindle(&mut self, direction: SpindleDirection, rpm: f64) -> Result<(), Refusal> {
        let Some(spindle) = &self.configured.settings.spindle else {
            let text = format!("coordinate system {} has no spindle", self.number);
            return Err(Refusal::new(RefusalCode::NotFound, text));
        };
        if !(0.0..=spindle.max_velocity).contains(&rpm) {
            let text = format!("spindle speed {rpm}: write 0 to {} r/min", spindle.max_velocity);
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        self.turn_spindle(direction, rpm);
        Ok(())
    }

    fn turn_spindle(&mut self, direction: SpindleDirection, rpm: f64) {
        self.inputs.spindle = (direction, rpm);
        self.inputs.spindle_at_s_from = None;
        self.send_spindle();
    }

    /// S has changed with the block before this segment, which has its turn: at once the speed of a spindle that the
    /// stock sequence program turns by M03 or M04 (manual, S function). Else whoever turns it sees to that (D35).
    pub(super) fn follow_spindle_speed(&mut self, segment: u64, rpm: f64) {
        if self.inputs.spindle_at_s_from.is_some_and(|from| segment >= from) {
            self.inputs.spindle.1 = rpm;
            self.send_spindle();
        }
    }

    pub(super) fn send_spindle(&mut self) {
        use tandem_servo::SpindleDirection as Direction;
        if self.configured.settings.spindle.is_none() {
            return;
        }
        let (direction, rpm) = self.inputs.spindle;
        let direction = match direction {
            SpindleDirection::Cw => Direction::Cw,
            SpindleDirection::Ccw => Direction::Ccw,
            SpindleDirection::Stop => Direction::Stop,
            SpindleDirection::Orient => Direction::Orient,
        };
        let rpm = rpm * self.inputs.overrides.spindle / 100.0;
        self.servo.control(Control::Spindle { direction, rpm });
        self.publish_spindle();
    }
}

fn origin(notice: &OutputNotice) -> Origin {
    Origin {
        program: notice.program,
        line: notice.line,
        column: 1,
    }
}
