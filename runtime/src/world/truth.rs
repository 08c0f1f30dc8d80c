//! What was asked of a machine, what it answered, and what must therefore hold. Nothing here looks into the machine.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use parking_lot::Mutex;
use plc_api::types::data::LastRun;
use plc_api::types::message::{Message, Payload};
use plc_api::types::output::{HandshakeStatus, OutputState};
use plc_api::types::state::Execution;
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::types::{BootId, CoordinateSystemNumber};
use tandem_model::alarm::{FAULT_LASTS, RUNTIME_FAULT};

use super::trace::Trace;

/// A rule that was broken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Broken {
    pub rule: Rule,
    pub how: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    /// Each output is answered once.
    Once,
    /// By its owner.
    Owner,
    /// What was acknowledged is kept.
    Kept,
    /// What is damaged is not believed.
    Believed,
    /// Nothing moves without a command.
    Motion,
    /// What was open at a kill is told, and nothing else.
    Told,
    /// No question about stored files is asked where no file was exchanged.
    Asks,
    /// The machine starts.
    Starts,
    /// In the end it works.
    Works,
    /// No part of it has failed.
    Whole,
}

/// An output of a boot.
type OutputKey = (String, CoordinateSystemNumber, u64);

#[derive(Debug, Default)]
struct Output {
    notices: u32,
    /// Accepted claims, each with its time.
    claims: Vec<(f64, String)>,
    resets: u32,
    /// When it was said first, and when it was answered or cancelled.
    said_s: Option<f64>,
    closed_s: Option<f64>,
    /// A client has heard of it.
    is_heard: bool,
}

/// Outputs as clients know them when their machine is killed.
#[derive(Debug)]
pub(super) struct AtKill {
    boot: String,
    /// Open, and heard of.
    open: BTreeSet<(CoordinateSystemNumber, u64)>,
    /// Answered before one that is open was said.
    answered: BTreeSet<(CoordinateSystemNumber, u64)>,
}

#[derive(Debug, Default)]
struct Channel {
    /// A command that may move something was made in this boot.
    is_commanded: bool,
    /// When the last one was made, and when the run was seen to have ended after that.
    commanded_s: f64,
    ended_s: Option<f64>,
}

/// What a client has been told is kept, or was about to be.
#[derive(Debug, Clone, Default)]
struct Value {
    /// Acknowledged, and when; the newest last.
    acknowledged: Vec<(f64, String)>,
    /// Asked for and not answered.
    attempted: Vec<String>,
}

#[derive(Debug)]
pub(super) struct Truth {
    trace: Trace,
    pub broken: Vec<Broken>,
    boot: String,
    outputs: BTreeMap<OutputKey, Output>,
    gone: BTreeMap<String, f64>,
    channels: BTreeMap<CoordinateSystemNumber, Channel>,
    values: BTreeMap<String, Value>,
    /// The disk was damaged since the last look, so that values may be lost, but not wrong.
    pub may_lose: bool,
    /// The disk was damaged once.
    was_damaged: bool,
    /// Programs that came to their end.
    pub completed: u32,
    /// How often a client has heard of an output.
    pub heard: u64,
    /// For a proof that it is found: whoever is told that a claim is not its own takes it for accepted.
    pub takes_all_claims: bool,
}

pub(super) type SharedTruth = Arc<Mutex<Truth>>;

/// A value that a machine says is lost.
pub(super) const LOST: &str = "lost";

impl Truth {
    pub fn new(trace: Trace) -> Self {
        Self {
            trace,
            broken: Vec::new(),
            boot: String::new(),
            outputs: BTreeMap::new(),
            gone: BTreeMap::new(),
            channels: BTreeMap::new(),
            values: BTreeMap::new(),
            may_lose: false,
            was_damaged: false,
            completed: 0,
            heard: 0,
            takes_all_claims: false,
        }
    }

    pub fn broke(&mut self, rule: Rule, how: String) {
        self.trace.line(format_args!("BROKEN {rule:?}: {how}"));
        self.broken.push(Broken { rule, how });
    }

    pub fn boot(&mut self, boot: &BootId) {
        self.boot.clone_from(&boot.0);
        self.channels.clear();
        self.gone.clear();
        // nobody hears of older ones any more
        self.outputs.clear();
    }

    // handshake

