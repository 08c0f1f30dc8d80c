//! Tests of the ledger under random schedules: messages lost, doubled, late and out of order, handlers that
//! fail and return, questions asked, answered and withdrawn, cancels at every point. The seed of a run
//! determines the whole run. The model of the ledger is a plain list of outputs.

use std::collections::BTreeMap;
use std::time::SystemTime;

use super::*;
use crate::types::output::{Params, Timing};
use crate::types::question::{Ask, OperatorAnswer};

const SEEDS: u64 = 4_000;
const STEPS: usize = 120;
const OPEN_MAX: usize = 6;
const HANDLERS: [&str; 3] = ["a", "b", "hmi"];
const QUESTIONS: [&str; 2] = ["q1", "q2"];
const CHOICES: [&str; 2] = ["yes", "no"];

/// Generator of random numbers (xorshift64*), so that a seed gives the same run on every machine.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let high = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33;
        usize::try_from(high).unwrap() % limit
    }
}

#[derive(Clone)]
enum InFlight {
    Claim(Option<u16>, Claim),
    Reset(Option<u16>, Reset),
    Redeliver(Redeliver),
    Ask(Option<u16>, Ask),
    Answer(Option<u16>, OperatorAnswer),
}

/// State of one output in the model.
struct ModelOutput {
    m: u16,
    issued: bool,
    owner: Option<String>,
    /// Id of the current question, and its answer.
    question: Option<(String, Option<String>)>,
    /// Handler and instance that were lost while they owned the output; `None` after a decision.
    withheld_from: Option<(String, Option<String>)>,
    closed: Option<OutputOutcome>,
}

struct World {
    seed: u64,
    random: Random,
    ledger: Ledger,
    now_s: f64,
    known: BTreeMap<u64, ModelOutput>,
    messages: Vec<InFlight>,
    notices: BTreeMap<u64, u32>,
    asked: u32,
    answered: u32,
    // online handlers: the instance of each handler, and true if the handler is exclusive
    online: BTreeMap<&'static str, (String, bool)>,
    instances: u32,
    claimed_at_once: u32,
}

impl World {
    fn new(seed: u64) -> Self {
        Self {
            seed,
            random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
            ledger: Ledger::new(BootId("b".into()), 1, OPEN_MAX),
            now_s: 0.0,
            known: BTreeMap::new(),
            messages: Vec::new(),
            notices: BTreeMap::new(),
            asked: 0,
            answered: 0,
            online: BTreeMap::new(),
            instances: 0,
            claimed_at_once: 0,
        }
    }

    fn now(&self) -> Now {
        Now {
            monotonic_s: self.now_s,
            time: SystemTime::UNIX_EPOCH,
        }
    }

    fn step(&mut self) {
        self.now_s += 0.1;
        let now = self.now();
        match self.random.below(26) {
            0..=2 => self.enqueue(),
            3..=5 => self.issue_output(),
            6..=9 => self.send_something(),
            10..=14 => self.send_about_a_question(),
            15..=21 => self.deliver(),
            22 => {
                let handler = HANDLERS[self.random.below(HANDLERS.len())];
                self.ledger.handler_lost(now, handler, None);
                let instance = self.online.remove(handler).map(|(instance, _)| instance);
                for known in self.known.values_mut() {
                    if known.owner.as_deref() == Some(handler) {
                        known.withheld_from = known.owner.take().map(|owner| (owner, instance.clone()));
                        known.question = None;
                    }
                }
            }
            23 if self.random.below(2) == 0 => self.ledger.republish(now, |m| m % 2 == 0),
            23 => self.ledger.expire(now),
            24 => self.bring_handler_online(),
            _ => {
                if self.random.below(6) == 0 {
                    self.ledger.cancel_all(now, CancelReason::Stop);
                }
            }
        }
        self.check();
    }

