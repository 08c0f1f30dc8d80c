//! Messages to be published, and those that the broker has not acknowledged: the client library loses them with its
//! session. Keeps the last value of each state, and all events in order. Pure: no I/O.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use plc_protocol::queue::{Queue, QueueEntry};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::topic::{CsTopic, Topic};

/// One message to be published.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Parcel {
    /// A message of the port.
    Message(Arc<Message>),
    /// A retained message on a path that is a client's; an empty one clears it.
    Retained(String, String),
}

/// The result of publishing a parcel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PublishOutcome {
    /// The client library has accepted it.
    Accepted,
    /// The client library is full: try again later.
    Full,
    /// The broker cannot accept it: drop it.
    Never,
}

impl QueueEntry for Parcel {
    fn topic(&self) -> Option<&Topic> {
        match self {
            Parcel::Message(message) => Some(&message.topic),
            Parcel::Retained(..) => None,
        }
    }
}

impl Parcel {
    fn is_state(&self) -> bool {
        self.topic().is_some_and(Topic::is_state)
    }

    /// Returns true for the notice of an output.
    fn is_notice(&self) -> bool {
        matches!(self.topic(), Some(Topic::CoordinateSystem(_, CsTopic::Output(_))))
    }

    /// Returns the state that this event explains.
    fn explains(&self) -> Option<Topic> {
        self.topic().and_then(Topic::explains)
    }
}

fn is_pending(topic: &Topic) -> bool {
    matches!(topic, Topic::CoordinateSystem(_, CsTopic::Pending))
}

/// Messages to be published, and published ones that are not acknowledged yet.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    // last value of each retained state
    states: BTreeMap<Topic, Arc<Message>>,
    queue: Queue<Parcel>,
    reported_lost: u64,
    /// Notices of pending outputs, held back with `m_code/pending` on a new connection. `None` if nothing is held back.
    held: Option<Vec<Parcel>>,
    // published with QoS 1, oldest first; `None` for a state, which is published again anyway
    unacknowledged: VecDeque<Option<Parcel>>,
}

impl Outbox {
    /// Queues a message.
    pub(super) fn put(&mut self, message: Arc<Message>) {
        if message.topic.is_state() {
            self.states.insert(message.topic.clone(), Arc::clone(&message));
        }
        let parcel = Parcel::Message(message);
        match &mut self.held {
            Some(_) if parcel.topic().is_some_and(is_pending) => {}
            Some(held) if parcel.is_notice() => held.push(parcel),
            _ => {
                self.queue.put(parcel);
            }
        }
    }

    /// Replaces the retained message of a client; an empty payload clears it.
    pub(super) fn retain(&mut self, path: String, payload: String) {
        self.queue.put(Parcel::Retained(path, payload));
    }

    /// Publishes the next parcel. Returns `false` when none is queued, or when the client library is full.
    pub(super) fn send_next(&mut self, publish: impl FnOnce(&Parcel) -> PublishOutcome) -> bool {
        let Some(handed) = self.queue.front().map(publish) else {
            return false;
        };
        if handed == PublishOutcome::Full {
            return false;
        }
        let parcel = self.queue.pop_front();
        if let (PublishOutcome::Accepted, Some(parcel)) = (handed, parcel)
            && parcel.topic().map_or(1, Topic::qos) > 0
        {
            self.unacknowledged
                .push_back((!parcel.is_state()).then_some(parcel));
        }
        true
    }

    /// Removes the oldest message, which the broker has acknowledged.
    pub(super) fn on_acknowledged(&mut self) {
        self.unacknowledged.pop_front();
    }

    /// Returns true while a published message is not acknowledged.
    pub(super) fn awaits_acknowledgement(&self) -> bool {
        !self.unacknowledged.is_empty()
    }

    /// Returns true if no message waits, and all published messages are acknowledged.
    pub(super) fn is_empty(&self) -> bool {
        self.queue.front().is_none() && self.unacknowledged.is_empty()
    }

    /// On a new connection, queues the last value of every retained state, and the events that no broker has
    /// acknowledged. A state follows the last event that explains it; states without one come first. Notices of pending
    /// outputs come last, after `pending`, which lists them: with `holds` these wait for [`release`](Self::release).
    pub(super) fn on_connected(&mut self, holds: bool) {
        let held = self.held.take().unwrap_or_default().into_iter();
        let unacknowledged = std::mem::take(&mut self.unacknowledged).into_iter();
        let waiting = self.queue.take_all().into_iter();
        let (open, past): (Vec<_>, Vec<_>) = unacknowledged
            .flatten()
            .chain(waiting.filter(|parcel| !parcel.is_state()))
            .chain(held)
            .partition(|parcel| self.is_of_open_output(parcel));
        let (open, held) = if holds {
            (Vec::new(), Some(open))
        } else {
            (open, None)
        };
        self.held = held;
        let is_held = |topic: &Topic| holds && is_pending(topic);
        let events: Vec<_> = past.into_iter().chain(open).collect();
        let explained_last: BTreeMap<_, _> = (0..events.len())
            .filter_map(|at| Some((events[at].explains()?, at)))
            .collect();
        for (topic, state) in &self.states {
            if !explained_last.contains_key(topic) && !is_held(topic) {
                self.queue.put(Parcel::Message(Arc::clone(state)));
            }
        }
        for (at, event) in events.into_iter().enumerate() {
            let explains = event
                .explains()
                .filter(|state| explained_last[state] == at && !is_held(state));
            self.queue.put(event);
            if let Some(state) = explains.and_then(|topic| self.states.get(&topic)) {
                self.queue.put(Parcel::Message(Arc::clone(state)));
            }
        }
    }

