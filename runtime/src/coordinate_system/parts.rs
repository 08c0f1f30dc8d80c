//! The parts of an ordered run that are still to be made. Each begins only after `PROGRAM_COMPLETED`, under the lease of the order; an
//! alarm, a stop, a reset or another command ends the order. The interlock and the start lock only delay the next part.

use plc_api::types::command::{CommandMeta, Verb};
use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::run::{RunEndedHow, RunOrder};
use plc_api::types::state::Execution;

use super::CoordinateSystem;
use super::run_state::End;
use crate::journal::Event;

/// What was ordered, and how far it is.
#[derive(Debug)]
pub(super) struct Parts {
    /// All parts are one run.
    pub run_id: String,
    /// Who has ordered, and under which lease.
    meta: CommandMeta,
    pub ordered: u32,
    done: u32,
    /// Why the next one does not begin yet.
    waits_for: Option<String>,
}

impl Parts {
    pub fn new(order: RunOrder, run_id: &str, meta: &CommandMeta) -> Self {
        Self {
            run_id: run_id.to_owned(),
            meta: CommandMeta {
                expect: None,
                ..meta.clone()
            },
            ordered: order.parts,
            done: 0,
            waits_for: None,
        }
    }
}

impl CoordinateSystem {
    /// A part is completed.
    pub(super) fn count_part(&mut self) {
        if let Some(parts) = &mut self.commands.parts {
            parts.done += 1;
        }
        self.commands.parts.take_if(|parts| parts.done >= parts.ordered);
    }

    /// True when the next part may begin, as far as is known.
    pub(super) fn part_is_due(&self) -> bool {
        let parts = self.commands.parts.as_ref();
        self.state.is_idle() && parts.is_some_and(|parts| parts.waits_for.is_none())
    }

    /// Begins the next part, holds it back, or gives the rest up.
    pub(super) fn begin_next_part(&mut self) {
        if !self.state.is_idle() || self.is_in_transition() {
            return;
        }
        let Some(parts) = &self.commands.parts else { return };
        let meta = parts.meta.clone();
        if self.state.state_word() != (Execution::ProgramCompleted, None) {
            return self.end_parts(RunEndedHow::Replaced, "");
        }
        self.publish_changes();
        let prepared = self
            .judge(Verb::Start, &meta)
            .and_then(|()| self.prepare_start(&meta, None));
        match prepared {
            Ok(prepared) => {
                if let Some(parts) = &mut self.commands.parts {
                    parts.waits_for = None;
                }
                if let Some(mut run) = prepared.run {
                    run.id = self
                        .commands
                        .parts
                        .as_ref()
                        .map_or(run.id, |parts| parts.run_id.clone());
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
            RefusalCode::Busy | RefusalCode::LeaseLost => {
                self.end_parts(RunEndedHow::LeaseLost, &refusal.text);
            }
            _ => self.end_parts(RunEndedHow::Refused, &refusal.text),
        }
    }

    /// A command was accepted: most take the place of parts that have not begun.
    pub(super) fn give_up_parts(&mut self, verb: Verb) {
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

    /// The run is ended before its end, or what was still to come of it.
    pub(super) fn end_parts_by(&mut self, why: End) {
        let how = match why {
            End::Stop => RunEndedHow::Stopped,
            End::Abort | End::JogEnded => RunEndedHow::Aborted,
            End::Reset { .. } => RunEndedHow::Reset,
            End::Alarm => RunEndedHow::Alarm,
        };
        self.end_parts(how, "");
    }

    fn end_parts(&mut self, how: RunEndedHow, text: &str) {
        if self.commands.parts.take().is_some() {
            let text = text.to_owned();
            self.context.record(Event::PartsEnded { how, text });
        }
    }
}

#[cfg(test)]
mod tests;
