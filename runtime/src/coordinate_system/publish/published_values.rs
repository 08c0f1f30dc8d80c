//! Publishes the state topics of a coordinate system when their values have changed.

use std::sync::Arc;
use std::time::SystemTime;

use plc_protocol::handshake::OpenOutput;
use plc_protocol::types::Timestamp;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::question::Question;
use plc_protocol::types::state::{
    CapturedPositions, Execution, Modal, OptionalSkip, Reason, Spindle, State, Switch, Tool, WaitingOn,
};
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_config::ConfiguredSystem;
use tandem_model::profile::TimeBase;
use tandem_model::{AXES_MAX, Axis, AxisSet, MachinePosition};
use tandem_store::journal::Event;
use tandem_store::program_store::StoredProgram;

use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::locks::start_conditions::PublishedStart;

/// The values of the state topics that were published last.
#[derive(Debug, Default)]
pub(crate) struct PublishedValues {
    pub state: Option<Arc<Message>>,
    pub start: PublishedStart,
    /// Time at which the awaited output reached the state that was published last.
    waiting_since: Option<SystemTime>,
    /// Number of program changes in the store when the state was published last.
    changes: u64,
    /// Modal codes with which the next manual data input begins, as far as they differ from the start-up codes.
    carried: Vec<String>,
    /// `_CNC_CapturedPosition<n>`: rest position of the motors at the end of the last G31 since the start of the
    /// runtime. Machine coordinates in mm or degrees, in ascending order of motor numbers (D16, D41).
    pub captured: [f64; AXES_MAX],
}

impl PublishedValues {
    fn state(&self) -> Option<&State> {
        match &self.state.as_ref()?.payload {
            Payload::State(state) => Some(state),
            _ => None,
        }
    }
}

impl CoordinateSystem {
    fn state(&self) -> State {
        let (execution, reason) = self.published_word();
        let waiting_on = self.awaited_output().map(|open| WaitingOn {
            m: open.notice.m,
            seq: open.notice.seq,
            since: Timestamp::from_system_time(open.since),
            progress: open.progress().cloned(),
            question: unanswered(open).cloned().map(Box::new),
        });
        let wait_state = waiting_on.as_ref().and_then(|waiting| {
            self.context
                .m_code(waiting.m)
                .and_then(|settings| settings.wait_state.clone())
        });
        let main = self.main_program();
        State {
            execution,
            transition: self.state.transition(),
            reason,
            wait_state,
            waiting_on,
            program: self.commands.program,
            hash: main.as_ref().map(|main| main.checksum().to_owned()),
            o_number: main.and_then(|main| main.tree.number()),
            run_id: self.past.last_id.clone(),
            run_kind: self.state.run().map(|run| run.kind.run_kind()),
            single_block: self.inputs.single_block,
            dry_run: self.pipeline.path.is_dry_run(),
            optional_stop: self.inputs.optional_stop,
            optional_skip: skip_numbers(self.inputs.optional_skip),
            alarm_count: self.context.alarm_count(),
            last_command_id: self.commands.last_id.clone(),
        }
    }

    /// Returns the state word and its reason; `OVERRIDE_ZERO` if an override of 0 percent stops a motion that is not
    /// held, or the spindle whose speed the program awaits.
    fn published_word(&self) -> (Execution, Option<Reason>) {
        let word = self.state.state_word();
        if word == (Execution::Wait, None) && self.awaits_stopped_spindle() {
            return (Execution::Wait, Some(Reason::OverrideZero));
        }
        let overrides = &self.inputs.overrides;
        let percent = match self.servo.started {
            Some(TimeBase::Feed) => overrides.feed,
            Some(TimeBase::Rapid) => overrides.rapid,
            Some(TimeBase::Fixed) | None => return word,
        };
        let stands = percent <= 0.0 && word == (Execution::Active, None) && self.is_moving();
        if stands {
            (Execution::Active, Some(Reason::OverrideZero))
        } else {
            word
        }
    }

    /// Returns the running program; if none runs, the program that a start would run.
    pub(crate) fn main_program(&self) -> Option<Arc<StoredProgram>> {
        let number = self.commands.program?;
        let running = self.state.run().map(|run| &run.main);
        let running = running.filter(|main| main.number == number).cloned();
        running.or_else(|| self.context.shared.store.get(number))
    }

