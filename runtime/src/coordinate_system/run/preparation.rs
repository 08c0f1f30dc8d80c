//! Preparation: the stages run ahead of the motion until an item ends the pre-read (D15).

use tandem_interp::Inputs;
use tandem_model::alarm::{AlarmEntry, COMPENSATION_REFUSED, PROGRAM_WARNING};
use tandem_model::flow::Item;
use tandem_model::limits::STEPS_IN_CHAIN_MAX;
use tandem_model::settings::Tool;
use tandem_model::{Alarm, Origin};

use plc_protocol::types::state::Execution;
use tandem_store::journal::{Event, RunEnd};

use super::active_run::{ActiveRun, ActiveRunKind};
use super::run_state::{Phase, RunEvent, Then};
use crate::coordinate_system::CoordinateSystem;

/// Limits of the work done in one turn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TurnLimits {
    /// True if the turn executes commands. A caller's turn does not, because a load checks whole programs and takes
    /// long.
    pub commands: bool,
    /// Maximum number of steps of the run; a step interprets one item or handles its consequences.
    items: usize,
    /// Approximate maximum number of interpreted blocks. A calculation may add up to [`STEPS_IN_CHAIN_MAX`] blocks.
    blocks: u64,
}

impl TurnLimits {
    /// Limits of a turn of the task, so that a command waits only briefly for the end of the turn.
    pub const OF_TASK: TurnLimits = TurnLimits {
        commands: true,
        items: 256,
        blocks: 2 * STEPS_IN_CHAIN_MAX as u64,
    };

    /// Limits of a turn of a caller, for the direct consequences of its request; the caller has other work to do.
    /// Reason for 16 items: an output takes 4.
    pub const OF_CALLER: TurnLimits = TurnLimits {
        commands: false,
        items: 16,
        blocks: 64,
    };
}

/// Returns the alarm of a wait, a stop or an end within cutter compensation. There the end point of a block depends on
/// the next block, so the machine cannot stop (manual, restrictions of G41).
pub(crate) fn rest_refused(item: &Item) -> Option<Alarm> {
    let (origin, text) = match item {
        Item::Block(_) | Item::NeedsStandstill(_) | Item::Warning(..) => return None,
        Item::Output(output) => (
            output.origin,
            format!("The program waits for the reset of M{:02}", output.m),
        ),
        Item::Stop(stop) => {
            let m = u16::from(stop.optional);
            (stop.origin, format!("The program stops at M{m:02}"))
        }
        Item::End(origin) => (*origin, "The program ends before a lead-out".to_owned()),
    };
    Some(Alarm::new(&COMPENSATION_REFUSED, text).at(origin))
}

impl Then {
    fn refused_in_compensation(&self) -> Option<Alarm> {
        rest_refused(&match self {
            Then::Interpret | Then::BlockEnd | Then::Alarm(_) => return None,
            Then::Output(output) => Item::Output(*output),
            Then::Stop(stop) => Item::Stop(*stop),
            Then::End(origin) => Item::End(*origin),
        })
    }
}

impl CoordinateSystem {
    /// Prepares as much as possible within the limits of `share`. Returns true if more can be prepared at once.
    pub(crate) fn prepare(&mut self, share: TurnLimits) -> bool {
        if self.is_replanning() {
            self.hand_over();
            return false;
        }
        let before = self.pipeline.interpreter.steps();
        for _ in 0..share.items {
            if self.pipeline.interpreter.steps() >= before + share.blocks {
                return true;
            }
            self.servo.hand_over_profiles(&mut self.pipeline.ready);
            if self.state.is_ending() || !self.advance() {
                return false;
            }
        }
        true
    }

    /// Returns true in a thread (tapping) unless a hold that acts in threads is active. The operator's hold waits for
    /// the end of the thread, so motion and outputs up to its end are still prepared.
    pub(crate) fn leaves_thread(&self) -> bool {
        self.pipeline.in_thread && !self.state.holds_in_thread()
    }

