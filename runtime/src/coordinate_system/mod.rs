//! One CNC coordinate system.
//!
//! The coordinate system pulls blocks through the stages, ahead of the motion, into the servo's queue
//! (`run::preparation`). It keeps the ledger of outputs and resets (`outputs`), executes commands one after another
//! (`commands`) and publishes changes (`publish`). The next step of its run follows from one state (`run::run_state`). The servo answers by
//! events only; the servo never calls a stage. Only one thread at a time works on a coordinate system: its task's
//! thread or a caller's thread (`mailbox`).

mod commands;
mod context;
mod fault;
mod locks;
mod mailbox;
mod manual;
mod outputs;
mod publish;
mod run;
mod servo_link;

use std::sync::Arc;

use plc_protocol::handshake::Ledger;
use plc_protocol::lock_input::LockInput;
use plc_protocol::types::machine::AlarmRaise;
use plc_protocol::types::output::CancelReason;
use plc_protocol::types::request::{Answer, CoordinateSystemRequest, Input, Refusal, RefusalCode};
use plc_protocol::types::state::{Execution, Overrides, Reason, SpindleDirection};
use tandem_model::MachinePosition;
use tandem_model::flow::Transform;
use tandem_servo::{ChannelHandle, Control, Event};

use crate::shared::SharedState;
use commands::pending_commands::{Awaiting, Commands, DeferredCommand};
use context::Context;
use locks::bus::Bus;
use locks::lease::ControlLease;
use locks::watched_clients::WatchedClients;
use mailbox::Envelope;
pub(crate) use mailbox::Mailbox;
use manual::cut_short::RunRemainder;
use outputs::output_ledger::Outputs;
use publish::published_values::PublishedValues;
pub(crate) use publish::published_values::published_modal;
use publish::rest::WrittenRest;
pub(crate) use publish::view::{Prediction, View};
use run::active_run::{ActiveRun, PastRuns};
use run::causes::EarlyEndCause;
pub(crate) use run::conditions::{Conditions, RunStart, state_of};
pub(crate) use run::holding::SINGLE_BLOCK_REFUSED;
pub(crate) use run::line_search;
pub(crate) use run::pipeline::{Pipeline, callers};
use run::preparation::TurnLimits;
pub(crate) use run::preparation::rest_refused;
use run::replanning::Replanning;
use run::run_state::{RunAction, RunEvent, RunState};
use servo_link::ServoLink;
use tandem_config::ConfiguredSystem;
use tandem_store::journal::{Event as Happened, RaisedAlarm, RunEnd};

/// Complete state of a coordinate system.
pub(crate) struct CoordinateSystem {
    context: Context,
    servo: ServoLink,
    pipeline: Pipeline,
    replanning: Replanning,
    state: RunState<Box<ActiveRun>, RunRemainder>,
    past: PastRuns,
    /// Position at the last rest of the axes.
    rest: WrittenRest,
    inputs: InputValues,
    outputs: Outputs,
    commands: Commands,
    published: PublishedValues,
    lease: ControlLease,
}

/// Input values from outside the coordinate system.
#[derive(Debug, Default)]
struct InputValues {
    bus: Bus,
    clients: WatchedClients,
    optional_skip: u32,
    /// The optional skip inputs that the interpreter uses now. They apply from `effective_from_line` on.
    effective_skip: u32,
    effective_from_line: u32,
    optional_stop: bool,
    single_block: bool,
    interlock: LockInput,
    start_lock: LockInput,
    overrides: Overrides,
    spindle: (SpindleDirection, f64),
    /// Set while the spindle turns by M03 or M04 of the stock sequence program. Spindle speeds (S) that were programmed
    /// in this segment or later are newer than that M code.
    spindle_at_s_from: Option<u64>,
    /// Number of waits for the spindle speed since the start of the runtime.
    spindle_waits: u64,
    /// Number of the tool in the spindle; `None` if the stored number is lost.
    tool: Option<u16>,
}

impl InputValues {
    /// Makes the interpreter use the current optional skip inputs from this line on.
    fn take_over_skip(&mut self, line: u32) {
        self.effective_skip = self.optional_skip;
        self.effective_from_line = line;
    }
}