    /// Brings a handler for every even M code online, or changes its presence.
    fn bring_handler_online(&mut self) {
        let handler = HANDLERS[self.random.below(HANDLERS.len())];
        let exclusive = self.random.below(2) == 0;
        self.instances += 1;
        let known = self.online.get(handler).map(|(instance, _)| instance.clone());
        let instance = known.unwrap_or(format!("i{}", self.instances));
        let presence = HandlerPresence {
            online: true,
            handles: vec![HandledCode { cs: 1, m: 100 }, HandledCode { cs: 1, m: 102 }],
            instance: Some(instance.clone()),
            exclusive,
            ..HandlerPresence::default()
        };
        self.ledger.handler_online(self.now(), handler, &presence);
        self.online.insert(handler, (instance, exclusive));
    }

    /// Returns the handler that owns an output of this M code from its creation (H20).
    fn owner_at_once(&self, m: u16) -> Option<String> {
        let only = self.online.first_key_value().filter(|_| self.online.len() == 1);
        let (handler, _) = only.filter(|(_, (_, exclusive))| *exclusive && m != 101)?;
        Some((*handler).to_owned())
    }

    fn enqueue(&mut self) {
        let open = self.known.values().filter(|known| known.closed.is_none()).count();
        let spec = OutputSpec {
            run_id: "r".into(),
            m: u16::try_from(self.random.below(3)).unwrap() + 100,
            params: Params::default(),
            timing: Timing::WithMotion,
            program: 1,
            line: 1,
            timeout_s: (self.random.below(4) == 0).then_some(2.0),
            redelivery: None,
        };
        let m = spec.m;
        match self.ledger.enqueue(self.now(), spec) {
            Err(Full) => assert_eq!(open, OPEN_MAX, "seed {}", self.seed),
            Ok(seq) => {
                assert!(open < OPEN_MAX, "seed {}", self.seed);
                let greatest = self.known.keys().next_back().copied().unwrap_or(0);
                assert_eq!(seq, greatest + 1, "seed {}", self.seed);
                let known = ModelOutput {
                    m,
                    issued: false,
                    owner: None,
                    question: None,
                    withheld_from: None,
                    closed: None,
                };
                self.known.insert(seq, known);
            }
        }
    }

    fn issue_output(&mut self) {
        let now = self.now();
        let queued = self
            .known
            .iter_mut()
            .find(|(_, known)| !known.issued && known.closed.is_none());
        if let Some((&seq, known)) = queued {
            known.issued = true;
            let m = known.m;
            self.ledger.issue_output(now, seq);
            let owner = self.owner_at_once(m);
            self.claimed_at_once += u32::from(owner.is_some());
            self.known.get_mut(&seq).unwrap().owner = owner;
        }
    }

    /// Sends a claim, a reset or a decision about any output, including past and non-existent outputs.
    fn send_something(&mut self) {
        let made: Vec<u64> = self
            .known
            .iter()
            .filter(|(_, known)| known.issued && known.closed.is_none())
            .map(|(&seq, _)| seq)
            .collect();
        // every other message is about an open output, so that the ledger accepts many messages
        let seq = match self.random.below(2) {
            0 if !made.is_empty() => made[self.random.below(made.len())],
            _ => self.random.below(self.known.len() + 3) as u64,
        };
        let boot = if self.random.below(20) == 0 { "old" } else { "b" };
        let (boot_id, handler_id) = (
            BootId(boot.into()),
            HANDLERS[self.random.below(HANDLERS.len())].to_owned(),
        );
        let m = match self.random.below(3) {
            0 => None,
            _ => Some(u16::try_from(self.random.below(3)).unwrap() + 100),
        };
        let instance = self.instance(&handler_id);
        let message = match self.random.below(5) {
            0 | 1 => InFlight::Claim(
                m,
                Claim {
                    boot_id,
                    seq,
                    handler_id,
                    instance,
                },
            ),
            2 => InFlight::Redeliver(Redeliver {
                boot_id,
                seq,
                how: Redelivery::Redo,
            }),
            _ => {
                let alarm = (self.random.below(5) == 0).then(|| Alarm::user(3, "x"));
                let mut reset = crate::handshake::reset_of(&boot_id, seq, &handler_id, alarm);
                reset.force = (handler_id == "hmi").then_some(true);
                reset.instance = instance;
                InFlight::Reset(m, reset)
            }
        };
        self.messages.push(message);
    }

