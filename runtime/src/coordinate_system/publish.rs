//! What others see: the state and what belongs to it, published when it has changed.

use plc_api::types::Timestamp;
use plc_api::types::machine::{AlarmRecord, AlarmSeverity};
use plc_api::types::message::Payload;
use plc_api::types::state::{Captured, Modal, OptionalSkip, Spindle, State, Switch, Tool, WaitingOn};
use plc_api::types::topic::CsTopic;
use tandem_model::alarm::{AlarmEntry, PROGRAM_WARNING};
use tandem_model::{Axis, AxisSet, MachinePosition, Origin};

use super::CoordinateSystem;
use crate::journal::Event;

impl CoordinateSystem {
    fn state(&self) -> State {
        let (execution, reason) = self.state.word();
        let awaited = self.state.awaited();
        let waiting_on = awaited
            .and_then(|awaited| self.ledger.get(awaited.seq))
            .map(|open| WaitingOn {
                m: open.notice.m,
                seq: open.notice.seq,
                since: Timestamp::from_system_time(open.since),
                progress: open.progress.clone(),
                question: open
                    .question
                    .clone()
                    .filter(|question| question.answer.is_none())
                    .map(Box::new),
            });
        let wait_state = waiting_on.as_ref().and_then(|waiting| {
            self.shared
                .machine
                .m_codes
                .get(&waiting.m)
                .and_then(|settings| settings.wait_state.clone())
        });
        State {
            execution,
            transition: self.state.transition(),
            reason,
            wait_state,
            waiting_on,
            program: self.program,
            run_id: self.run_id.clone(),
            single_block: self.inputs.single_block,
            dry_run: self.pipeline.is_dry_run(),
            optional_stop: self.inputs.optional_stop,
            optional_skip: skip_numbers(self.inputs.optional_skip),
            alarm_count: self.shared.alarm_count(self.number),
            last_command_id: self.last_command_id.clone(),
        }
    }

    /// True when this is the state, nothing being waited for. Compared before a state is made: most turns change nothing.
    fn is_in(&self, state: &State) -> bool {
        let State {
            execution,
            transition,
            reason,
            wait_state,
            waiting_on,
            program,
            run_id,
            single_block,
            dry_run,
            optional_stop,
            optional_skip,
            alarm_count,
            last_command_id,
        } = state;
        self.state.awaited().is_none()
            && (wait_state, waiting_on) == (&None, &None)
            && (*execution, *reason) == self.state.word()
            && *transition == self.state.transition()
            && (*program, run_id) == (self.program, &self.run_id)
            && *single_block == self.inputs.single_block
            && *dry_run == self.pipeline.is_dry_run()
            && *optional_stop == self.inputs.optional_stop
            && self.inputs.optional_skip == skip_bits(optional_skip)
            && *alarm_count == self.shared.alarm_count(self.number)
            && *last_command_id == self.last_command_id
    }

    /// Publishes the state, and the program place with it, where they have changed.
    pub(super) fn publish_changes(&mut self) {
        if self.published.as_ref().is_some_and(|state| self.is_in(state)) {
            return;
        }
        let state = self.state();
        let before = self.published.as_ref().map(|state| state.execution);
        if before != Some(state.execution) {
            self.publish_place();
        }
        self.shared
            .publish(self.topic(CsTopic::State), Payload::State(state.clone()));
        self.published = Some(state);
    }

    pub(super) fn publish_place(&self) {
        let place = self.view.program(&self.shared.store);
        self.shared
            .publish(self.topic(CsTopic::Program), Payload::Program(place));
    }

    /// Publishes every state topic once, at the start.
    pub(super) fn publish_all(&mut self) {
        self.publish_changes();
        self.publish_modal(self.pipeline.interpreter.modal());
        self.publish_inputs();
        self.publish_spindle();
        self.publish_tool();
        self.publish_lease();
        self.shared.publish(
            self.topic(CsTopic::Pending),
            Payload::Pending(self.ledger.pending()),
        );
        self.shared.publish(
            self.topic(CsTopic::Position),
            Payload::Position(self.view.position()),
        );
        let captured = self.captured_of(MachinePosition::default(), AxisSet::EMPTY);
        self.shared
            .publish(self.topic(CsTopic::Captured), Payload::Captured(captured));
    }

    /// A G31 has ended: where its motors rest, and which of them captured that position (D41).
    pub(super) fn publish_captured(&mut self, position: MachinePosition, captured: AxisSet) {
        let captured = Captured {
            run_id: self.run.as_ref().map(|run| run.id.clone()),
            line: self.view.executing_line(),
            ..self.captured_of(position, captured)
        };
        for (value, position) in self.captured.iter_mut().zip(&captured.positions) {
            *value = *position;
        }
        self.shared
            .record(self.number, Event::Capture(Box::new(captured.clone())));
        self.shared
            .publish(self.topic(CsTopic::Captured), Payload::Captured(captured));
    }