    /// Returns the open output for which the run waits.
    fn awaited_output(&self) -> Option<&OpenOutput> {
        self.outputs.ledger.get(self.state.awaited()?.seq)
    }

    /// Returns true if the run still waits as published in `waiting_on`.
    fn is_waiting_on(&self, waiting_on: Option<&WaitingOn>) -> bool {
        match (self.awaited_output(), waiting_on) {
            (None, None) => true,
            (Some(open), Some(on)) => {
                (open.notice.m, open.notice.seq) == (on.m, on.seq)
                    && self.published.waiting_since == Some(open.since)
                    && open.progress() == on.progress.as_ref()
                    && unanswered(open) == on.question.as_deref()
            }
            _ => false,
        }
    }

    /// Returns true if `state` is still current. Reason: most turns change nothing, and this costs less than a new
    /// state.
    fn is_in(&self, state: &State) -> bool {
        let State {
            execution,
            transition,
            reason,
            waiting_on,
            program,
            // these follow from the M code, the program, the run, and the changes of the store, which are compared
            wait_state: _,
            hash: _,
            o_number: _,
            run_id,
            run_kind,
            single_block,
            dry_run,
            optional_stop,
            optional_skip,
            alarm_count,
            last_command_id,
        } = state;
        self.is_waiting_on(waiting_on.as_ref())
            && (*execution, *reason) == self.published_word()
            && *transition == self.state.transition()
            && self.published.changes == self.context.shared.store.changes()
            && (*program, run_id) == (self.commands.program, &self.past.last_id)
            && *run_kind == self.state.run().map(|run| run.kind.run_kind())
            && *single_block == self.inputs.single_block
            && *dry_run == self.pipeline.path.is_dry_run()
            && *optional_stop == self.inputs.optional_stop
            && self.inputs.optional_skip == skip_bits(optional_skip)
            && *alarm_count == self.context.alarm_count()
            && *last_command_id == self.commands.last_id
    }

    /// Publishes the state of the coordinate system if it has changed.
    pub(crate) fn publish_changes(&mut self) {
        self.note_rest();
        if self.published.state().is_some_and(|state| self.is_in(state)) {
            return;
        }
        self.published.changes = self.context.shared.store.changes();
        self.published.waiting_since = self.awaited_output().map(|open| open.since);
        let state = self.state();
        let topic = Topic::cs(self.context.number, CsTopic::State);
        let message = (self.context.shared).publish_state(topic, Payload::State(state));
        self.published.state = Some(message);
    }

    /// Publishes every state topic once, at the start of the runtime or after a fault.
    pub(crate) fn publish_all(&mut self) {
        self.publish_changes();
        self.publish_start_conditions();
        self.publish_modal(self.pipeline.interpreter.modal());
        self.publish_inputs();
        self.publish_spindle();
        self.publish_tool();
        self.publish_lease();
        self.context
            .publish(CsTopic::Pending, Payload::Pending(self.outputs.ledger.pending()));
        self.context
            .publish(CsTopic::Position, Payload::Position(self.context.view.position()));
        let captured = self.captured_of(MachinePosition::default(), AxisSet::EMPTY);
        self.context
            .publish(CsTopic::Captured, Payload::Captured(captured));
        self.note_published();
    }

    /// Notes that all journal events of this coordinate system up to now have been published.
    pub(crate) fn note_published(&self) {
        let line = self.context.shared.journal.last_number();
        self.context.view.set_published_line(line);
    }

    /// Publishes the rest position of the motors after a G31, and which motors captured that position (D41).
    pub(crate) fn publish_captured(&mut self, position: MachinePosition, captured: AxisSet) {
        let captured = CapturedPositions {
            run_id: self.state.run().map(|run| run.id.clone()),
            line: self.context.view.executing().line,
            ..self.captured_of(position, captured)
        };
        for (value, position) in self.published.captured.iter_mut().zip(&captured.positions) {
            *value = *position;
        }
        self.context.record(Event::Capture(Box::new(captured.clone())));
        self.context
            .publish(CsTopic::Captured, Payload::Captured(captured));
    }

    /// Returns the captured positions in ascending order of motor numbers.
    fn captured_of(&self, position: MachinePosition, captured: AxisSet) -> CapturedPositions {
        let motors = &self.context.configured.settings.motors;
        let mut each: Vec<(u16, Axis)> = Axis::ALL
            .into_iter()
            .filter_map(|axis| Some((motors[axis.index()].as_ref()?.number, axis)))
            .collect();
        each.sort_unstable_by_key(|(number, _)| *number);
        CapturedPositions {
            motors: each.iter().map(|(number, _)| *number).collect(),
            positions: each.iter().map(|(_, axis)| position.0[*axis]).collect(),
            captured: each.iter().map(|(_, axis)| captured.contains(*axis)).collect(),
            ..CapturedPositions::default()
        }
    }

