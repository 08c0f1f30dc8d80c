//! The ledger under random schedules: messages lost, doubled, late and out of order, handlers that die and come back,
//! cancels at every point. Each run follows from its seed. The model beside the ledger is the plain list of outputs.

use std::collections::BTreeMap;
use std::time::SystemTime;

use super::*;
use crate::types::output::{Params, Timing};

const SEEDS: u64 = 2_000;
const STEPS: usize = 120;
const OPEN_MAX: usize = 6;
const HANDLERS: [&str; 3] = ["a", "b", "hmi"];

/// xorshift64*, so that a seed gives the same run on every machine.
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
}

/// What the model knows of one output.
struct Known {
    m: u16,
    made: bool,
    owner: Option<String>,
    closed: Option<Closed>,
}

struct World {
    seed: u64,
    random: Random,
    ledger: Ledger,
    now_s: f64,
    known: BTreeMap<u64, Known>,
    messages: Vec<InFlight>,
    notices: BTreeMap<u64, u32>,
}

impl World {
    fn new(seed: u64) -> Self {
        Self {
            seed,
            random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
            ledger: Ledger::new(BootId("b".into()), OPEN_MAX),
            now_s: 0.0,
            known: BTreeMap::new(),
            messages: Vec::new(),
            notices: BTreeMap::new(),
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
        match self.random.below(16) {
            0..=2 => self.enqueue(),
            3 | 4 => self.put_out(),
            5..=7 => self.send_something(),
            8..=11 => self.deliver(),
            12 => {
                let handler = HANDLERS[self.random.below(HANDLERS.len())];
                self.ledger.handler_lost(now, handler);
                for known in self.known.values_mut() {
                    if known.owner.as_deref() == Some(handler) {
                        known.owner = None;
                    }
                }
            }
            13 => self.ledger.republish(now, |m| m % 2 == 0),
            14 => self.ledger.expire(now),
            _ => {
                if self.random.below(6) == 0 {
                    self.ledger.cancel_all(now, CancelReason::Stop);
                }
            }
        }
        self.check();
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
        };
        let m = spec.m;
        match self.ledger.enqueue(self.now(), spec) {
            Err(Full) => assert_eq!(open, OPEN_MAX, "seed {}", self.seed),
            Ok(seq) => {
                assert!(open < OPEN_MAX, "seed {}", self.seed);
                let greatest = self.known.keys().next_back().copied().unwrap_or(0);
                assert_eq!(seq, greatest + 1, "seed {}", self.seed);
                let known = Known {
                    m,
                    made: false,
                    owner: None,
                    closed: None,
                };
                self.known.insert(seq, known);
            }
        }
    }

    fn put_out(&mut self) {
        let now = self.now();
        let queued = self
            .known
            .iter_mut()
            .find(|(_, known)| !known.made && known.closed.is_none());
        if let Some((&seq, known)) = queued {
            known.made = true;
            self.ledger.put_out(now, seq);
        }
    }

    /// A claim, reset or decision about any output, past ones and ones that never were included.
    fn send_something(&mut self) {
        let seq = self.random.below(self.known.len() + 3) as u64;
        let boot = if self.random.below(20) == 0 { "old" } else { "b" };
        let (boot_id, handler_id) = (
            BootId(boot.into()),
            HANDLERS[self.random.below(HANDLERS.len())].to_owned(),
        );
        let m = match self.random.below(3) {
            0 => None,
            _ => Some(u16::try_from(self.random.below(3)).unwrap() + 100),
        };
        let message = match self.random.below(5) {
            0 | 1 => InFlight::Claim(
                m,
                Claim {
                    boot_id,
                    seq,
                    handler_id,
                },
            ),
            2 => InFlight::Redeliver(Redeliver {
                boot_id,
                seq,
                how: Redelivery::Redo,
            }),
            _ => {
                let alarm = (self.random.below(5) == 0).then(|| Alarm::user(3, "x"));
                let mut reset = crate::outputs::reset_of(&boot_id, seq, &handler_id, alarm);
                reset.force = (handler_id == "hmi").then_some(true);
                InFlight::Reset(m, reset)
            }
        };
        self.messages.push(message);
    }

