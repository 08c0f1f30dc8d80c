//! Preparation: the stages run ahead of the motion until something ends the pre-read (D15).

use tandem_interp::Inputs;
use tandem_model::alarm::AlarmEntry;
use tandem_model::flow::{Action, Item, Output, ProgramStop};
use tandem_model::{Alarm, Origin};

use plc_api::types::state::Execution;
use serde_json::json;

use super::{CoordinateSystem, Held};
use crate::journal::Entry;

/// Items taken from the interpreter in one turn, so that a command never waits long for the task.
const ITEMS_PER_TURN: usize = 256;

/// How far a run is.
#[derive(Debug)]
pub(super) enum Phase {
    /// The interpreter is asked for the next item.
    Interpret,
    /// All motion so far must be finished, in position, and not held; then this.
    Standstill(Then),
    /// An `after_motion` output is open.
    Reset { seq: u64 },
    /// A `with_motion` output whose M number is still open, or for which the ledger has no room (D32).
    Room(Output),
    /// M00, or M01 with the optional stop on.
    Paused(ProgramStop),
    /// M02, M30: outputs of the run may still be open.
    LastOutputs,
}

/// What follows a standstill.
#[derive(Debug)]
pub(super) enum Then {
    Interpret,
    Output(Output),
    Stop(ProgramStop),
    Alarm(Alarm),
    End(Origin),
}

impl CoordinateSystem {
    /// Prepares as far as it goes, at most [`ITEMS_PER_TURN`]. True when there is more to do at once.
    pub(super) fn prepare(&mut self) -> bool {
        for _ in 0..ITEMS_PER_TURN {
            self.servo.hand_over_profiles(&mut self.pipeline.ready);
            if self.ending.is_some() || !self.advance() {
                return false;
            }
        }
        true
    }

    /// One step of the run. False when it has to wait.
    fn advance(&mut self) -> bool {
        let Some(run) = &mut self.run else { return false };
        let held = run.held != Held::No;
        match std::mem::replace(&mut run.phase, Phase::Interpret) {
            Phase::Interpret => {
                if !self.pipeline.ready.is_empty() {
                    return false;
                }
                self.interpret();
                true
            }
            Phase::Standstill(then) => {
                let moving = !self.pipeline.ready.is_empty()
                    || self.servo.finished_segment < self.pipeline.last_segment();
                if moving || held {
                    run.phase = Phase::Standstill(then);
                    return false;
                }
                self.at_standstill(then);
                true
            }
            Phase::Reset { seq } => {
                let open = self.ledger.get(seq).is_some();
                if open || held {
                    run.phase = Phase::Reset { seq };
                }
                !(open || held)
            }
            Phase::Room(output) => self.put_out_with_motion(output),
            Phase::Paused(stop) => {
                run.phase = Phase::Paused(stop);
                false
            }
            Phase::LastOutputs => {
                if !self.ledger.is_empty() || held {
                    run.phase = Phase::LastOutputs;
                } else {
                    self.complete_run();
                }
                false
            }
        }
    }

    fn interpret(&mut self) {
        let Some(run) = &mut self.run else { return };
        let inputs = Inputs {
            programs: &run.programs,
            optional_skip: self.inputs.optional_skip,
            work_offsets: &self.configured.work_offsets,
        };
        let item = self.pipeline.next(&inputs);
        self.note_interpreted();
        match item {
            // Where G31 ends only the servo knows.
            Ok(Item::Block(block)) if matches!(block.action, Action::Skip(_)) => {
                self.stand_still_then(Then::Interpret);
            }
            Ok(Item::Block(_)) => {}
            Ok(Item::Warning(origin, text)) => self.warn(origin, &text),
            Ok(Item::Output(output)) if self.is_with_motion(&output) => {
                self.put_out_with_motion(output);
            }
            Ok(Item::Output(output)) => self.stand_still_then(Then::Output(output)),
            Ok(Item::Stop(stop)) => self.stand_still_then(Then::Stop(stop)),
            Ok(Item::NeedsStandstill(_)) => self.stand_still_then(Then::Interpret),
            Ok(Item::End(origin)) => self.stand_still_then(Then::End(origin)),
            // What moves before the refused block moves; then the alarm.
            Err(alarm) => self.stand_still_then(Then::Alarm(alarm)),
        }
    }

    fn note_interpreted(&mut self) {
        let Some(line) = self
            .pipeline
            .interpreter
            .call_stack()
            .last()
            .map(|origin| origin.line)
        else {
            return;
        };
        self.view.update(|place| place.interpreted_line = line);
        if self.inputs.optional_skip_fresh {
            self.inputs.optional_skip_fresh = false;
            self.inputs.effective_from_line = line;
            self.publish_inputs();
        }
    }

    fn stand_still_then(&mut self, then: Then) {
        let then = match self.pipeline.flush() {
            Ok(()) => then,
            Err(alarm) => Then::Alarm(alarm),
        };
        if let Some(run) = &mut self.run {
            run.phase = Phase::Standstill(then);
        }
    }

    fn at_standstill(&mut self, then: Then) {
        self.follow_changes(u64::MAX);
        match then {
            Then::Interpret => {}
            Then::Output(output) => self.put_out_after_motion(output),
            Then::Stop(stop) if stop.optional && !self.inputs.optional_stop => {}
            Then::Stop(stop) => {
                self.view.update(|place| place.executing = stop.origin);
                let m = u16::from(stop.optional);
                let fields = json!({"m": m, "program": stop.origin.program, "line": stop.origin.line});
                self.shared.record(self.number, &Entry::new("stop", fields));
                if let Some(run) = &mut self.run {
                    run.phase = Phase::Paused(stop);
                }
            }
            Then::Alarm(Alarm { entry, text, origin }) => self.raise_entry(entry, &text, origin),
            Then::End(origin) => {
                self.view.update(|place| place.executing = origin);
                if let Some(run) = &mut self.run {
                    run.phase = Phase::LastOutputs;
                }
            }
        }
    }

    pub(super) fn raise_entry(&mut self, entry: &AlarmEntry, text: &str, origin: Option<Origin>) {
        self.raise(entry.number, format!("{}: {text}", entry.title), origin);
    }

    fn complete_run(&mut self) {
        self.run = None;
        self.idle = (Execution::ProgramCompleted, None);
        let fields = json!({"outcome": "PROGRAM_COMPLETED"});
        self.shared.record(self.number, &Entry::new("end", fields));
    }
}