    /// Executes one step of the run. Returns false if the run must wait.
    fn advance(&mut self) -> bool {
        if self.plan_set_aside() {
            return true;
        }
        let held = !self.state.is_running() && !self.leaves_thread();
        let Some(phase) = self.state.phase() else {
            return false;
        };
        match phase {
            Phase::Interpret => self.advance_interpreter(held),
            Phase::Standstill(_) => {
                if held || self.is_moving() || self.end_planned_block() {
                    return false;
                }
                let then = self.state.take_then();
                then.is_some_and(|then| self.at_standstill(then))
            }
            Phase::Reset { .. } => {
                let goes_on = self.state.awaited().is_none() && !held;
                if goes_on {
                    self.drive(RunEvent::Phase(Phase::Interpret));
                }
                goes_on
            }
            Phase::Room(output) => {
                let output = *output;
                self.issue_if_room(output, held)
            }
            Phase::Paused(_) => false,
            Phase::LastOutputs => {
                if self.state.awaited().is_none() && !held {
                    self.complete_run();
                }
                false
            }
        }
    }

    /// Interprets the next item, or ends a block in single block. Returns false if the interpreter must wait.
    fn advance_interpreter(&mut self, held: bool) -> bool {
        let Some(run) = self.state.run_mut() else {
            return false;
        };
        let single_block = self.inputs.single_block;
        let is_full = !self.pipeline.ready.is_empty()
            || self.pipeline.set_aside.len() >= self.context.configured.pre_read_blocks;
        if is_full || run.at_rest.until_s().is_some() || single_block && held {
            return false;
        }
        let between_blocks = self.pipeline.interpreter.is_between_blocks();
        if single_block && between_blocks && std::mem::take(&mut run.steps.in_block) {
            self.stand_still_then(Then::BlockEnd);
        } else {
            self.interpret();
        }
        true
    }

    /// Plans an item that was interpreted while the end point of a G31 was unknown. Returns false if there is no such
    /// item or the run must wait.
    fn plan_set_aside(&mut self) -> bool {
        if !self.state.has_run() || !self.pipeline.ready.is_empty() {
            return false;
        }
        let Some(planned) = self.pipeline.next_set_aside() else {
            return false;
        };
        self.plan_ahead_of_single_block();
        if let Err(alarm) = planned {
            self.stand_still_then(Then::Alarm(alarm));
        } else if !self.pipeline.is_behind_skip()
            && let Some(then) = self.state.take_then()
        {
            // The end of the last block becomes certain only now: nothing follows it.
            self.stand_still_then(then);
        }
        self.look_at_outputs();
        true
    }

    fn interpret(&mut self) {
        if self.approach_line() {
            return;
        }
        let Some(run) = self.state.run_mut() else { return };
        let tables = self.context.shared.tables.read();
        let inputs = Inputs {
            programs: &run.programs,
            optional_skip: self.inputs.optional_skip,
            work_offsets: tables.work_offsets(self.context.number),
            variables: &self.context.variables,
            tool: match self.inputs.tool {
                Some(id) => tables.tool(id),
                None => Some(Tool::LOST),
            },
            tools: tables.tools(),
            captured: (!self.pipeline.is_behind_skip()).then_some(self.published.captured),
            position: self.pipeline.counts_from().map(|position| position.0),
        };
        let item = self.pipeline.next(&inputs);
        drop(tables);
        run.steps.in_block |= matches!(item, Ok(Item::Block(_) | Item::Stop(_)));
        run.at_rest.count(
            self.pipeline.planner.last_segment(),
            &self.context.shared.clock,
            self.context.configured.settings.servo_period_s,
        );
        self.note_interpreted();
        let item = item.and_then(|item| self.take_output(item));
        match item {
            Ok(Item::Block(_)) => {}
            Ok(Item::Warning(origin, text)) => self.context.warn(PROGRAM_WARNING.number, origin, text),
            Ok(Item::Output(output)) if self.is_issued_at_once(&output) => {
                self.issue_with_motion(output);
            }
            Ok(Item::Output(output)) => self.stand_still_then(Then::Output(output)),
            Ok(Item::Stop(stop)) => self.stand_still_then(Then::Stop(stop)),
            Ok(Item::NeedsStandstill(_)) => self.stand_still_then(Then::Interpret),
            Ok(Item::End(origin)) => self.stand_still_then(Then::End(origin)),
            // The motion before the refused block is executed first; then the alarm is raised.
            Err(alarm) => {
                let alarm = match self.state.run() {
                    Some(run) => run.refusal_of_call(alarm),
                    None => alarm,
                };
                self.stand_still_then(Then::Alarm(alarm));
            }
        }
    }