    /// One message arrives, in any order; it may stay in flight (doubled), or be lost.
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
                let expected = self.expected(&claim.boot_id, claim.seq, m, &claim.handler_id, false);
                let status = self.ledger.claim(now, m, &claim).status;
                assert_eq!(status, expected, "seed {} {claim:?}", self.seed);
                if status == HandshakeStatus::Accepted {
                    self.known.get_mut(&claim.seq).unwrap().owner = Some(claim.handler_id);
                }
            }
            InFlight::Reset(m, reset) => {
                let force = reset.force == Some(true);
                let expected = self.expected(&reset.boot_id, reset.seq, m, &reset.handler_id, force);
                let open_before = self.ledger.open().len();
                let status = self.ledger.reset(now, m, &reset).status;
                assert_eq!(status, expected, "seed {} {reset:?}", self.seed);
                // a reset that counts ends its output and no other; any other ends none
                let ended = usize::from(status == HandshakeStatus::Accepted);
                assert_eq!(
                    self.ledger.open().len(),
                    open_before - ended,
                    "seed {}",
                    self.seed
                );
            }
            InFlight::Redeliver(redeliver) => {
                self.ledger.redeliver(now, None, &redeliver);
            }
        }
    }

    /// The answer by the words of the interface.
    fn expected(&self, boot: &BootId, seq: u64, m: Option<u16>, id: &str, force: bool) -> HandshakeStatus {
        if boot.0 != "b" {
            return HandshakeStatus::Stale;
        }
        let Some(known) = self.known.get(&seq).filter(|known| known.made) else {
            return HandshakeStatus::Unknown;
        };
        if m.is_some_and(|m| m != known.m) {
            return HandshakeStatus::Unknown;
        }
        match (&known.closed, known.owner.as_deref()) {
            (Some(Closed::Reset), _) => HandshakeStatus::Duplicate,
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
        // nothing lost: what has not ended is in pending, with its owner, and what has been made was told
        let pending = self.ledger.pending();
        let shown: Vec<_> = pending
            .outputs
            .iter()
            .map(|output| (output.output.seq, output.handler_id.clone()))
            .collect();
        let open = self.known.iter().filter(|(_, known)| known.closed.is_none());
        let expected: Vec<_> = open.map(|(&seq, known)| (seq, known.owner.clone())).collect();
        assert_eq!(shown, expected, "seed {}", self.seed);
        for (seq, known) in &self.known {
            assert_eq!(known.made, self.notices.contains_key(seq), "seed {}", self.seed);
        }
    }

    /// No wait that cannot be ended: an operator ends whatever is open, whoever owns it.
    fn end_all(&mut self) {
        while self
            .known
            .values()
            .any(|known| !known.made && known.closed.is_none())
        {
            self.put_out();
        }
        let open: Vec<u64> = self
            .ledger
            .open()
            .iter()
            .map(|output| output.notice.seq)
            .collect();
        for seq in open {
            let mut reset = crate::outputs::reset_of(&BootId("b".into()), seq, "hmi", None);
            reset.force = Some(true);
            let status = self.ledger.reset(self.now(), None, &reset).status;
            assert_eq!(status, HandshakeStatus::Accepted, "seed {}", self.seed);
        }
        self.check();
        assert!(self.ledger.is_empty(), "seed {}", self.seed);
    }
}

#[test]
fn no_output_is_lost_none_ends_twice_none_frees_another_and_every_wait_can_be_ended() {
    for seed in 1..=SEEDS {
        let mut world = World::new(seed);
        for _ in 0..STEPS {
            world.step();
        }
        world.end_all();
    }
}
