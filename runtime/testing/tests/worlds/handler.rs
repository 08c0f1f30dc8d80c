//! A handler over MQTT that uses only the documented topics. It loses its connection, ends without notice,
//! reconnects, sends messages twice, and resets outputs without claiming them.

use std::collections::BTreeMap;
use std::time::Duration;

use plc_protocol::types::BootId;
use plc_protocol::types::handler::HandlerStatus;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{
    Claim, HandledCode, HandlerPresence, HandshakeStatus, OutputState, Pending, Reset, ResetResult,
};
use plc_protocol::types::request::Request;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::wire::mqtt::encode;
use tandem_gateway::{Event, Wire};
use tokio::time::Instant;

use super::ROOT;
use super::broker::{ModelBroker, ModelWire};
use super::oracle::SharedOracle;
use super::random::Random;

/// Key of an output: boot identifier, coordinate system and sequence number.
type Key = (BootId, u8, u64);

/// State of an output in the handler.
#[derive(Debug, Clone, Copy, PartialEq)]
enum OutputProgress {
    Claiming,
    Working,
    Resetting,
}

pub(super) struct Handler {
    pub id: String,
    pub codes: Vec<u16>,
    pub broker: ModelBroker,
    pub truth: SharedOracle,
    pub random: Random,
    jobs: BTreeMap<Key, (u16, OutputProgress, Instant)>,
    /// Number of processes of this handler so far, including the current one.
    processes: u32,
    /// Time when the handler publishes its presence again, because another process of this handler was
    /// online.
    announces_at: Option<Instant>,
}

impl Handler {
    pub fn new(id: &str, codes: &[u16], broker: &ModelBroker, truth: &SharedOracle, random: Random) -> Self {
        Self {
            id: id.to_owned(),
            codes: codes.to_vec(),
            broker: broker.clone(),
            truth: truth.clone(),
            random,
            jobs: BTreeMap::new(),
            processes: 1,
            announces_at: None,
        }
    }

    fn instance(&self) -> String {
        format!("{}-{}", self.id, self.processes)
    }

    /// Connects to the broker repeatedly, without an end.
    pub async fn run(mut self) {
        loop {
            let gone = presence(false, &[], self.instance());
            let wire = self
                .broker
                .connect(&self.id, Some((self.topic("presence"), gone)));
            self.serve(wire).await;
            if self.random.percent(30) {
                // A new process of the handler begins, without the outputs of the previous process.
                self.jobs.clear();
                self.processes += 1;
            }
            let pause = self.random.ms(10, 1500);
            tokio::time::sleep(pause).await;
        }
    }

    fn topic(&self, last: &str) -> String {
        format!("{ROOT}handler/{}/{last}", self.id)
    }

    async fn serve(&mut self, mut wire: ModelWire) {
        let breaks = if self.broker.is_calm() { 0 } else { 60 };
        let ends = self.random.percent(breaks).then(|| self.random.ms(200, 6000));
        let end = Instant::now() + ends.unwrap_or(Duration::from_hours(1));
        loop {
            let due = self.jobs.values().map(|(_, _, due)| *due);
            let due = due.chain(self.announces_at).min();
            let due = due.map_or(end, |due| due.min(end));
            let event = tokio::select! {
                biased;
                event = wire.next() => Some(event),
                () = tokio::time::sleep_until(due) => None,
            };
            match event {
                Some(Err(_)) => return,
                Some(Ok(Event::Connected { .. })) => self.connected(&wire),
                Some(Ok(Event::Published { publish, .. })) => {
                    self.receive_message(&wire, &publish.topic, &publish.payload);
                }
                Some(Ok(_)) => {}
                None if Instant::now() >= end => {
                    if self.random.percent(20) {
                        self.announce(&wire, false);
                        wire.disconnect();
                    }
                    return;
                }
                None => {
                    if self.announces_at.is_some_and(|at| at <= Instant::now()) {
                        self.announces_at = None;
                        self.announce(&wire, true);
                    }
                    self.work(&wire);
                }
            }
        }
    }

    fn announce(&self, wire: &ModelWire, online: bool) {
        wire.publish(
            self.topic("presence"),
            1,
            true,
            presence(online, &self.codes, self.instance()),
            None,
        );
    }

    fn connected(&mut self, wire: &ModelWire) {
        let filters = [
            "cs/+/m_code/pending",
            "cs/+/m_code/+/output",
            "cs/+/m_code/+/result",
            "handler/+/presence",
            "handler/+/result",
        ];
        self.announces_at = None;
        wire.subscribe(filters.iter().map(|filter| format!("{ROOT}{filter}")));
        self.announce(wire, true);
    }

