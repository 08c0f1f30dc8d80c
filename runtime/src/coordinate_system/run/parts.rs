//! The remaining parts of an ordered run. Each part begins only in `PROGRAM_COMPLETED` and under the lease of the
//! order. An alarm, a stop, a reset or another command ends the order; the interlock and the start lock only delay the
//! next part.

use std::collections::BTreeMap;

use plc_protocol::types::command::{CommandMeta, Verb};
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::run::{RunEndedHow, RunOrder};
use plc_protocol::types::state::Execution;
use tandem_store::journal::Event;
use tandem_store::order_key::OrderKey;
use tandem_store::program_store::shown_to_be_called_by;

use super::active_run::ActiveRun;
use super::causes::EarlyEndCause;
use crate::coordinate_system::CoordinateSystem;

/// Delay in s of the next attempt to begin a part while a program that the part may call is being stored.
const STORING_S: f64 = 0.01;

/// Ordered parts of a run and their progress.
#[derive(Debug)]
pub(crate) struct OrderedParts {
    /// Run to which all parts belong.
    pub run_id: String,
    /// Client and lease under which the parts were ordered.
    meta: CommandMeta,
    pub ordered: u32,
    order: OrderKey,
    done: u32,
    /// Reason why the next part does not begin yet.
    waits_for: Option<String>,
    /// Time in s since the start of the next attempt to begin the part.
    again_s: Option<f64>,
    /// Hashes that all parts must share: of the main program, of programs that its text names, and of programs called
    /// so far.
    hashes: BTreeMap<u16, String>,
}

impl OrderedParts {
    pub fn new(order: RunOrder, run: &ActiveRun, meta: &CommandMeta) -> Self {
        let texts = run.texts();
        let shown = shown_to_be_called_by(texts, run.main.number);
        let hash = |number: u16| Some((number, texts.get(&number)?.checksum().to_owned()));
        Self {
            run_id: run.id.clone(),
            hashes: shown.into_iter().filter_map(hash).collect(),
            meta: CommandMeta {
                expect: None,
                not_after: None,
                ..meta.clone()
            },
            ordered: order.parts,
            order: OrderKey::new(order, meta),
            done: 0,
            waits_for: None,
            again_s: None,
        }
    }
}

impl OrderedParts {
    /// Returns the order if its first part is the run with this name.
    pub fn order_of(&self, run_id: &str) -> Option<OrderKey> {
        (self.done == 0 && self.run_id == run_id).then(|| self.order.clone())
    }
}

impl CoordinateSystem {
    /// Counts a completed part. After the last part, ends the run in the store; until then the programs of its parts
    /// cannot be changed.
    pub(crate) fn count_part(&mut self, run: &ActiveRun) {
        let (cs, store) = (self.context.number, &self.context.shared.store);
        if let Some(parts) = &mut self.commands.parts {
            parts.done += 1;
            let texts = run.texts();
            for number in self.pipeline.interpreter.called() {
                if let Some(text) = texts.get(&number) {
                    let hash = || text.checksum().to_owned();
                    parts.hashes.entry(number).or_insert_with(hash);
                }
            }
            store.end_part(cs, &run.id, parts.hashes.keys().copied().collect());
        }
        self.commands.parts.take_if(|parts| parts.done >= parts.ordered);
        if self.commands.parts.is_none() {
            store.end_run(cs, &run.id);
        }
    }

    /// Refuses the next part if its programs differ from those of the earlier parts.
    fn check_part_hashes(&self, parts: &OrderedParts) -> Result<(), Refusal> {
        for (number, hash) in &parts.hashes {
            let now = self.context.shared.store.get(*number);
            if now.is_none_or(|now| now.checksum() != hash) {
                let text = format!(
                    "program {number} was changed since the run began; order the remaining parts again"
                );
                return Err(Refusal::new(RefusalCode::PreconditionFailed, text));
            }
        }
        Ok(())
    }

    /// Returns true if the next part can be attempted now.
    pub(crate) fn part_is_due(&self) -> bool {
        let parts = self.commands.parts.as_ref();
        let is_due = |parts: &OrderedParts| parts.waits_for.is_none() && parts.again_s.is_none();
        self.state.is_idle() && parts.is_some_and(is_due)
    }