    /// Sends a question or an answer about an output that was issued, mostly in the name of the owner, so
    /// that the ledger accepts many of them.
    fn send_about_a_question(&mut self) {
        let owned = self.known.iter().filter(|(_, known)| known.owner.is_some());
        let owned: Vec<u64> = owned.map(|(&seq, _)| seq).collect();
        let seq = match self.random.below(4) {
            0 => self.random.below(self.known.len() + 3) as u64,
            _ if owned.is_empty() => return,
            _ => owned[self.random.below(owned.len())],
        };
        let owner = self.known.get(&seq).and_then(|known| known.owner.clone());
        let any = HANDLERS[self.random.below(HANDLERS.len())].to_owned();
        let boot_id = BootId(if self.random.below(20) == 0 { "old" } else { "b" }.into());
        let question_id = QUESTIONS[self.random.below(QUESTIONS.len())].to_owned();
        let message = if self.random.below(2) == 0 {
            let choices = match self.random.below(4) {
                0 => Vec::new(),
                _ => CHOICES.map(str::to_owned).to_vec(),
            };
            let handler_id = owner.filter(|_| self.random.below(4) > 0).unwrap_or(any);
            let instance = self.instance(&handler_id);
            InFlight::Ask(
                None,
                Ask {
                    boot_id,
                    seq,
                    handler_id,
                    question_id,
                    text: "?".into(),
                    choices,
                    instance,
                },
            )
        } else {
            let choice = ["yes", "no", "maybe"][self.random.below(3)].to_owned();
            InFlight::Answer(
                None,
                OperatorAnswer {
                    boot_id,
                    seq,
                    question_id,
                    choice,
                    client_id: None,
                },
            )
        };
        self.messages.push(message);
    }

    /// Returns the instance of an online handler.
    fn instance(&self, handler_id: &str) -> Option<String> {
        self.online.get(handler_id).map(|(instance, _)| instance.clone())
    }

    /// Returns true for the online instance. The ledger accepts no message of another instance for an owner.
    fn speaks(&self, handler_id: &str, instance: Option<&String>) -> bool {
        let there = self.instance(handler_id);
        there.is_some() && there.as_ref() == instance
    }

    /// Delivers one message, in any order. The message may be lost, or stay in flight and be delivered again.
    fn deliver(&mut self) {
        if self.messages.is_empty() {
            return;
        }
        let place = self.random.below(self.messages.len());
        let message = match self.random.below(4) {
            0 => self.messages[place].clone(),
            1 => {
                self.messages.swap_remove(place);
                return;
            }
            _ => self.messages.swap_remove(place),
        };
        let now = self.now();
        match message {
            InFlight::Claim(m, claim) => {
                let mut expected = self.expected(&claim.boot_id, claim.seq, m, &claim.handler_id, false);
                if expected == HandshakeStatus::Accepted {
                    if !self.speaks(&claim.handler_id, claim.instance.as_ref()) {
                        expected = HandshakeStatus::NotOwner;
                    } else if self.known[&claim.seq].withheld_from.is_some() {
                        expected = HandshakeStatus::Withheld;
                    }
                }
                let status = self.ledger.claim(now, m, &claim).status;
                assert_eq!(status, expected, "seed {} {claim:?}", self.seed);
                if status == HandshakeStatus::Accepted {
                    self.known.get_mut(&claim.seq).unwrap().owner = Some(claim.handler_id);
                }
            }
            InFlight::Reset(m, reset) => {
                let expected = self.expected_of_reset(m, &reset);
                let open_before = self.ledger.open().len();
                let status = self.ledger.reset(now, m, &reset).status;
                assert_eq!(status, expected, "seed {} {reset:?}", self.seed);
                // an accepted reset ends its output and no other output; any other reset ends no output
                let ended = usize::from(status == HandshakeStatus::Accepted);
                assert_eq!(
                    self.ledger.open().len(),
                    open_before - ended,
                    "seed {}",
                    self.seed
                );
            }
            InFlight::Redeliver(redeliver) => {
                let expected = self.expected(&redeliver.boot_id, redeliver.seq, None, "", false);
                let status = self.ledger.redeliver(now, None, &redeliver);
                assert_eq!(status, expected, "seed {} {redeliver:?}", self.seed);
                if status == HandshakeStatus::Accepted {
                    self.known.get_mut(&redeliver.seq).unwrap().withheld_from = None;
                }
            }
            InFlight::Ask(m, ask) => self.deliver_ask(now, m, ask),
            InFlight::Answer(m, answer) => self.deliver_answer(now, m, answer),
        }
    }

