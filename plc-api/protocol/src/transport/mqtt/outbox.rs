//! Messages that have not been answered. The client library forgets messages when its connection ends.
//! Therefore the outbox keeps each message until it is answered, and sends it again on every new connection,
//! in order.

use std::collections::{HashMap, VecDeque};

use tokio::sync::oneshot;

use crate::types::command::{CommandReply, CommandStatus};
use crate::types::handler::HandlerStatus;
use crate::types::message::{Message, Payload};
use crate::types::output::{HandshakeStatus, OutputAct};
use crate::types::request::{Answer, Refusal, RefusalCode};
use crate::types::topic::{CsTopic, Topic};

use crate::wire::mqtt::{Outgoing, Until};

/// Largest number of pending messages; a further request is refused. Reason: this is twice the number of
/// claims or resets of 64 open outputs in each of 8 coordinate systems.
pub(super) const OUTBOX_MAX: usize = 1_024;

pub(super) type Outcome = Result<Answer, Refusal>;

#[derive(Debug)]
struct OutboxEntry {
    id: u64,
    outgoing: Outgoing,
    sent: bool,
    done: oneshot::Sender<Outcome>,
}

#[derive(Debug, Default)]
pub(super) struct Outbox {
    next_id: u64,
    entries: VecDeque<OutboxEntry>,
    // messages that the library has accepted and that have no packet id yet, in order
    unnumbered: VecDeque<u64>,
    by_packet: HashMap<u16, u64>,
}