    pub fn claimed(&mut self, cs: CoordinateSystemNumber, seq: u64, handler: &str, status: HandshakeStatus) {
        let is_taken = self.takes_all_claims && status == HandshakeStatus::NotOwner;
        if status != HandshakeStatus::Accepted && !is_taken {
            return;
        }
        let now_s = self.trace.now_s();
        let output = self.outputs.entry((self.boot.clone(), cs, seq)).or_default();
        let last = output.claims.last().cloned();
        output.claims.push((now_s, handler.to_owned()));
        if let Some((at_s, owner)) = last
            && owner != handler
            && at_s < now_s
            && self.gone.get(&owner).is_none_or(|gone_s| *gone_s < at_s)
        {
            let how = format!("{handler} has claimed output {seq} of {owner}, which has not gone");
            self.broke(Rule::Owner, how);
        }
    }

    pub fn reset(
        &mut self,
        (cs, seq): (CoordinateSystemNumber, u64),
        handler: &str,
        is_forced: bool,
        status: HandshakeStatus,
    ) {
        if status != HandshakeStatus::Accepted {
            return;
        }
        let now_s = self.trace.now_s();
        let output = self.outputs.entry((self.boot.clone(), cs, seq)).or_default();
        output.resets += 1;
        output.closed_s = Some(now_s);
        let (resets, claims) = (output.resets, output.claims.clone());
        if resets > 1 {
            self.broke(Rule::Once, format!("output {seq} was answered {resets} times"));
        }
        if let Some((at_s, owner)) = claims.last()
            && owner != handler
            && *at_s < now_s
            && !is_forced
            && self.gone.get(owner).is_none_or(|gone_s| gone_s < at_s)
        {
            let how = format!("{handler} has reset output {seq} of {owner}");
            self.broke(Rule::Owner, how);
        }
    }

    pub fn handler_gone(&mut self, handler: &str) {
        self.gone.insert(handler.to_owned(), self.trace.now_s());
    }

    /// A client hears of an output.
    pub fn heard(&mut self, boot: &str, cs: CoordinateSystemNumber, seq: u64) {
        let key = (boot.to_owned(), cs, seq);
        if let Some(output) = self.outputs.get_mut(&key) {
            self.heard += u64::from(!output.is_heard);
            output.is_heard = true;
        }
    }