    /// By motor number, ascending.
    fn captured_of(&self, position: MachinePosition, captured: AxisSet) -> Captured {
        let motors = &self.configured.settings.motors;
        let mut each: Vec<(u16, Axis)> = Axis::ALL
            .into_iter()
            .filter_map(|axis| Some((motors[axis.index()].as_ref()?.number, axis)))
            .collect();
        each.sort_unstable_by_key(|(number, _)| *number);
        Captured {
            motors: each.iter().map(|(number, _)| *number).collect(),
            positions: each.iter().map(|(_, axis)| position.0[*axis]).collect(),
            captured: each.iter().map(|(_, axis)| captured.contains(*axis)).collect(),
            ..Captured::default()
        }
    }

    pub(super) fn publish_inputs(&self) {
        let skip = OptionalSkip {
            requested: skip_numbers(self.inputs.optional_skip),
            effective: skip_numbers(self.inputs.effective_skip),
            effective_from_line: self.inputs.effective_from_line,
        };
        let switches = [
            (CsTopic::OptionalStop, self.inputs.optional_stop),
            (CsTopic::SingleBlock, self.inputs.single_block),
            (CsTopic::DryRun, self.pipeline.is_dry_run()),
        ];
        for (topic, value) in switches {
            self.shared
                .publish(self.topic(topic), Payload::Switch(Switch { value }));
        }
        self.shared
            .publish(self.topic(CsTopic::OptionalSkip), Payload::OptionalSkip(skip));
        let locks = [
            (CsTopic::Interlock, &self.inputs.interlock),
            (CsTopic::StartLock, &self.inputs.start_lock),
        ];
        for (topic, lock) in locks {
            self.shared
                .publish(self.topic(topic), Payload::Lock(lock.clone()));
        }
        self.shared.publish(
            self.topic(CsTopic::Override),
            Payload::Override(self.inputs.overrides),
        );
    }

    pub(super) fn publish_spindle(&self) {
        let (actual_rpm, oriented) = self.view.spindle();
        let (direction, rpm) = self.inputs.spindle;
        let spindle = Spindle {
            direction,
            rpm,
            actual_rpm,
            oriented,
        };
        self.shared
            .publish(self.topic(CsTopic::Spindle), Payload::Spindle(spindle));
    }

    pub(super) fn publish_tool(&self) {
        self.shared.publish(
            self.topic(CsTopic::Tool),
            Payload::Tool(Tool { id: self.inputs.tool }),
        );
    }

    pub(super) fn publish_modal(&self, modal: &tandem_interp::Modal) {
        let groups = modal
            .groups()
            .map(|(group, code)| (group.to_owned(), code.to_owned()));
        let modal = Modal {
            g: groups.collect(),
            f: (modal.feedrate_mm_min).min(self.configured.settings.max_feedrate_mm_min),
            s: modal.spindle_speed_r_min,
            ta: modal.ta_ms,
            td: modal.td_ms,
            ts: modal.ts_ms,
            tool: self.inputs.tool,
            work_offset: modal.work_offset().map(str::to_owned),
        };
        self.shared
            .publish(self.topic(CsTopic::Modal), Payload::Modal(modal));
    }

    /// A warning of the program: an alarm of severity warning, which stops nothing.
    pub(super) fn warn(&self, origin: Origin, text: &str) {
        self.raise_warning(PROGRAM_WARNING.number, origin, text.to_owned());
    }

    /// A warning of the alarm table.
    pub(super) fn warn_of(&self, entry: &AlarmEntry, origin: Origin, text: &str) {
        self.raise_warning(entry.number, origin, format!("{}: {text}", entry.title));
    }

    fn raise_warning(&self, number: u16, origin: Origin, text: String) {
        let record = self.shared.raise(AlarmRecord {
            severity: AlarmSeverity::Warning,
            number,
            text,
            cs: Some(self.number),
            program: Some(origin.program),
            line: Some(origin.line),
            column: Some(origin.column),
            ..AlarmRecord::default()
        });
        let event = Event::Warning {
            program: record.program,
            line: record.line,
            text: record.text,
        };
        self.shared.record(self.number, event);
    }
}

fn skip_numbers(bits: u32) -> Vec<u8> {
    (1..=31)
        .filter(|number| bits & (1 << (number - 1)) != 0)
        .collect()
}

fn skip_bits(numbers: &[u8]) -> u32 {
    numbers.iter().fold(0, |bits, number| bits | 1 << (number - 1))
}
