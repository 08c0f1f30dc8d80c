//! Ledger of the outputs of a coordinate system with the data about each pending output, and requests about outputs:
//! claim, reset, progress, questions, redelivery.

use std::collections::BTreeMap;

use plc_protocol::handshake::{Ledger, Now};
use plc_protocol::types::handler::Departure;
use plc_protocol::types::output::{
    CancelReason, HandshakeResult, HandshakeStatus, OutputNotice, OutputState, Redelivery, ResetResult,
};
use plc_protocol::types::request::{OutputRequest, Refusal};
use tandem_model::Origin;
use tandem_store::journal::{Event, ResetOutcome};

use crate::coordinate_system::context::Context;
use crate::coordinate_system::run::run_state::{AwaitedOutput, Phase};

/// The outputs of a coordinate system.
#[derive(Debug)]
pub(crate) struct Outputs {
    pub ledger: Ledger,
    /// M number and block of each pending output that was issued, by `seq`, for alarms and the journal.
    pub made: BTreeMap<u64, (u16, Origin)>,
    /// Time at which each pending output was issued, in s since the start, by `seq`.
    pub since_s: BTreeMap<u64, f64>,
    /// Outputs that the stock sequence program handles.
    pub stock: Vec<StockWork>,
    /// Outputs whose handler is expected to return, each with the end of the wait in s since the start.
    pub away: Vec<(u64, f64)>,
    /// Outputs that have lost their owner, if that loss is not reported yet, by `seq`.
    losses: BTreeMap<u64, OwnerLoss>,
}

/// Loss of the owner of an output.
#[derive(Debug, Clone, PartialEq)]
struct OwnerLoss {
    /// Time in s since the start at which the loss is reported, unless a handler claims the output before.
    report_s: f64,
    handler_id: String,
}

/// Output that the stock sequence program handles.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StockWork {
    pub seq: u64,
    /// Time in s since the start at which its work is due.
    pub due_s: f64,
    /// Spindle state that must be reached before the reset of the output.
    pub awaits: Option<SpindleGoal>,
}

/// Spindle state that an output of a spindle M code waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SpindleGoal {
    /// Orientation position, for M19.
    Orientation,
    /// Commanded speed for M03 and M04, standstill for M05. `id` identifies the wait in the servo.
    Speed { id: u64 },
}

impl Outputs {
    pub fn new(ledger: Ledger) -> Self {
        Self {
            ledger,
            made: BTreeMap::new(),
            since_s: BTreeMap::new(),
            stock: Vec::new(),
            away: Vec::new(),
            losses: BTreeMap::new(),
        }
    }

    /// Returns the output that the run waits for in this phase. `is_at_rest` is true if all earlier motion has ended.
    pub fn awaited(&self, phase: &Phase, is_at_rest: bool) -> Option<AwaitedOutput> {
        let open = self.ledger.open();
        let awaited = match phase {
            Phase::Reset { seq } => self.ledger.get(*seq),
            Phase::Room(output) if is_at_rest => {
                let same = open.iter().find(|open| open.notice.m == output.m);
                same.or(open.first())
            }
            Phase::LastOutputs => open.first(),
            _ => None,
        };
        awaited.map(|open| AwaitedOutput {
            seq: open.notice.seq,
            is_lost: open.is_lost() && !self.losses.contains_key(&open.notice.seq),
        })
    }

    /// Returns the outputs that a hold has delayed.
    pub fn queued(&self) -> Vec<u64> {
        let open = self.ledger.open().iter();
        let queued = open.filter(|open| open.state() == OutputState::Queued);
        queued.map(|open| open.notice.seq).collect()
    }

    /// Returns the next time in s since the start at which an output needs work of the ledger, the stock program or a
    /// lost handler.
    pub fn next_deadline_s(&self) -> Option<f64> {
        let timed = self.stock.iter().filter(|work| work.awaits.is_none());
        let stock = timed.map(|work| work.due_s);
        let ledger = self.ledger.next_deadline_s();
        let away = self.away.iter().map(|(_, until_s)| *until_s);
        let losses = self.losses.values().map(|loss| loss.report_s);
        let all = stock.chain(ledger).chain(away).chain(losses);
        all.min_by(f64::total_cmp)
    }

    /// Removes and returns the stock work that is done according to `is_done`.
    pub fn take_stock_work(&mut self, is_done: impl Fn(&StockWork) -> bool) -> Vec<StockWork> {
        self.stock.extract_if(.., |work| is_done(work)).collect()
    }