    /// Queues the held messages: `m_code/pending`, then the notices of outputs that it lists.
    pub(super) fn release(&mut self) {
        let Some(held) = self.held.take() else { return };
        for (_, state) in self.states.iter().filter(|(topic, _)| is_pending(topic)) {
            self.queue.put(Parcel::Message(Arc::clone(state)));
        }
        for notice in held {
            self.queue.put(notice);
        }
    }

    /// Queues the last value of every state again, for clients of a broker that has lost one.
    pub(super) fn queue_states_again(&mut self) {
        for state in self.states.values().cloned().collect::<Vec<_>>() {
            self.put(state);
        }
    }

    /// Returns true for the notice of an output that `pending` lists.
    fn is_of_open_output(&self, parcel: &Parcel) -> bool {
        let Parcel::Message(message) = parcel else {
            return false;
        };
        let (Topic::CoordinateSystem(cs, _), Payload::Output(notice)) = (&message.topic, &message.payload)
        else {
            return false;
        };
        let pending = self.states.get(&Topic::cs(*cs, CsTopic::Pending));
        pending.is_some_and(|pending| match &pending.payload {
            Payload::Pending(pending) => (pending.outputs.iter()).any(|open| open.output.seq == notice.seq),
            _ => false,
        })
    }

    /// Returns the number of events dropped since the last call.
    pub(super) fn take_dropped_count(&mut self) -> u64 {
        let reported = std::mem::replace(&mut self.reported_lost, self.queue.dropped_events());
        self.queue.dropped_events() - reported
    }
}