    /// What the machine says.
    pub fn said(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (Topic::CoordinateSystem(cs, CsTopic::Output(_)), Payload::Output(notice)) => {
                let key = (message.boot_id.0.clone(), *cs, notice.seq);
                let is_behind = self
                    .outputs
                    .iter()
                    .any(|((_, other, seq), output)| other == cs && *seq > notice.seq && output.notices > 0);
                let now_s = self.trace.now_s();
                let output = self.outputs.entry(key).or_default();
                output.notices += 1;
                output.said_s.get_or_insert(now_s);
                if notice.attempt == 1 && (output.notices > 1 || is_behind) {
                    let how = format!("output {} was made twice, or out of order", notice.seq);
                    self.broke(Rule::Once, how);
                }
            }
            (Topic::CoordinateSystem(cs, _), Payload::Cancel(cancel)) => {
                let key = (message.boot_id.0.clone(), *cs, cancel.seq);
                let now_s = self.trace.now_s();
                if let Some(output) = self.outputs.get_mut(&key) {
                    output.closed_s = Some(now_s);
                }
            }
            (Topic::CoordinateSystem(cs, _), Payload::State(state)) => {
                let is_ended = matches!(
                    state.execution,
                    Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
                );
                if state.execution == Execution::ProgramCompleted {
                    self.completed += 1;
                }
                let now_s = self.trace.now_s();
                let channel = self.channels.entry(*cs).or_default();
                channel.ended_s = is_ended.then_some(now_s);
            }
            (_, Payload::AlarmEvent(alarm)) => {
                let is_fault = [&RUNTIME_FAULT, &FAULT_LASTS]
                    .iter()
                    .any(|fault| fault.number == alarm.number);
                if is_fault && !alarm.text.contains("an injected fault") {
                    self.broke(Rule::Whole, alarm.text.clone());
                }
            }
            _ => {}
        }
    }

    // motion

    pub fn commanded(&mut self, cs: CoordinateSystemNumber) {
        let now_s = self.trace.now_s();
        let channel = self.channels.entry(cs).or_default();
        channel.is_commanded = true;
        channel.commanded_s = now_s;
    }

    pub fn moved(&mut self, cs: CoordinateSystemNumber) {
        let now_s = self.trace.now_s();
        let channel = self.channels.entry(cs).or_default();
        let is_allowed = channel.is_commanded
            && (channel.ended_s).is_none_or(|ended_s| now_s < ended_s.max(channel.commanded_s) + 0.5);
        if !is_allowed {
            let how = format!("coordinate system {cs} moved without a command: {channel:?}");
            self.broke(Rule::Motion, how);
        }
    }

    // what is kept

    /// A bit on the disk has flipped.
    pub fn damaged(&mut self) {
        self.may_lose = true;
        self.was_damaged = true;
    }

    pub fn attempt(&mut self, name: &str, value: &str) {
        let attempted = &mut self.values.entry(name.to_owned()).or_default().attempted;
        attempted.push(value.to_owned());
    }

    pub fn acknowledge(&mut self, name: &str, value: &str) {
        let now_s = self.trace.now_s();
        let kept = self.values.entry(name.to_owned()).or_default();
        kept.attempted.retain(|attempted| attempted != value);
        kept.acknowledged.push((now_s, value.to_owned()));
    }

    /// The machine has refused for certain.
    pub fn refused(&mut self, name: &str, value: &str) {
        let kept = self.values.entry(name.to_owned()).or_default();
        kept.attempted.retain(|attempted| attempted != value);
    }

    pub fn names(&self) -> Vec<String> {
        self.values.keys().cloned().collect()
    }

    /// A value is read after a start. `since_s`: what was acknowledged after this moment may be missing.
    pub fn read(&mut self, name: &str, value: &str, since_s: f64) {
        let may_lose = self.may_lose;
        let Some(kept) = self.values.get_mut(name) else {
            return;
        };
        let newest = kept.acknowledged.last().map(|(_, value)| value.clone());
        let mut right: BTreeSet<&str> = kept.attempted.iter().map(String::as_str).collect();
        let sure = (kept.acknowledged.iter()).rposition(|(at_s, _)| *at_s <= since_s);
        right.extend(
            kept.acknowledged[sure.unwrap_or(0)..]
                .iter()
                .map(|(_, value)| value.as_str()),
        );
        let is_unset = sure.is_none() && (value == "0" || value == "none");
        // a tool that is lost is not in the table
        let is_lost = value == LOST || (name.starts_with('T') && value == "none");
        // a variable that nobody asked for when its page was lost is lost until somebody writes it
        let was_lost = self.was_damaged && kept.acknowledged.is_empty();
        let is_right = right.contains(value) || is_unset || ((may_lose || was_lost) && is_lost);
        if !is_right {
            let rule = if may_lose { Rule::Believed } else { Rule::Kept };
            let how = format!("{name} is {value}; acknowledged was {newest:?}, possible is {right:?}");
            self.broke(rule, how);
        }
        let kept = self.values.entry(name.to_owned()).or_default();
        kept.attempted.clear();
        kept.acknowledged = vec![(self.trace.now_s(), value.to_owned())];
    }

    /// What a machine that is killed now must tell of its outputs.
    pub fn at_kill(&self, boot: String) -> AtKill {
        let mut at_kill = AtKill {
            boot,
            open: BTreeSet::new(),
            answered: BTreeSet::new(),
        };
        for ((_, cs, seq), output) in self.outputs.iter().rev() {
            let Some(closed_s) = output.closed_s else {
                if output.is_heard {
                    at_kill.open.insert((*cs, *seq));
                }
                continue;
            };
            let of_open = at_kill.open.iter().filter(|(of, _)| of == cs);
            let said_s = of_open.filter_map(|(_, later)| {
                let key = (at_kill.boot.clone(), *cs, *later);
                self.outputs.get(&key)?.said_s
            });
            if said_s.into_iter().any(|said_s| closed_s < said_s) {
                at_kill.answered.insert((*cs, *seq));
            }
        }
        at_kill
    }

    /// After a start: what a machine says of the run that was cut short.
    pub fn told(&mut self, at_kill: &AtKill, cs: CoordinateSystemNumber, last_run: Option<&LastRun>) {
        let told: BTreeSet<u64> = last_run
            .filter(|last_run| last_run.boot_id.0 == at_kill.boot)
            .into_iter()
            .flat_map(|last_run| &last_run.outputs)
            .filter(|output| output.state != OutputState::Queued)
            .map(|output| output.output.seq)
            .collect();
        let of_cs = |all: &BTreeSet<(CoordinateSystemNumber, u64)>| -> Vec<u64> {
            let of_cs = all.iter().filter(|(of, _)| *of == cs);
            of_cs.map(|(_, seq)| *seq).collect()
        };
        let boot = &at_kill.boot;
        let mut missing = of_cs(&at_kill.open);
        missing.retain(|seq| !told.contains(seq));
        if !missing.is_empty() {
            let how = format!("outputs {missing:?} of {boot} were open, which {last_run:?} does not say");
            self.broke(Rule::Told, how);
        }
        let mut wrong = of_cs(&at_kill.answered);
        wrong.retain(|seq| told.contains(seq));
        if !wrong.is_empty() {
            let how = format!("outputs {wrong:?} of {boot} were answered, which {last_run:?} tells as open");
            self.broke(Rule::Told, how);
        }
    }
}