    /// Returns the expected answer to a reset. If an output has an owner, only its online instance is
    /// accepted.
    fn expected_of_reset(&self, m: Option<u16>, reset: &Reset) -> HandshakeStatus {
        let force = reset.force == Some(true);
        let mut expected = self.expected(&reset.boot_id, reset.seq, m, &reset.handler_id, force);
        let there = self.instance(&reset.handler_id);
        let is_owned = || self.known[&reset.seq].owner.is_some();
        let is_of_another = match (&there, &reset.instance) {
            (Some(there), Some(named)) => there != named,
            (_, None) => expected == HandshakeStatus::Accepted && is_owned(),
            (None, Some(_)) => false,
        };
        if expected == HandshakeStatus::Accepted && !force && is_of_another {
            expected = HandshakeStatus::NotOwner;
        }
        // an operator can always end the output, and so can the instance that worked on the output
        if expected == HandshakeStatus::Accepted
            && !force
            && let Some((lost, instance)) = &self.known[&reset.seq].withheld_from
        {
            let is_lost_one = *lost == reset.handler_id;
            let worked = is_lost_one && instance.is_some() && *instance == reset.instance;
            if !worked && (is_lost_one || self.online.contains_key(&*reset.handler_id)) {
                expected = HandshakeStatus::Withheld;
            }
        }
        expected
    }

    /// Delivers a question, and checks the answer. Only the owner may ask. A new question replaces the
    /// current question; a repetition of the current question changes nothing.
    fn deliver_ask(&mut self, now: Now, m: Option<u16>, ask: Ask) {
        let mut expected = self.expected(&ask.boot_id, ask.seq, m, &ask.handler_id, false);
        let speaks = self.speaks(&ask.handler_id, ask.instance.as_ref());
        if expected == HandshakeStatus::Accepted && (self.known[&ask.seq].owner.is_none() || !speaks) {
            expected = HandshakeStatus::NotOwner;
        }
        let status = self.ledger.ask(now, m, &ask).unwrap();
        assert_eq!(status, expected, "seed {} {ask:?}", self.seed);
        if status == HandshakeStatus::Accepted {
            self.asked += 1;
            let question = &mut self.known.get_mut(&ask.seq).unwrap().question;
            let stands = question.as_ref().is_some_and(|(id, _)| *id == ask.question_id);
            match (ask.choices.is_empty(), stands) {
                (true, true) => *question = None,
                (false, false) => *question = Some((ask.question_id, None)),
                (true, false) | (false, true) => {}
            }
        }
    }

    /// Delivers an answer. The ledger accepts only the first answer to the current question, for any owner.
    fn deliver_answer(&mut self, now: Now, m: Option<u16>, answer: OperatorAnswer) {
        let mut expected = self.expected(&answer.boot_id, answer.seq, m, "", true);
        if expected == HandshakeStatus::Accepted {
            expected = match &self.known[&answer.seq].question {
                Some((id, _)) if *id != answer.question_id => HandshakeStatus::Unknown,
                Some(_) if !CHOICES.contains(&answer.choice.as_str()) => HandshakeStatus::Unknown,
                Some((_, Some(_))) => HandshakeStatus::Duplicate,
                Some((_, None)) => HandshakeStatus::Accepted,
                None => HandshakeStatus::Unknown,
            };
        }
        let status = self.ledger.answer_question(now, m, &answer);
        assert_eq!(status, expected, "seed {} {answer:?}", self.seed);
        if status == HandshakeStatus::Accepted {
            let known = self.known.get_mut(&answer.seq).unwrap();
            known.question = Some((answer.question_id, Some(answer.choice)));
            self.answered += 1;
        }
    }