impl CoordinateSystem {
    pub fn new(
        shared: Arc<SharedState>,
        configured: ConfiguredSystem,
        handle: ChannelHandle,
        first_state: (Execution, Option<Reason>),
        tool: Option<u16>,
    ) -> Self {
        let number = configured.settings.number;
        let [interlock, start_lock] = configured.locks.clone();
        let ledger = Ledger::new(
            shared.boot_id.clone(),
            configured.settings.number,
            configured.open_outputs_max,
        );
        let at = handle.readings.read().commanded;
        let mut pipeline = Pipeline::new(&configured.settings, configured.dialect, at);
        if let Some(on_plan) = shared.on_plan.clone() {
            pipeline.watch(on_plan, &configured.settings);
        }
        Self {
            pipeline,
            lease: ControlLease::new(number, shared.now()),
            context: Context {
                number,
                view: Arc::new(View::new(
                    &configured.settings,
                    Arc::clone(&handle.readings),
                    Arc::clone(&handle.trace),
                )),
                variables: shared.tables.variables(number),
                configured,
                shared,
            },
            servo: ServoLink::new(handle),
            replanning: Replanning::default(),
            state: RunState::Idle(first_state),
            past: PastRuns::default(),
            rest: WrittenRest::default(),
            inputs: InputValues {
                tool,
                interlock: LockInput::new("interlock", interlock),
                start_lock: LockInput::new("start lock", start_lock),
                ..InputValues::default()
            },
            outputs: Outputs::new(ledger),
            commands: Commands::default(),
            published: PublishedValues::default(),
        }
    }

    /// Cancels all open outputs when the runtime closes.
    fn shut_down(mut self) {
        self.outputs
            .ledger
            .cancel_all(self.context.now(), CancelReason::Shutdown);
        self.apply_effects();
        self.note_published();
    }

    /// Executes one turn: servo events, expired times, commands, preparation. Returns true if there is more to prepare.
    fn turn(&mut self, share: TurnLimits) -> bool {
        while let Some(event) = self.servo.next_event() {
            self.on_servo_event(event);
        }
        self.follow_servo_failure();
        let now = self.context.now();
        if let Some(run) = self.state.run_mut() {
            run.at_rest.on_time(now.monotonic_s);
        }
        self.outputs.ledger.expire(now);
        self.expire_jog(now.monotonic_s);
        self.expire_lease(now.monotonic_s);
        self.do_stock_work(now);
        self.expire_handler_waits(now);
        self.look_at_losses(now.monotonic_s);
        self.look_at_bus();
        self.look_at_clients(now.monotonic_s);
        self.apply_effects();
        self.expire_validation(now.monotonic_s);
        if share.commands {
            self.execute_deferred();
        }
        self.begin_next_part();
        self.follow_override();
        let busy = self.prepare(share) || self.has_ready_command() || self.part_is_due();
        self.hold_without_bus();
        self.publish_changes();
        self.publish_start_conditions();
        self.note_published();
        self.context.shared.publish_variables_simulated();
        debug_assert!(
            self.state.has_run() || self.outputs.ledger.is_empty(),
            "outputs are open without a run"
        );
        busy
    }

    fn next_deadline_s(&self) -> Option<f64> {
        let goes_on_s = self.state.run().and_then(|run| run.at_rest.until_s());
        let retry = self.servo.is_backlogged().then(|| self.context.now_s() + 0.001);
        self.outputs
            .next_deadline_s()
            .into_iter()
            .chain(retry)
            .chain(goes_on_s)
            .chain(self.jog_until_s())
            .chain(self.commands.validation.as_ref().map(|asked| asked.deadline_s))
            .chain(self.parts_again_s())
            .chain(self.lease.until_s())
            .chain(self.inputs.clients.until_s())
            .chain(self.inputs.interlock.next_deadline_s())
            .chain(self.inputs.start_lock.next_deadline_s())
            .chain(self.start_conditions_due_s())
            .min_by(f64::total_cmp)
    }