    /// Refuses an output if a computed parameter violates the declaration of its M code.
    fn take_output(&self, item: Item) -> Result<Item, Alarm> {
        let Item::Output(output) = &item else {
            return Ok(item);
        };
        let context = &self.context;
        let refused = context.shared.refused_output(context.number, output);
        refused.map_or(Ok(item), Err)
    }

    fn note_interpreted(&mut self) {
        let Some(at) = self.pipeline.interpreter.call_stack().last() else {
            return;
        };
        self.context.view.update(|place| place.interpreted_line = at.line);
        if self.inputs.effective_skip != self.inputs.optional_skip
            && let Some(began) = self.pipeline.interpreter.began()
        {
            self.inputs.take_over_skip(began.line);
            self.publish_inputs();
        }
    }

    pub(crate) fn stand_still_then(&mut self, then: Then) {
        let is_compensating = self.pipeline.is_compensating();
        let refused = is_compensating.then(|| then.refused_in_compensation());
        let then = refused.flatten().map_or(then, Then::Alarm);
        let brought_out = match then {
            Then::Alarm(_) => self.pipeline.finish(),
            _ => self.pipeline.flush(),
        };
        let then = match brought_out {
            Ok(()) => then,
            Err(alarm) => Then::Alarm(alarm),
        };
        self.drive(RunEvent::Phase(Phase::Standstill(then)));
    }

    /// Executes the pending action when the machine is at a standstill. Returns false if the run must wait.
    fn at_standstill(&mut self, then: Then) -> bool {
        self.follow_changes(u64::MAX);
        match then {
            Then::Interpret => {}
            Then::BlockEnd => self.on_block_ended(),
            Then::Output(output) => {
                self.pipeline.planner.forbid_retrace();
                return self.issue_at_standstill(output);
            }
            Then::Stop(stop) if stop.optional && !self.inputs.optional_stop => {}
            Then::Stop(stop) => {
                self.context.view.update(|place| place.executing = stop.origin);
                let event = Event::Stop {
                    m: Some(u16::from(stop.optional)),
                    reason: None,
                    program: Some(stop.origin.program),
                    line: Some(stop.origin.line),
                };
                self.context.record(event);
                self.drive(RunEvent::Phase(Phase::Paused(stop)));
            }
            Then::Alarm(alarm) => {
                let origin = alarm.origin.map(|at| self.word_to_blame(&alarm, at));
                self.raise_entry(alarm.entry, &alarm.text, origin);
            }
            Then::End(origin) => {
                self.context.view.update(|place| place.executing = origin);
                self.drive(RunEvent::Phase(Phase::LastOutputs));
            }
        }
        true
    }

    /// Returns the place of the first word that caused the alarm; otherwise that of its block.
    fn word_to_blame(&self, alarm: &Alarm, block: Origin) -> Origin {
        let program = self.state.run().and_then(|run| {
            let called = run.programs.get(&block.program);
            called.or_else(|| (run.main.number == block.program).then_some(&run.main.tree))
        });
        program
            .and_then(|program| program.origin_of_word(block, &alarm.words))
            .unwrap_or(block)
    }

    pub(crate) fn raise_entry(&mut self, entry: &AlarmEntry, text: &str, origin: Option<Origin>) {
        self.raise(entry.number, format!("{}: {text}", entry.title), origin);
    }

    fn complete_run(&mut self) {
        let Some(run) = self.state.run() else { return };
        let outcome = match run.kind {
            ActiveRunKind::Program => Execution::ProgramCompleted,
            ActiveRunKind::Manual | ActiveRunKind::Home | ActiveRunKind::Jog(_) => Execution::Ready,
        };
        self.drive(RunEvent::Completed(outcome));
    }

    /// Performs the consequences of the end of a run that has reached its end.
    pub(crate) fn on_run_completed(&mut self, mut run: ActiveRun, outcome: Execution) {
        self.context.view.update(|place| place.run = None);
        self.past.jogs.remember(&run.kind, self.context.now_s());
        self.past.manual_goes_on |= matches!(run.kind, ActiveRunKind::Manual);
        if let Some(restores) = run.restores.take() {
            self.restore_after_macro(*restores);
        }
        self.publish_carried();
        self.context.record(Event::End(RunEnd::Completed { outcome }));
        if matches!(run.kind, ActiveRunKind::Program) {
            self.count_part(&run);
        }
        self.answer_completed_run(&run);
    }
}