    pub(crate) fn publish_inputs(&self) {
        let skip = OptionalSkip {
            requested: skip_numbers(self.inputs.optional_skip),
            effective: skip_numbers(self.inputs.effective_skip),
            effective_from_line: self.inputs.effective_from_line,
        };
        let switches = [
            (CsTopic::OptionalStop, self.inputs.optional_stop),
            (CsTopic::SingleBlock, self.inputs.single_block),
            (CsTopic::DryRun, self.pipeline.path.is_dry_run()),
        ];
        for (topic, value) in switches {
            self.context.publish(topic, Payload::Switch(Switch { value }));
        }
        self.context
            .publish(CsTopic::OptionalSkip, Payload::OptionalSkip(skip));
        let locks = [
            (CsTopic::Interlock, &self.inputs.interlock),
            (CsTopic::StartLock, &self.inputs.start_lock),
        ];
        for (topic, lock) in locks {
            self.context.publish(topic, Payload::Lock(lock.state()));
        }
        self.context
            .publish(CsTopic::Override, Payload::Override(self.inputs.overrides));
    }

    pub(crate) fn publish_spindle(&self) {
        let (actual_rpm, oriented) = self.context.view.spindle();
        let (direction, rpm) = self.inputs.spindle;
        let spindle = Spindle {
            direction,
            rpm,
            actual_rpm,
            oriented,
        };
        self.context.publish(CsTopic::Spindle, Payload::Spindle(spindle));
    }

    pub(crate) fn publish_tool(&self) {
        let tables = &self.context.shared.tables;
        tables.note_spindle(self.context.number, self.inputs.tool.is_some());
        // The number of an unknown tool is not published.
        if let Some(id) = self.inputs.tool {
            self.context.publish(CsTopic::Tool, Payload::Tool(Tool { id }));
        }
    }

    pub(crate) fn publish_modal(&self, modal: &tandem_interp::Modal) {
        let modal = Modal {
            mdi: self.published.carried.clone(),
            ..published_modal(modal, &self.context.configured, self.inputs.tool)
        };
        self.context.publish(CsTopic::Modal, Payload::Modal(modal));
    }

    /// Publishes the modal codes with which the next manual data input begins, if they have changed.
    pub(crate) fn publish_carried(&mut self) {
        let codes = self.pipeline.interpreter.codes_unlike_start_up();
        let codes = codes.filter(|_| self.past.manual_goes_on).map(str::to_owned);
        let carried: Vec<String> = codes.collect();
        if carried != self.published.carried {
            self.published.carried = carried;
            let pipeline = &self.pipeline;
            self.publish_modal(if self.state.has_run() {
                &pipeline.in_force.modal
            } else {
                pipeline.interpreter.modal()
            });
        }
    }
}

/// Returns a modal state and the tool in the spindle in their published form.
pub(crate) fn published_modal(
    modal: &tandem_interp::Modal,
    configured: &ConfiguredSystem,
    tool: Option<u16>,
) -> Modal {
    let groups = modal
        .groups()
        .map(|(group, code)| (group.to_owned(), code.to_owned()));
    Modal {
        g: groups.collect(),
        f: (modal.feedrate_mm_min).min(configured.settings.max_feedrate_mm_min * modal.unit()),
        s: modal.spindle_speed_r_min,
        ta: modal.ta_ms,
        td: modal.td_ms,
        ts: modal.ts_ms,
        tool,
        work_offset: modal.work_offset().map(str::to_owned),
        mdi: Vec::new(),
    }
}

/// Returns the question of an output if it is not answered yet.
fn unanswered(open: &OpenOutput) -> Option<&Question> {
    open.question().filter(|question| question.answer.is_none())
}

fn skip_numbers(bits: u32) -> Vec<u8> {
    (1..=31)
        .filter(|number| bits & (1 << (number - 1)) != 0)
        .collect()
}

fn skip_bits(numbers: &[u8]) -> u32 {
    numbers.iter().fold(0, |bits, number| bits | 1 << (number - 1))
}