impl Outbox {
    /// Adds a message, and returns the receiver of the answer. If the receiver is dropped, the message is
    /// removed.
    pub(super) fn put(&mut self, outgoing: Outgoing) -> Result<oneshot::Receiver<Outcome>, Refusal> {
        self.forget_abandoned();
        if self.entries.len() >= OUTBOX_MAX {
            let text = format!("{OUTBOX_MAX} messages wait for the broker");
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let (done, end) = oneshot::channel();
        self.next_id += 1;
        self.entries.push_back(OutboxEntry {
            id: self.next_id,
            outgoing,
            sent: false,
            done,
        });
        Ok(end)
    }

    fn forget_abandoned(&mut self) {
        self.entries.retain(|entry| !entry.done.is_closed());
    }

    /// Prepares all messages except claims to be sent again on a new connection. The registration of a
    /// handler was lost with the old connection, so the machine would refuse its claims. Therefore each claim
    /// ends without an answer, and the sender of the claim registers the handler before it claims again.
    pub(super) fn new_connection(&mut self) {
        self.unnumbered.clear();
        self.by_packet.clear();
        let is_claim =
            |entry: &OutboxEntry| matches!(entry.outgoing.until, Until::Result { is_reset: false, .. });
        self.complete_entries(is_claim, &|| {
            let text = "the connection was lost before the claim was answered; register, then claim again";
            Err(Refusal::new(RefusalCode::NoAnswer, text))
        });
        for entry in &mut self.entries {
            entry.sent = false;
        }
    }

    /// Passes the unsent messages to `send`, in order, until `send` returns false.
    pub(super) fn send(&mut self, mut send: impl FnMut(&Outgoing) -> bool) {
        self.forget_abandoned();
        for entry in self.entries.iter_mut().filter(|entry| !entry.sent) {
            if !send(&entry.outgoing) {
                return;
            }
            entry.sent = true;
            self.unnumbered.push_back(entry.id);
        }
    }

    /// Returns true while a sent message has no acknowledgement of the broker.
    pub(super) fn awaits_acknowledgement(&self) -> bool {
        !self.by_packet.is_empty()
    }

    /// Records the packet id that the library has given to the oldest sent message without a packet id.
    pub(super) fn on_packet_id(&mut self, packet: u16) {
        if let Some(id) = self.unnumbered.pop_front() {
            self.by_packet.insert(packet, id);
        }
    }

    pub(super) fn on_acknowledgement(&mut self, packet: u16) {
        if let Some(id) = self.by_packet.remove(&packet) {
            self.complete_entries(
                |entry| entry.id == id && entry.outgoing.until == Until::Acknowledged,
                &|| Ok(Answer::Done),
            );
        }
    }

    /// Ends the requests that this message of the machine answers. `is_open` returns true if the last
    /// `pending` lists the output; the machine publishes `pending` before the result.
    pub(super) fn on_message(&mut self, message: &Message, is_open: impl Fn(u64) -> bool) {
        match (&message.topic, &message.payload) {
            (Topic::CoordinateSystem(result_cs, CsTopic::Result(result_m)), Payload::Result(result)) => {
                let is_of = |is_reset: bool| match result.of {
                    Some(of) => {
                        of == if is_reset {
                            OutputAct::Reset
                        } else {
                            OutputAct::Claim
                        }
                    }
                    // while the output is open, this result does not answer a reset: it is the late answer to
                    // a claim
                    None => !(is_reset && result.status == HandshakeStatus::Accepted && is_open(result.seq)),
                };
                let is_its = |entry: &OutboxEntry| match &entry.outgoing.until {
                    Until::Result {
                        cs,
                        m,
                        seq,
                        handler_id,
                        instance,
                        is_reset,
                    } => {
                        (cs, m, *seq) == (result_cs, result_m, result.seq)
                            && (handler_id, instance) == (&result.handler_id, &result.instance)
                            && is_of(*is_reset)
                    }
                    _ => false,
                };
                self.complete_entries(is_its, &|| match result.status {
                    HandshakeStatus::Refused => Err(Refusal::new(
                        RefusalCode::Invalid,
                        result.text.clone().unwrap_or_default(),
                    )),
                    _ => Ok(Answer::Handshake(result.clone())),
                });
            }
            (Topic::HandlerResult(id), Payload::HandlerResult(result))
                if result.status != HandlerStatus::Confirm =>
            {
                let is_its = |entry: &OutboxEntry| match &entry.outgoing.until {
                    Until::Announced { handler_id, instance } => {
                        handler_id == id && Some(instance) == result.instance.as_ref()
                    }
                    _ => false,
                };
                self.complete_entries(is_its, &|| match result.status {
                    HandlerStatus::Accepted | HandlerStatus::Confirm => Ok(Answer::Done),
                    HandlerStatus::Refused | HandlerStatus::TakenOver => {
                        let code = result.code.unwrap_or(RefusalCode::HandlerTaken);
                        Err(Refusal::new(code, result.text.clone().unwrap_or_default()))
                    }
                });
            }
            (Topic::Reply(_), Payload::Reply(reply)) => {
                let is_its = |entry: &OutboxEntry| match &entry.outgoing.until {
                    Until::Reply { command_id, done } => {
                        *command_id == reply.command_id && !(*done && reply.status == CommandStatus::Accepted)
                    }
                    _ => false,
                };
                self.complete_entries(is_its, &|| answer_of(reply));
            }
            _ => {}
        }
    }

    fn complete_entries(&mut self, is_its: impl Fn(&OutboxEntry) -> bool, outcome: &dyn Fn() -> Outcome) {
        while let Some(place) = self.entries.iter().position(&is_its) {
            if let Some(entry) = self.entries.remove(place) {
                let _nobody_waits = entry.done.send(outcome());
            }
        }
    }
}

fn answer_of(reply: &CommandReply) -> Outcome {
    if reply.status == CommandStatus::Rejected {
        let code = serde_json::from_value(reply.code.clone().into()).unwrap_or(RefusalCode::NotAllowed);
        return Err(Refusal::new(code, reply.text.clone()));
    }
    Ok(match &reply.variables {
        Some(read) => Answer::Variables(read.numbers()),
        None => Answer::Command(reply.clone()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::output::HandshakeResult;
    use crate::types::{BootId, Timestamp};

    fn outgoing(path: &str, until: Until) -> Outgoing {
        Outgoing {
            path: path.to_owned(),
            payload: String::new(),
            retain: false,
            until,
        }
    }

    fn handshake(is_reset: bool) -> Until {
        Until::Result {
            cs: 1,
            m: 100,
            seq: 5,
            handler_id: "h".to_owned(),
            instance: None,
            is_reset,
        }
    }

    fn sent(outbox: &mut Outbox) -> Vec<String> {
        let mut paths = Vec::new();
        outbox.send(|outgoing| {
            paths.push(outgoing.path.clone());
            true
        });
        paths
    }

    fn accepted() -> Message {
        Message {
            topic: Topic::cs(1, CsTopic::Result(100)),
            boot_id: BootId("b".into()),
            ts: Timestamp::default(),
            rev: None,
            payload: Payload::Result(HandshakeResult::new(5, "h", HandshakeStatus::Accepted)),
        }
    }

    #[test]
    fn what_is_not_known_to_have_arrived_is_sent_again_on_a_new_connection() {
        let mut outbox = Outbox::default();
        let mut tool = outbox.put(outgoing("tool", Until::Acknowledged)).unwrap();
        let mut reset = outbox.put(outgoing("reset", handshake(true))).unwrap();
        assert_eq!(sent(&mut outbox), ["tool", "reset"]);
        assert!(sent(&mut outbox).is_empty());
        outbox.on_packet_id(1);
        outbox.on_packet_id(2);
        outbox.on_acknowledgement(2);
        outbox.new_connection();
        assert_eq!(sent(&mut outbox), ["tool", "reset"]);
        outbox.on_packet_id(1);
        outbox.on_acknowledgement(1);
        assert_eq!(tool.try_recv().unwrap(), Ok(Answer::Done));
        assert!(reset.try_recv().is_err());
        outbox.on_message(&accepted(), |_| false);
        assert!(reset.try_recv().unwrap().is_ok());
    }

    #[test]
    fn a_claim_ends_unanswered_on_a_new_connection() {
        let mut outbox = Outbox::default();
        let mut claim = outbox.put(outgoing("claim", handshake(false))).unwrap();
        let _reset = outbox.put(outgoing("reset", handshake(true))).unwrap();
        assert_eq!(sent(&mut outbox), ["claim", "reset"]);
        outbox.new_connection();
        assert_eq!(sent(&mut outbox), ["reset"]);
        let refusal = claim.try_recv().unwrap().unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NoAnswer);
        assert!(refusal.code.may_pass());
    }

    #[test]
    fn the_late_answer_to_a_claim_is_not_taken_for_that_to_the_reset() {
        let mut outbox = Outbox::default();
        let mut reset = outbox.put(outgoing("reset", handshake(true))).unwrap();
        outbox.on_message(&accepted(), |_| true);
        assert!(reset.try_recv().is_err());
        outbox.on_message(&accepted(), |_| false);
        assert!(reset.try_recv().unwrap().is_ok());
    }

    #[test]
    fn a_full_outbox_refuses() {
        let mut outbox = Outbox::default();
        let put = |outbox: &mut Outbox| outbox.put(outgoing("x", Until::Acknowledged));
        let waiting: Vec<_> = (0..OUTBOX_MAX).map(|_| put(&mut outbox).unwrap()).collect();
        assert_eq!(put(&mut outbox).unwrap_err().code, RefusalCode::Unavailable);
        drop(waiting);
        assert!(put(&mut outbox).is_ok(), "their receivers are dropped");
    }
}