    fn on_servo_event(&mut self, event: Event) {
        match event {
            Event::Started {
                segment,
                origin,
                base,
                ..
            } => {
                self.follow_changes(segment);
                self.servo.started = Some(base);
                let in_run = segment.saturating_sub(self.state.run().map_or(0, |run| run.first_segment - 1));
                let since_s = self.context.now_s();
                self.context.view.update(|place| {
                    place.executing = origin;
                    place.segment = in_run;
                    place.since_s = since_s;
                });
                if self.pipeline.begins_block(segment) {
                    let block = Happened::Block {
                        program: origin.program,
                        line: origin.line,
                    };
                    self.context.record(block);
                }
            }
            Event::Finished { segment, .. } => {
                self.servo.finished_segment = segment;
                self.pipeline.planner.passed(segment);
                self.drive(RunEvent::Passed { segment });
            }
            Event::Late { cycles } => self.on_servo_late(cycles),
            Event::Spliced { taken } => self.on_spliced(taken),
            Event::Held { at } => {
                self.note_held_at(at);
                self.on_servo_held();
                self.complete(&Awaiting::is_hold);
            }
            Event::Stopped { epoch, position } => self.on_servo_stopped(epoch, position),
            Event::Oriented => self.on_oriented(),
            Event::SpindleReached { id } => self.on_spindle_reached(id),
            Event::Captured {
                position, captured, ..
            } => {
                self.pipeline.path.skipped_to(position);
                self.note_touch(captured);
                self.publish_captured(position, captured);
            }
            Event::Fault(fault) => {
                let alarm = fault.alarm();
                let executing = self.context.view.executing();
                let origin = (self.state.has_run() && executing.line > 0).then_some(executing);
                self.raise(alarm.entry.number, alarm.text, origin);
            }
        }
    }

    /// Applies the changes of modal data that the interpreter noted before the motion reached this segment.
    fn follow_changes(&mut self, segment: u64) {
        let mut speed = self.pipeline.in_force.modal.spindle_speed_r_min;
        while let Some(change) = self.pipeline.changed_before(segment) {
            self.publish_modal(&change.modal);
            let before = std::mem::replace(&mut speed, change.modal.spindle_speed_r_min);
            if speed.to_bits() != before.to_bits() {
                self.follow_spindle_speed(change.after_segment + 1, speed);
            }
            self.context.view.update(|place| {
                place.transform = change.transform;
                place.stack = change.stack;
            });
        }
    }

    /// Applies an event to the state of the run and performs the resulting actions.
    fn drive(&mut self, event: RunEvent<Box<ActiveRun>, RunRemainder>) {
        for action in self.change_state(event) {
            self.execute_action(action);
        }
        self.look_at_outputs();
    }

    fn change_state(
        &mut self,
        event: RunEvent<Box<ActiveRun>, RunRemainder>,
    ) -> Vec<RunAction<Box<ActiveRun>, RunRemainder>> {
        let (state, actions) = std::mem::take(&mut self.state).on(event);
        self.state = state;
        self.state.assert_invariants();
        actions
    }

    fn execute_action(&mut self, action: RunAction<Box<ActiveRun>, RunRemainder>) {
        match action {
            RunAction::HoldServo { in_phase: true } => self.servo.control(Control::HoldInPhase),
            RunAction::HoldServo { in_phase: false } => self.servo.control(Control::Hold),
            RunAction::ResumeServo => self.servo.control(Control::Resume),
            RunAction::GoForward => self.go_forward(),
            RunAction::GoOn => self.resume_held_work(),
            RunAction::BeginBlock => {
                if let Some(run) = self.state.run_mut() {
                    run.steps.in_block = false;
                }
            }
            RunAction::End { why, epoch, run } => self.on_run_end(why, epoch, run),
            RunAction::Ended { why, remainder } => self.on_rest_after_end(why, remainder),
            RunAction::Complete { run, outcome } => self.on_run_completed(*run, outcome),
            RunAction::ReportUnexpected { text, run } => {
                if let Some(run) = run {
                    self.context.shared.store.end_run(self.context.number, &run.id);
                }
                self.context.report_inconsistency(&text);
            }
        }
    }

    /// Ends the run, if a run is active. Returns true if the machine already rests.
    fn end_run(&mut self, why: EarlyEndCause) -> bool {
        let epoch = self.servo.epoch() + 1;
        let remainder = self.remainder_of_run(why);
        self.drive(RunEvent::End {
            why,
            epoch,
            remainder,
        });
        self.state.is_idle()
    }