    /// Returns true if the stock sequence program works on an output.
    pub fn has_stock_work(&self, seq: u64) -> bool {
        self.stock.iter().any(|work| work.seq == seq)
    }

    /// Removes waits for handlers that did not return within their time limit. Returns `seq` and M number of the
    /// outputs that are still unclaimed.
    pub fn take_overdue(&mut self, now_s: f64) -> Vec<(u64, u16)> {
        let over = self.away.extract_if(.., |(_, until_s)| *until_s <= now_s + 1e-9);
        let open = over.filter_map(|(seq, _)| self.ledger.get(seq));
        let unclaimed = open.filter(|open| open.state() == OutputState::Output);
        unclaimed.map(|open| (open.notice.seq, open.notice.m)).collect()
    }

    /// Cancels all outputs.
    pub fn cancel_all(&mut self, now: Now, reason: CancelReason) {
        self.ledger.cancel_all(now, reason);
        self.stock.clear();
        self.away.clear();
        self.losses.clear();
    }

    /// Executes a request about an output, and writes an accepted change to the journal.
    pub fn execute_request(
        &mut self,
        context: &Context,
        m: Option<u16>,
        request: OutputRequest,
    ) -> Result<HandshakeResult, Refusal> {
        let result = self.ledger.execute_request(context.now(), m, &request)?;
        if result.status == HandshakeStatus::Accepted
            && let Some(event) = self.event(request)
        {
            context.record(event);
        }
        Ok(result)
    }

    /// Returns the journal event for an accepted request; `None` if the request is not recorded.
    fn event(&self, request: OutputRequest) -> Option<Event> {
        Some(match request {
            OutputRequest::Claim(claim) => Event::Claim {
                seq: claim.seq,
                handler_id: claim.handler_id,
            },
            OutputRequest::Reset(reset) => Event::Reset {
                seq: reset.seq,
                m: self.made.get(&reset.seq).map(|(m, _)| *m),
                handler_id: reset.handler_id,
                outcome: match reset.result {
                    ResetResult::Ok => ResetOutcome::Ok,
                    ResetResult::Fault => ResetOutcome::Fault {
                        code: reset.code,
                        text: reset.text,
                    },
                },
                force: reset.force == Some(true),
            },
            OutputRequest::Ask(ask) if !ask.choices.is_empty() => Event::Question {
                seq: ask.seq,
                text: ask.text,
                choices: ask.choices,
            },
            OutputRequest::AnswerQuestion(answer) => Event::Answer {
                seq: answer.seq,
                choice: answer.choice,
                client_id: answer.client_id,
            },
            _ => return None,
        })
    }

    /// Processes the loss of a handler instance. If another instance may claim an output, its loss is reported when the
    /// time limit of the lost handler has expired. If the output waits for a decision of an operator, its loss is
    /// reported after the grace time.
    pub fn on_handler_left(
        &mut self,
        now: Now,
        (id, instance): (&str, Option<&str>),
        departure: Departure,
        grace_s: f64,
    ) {
        let owned = self.ledger.open().iter();
        let owned: Vec<_> = owned
            .filter(|output| output.is_owned_by(id, instance))
            .map(|output| output.notice.seq)
            .collect();
        self.ledger.handler_lost(now, id, instance);
        let grace_end_s = now.monotonic_s + grace_s;
        for seq in owned {
            let said = self.ledger.get(seq).and_then(|output| output.redelivery);
            let goes_on = said.is_some_and(|said| said != Redelivery::Ask);
            let until_s = departure.until_s().filter(|_| goes_on);
            let loss = OwnerLoss {
                report_s: until_s.unwrap_or(grace_end_s).max(grace_end_s),
                handler_id: id.to_owned(),
            };
            self.losses.insert(seq, loss);
        }
    }

    /// Removes the losses whose report is due. For outputs that are still lost, returns the block and the text of the
    /// warning.
    pub fn take_losses(&mut self, now_s: f64) -> Vec<(Origin, String)> {
        let due = self
            .losses
            .extract_if(.., |_, loss| loss.report_s <= now_s + 1e-9);
        let lost = due.filter_map(|(seq, loss)| {
            let output = self.ledger.get(seq).filter(|output| output.is_lost())?;
            let text = format!("M{:02} of {}", output.notice.m, loss.handler_id);
            Some((origin(&output.notice), text))
        });
        lost.collect()
    }
}

