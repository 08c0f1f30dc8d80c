//! Open outputs, and requests about them: claim, reset, progress, questions, redelivery.

use std::collections::BTreeMap;

use plc_api::handshake::{Ledger, Now};
use plc_api::types::output::{
    CancelReason, HandlerPresence, HandshakeResult, HandshakeStatus, OutputNotice, OutputState, ResetResult,
};
use plc_api::types::request::{OutputRequest, Refusal};
use tandem_model::Origin;
use tandem_model::alarm::HANDLER_LOST;

use super::context::Context;
use super::run_state::{Awaited, Phase};
use crate::journal::{Event, ResetOutcome};

/// The outputs of a coordinate system.
#[derive(Debug)]
pub(super) struct Outputs {
    pub ledger: Ledger,
    /// M number and block of each open output that was made, by `seq`, for alarms and the journal.
    pub made: BTreeMap<u64, (u16, Origin)>,
    /// When each open output was made, seconds since the start.
    pub since_s: BTreeMap<u64, f64>,
    /// What the stock sequence program works on.
    pub stock: Vec<StockWork>,
    /// Outputs whose handler has left and comes back, with the time until which they wait for it, seconds since the start.
    pub away: Vec<(u64, f64)>,
}

/// An output that the stock sequence program works on.
#[derive(Debug, Clone, Copy)]
pub(super) struct StockWork {
    pub seq: u64,
    /// When it resets; `None`: when the spindle is oriented.
    pub due_s: Option<f64>,
}

impl Outputs {
    pub fn new(ledger: Ledger) -> Self {
        Self {
            ledger,
            made: BTreeMap::new(),
            since_s: BTreeMap::new(),
            stock: Vec::new(),
            away: Vec::new(),
        }
    }

    /// The output that a phase of the run waits for; `is_at_rest`: all motion before it has ended.
    pub fn awaited(&self, phase: &Phase, is_at_rest: bool) -> Option<Awaited> {
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
        awaited.map(|open| Awaited {
            seq: open.notice.seq,
            is_lost: open.lost,
        })
    }

    /// The outputs that a hold kept back.
    pub fn queued(&self) -> Vec<u64> {
        let open = self.ledger.open().iter();
        let queued = open.filter(|open| open.state == OutputState::Queued);
        queued.map(|open| open.notice.seq).collect()
    }

    /// When the ledger or the stock sequence program has something to do, seconds since the start.
    pub fn next_deadline_s(&self) -> Option<f64> {
        let stock = self.stock.iter().filter_map(|work| work.due_s);
        let ledger = self.ledger.next_deadline_s();
        let away = self.away.iter().map(|(_, until_s)| *until_s);
        stock.chain(ledger).chain(away).min_by(f64::total_cmp)
    }

    /// Takes the stock work that is done.
    pub fn take_stock_work(&mut self, is_done: impl Fn(&StockWork) -> bool) -> Vec<StockWork> {
        self.stock.extract_if(.., |work| is_done(work)).collect()
    }

    /// Sequence and M numbers of unclaimed outputs whose handler has not come back in its time.
    pub fn take_overdue(&mut self, now_s: f64) -> Vec<(u64, u16)> {
        let over = self.away.extract_if(.., |(_, until_s)| *until_s <= now_s + 1e-9);
        let open = over.filter_map(|(seq, _)| self.ledger.get(seq));
        let unclaimed = open.filter(|open| open.state == OutputState::Output);
        unclaimed.map(|open| (open.notice.seq, open.notice.m)).collect()
    }

    /// All are cancelled.
    pub fn cancel_all(&mut self, now: Now, reason: CancelReason) {
        self.ledger.cancel_all(now, reason);
        self.stock.clear();
        self.away.clear();
    }

    /// Carries out what is said of an output; what counts is written to the journal.
    pub fn carry_out(
        &mut self,
        context: &Context,
        m: Option<u16>,
        request: OutputRequest,
    ) -> Result<HandshakeResult, Refusal> {
        let result = self.ledger.carry_out(context.now(), m, &request)?;
        if result.status == HandshakeStatus::Accepted
            && let Some(event) = self.event(request)
        {
            context.record(event);
        }
        Ok(result)
    }

    /// What the journal keeps of a request that has been accepted.
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

    pub fn on_handler_changed(&mut self, context: &Context, id: &str, presence: &HandlerPresence) {
        let now = context.now();
        if presence.online {
            self.ledger.handler_online(now, id, presence);
        } else {
            let instance = presence.instance.as_deref();
            let owned = self.ledger.open().iter();
            let owned: Vec<_> = owned
                .filter(|output| output.is_owned_by(id, instance))
                .map(|output| (origin(&output.notice), format!("M{:02} of {id}", output.notice.m)))
                .collect();
            self.ledger.handler_lost(now, id, instance);
            for (origin, text) in owned {
                context.warn_of(&HANDLER_LOST, origin, &text);
            }
        }
    }
}

pub(super) fn origin(notice: &OutputNotice) -> Origin {
    Origin {
        program: notice.program,
        line: notice.line,
        column: 1,
    }
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use plc_api::handshake::OutputSpec;
    use plc_api::types::BootId;
    use plc_api::types::output::{Claim, Timing};
    use tandem_model::flow::Output;

    use super::*;

    fn now() -> Now {
        Now {
            monotonic_s: 0.0,
            time: UNIX_EPOCH,
        }
    }

    /// Outputs of these M numbers, made in this order.
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
            outputs.ledger.put_out(now(), seq);
        }
        outputs
    }

    fn seq(awaited: Option<Awaited>) -> Option<u64> {
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
    fn an_output_without_room_waits_for_its_own_m_number_or_the_oldest_once_the_motion_rests() {
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
    fn an_output_whose_handler_has_gone_is_lost() {
        let mut outputs = open(&[10]);
        let seq = outputs.ledger.open()[0].notice.seq;
        let claim = Claim {
            boot_id: BootId("b1".to_owned()),
            seq,
            handler_id: "gripper".to_owned(),
            instance: None,
        };
        outputs.ledger.claim(now(), None, &claim);
        let lost = |outputs: &Outputs| outputs.awaited(&Phase::LastOutputs, true);
        assert_eq!(lost(&outputs), Some(Awaited { seq, is_lost: false }));
        outputs.ledger.handler_lost(now(), "gripper", None);
        assert_eq!(lost(&outputs), Some(Awaited { seq, is_lost: true }));
    }

    #[test]
    fn stock_work_is_taken_once_when_it_is_due() {
        let mut outputs = open(&[]);
        for (seq, due_s) in [(1, Some(2.0)), (2, None), (3, Some(1.0))] {
            outputs.stock.push(StockWork { seq, due_s });
        }
        assert_eq!(outputs.next_deadline_s(), Some(1.0));
        let due = |work: &StockWork| work.due_s.is_some_and(|due_s| due_s <= 2.0);
        let taken: Vec<_> = outputs.take_stock_work(due).iter().map(|work| work.seq).collect();
        assert_eq!((taken, outputs.next_deadline_s()), (vec![1, 3], None));
    }
}