    /// Stops the servo and cancels the open outputs at once. The state of the run changes when the machine rests.
    fn on_run_end(&mut self, why: EarlyEndCause, epoch: u32, run: Option<Box<ActiveRun>>) {
        self.outputs.cancel_all(self.context.now(), why.cancel_reason());
        self.servo.stop(epoch, why.is_abort());
        // An early end of any run but a jog also ends the modal state from which the next MDI would continue.
        self.past.manual_goes_on &= run.as_ref().is_some_and(|run| run.is_jog());
        self.context.view.update(|place| place.run = None);
        if let Some(run) = run {
            let (outcome, reason) = why.at_rest();
            let executing = self.context.view.executing();
            let has_run = executing.line > 0 && executing.program != 0;
            let end = RunEnd::CutShort {
                outcome,
                reason,
                program: has_run.then_some(executing.program),
                line: has_run.then_some(executing.line),
            };
            self.context.record(Happened::End(end));
            self.past.jogs.remember(&run.kind, self.context.now_s());
            (self.context.shared.store).end_run(self.context.number, &run.id);
        }
        self.end_parts_by(why);
        self.apply_effects();
    }

    fn on_servo_stopped(&mut self, epoch: u32, position: MachinePosition) {
        self.pipeline
            .restart(self.servo.epoch(), position, self.past.manual_goes_on);
        self.servo.finished_segment = self.pipeline.planner.last_segment();
        self.drive(RunEvent::AtRest { epoch });
    }

    /// Completes the end of a run when the machine rests.
    fn on_rest_after_end(&mut self, why: EarlyEndCause, remainder: RunRemainder) {
        if matches!(why, EarlyEndCause::Reset { .. }) {
            self.pipeline.interpreter.reset();
            self.context
                .view
                .update(|place| place.transform = Transform::default());
            self.publish_modal(self.pipeline.interpreter.modal());
        } else if let Some(restores) = remainder.restores {
            self.restore_after_macro(*restores);
        }
        self.publish_carried();
        self.answer_cut_short(remainder.cut_short);
        self.complete(&Awaiting::is_end);
    }

    /// Raises an alarm, which ends the run of this coordinate system and cancels its outputs.
    fn raise(&mut self, number: u16, text: String, origin: Option<tandem_model::Origin>) {
        let record = plc_protocol::types::machine::AlarmRecord {
            number,
            text,
            cs: Some(self.context.number),
            program: origin
                .map(|origin| origin.program)
                .filter(|program| *program != 0),
            line: origin.map(|origin| origin.line),
            column: origin.map(|origin| origin.column),
            ..Default::default()
        };
        let record = self.context.shared.raise(record);
        self.stop_by_alarm(RaisedAlarm::OfThis(Box::new(record)));
    }

    /// Handles an alarm that a sequence program raised. An alarm of the whole machine is already in the list of alarms.
    fn raise_asked(&mut self, raise: &AlarmRaise) -> Result<Answer, Refusal> {
        let alarm = raise.alarm()?;
        if raise.cs.is_some() {
            self.raise(alarm.number, alarm.text, None);
        } else {
            let (number, text) = (alarm.number, alarm.text);
            self.stop_by_alarm(RaisedAlarm::OfAll { number, text });
        }
        Ok(Answer::Done)
    }

    fn stop_by_alarm(&mut self, alarm: RaisedAlarm) {
        self.past.alarm = alarm.display_text();
        self.context.record(Happened::Alarm(alarm));
        self.end_run(EarlyEndCause::Alarm);
    }