    /// Returns the time in s since the start of the next attempt to begin a part.
    pub(crate) fn parts_again_s(&self) -> Option<f64> {
        self.commands.parts.as_ref()?.again_s
    }

    /// Begins the next part; if it is refused, delays it or drops the remaining parts.
    pub(crate) fn begin_next_part(&mut self) {
        if !self.state.is_idle() || self.is_in_transition() {
            return;
        }
        if let Some(parts) = &mut self.commands.parts {
            parts.again_s = None;
        }
        let Some(parts) = &self.commands.parts else { return };
        let (meta, run_id) = (parts.meta.clone(), parts.run_id.clone());
        let are_same = self.check_part_hashes(parts);
        if self.state.state_word() != (Execution::ProgramCompleted, None) {
            return self.end_parts(RunEndedHow::Replaced, "");
        }
        self.publish_changes();
        let prepared = are_same
            .and_then(|()| self.check_preconditions(Verb::Start, &meta))
            .and_then(|()| self.prepare_start(run_id, &meta, None));
        match prepared {
            Ok(prepared) => {
                if let Some(parts) = &mut self.commands.parts {
                    parts.waits_for = None;
                }
                if let Some(run) = prepared.run {
                    self.start(run, None);
                }
            }
            Err(refusal) => self.on_part_refused(refusal),
        }
    }

    fn on_part_refused(&mut self, refusal: Refusal) {
        match refusal.code {
            RefusalCode::StartLocked => {
                let Some(parts) = &mut self.commands.parts else {
                    return;
                };
                if parts.waits_for.as_ref() == Some(&refusal.text) {
                    return;
                }
                parts.waits_for = Some(refusal.text.clone());
                self.context.record(Event::PartsWait { text: refusal.text });
            }
            // the next part may call this program, which no earlier part has called
            RefusalCode::Unavailable if self.context.shared.store.is_storing() => {
                let again_s = self.context.now_s() + STORING_S;
                if let Some(parts) = &mut self.commands.parts {
                    parts.again_s = Some(again_s);
                }
            }
            RefusalCode::Busy | RefusalCode::LeaseLost => {
                self.end_parts(RunEndedHow::LeaseLost, &refusal.text);
            }
            _ => self.end_parts(RunEndedHow::Refused, &refusal.text),
        }
    }

    /// Processes an accepted command: most commands drop the parts that have not begun.
    pub(crate) fn give_up_parts(&mut self, verb: Verb) {
        let how = match verb {
            Verb::Hold | Verb::Resume | Verb::BackTrace | Verb::AlarmAcknowledge => return,
            Verb::Stop => RunEndedHow::Stopped,
            Verb::Abort => RunEndedHow::Aborted,
            Verb::Reset => RunEndedHow::Reset,
            Verb::Load | Verb::Start | Verb::Run | Verb::Mdi | Verb::Jog | Verb::Home => {
                RunEndedHow::Replaced
            }
        };
        if self.state.is_idle() {
            self.end_parts(how, "");
        }
    }

    /// Ends the order because its run, or the remaining parts, were ended early.
    pub(crate) fn end_parts_by(&mut self, why: EarlyEndCause) {
        let how = match why {
            EarlyEndCause::Stop => RunEndedHow::Stopped,
            EarlyEndCause::Abort | EarlyEndCause::JogEnded(_) => RunEndedHow::Aborted,
            EarlyEndCause::Reset { .. } => RunEndedHow::Reset,
            EarlyEndCause::Alarm => RunEndedHow::Alarm,
        };
        self.end_parts(how, "");
    }

    fn end_parts(&mut self, how: RunEndedHow, text: &str) {
        if let Some(parts) = self.commands.parts.take() {
            (self.context.shared.store).end_run(self.context.number, &parts.run_id);
            let text = text.to_owned();
            self.context.record(Event::PartsEnded { how, text });
        }
    }
}

#[cfg(test)]
mod tests;