pub(crate) fn origin(notice: &OutputNotice) -> Origin {
    Origin {
        program: notice.program,
        line: notice.line,
        column: 1,
    }
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use plc_protocol::handshake::OutputSpec;
    use plc_protocol::types::BootId;
    use plc_protocol::types::output::{Claim, HandlerPresence, Timing};
    use tandem_model::flow::Output;

    use super::*;

    fn now() -> Now {
        Now {
            monotonic_s: 0.0,
            time: UNIX_EPOCH,
        }
    }

    /// Returns pending outputs with these M numbers, issued in this order.
    fn open(m_codes: &[u16]) -> Outputs {
        let mut outputs = Outputs::new(Ledger::new(BootId("b1".to_owned()), 1, 8));
        for m in m_codes {
            let spec = OutputSpec {
                run_id: "1-1".to_owned(),
                m: *m,
                params: plc_api::Params::default(),
                timing: Timing::AfterMotion,
                program: 60,
                line: 1,
                timeout_s: None,
                redelivery: None,
            };
            let seq = outputs.ledger.enqueue(now(), spec).unwrap();
            outputs.ledger.issue_output(now(), seq);
        }
        outputs
    }

    fn seq(awaited: Option<AwaitedOutput>) -> Option<u64> {
        awaited.map(|awaited| awaited.seq)
    }

    #[test]
    fn each_phase_waits_for_its_output_and_for_none_that_is_closed() {
        let outputs = open(&[10, 11]);
        let [first, second] = [0, 1].map(|place: usize| outputs.ledger.open()[place].notice.seq);
        let awaited = |phase: Phase| seq(outputs.awaited(&phase, true));
        assert_eq!(awaited(Phase::Reset { seq: second }), Some(second));
        assert_eq!(awaited(Phase::Reset { seq: second + 1 }), None);
        assert_eq!(awaited(Phase::LastOutputs), Some(first));
        assert_eq!(awaited(Phase::Interpret), None);
        assert_eq!(seq(open(&[]).awaited(&Phase::LastOutputs, true)), None);
    }

    #[test]
    fn output_without_room_waits_for_its_m_number_or_the_oldest_at_rest() {
        let outputs = open(&[10, 11]);
        let [first, second] = [0, 1].map(|place: usize| outputs.ledger.open()[place].notice.seq);
        let of = |m, is_at_rest| {
            let output = Output {
                m,
                params: [None; 8],
                origin: Origin::default(),
            };
            seq(outputs.awaited(&Phase::Room(output), is_at_rest))
        };
        assert_eq!((of(11, true), of(12, true)), (Some(second), Some(first)));
        assert_eq!(of(11, false), None);
    }

    #[test]
    fn an_output_whose_handler_has_gone_is_lost_after_the_grace_time() {
        let mut outputs = open(&[10]);
        let seq = outputs.ledger.open()[0].notice.seq;
        let claim = Claim {
            boot_id: BootId("b1".to_owned()),
            seq,
            handler_id: "gripper".to_owned(),
            instance: None,
        };
        let presence = HandlerPresence {
            online: true,
            ..HandlerPresence::default()
        };
        outputs.ledger.handler_online(now(), "gripper", &presence);
        outputs.ledger.claim(now(), None, &claim);
        let lost = |outputs: &Outputs| outputs.awaited(&Phase::LastOutputs, true);
        assert_eq!(lost(&outputs), Some(AwaitedOutput { seq, is_lost: false }));
        let departure = Departure::Unannounced { until_s: 2.0 };
        outputs.on_handler_left(now(), ("gripper", None), departure, 2.0);
        assert_eq!(
            (lost(&outputs), outputs.next_deadline_s()),
            (Some(AwaitedOutput { seq, is_lost: false }), Some(2.0))
        );
        assert_eq!(outputs.take_losses(1.9), []);
        assert_eq!(outputs.take_losses(2.0).len(), 1);
        assert_eq!(lost(&outputs), Some(AwaitedOutput { seq, is_lost: true }));
    }

    #[test]
    fn stock_work_is_taken_once_when_it_is_due() {
        let mut outputs = open(&[]);
        let orientation = Some(SpindleGoal::Orientation);
        for (seq, due_s, awaits) in [(1, 2.0, None), (2, 0.0, orientation), (3, 1.0, None)] {
            outputs.stock.push(StockWork { seq, due_s, awaits });
        }
        assert_eq!(outputs.next_deadline_s(), Some(1.0));
        let due = |work: &StockWork| work.awaits.is_none() && work.due_s <= 2.0;
        let taken: Vec<_> = outputs.take_stock_work(due).iter().map(|work| work.seq).collect();
        assert_eq!((taken, outputs.next_deadline_s()), (vec![1, 3], None));
    }
}