    /// Returns the answer that the rules require, as far as boot, `seq`, M number and owner determine the
    /// answer.
    fn expected(&self, boot: &BootId, seq: u64, m: Option<u16>, id: &str, force: bool) -> HandshakeStatus {
        if boot.0 != "b" {
            return HandshakeStatus::Stale;
        }
        let Some(known) = self.known.get(&seq).filter(|known| known.issued) else {
            return HandshakeStatus::Unknown;
        };
        if m.is_some_and(|m| m != known.m) {
            return HandshakeStatus::Unknown;
        }
        match (&known.closed, known.owner.as_deref()) {
            (Some(OutputOutcome::Reset), _) => HandshakeStatus::Duplicate,
            (Some(_), _) => HandshakeStatus::Stale,
            (None, Some(owner)) if owner != id && !force => HandshakeStatus::NotOwner,
            _ => HandshakeStatus::Accepted,
        }
    }

    fn check(&mut self) {
        for effect in self.ledger.take_effects() {
            match effect {
                Effect::Closed { seq, m, how } => {
                    let known = self.known.get_mut(&seq).unwrap();
                    assert_eq!(known.m, m, "seed {}", self.seed);
                    let before = known.closed.replace(how);
                    assert_eq!(before, None, "seed {}: output {seq} ended twice", self.seed);
                }
                Effect::Output(notice) => {
                    let attempt = self.notices.insert(notice.seq, notice.attempt).unwrap_or(0);
                    assert_eq!(notice.attempt, attempt + 1, "seed {}", self.seed);
                }
                Effect::PendingChanged | Effect::Result { .. } | Effect::Cancel { .. } => {}
            }
        }
        // nothing is lost: `pending` contains each open output with its owner and question, and each issued
        // output was published
        let pending = self.ledger.pending();
        let shown: Vec<_> = pending
            .outputs
            .iter()
            .map(|output| {
                let question = output.question.as_ref();
                let question = question.map(|question| (question.id.clone(), question.answer.clone()));
                (output.output.seq, output.handler_id.clone(), question)
            })
            .collect();
        let open = self.known.iter().filter(|(_, known)| known.closed.is_none());
        let expected: Vec<_> = open
            .map(|(&seq, known)| (seq, known.owner.clone(), known.question.clone()))
            .collect();
        assert_eq!(shown, expected, "seed {}", self.seed);
        for (seq, known) in &self.known {
            assert_eq!(known.issued, self.notices.contains_key(seq), "seed {}", self.seed);
        }
    }

    /// Checks that no output waits without a limit: an operator ends any open output, for any owner.
    fn end_all(&mut self) {
        while self
            .known
            .values()
            .any(|known| !known.issued && known.closed.is_none())
        {
            self.issue_output();
        }
        let open: Vec<u64> = self
            .ledger
            .open()
            .iter()
            .map(|output| output.notice.seq)
            .collect();
        for seq in open {
            let mut reset = crate::handshake::reset_of(&BootId("b".into()), seq, "hmi", None);
            reset.force = Some(true);
            let status = self.ledger.reset(self.now(), None, &reset).status;
            assert_eq!(status, HandshakeStatus::Accepted, "seed {}", self.seed);
        }
        self.check();
        assert!(self.ledger.is_empty(), "seed {}", self.seed);
    }
}

#[test]
fn no_output_is_lost_each_ends_once_frees_no_other_and_waits_can_end() {
    let (mut asked, mut answered, mut claimed_at_once) = (0, 0, 0);
    for seed in 1..=SEEDS {
        let mut world = World::new(seed);
        for _ in 0..STEPS {
            world.step();
        }
        world.end_all();
        asked += world.asked;
        answered += world.answered;
        claimed_at_once += world.claimed_at_once;
    }
    assert!(
        asked > 1000 && answered > 100 && claimed_at_once > 1000,
        "only {asked} questions, {answered} answers and {claimed_at_once} claims at once in all schedules"
    );
}
