//! Oracle of the simulated world. It records the requests to a machine and the answers, and derives the rules
//! that must hold. It does not use the internal state of the machine.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::types::data::LastRun;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{HandshakeStatus, OutputState};
use plc_protocol::types::state::Execution;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use tandem_model::alarm::{FAULT_LASTS, RUNTIME_FAULT};

use super::trace::Trace;

/// A rule that the machine has broken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct BrokenRule {
    pub rule: Rule,
    pub how: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    /// Each output is answered only once.
    Once,
    /// Only the owner of an output answers it.
    Owner,
    /// Acknowledged data are stored.
    Kept,
    /// Damaged data are rejected, not used.
    Believed,
    /// No axis moves without a command.
    Motion,
    /// After a kill, the machine reports all outputs that were pending, and no answered ones.
    Told,
    /// The machine asks a question about stored files only if a file was exchanged.
    Asks,
    /// The machine starts.
    Starts,
    /// After the last fault, the machine works.
    Works,
    /// No task or thread of the machine has failed, except by an injected fault.
    Whole,
}

/// Key of an output: boot identifier, coordinate system and sequence number.
type OutputKey = (String, CoordinateSystemNumber, u64);

#[derive(Debug, Default)]
struct ObservedOutput {
    notices: u32,
    /// Accepted claims: the time and the handler of each.
    claims: Vec<(f64, String)>,
    resets: u32,
    /// Time of the first publication, and time of the reset or cancellation.
    said_s: Option<f64>,
    closed_s: Option<f64>,
    /// True if a client has received the output.
    is_heard: bool,
}

/// State of the outputs, as clients know it, at the time of a kill.
#[derive(Debug)]
pub(super) struct AtKill {
    boot: String,
    /// Pending outputs that a client has received.
    open: BTreeSet<(CoordinateSystemNumber, u64)>,
    /// Outputs that were answered before a pending output was first published.
    answered: BTreeSet<(CoordinateSystemNumber, u64)>,
}

#[derive(Debug, Default)]
struct Channel {
    /// True if a command that may cause motion was sent in this boot.
    is_commanded: bool,
    /// Time of the last such command, and time when the run was observed to have ended.
    commanded_s: f64,
    ended_s: Option<f64>,
}

/// Acknowledged and attempted values of a stored item.
#[derive(Debug, Clone, Default)]
struct Value {
    /// Acknowledged values with the times of acknowledgement, the newest last.
    acknowledged: Vec<(f64, String)>,
    /// Values that were requested but neither acknowledged nor rejected.
    attempted: Vec<String>,
}

#[derive(Debug)]
pub(super) struct Oracle {
    trace: Trace,
    pub broken: Vec<BrokenRule>,
    boot: String,
    outputs: BTreeMap<OutputKey, ObservedOutput>,
    gone: BTreeMap<String, f64>,
    channels: BTreeMap<CoordinateSystemNumber, Channel>,
    values: BTreeMap<String, Value>,
    /// True if the disk was damaged since the last check; values may then be lost, but must not be wrong.
    pub may_lose: bool,
    /// True if the disk was damaged at least once.
    was_damaged: bool,
    /// Number of completed programs.
    pub completed: u32,
    /// Number of outputs that a client has received.
    pub heard: u64,
    /// Mutation that the rules must detect: a client treats a claim that was rejected as `not_owner` as
    /// accepted.
    pub takes_all_claims: bool,
}

pub(super) type SharedOracle = Arc<Mutex<Oracle>>;

/// Text for a value that the machine reports as lost.
pub(super) const LOST: &str = "lost";

impl Oracle {
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
        self.broken.push(BrokenRule { rule, how });
    }

    pub fn boot(&mut self, boot: &BootId) {
        self.boot.clone_from(&boot.0);
        self.channels.clear();
        self.gone.clear();
        // Clients no longer receive outputs of earlier boots.
        self.outputs.clear();
    }

    // Records of claims, resets and the ends of outputs.

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
            let how = format!("{handler} has claimed output {seq} of {owner}, which is still online");
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

    pub fn record_handler_offline(&mut self, handler: &str) {
        self.gone.insert(handler.to_owned(), self.trace.now_s());
    }

    /// Records that a client has received an output.
    pub fn record_receipt(&mut self, boot: &str, cs: CoordinateSystemNumber, seq: u64) {
        let key = (boot.to_owned(), cs, seq);
        if let Some(output) = self.outputs.get_mut(&key) {
            self.heard += u64::from(!output.is_heard);
            output.is_heard = true;
        }
    }

    /// Checks a message of the machine.
    pub fn check_message(&mut self, message: &Message) {
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

    // Records of stored values.

    /// Records that a bit on the disk was flipped.
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

    /// Records that the machine has rejected a value, so it is certain that it was not stored.
    pub fn refused(&mut self, name: &str, value: &str) {
        let kept = self.values.entry(name.to_owned()).or_default();
        kept.attempted.retain(|attempted| attempted != value);
    }

    pub fn names(&self) -> Vec<String> {
        self.values.keys().cloned().collect()
    }

    /// Checks a value that was read after a start. Values acknowledged after `since_s` may be missing.
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
        // A lost tool is missing from the table of tools.
        let is_lost = value == LOST || (name.starts_with('T') && value == "none");
        // If no client wrote a variable before its page was lost, the variable stays lost until it is
        // written.
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

    /// Returns the outputs that the machine must report after its next start, if it is killed now.
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

    /// Checks the report of the machine about the run that was cut short by a kill.
    pub fn check_last_run(
        &mut self,
        at_kill: &AtKill,
        cs: CoordinateSystemNumber,
        last_run: Option<&LastRun>,
    ) {
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
            let how = format!(
                "outputs {missing:?} of {boot} were open, but {last_run:?} does not report \
                               them"
            );
            self.broke(Rule::Told, how);
        }
        let mut wrong = of_cs(&at_kill.answered);
        wrong.retain(|seq| told.contains(seq));
        if !wrong.is_empty() {
            let how = format!("outputs {wrong:?} of {boot} were answered, but {last_run:?} reports them");
            self.broke(Rule::Told, how);
        }
    }
}