/// Returns the expiry of a message at the broker, in s, if it is a presence that is not repeated.
pub(super) fn expiry_s(message: &Message) -> Option<u32> {
    let Payload::Presence(presence) = &message.payload else {
        return None;
    };
    let expires_ms = presence.expires_ms.filter(|_| presence.online)?;
    u32::try_from(expires_ms.div_ceil(1000)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use plc_protocol::queue::EVENTS_MAX;
    use plc_protocol::types::output::{
        Cancel, CancelReason, OutputNotice, OutputState, Params, Pending, PendingOutput, Timing,
    };
    use plc_protocol::types::state::Switch;
    use plc_protocol::types::{BootId, Timestamp};

    fn message(topic: CsTopic, payload: Payload) -> Arc<Message> {
        Arc::new(Message {
            topic: Topic::cs(1, topic),
            boot_id: BootId("b".into()),
            ts: Timestamp::default(),
            rev: None,
            payload,
        })
    }

    fn switch(value: bool) -> Arc<Message> {
        message(CsTopic::DryRun, Payload::Switch(Switch { value }))
    }

    fn cancel(seq: u64) -> Arc<Message> {
        let reason = CancelReason::Stop;
        message(CsTopic::Cancel(5), Payload::Cancel(Cancel { seq, reason }))
    }

    /// Returns a list without outputs. `rev` distinguishes the values.
    fn pending(rev: u64) -> Arc<Message> {
        let payload = Payload::Pending(Pending::default());
        let mut message = (*message(CsTopic::Pending, payload)).clone();
        message.rev = Some(rev);
        Arc::new(message)
    }

    fn showing<const N: usize>(open: [u64; N]) -> Arc<Message> {
        let outputs = open.map(|seq| PendingOutput {
            redelivery: None,
            output: notice(seq),
            state: OutputState::Output,
            handler_id: None,
            instance: None,
            since: Timestamp::default(),
            lost: false,
            lost_instance: None,
            progress: None,
            checkpoint: None,
            how: None,
            question: None,
        });
        let outputs = outputs.to_vec();
        message(CsTopic::Pending, Payload::Pending(Pending { outputs }))
    }

    fn output(seq: u64) -> Arc<Message> {
        message(CsTopic::Output(5), Payload::Output(notice(seq)))
    }

    fn notice(seq: u64) -> OutputNotice {
        OutputNotice {
            id: String::new(),
            seq,
            run_id: String::new(),
            m: 5,
            params: Params::default(),
            timing: Timing::AfterMotion,
            program: 1,
            line: 1,
            attempt: 1,
            redelivered: false,
        }
    }

    fn send_all(outbox: &mut Outbox) -> Vec<Arc<Message>> {
        let mut sent = Vec::new();
        while outbox.send_next(|parcel| {
            if let Parcel::Message(message) = parcel {
                sent.push(Arc::clone(message));
            }
            PublishOutcome::Accepted
        }) {}
        sent
    }

    #[test]
    fn on_a_new_connection_pending_and_notices_wait_until_they_are_released() {
        let mut outbox = Outbox::default();
        for message in [showing([7]), output(7), switch(true)] {
            outbox.put(message);
        }
        send_all(&mut outbox);
        outbox.on_connected(true);
        outbox.put(showing([7, 8]));
        outbox.put(output(8));
        assert_eq!(send_all(&mut outbox), [switch(true)]);
        // the connection is lost, and another one made
        outbox.on_connected(true);
        assert_eq!(send_all(&mut outbox), [switch(true)]);
        outbox.release();
        assert_eq!(send_all(&mut outbox), [showing([7, 8]), output(7), output(8)]);
        outbox.put(cancel(8));
        outbox.put(showing([7]));
        assert_eq!(send_all(&mut outbox), [cancel(8), showing([7])]);
    }

    #[test]
    fn waiting_state_is_sent_once_with_last_value_at_first_position() {
        let mut outbox = Outbox::default();
        for message in [switch(true), cancel(1), switch(false)] {
            outbox.put(message);
        }
        assert_eq!(send_all(&mut outbox), [switch(false), cancel(1)]);
        assert!(!outbox.is_empty(), "nothing is acknowledged yet");
        outbox.on_acknowledged();
        outbox.on_acknowledged();
        assert!(outbox.is_empty());
    }

    #[test]
    fn after_reconnect_states_and_unacknowledged_events_are_sent_again() {
        let mut outbox = Outbox::default();
        for message in [switch(true), cancel(1), cancel(2)] {
            outbox.put(message);
        }
        send_all(&mut outbox);
        outbox.on_acknowledged(); // the state
        outbox.on_acknowledged(); // cancel 1
        outbox.put(cancel(3));
        outbox.on_connected(false);
        assert_eq!(send_all(&mut outbox), [switch(true), cancel(2), cancel(3)]);
    }

    #[test]
    fn events_are_bounded_the_oldest_go_first_and_are_counted() {
        let mut outbox = Outbox::default();
        for seq in 0..EVENTS_MAX as u64 + 2 {
            outbox.put(cancel(seq));
        }
        assert_eq!(outbox.take_dropped_count(), 2);
        assert_eq!(outbox.take_dropped_count(), 0);
        let sent = send_all(&mut outbox);
        assert_eq!(sent.len(), EVENTS_MAX);
        assert_eq!(sent.first(), Some(&cancel(2)));
    }

    #[test]
    fn a_full_channel_stops_the_sending_and_loses_nothing() {
        let mut outbox = Outbox::default();
        outbox.put(cancel(1));
        outbox.put(cancel(2));
        assert!(outbox.send_next(|_| PublishOutcome::Accepted));
        assert!(!outbox.send_next(|_| PublishOutcome::Full));
        assert_eq!(send_all(&mut outbox), [cancel(2)]);
    }

    #[test]
    fn what_no_broker_can_take_is_dropped_and_holds_up_nothing() {
        let mut outbox = Outbox::default();
        outbox.put(switch(true));
        outbox.put(cancel(1));
        while outbox.send_next(|_| PublishOutcome::Never) {}
        assert!(outbox.is_empty(), "no acknowledgement is awaited");
    }

    #[test]
    fn after_reconnect_pending_is_sent_once_after_the_cancels_it_reflects() {
        let mut outbox = Outbox::default();
        for message in [switch(true), pending(1), output(1), output(2), cancel(1)] {
            outbox.put(message);
        }
        send_all(&mut outbox);
        for message in [pending(2), cancel(2), pending(3), output(3)] {
            outbox.put(message);
        }
        outbox.on_connected(false);
        let right = [
            switch(true),
            output(1),
            output(2),
            cancel(1),
            cancel(2),
            pending(3),
            output(3),
        ];
        assert_eq!(send_all(&mut outbox), right);
    }

    #[test]
    fn after_reconnect_the_notice_of_a_pending_output_follows_pending() {
        let mut outbox = Outbox::default();
        for message in [output(1), output(2), output(3), cancel(1), cancel(3), output(4)] {
            outbox.put(message);
        }
        let pending = showing([2, 4]);
        outbox.put(Arc::clone(&pending));
        outbox.on_connected(false);
        let right = [
            output(1),
            output(3),
            cancel(1),
            cancel(3),
            pending,
            output(2),
            output(4),
        ];
        assert_eq!(send_all(&mut outbox), right);
    }
}