    fn handle(&mut self, envelope: Envelope) {
        let Envelope {
            order,
            request,
            not_after,
            reply,
        } = envelope;
        if let Err(refusal) = self.context.shared.check_not_after(not_after.as_ref()) {
            // The caller may have stopped waiting for the reply. The request was not executed.
            let _ = reply.send(Err(refusal));
            return;
        }
        let answer = match request {
            CoordinateSystemRequest::Command { command, meta, wait } => {
                return self.command(DeferredCommand {
                    order,
                    command,
                    meta,
                    wait,
                    reply,
                });
            }
            CoordinateSystemRequest::Output(m, request) => self
                .outputs
                .execute_request(&self.context, m, request)
                .map(Answer::Handshake),
            CoordinateSystemRequest::Lease { request, meta } => self.ask_lease(&request, &meta),
            CoordinateSystemRequest::Heartbeat(id, beat) => {
                self.receive_client_heartbeat(id, beat).map(|()| Answer::Done)
            }
            CoordinateSystemRequest::RaiseAlarm(raise) => self.raise_asked(&raise),
            CoordinateSystemRequest::Input(input) => self.set_input(input).map(|()| Answer::Done),
            CoordinateSystemRequest::Spindle(command) => self
                .command_spindle(command.direction, command.rpm)
                .map(|()| Answer::Done),
            CoordinateSystemRequest::ValidateResult(_, result) => {
                self.on_validate_result(&result);
                Ok(Answer::Done)
            }
            CoordinateSystemRequest::Handler(id, presence) => {
                self.on_handler_online(&id, &presence);
                self.forget_start_conditions();
                Ok(Answer::Done)
            }
            CoordinateSystemRequest::HandlerLeft(id, instance, departure) => {
                self.on_handler_left(&id, instance.as_deref(), departure);
                self.forget_start_conditions();
                Ok(Answer::Done)
            }
            CoordinateSystemRequest::Republish => {
                self.outputs.ledger.republish(self.context.now(), |_| true);
                Ok(Answer::Done)
            }
            CoordinateSystemRequest::SkipInput(motor, value) => {
                self.servo.set_skip_input(motor, value);
                Ok(Answer::Done)
            }
            CoordinateSystemRequest::Tool(id) => {
                self.set_tool(id);
                Ok(Answer::Done)
            }
        };
        self.apply_effects();
        self.publish_changes();
        self.publish_start_conditions();
        // The caller may have stopped waiting for the reply. The request was executed.
        let _ = reply.send(answer);
    }

    fn set_tool(&mut self, id: u16) {
        self.inputs.tool = Some(id);
        self.pipeline.planner.forbid_retrace();
        self.publish_tool();
        if !self.state.is_running() {
            // while a run is active, the next block that starts to move publishes the modal data
            self.publish_modal(self.pipeline.interpreter.modal());
        }
    }

    fn set_input(&mut self, input: Input) -> Result<(), Refusal> {
        match input {
            Input::OptionalSkip(set) => {
                if let Some(number) = set.keys().find(|number| !(1..=31).contains(*number)) {
                    let text = format!("there is no optional skip {number}; write 1 to 31");
                    return Err(Refusal::new(RefusalCode::Invalid, text));
                }
                for (number, on) in set {
                    let bit = 1 << (number - 1);
                    self.inputs.optional_skip &= !bit;
                    self.inputs.optional_skip |= bit * u32::from(on);
                }
                if !self.state.has_run() {
                    self.inputs.take_over_skip(1);
                }
            }
            Input::OptionalStop(on) => self.inputs.optional_stop = on,
            Input::StartLock(set) => {
                let Self { inputs, context, .. } = self;
                inputs
                    .start_lock
                    .set(set, |id, instance| context.shared.check_writer(id, instance))?;
            }
            Input::Override(change) => self.set_overrides(change)?,
            Input::SingleBlock(on) => self.set_single_block(on)?,
            Input::DryRun(on) => self.pipeline.path.set_dry_run(on),
            Input::Interlock(set) => {
                let Self { inputs, context, .. } = self;
                inputs
                    .interlock
                    .set(set, |id, instance| context.shared.check_writer(id, instance))?;
                self.follow_interlock();
            }
        }
        self.publish_inputs();
        Ok(())
    }

    fn set_overrides(&mut self, change: plc_protocol::types::request::OverrideChange) -> Result<(), Refusal> {
        let overrides = &self.inputs.overrides;
        let new = Overrides {
            feed: change.feed.unwrap_or(overrides.feed),
            rapid: change.rapid.unwrap_or(overrides.rapid),
            spindle: change.spindle.unwrap_or(overrides.spindle),
        };
        for (name, value, high) in [
            ("feed", new.feed, 200.0),
            ("rapid", new.rapid, 100.0),
            ("spindle", new.spindle, 200.0),
        ] {
            if !(0.0..=high).contains(&value) {
                let text = format!("{name} override {value}: write 0 to {high} percent");
                return Err(Refusal::new(RefusalCode::Invalid, text));
            }
        }
        self.inputs.overrides = new;
        self.servo.set_override(new.feed / 100.0, new.rapid / 100.0);
        self.send_spindle();
        Ok(())
    }
}