    fn receive_message(&mut self, wire: &ModelWire, topic: &str, payload: &[u8]) {
        let Some(topic) = topic.strip_prefix(ROOT).and_then(Topic::parse) else {
            return;
        };
        if let Topic::HandlerPresence(id) = &topic {
            let said = serde_json::from_slice::<HandlerPresence>(payload);
            if *id == self.id && said.is_ok_and(|said| !said.online) {
                self.announce(wire, true);
            }
            return;
        }
        let Ok(message) = Message::from_json(topic, payload) else {
            return;
        };
        match (&message.topic, &message.payload) {
            (Topic::HandlerResult(_), Payload::HandlerResult(result)) => {
                let is_own = result.instance.as_ref() == Some(&self.instance());
                match result.status {
                    HandlerStatus::Refused if is_own => {
                        self.announces_at = Some(Instant::now() + self.random.ms(500, 2000));
                    }
                    HandlerStatus::Confirm if is_own => self.announce(wire, true),
                    _ => {}
                }
            }
            (Topic::CoordinateSystem(cs, CsTopic::Output(_)), Payload::Output(notice)) => {
                self.truth
                    .lock()
                    .record_receipt(&message.boot_id.0, *cs, notice.seq);
            }
            (Topic::CoordinateSystem(cs, _), Payload::Pending(pending)) => {
                self.update_jobs(&message.boot_id, *cs, pending);
            }
            (Topic::CoordinateSystem(cs, _), Payload::Result(result)) if result.handler_id == self.id => {
                let key = (message.boot_id.clone(), *cs, result.seq);
                self.answered(&key, result.status);
            }
            _ => {}
        }
    }

    fn update_jobs(&mut self, boot: &BootId, cs: u8, pending: &Pending) {
        let now = Instant::now();
        self.jobs.retain(|(of, other, seq), _| {
            other != &cs || of == boot && pending.outputs.iter().any(|open| open.output.seq == *seq)
        });
        for open in &pending.outputs {
            if open.state != OutputState::Queued {
                self.truth.lock().record_receipt(&boot.0, cs, open.output.seq);
            }
            let key = (boot.clone(), cs, open.output.seq);
            let is_own = open.handler_id.as_ref().is_some_and(|owner| *owner == self.id);
            if !self.codes.contains(&open.output.m) || self.jobs.contains_key(&key) {
                continue;
            }
            if open.state == OutputState::Output {
                self.jobs
                    .insert(key, (open.output.m, OutputProgress::Claiming, now));
            } else if is_own {
                self.jobs
                    .insert(key, (open.output.m, OutputProgress::Working, now));
            }
        }
    }

    fn answered(&mut self, key: &Key, status: HandshakeStatus) {
        let work = self.random.ms(0, 400);
        let Some((_, job, due)) = self.jobs.get_mut(key) else {
            return;
        };
        match (status, *job) {
            (HandshakeStatus::Accepted, OutputProgress::Claiming) => {
                (*job, *due) = (OutputProgress::Working, Instant::now() + work);
            }
            (HandshakeStatus::Accepted, _) => {}
            _ => {
                self.jobs.remove(key);
            }
        }
    }

    /// Sends the claims and resets that are due, and repeats each until the machine answers.
    fn work(&mut self, wire: &ModelWire) {
        let now = Instant::now();
        let due: Vec<Key> = (self.jobs.iter())
            .filter(|(_, (_, _, due))| *due <= now)
            .map(|(key, _)| key.clone())
            .collect();
        for key in due {
            let again = now + self.random.ms(300, 1500);
            let Some((m, job, due)) = self.jobs.get_mut(&key) else {
                continue;
            };
            *due = again;
            if *job == OutputProgress::Working {
                *job = OutputProgress::Resetting;
            }
            let (m, job) = (*m, *job);
            self.send(wire, &key, m, job);
            if self.random.percent(20) {
                self.send(wire, &key, m, job);
            }
        }
    }

    fn send(&mut self, wire: &ModelWire, (boot_id, cs, seq): &Key, m: u16, job: OutputProgress) {
        let (boot_id, seq) = (boot_id.clone(), *seq);
        // Identifies the handler to the machine, which must reject requests for outputs of other handlers.
        let (handler_id, instance) = (self.id.clone(), Some(self.instance()));
        let request = match job {
            OutputProgress::Claiming if self.random.percent(97) => Request::Claim(
                *cs,
                Some(m),
                Claim {
                    boot_id,
                    seq,
                    handler_id,
                    instance,
                },
            ),
            // A reset may also come without a claim, as from a simple handler.
            _ => Request::Reset(
                *cs,
                Some(m),
                Reset {
                    boot_id,
                    seq,
                    handler_id,
                    result: if self.random.percent(3) && !self.broker.is_calm() {
                        ResetResult::Fault
                    } else {
                        ResetResult::Ok
                    },
                    code: None,
                    text: None,
                    force: None,
                    instance,
                },
            ),
        };
        if let Ok(outgoing) = encode(request, &self.id, |_, _| None) {
            wire.publish(
                format!("{ROOT}{}", outgoing.path),
                1,
                outgoing.retain,
                outgoing.payload,
                None,
            );
        }
    }
}

fn presence(online: bool, codes: &[u16], instance: String) -> String {
    let code = |m: &u16| [1, 2].map(|cs| HandledCode { cs, m: *m });
    let presence = HandlerPresence {
        online,
        handles: codes.iter().flat_map(code).collect(),
        instance: Some(instance),
        ..HandlerPresence::default()
    };
    serde_json::to_string(&presence).unwrap()
}
