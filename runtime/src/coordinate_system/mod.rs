//! One CNC coordinate system.
//!
//! It pulls the stages ahead of the motion into the servo's queue (`preparation`), keeps the ledger of outputs and resets
//! (`outputs`), carries out commands one after another (`commands`) and publishes what changed (`publish`). The servo
//! answers by events only; nothing calls back into a stage. One at a time works on it: its task, or who asks (`desk`).

mod bus;
mod commands;
mod desk;
mod holding;
mod jog;
mod lease;
mod manual;
mod outputs;
mod pipeline;
mod preparation;
mod publish;
mod replanning;
mod run;
mod run_state;
mod servo_link;
mod validation;
mod view;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use plc_api::handshake::Ledger;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::machine::AlarmRaise;
use plc_api::types::output::{CancelReason, OutputNotice};
use plc_api::types::request::{Answer, Input, Refusal, RefusalCode, Request};
use plc_api::types::state::{Execution, Lock, Overrides, Reason, SpindleDirection, State};
use plc_api::types::topic::CsTopic;
use tandem_model::flow::Transform;
use tandem_model::{AXES_MAX, MachinePosition, Variables};
use tandem_servo::{ChannelHandle, Control, Event};

use crate::config::CoordinateSystem as Configured;
use crate::journal::{Event as Happened, RaisedAlarm, RunEnd};
use crate::shared::Shared;
use bus::Bus;
use commands::{Awaiting, Deferred};
pub(crate) use desk::Desk;
use desk::Envelope;
use lease::ControlLease;
use outputs::StockWork;
use pipeline::Pipeline;
use preparation::Share;
use replanning::Replanning;
use run::{Kind, Run};
use run_state::{End, RunAction, RunEvent, RunState};
use servo_link::ServoLink;
use validation::{Texts, Validation};
pub(crate) use view::View;

/// How the port reaches a coordinate system.
#[derive(Debug, Clone)]
pub(crate) struct Handle {
    pub number: CoordinateSystemNumber,
    pub desk: Arc<Desk>,
    pub view: Arc<View>,
    pub variables: Variables,
}

/// Its whole state.
pub(crate) struct CoordinateSystem {
    shared: Arc<Shared>,
    number: CoordinateSystemNumber,
    configured: Configured,
    view: Arc<View>,
    servo: ServoLink,
    pipeline: Pipeline,
    replanning: Replanning,
    variables: Variables,
    /// `_CNC_CapturedPosition<n>`: where the motors rested at the end of the last G31 since the start of the runtime,
    /// ascending by motor number, machine coordinates in mm or degrees (D16, D41).
    captured: [f64; AXES_MAX],
    ledger: Ledger,
    /// What each open output said, for alarms and the journal.
    notices: BTreeMap<u64, OutputNotice>,
    program: Option<u16>,
    state: RunState,
    /// The run that the state is of.
    run: Option<Run>,
    runs: u64,
    /// The next manual data input goes on in the modal state of the last one.
    manual_goes_on: bool,
    /// Jogs that have ended, the oldest first.
    ended_jogs: VecDeque<String>,
    inputs: InputValues,
    stock: Vec<StockWork>,
    deferred: VecDeque<Deferred>,
    /// Programs as they were when the main program was loaded, by their numbers.
    loaded: Texts,
    /// Order of the last stop or abort.
    stopped_at: u64,
    awaiting: Vec<Awaiting>,
    last_command_id: Option<String>,
    /// Of the run started last.
    run_id: Option<String>,
    /// What all others see.
    published: Option<State>,
    /// A load whose parameters are being checked by handlers.
    validation: Option<Validation>,
    validations: u64,
    lease: ControlLease,
    bus: Bus,
}

#[derive(Debug, Default)]
struct InputValues {
    optional_skip: u32,
    /// What the interpreter has read last, and the first line read with it.
    effective_skip: u32,
    effective_from_line: u32,
    optional_stop: bool,
    single_block: bool,
    interlock: Lock,
    start_lock: Lock,
    overrides: Overrides,
    spindle: (SpindleDirection, f64),
    /// It turns by M03 or M04 of the stock sequence program: a change of S from this segment on is newer than that.
    spindle_at_s_from: Option<u64>,
    tool: u16,
}

impl InputValues {
    /// The interpreter reads the optional skip inputs from this line on.
    fn take_over_skip(&mut self, line: u32) {
        self.effective_skip = self.optional_skip;
        self.effective_from_line = line;
    }
}

impl CoordinateSystem {
    pub fn new(
        shared: Arc<Shared>,
        configured: Configured,
        handle: ChannelHandle,
        first_state: (Execution, Option<Reason>),
        tool: u16,
    ) -> Self {
        let number = configured.settings.number;
        let at = handle.readings.read().commanded;
        let view = Arc::new(View::new(&configured.settings, Arc::clone(&handle.readings)));
        Self {
            number,
            view,
            servo: ServoLink::new(handle),
            pipeline: Pipeline::new(&configured.settings, configured.dialect, at),
            replanning: Replanning::default(),
            variables: shared.tables.variables(number),
            captured: [0.0; AXES_MAX],
            ledger: Ledger::new(shared.boot_id.clone(), configured.open_outputs_max),
            notices: BTreeMap::new(),
            program: None,
            state: RunState::Idle(first_state),
            run: None,
            runs: 0,
            manual_goes_on: false,
            ended_jogs: VecDeque::new(),
            inputs: InputValues {
                tool,
                ..InputValues::default()
            },
            stock: Vec::new(),
            deferred: VecDeque::new(),
            loaded: Texts::new(),
            stopped_at: 0,
            awaiting: Vec::new(),
            last_command_id: None,
            run_id: None,
            published: None,
            validation: None,
            validations: 0,
            lease: ControlLease::new(number, shared.now()),
            bus: Bus::default(),
            shared,
            configured,
        }
    }

    pub fn variables(&self) -> Variables {
        self.variables.clone()
    }

    pub fn view(&self) -> Arc<View> {
        Arc::clone(&self.view)
    }

    /// The runtime closes.
    fn end(mut self) {
        self.ledger.cancel_all(self.shared.now(), CancelReason::Shutdown);
        self.carry_out_effects();
    }

    /// One turn: what the servo reported, what is due, what can be prepared. True when there is more to prepare.
    fn turn(&mut self, share: Share) -> bool {
        while let Some(event) = self.servo.next_event() {
            self.servo_event(event);
        }
        let now = self.shared.now();
        self.ledger.expire(now);
        self.expire_jog(now.monotonic_s);
        self.expire_lease(now.monotonic_s);
        self.do_stock_work(now);
        self.look_at_bus(now);
        self.carry_out_effects();
        self.expire_validation(now.monotonic_s);
        if share.commands {
            self.carry_out_deferred();
        }
        self.follow_override();
        let busy = self.prepare(share) || self.may_go_on_with_commands();
        self.hold_without_bus();
        self.publish_changes();
        busy
    }

    fn next_deadline_s(&self) -> Option<f64> {
        let stock = self.stock.iter().filter_map(|work| work.due_s);
        let at_rest = self.run.as_ref().map(|run| &run.at_rest);
        let goes_on_s = at_rest.and_then(|at_rest| at_rest.until_s(&self.shared.clock));
        let retry = self
            .servo
            .is_backlogged()
            .then(|| self.shared.clock.now_s() + 0.001);
        self.ledger
            .next_deadline_s()
            .into_iter()
            .chain(stock)
            .chain(retry)
            .chain(goes_on_s)
            .chain(self.jog_until_s())
            .chain(self.validation_deadline_s())
            .chain(self.lease.until_s())
            .min_by(f64::total_cmp)
    }

    fn servo_event(&mut self, event: Event) {
        match event {
            Event::Started { segment, origin, .. } => {
                self.follow_changes(segment);
                self.view.update(|place| place.executing = origin);
                if self.pipeline.begins_block(segment) {
                    let block = Happened::Block {
                        program: origin.program,
                        line: origin.line,
                    };
                    self.shared.record(self.number, block);
                }
            }
            Event::Finished { segment, .. } => {
                self.servo.finished_segment = segment;
                self.pipeline.passed(segment);
                self.drive(RunEvent::Passed { segment });
            }
            Event::Spliced { taken } => self.spliced(taken),
            Event::Held { at } => {
                self.note_held_at(at);
                self.on_servo_held();
                self.complete(&Awaiting::is_hold);
            }
            Event::Stopped { epoch, position } => self.on_servo_stopped(epoch, position),
            Event::Oriented => self.stock_oriented(),
            Event::Captured {
                position, captured, ..
            } => {
                self.pipeline.skipped_to(position);
                self.publish_captured(position, captured);
            }
            Event::Fault(fault) => {
                let alarm = fault.alarm();
                let executing = self.view.executing();
                let origin = (self.run.is_some() && executing.line > 0).then_some(executing);
                self.raise(alarm.entry.number, alarm.text, origin);
            }
        }
    }

    /// What was in force ahead of the motion is in force now.
    fn follow_changes(&mut self, segment: u64) {
        let mut speed = self.pipeline.in_force().spindle_speed_r_min;
        while let Some(change) = self.pipeline.changed_before(segment) {
            self.publish_modal(&change.modal);
            let before = std::mem::replace(&mut speed, change.modal.spindle_speed_r_min);
            if speed.to_bits() != before.to_bits() {
                self.follow_spindle_speed(change.after_segment + 1, speed);
            }
            self.view.update(|place| {
                place.transform = change.transform;
                place.stack = change.stack;
            });
        }
    }

    /// An event changes the state of the run, and what follows from that is done.
    fn drive(&mut self, event: RunEvent) {
        for action in self.change_state(event) {
            self.act(action);
        }
        self.look_at_outputs();
    }

    fn change_state(&mut self, event: RunEvent) -> Vec<RunAction> {
        let (state, actions) = std::mem::take(&mut self.state).on(event);
        self.state = state;
        actions
    }

    fn act(&mut self, action: RunAction) {
        match action {
            RunAction::HoldServo => self.servo.control(Control::Hold),
            RunAction::ResumeServo => self.servo.control(Control::Resume),
            RunAction::GoForward => self.go_forward(),
            RunAction::GoOn => self.go_on(),
            RunAction::BeginBlock => {
                if let Some(run) = &mut self.run {
                    run.steps.in_block = false;
                }
            }
            RunAction::End { why, epoch } => self.on_run_end(why, epoch),
            RunAction::Ended(why) => self.on_rest_after_end(why),
        }
    }

    /// Ends the run, if there is one. True when there is nothing to wait for.
    fn end_run(&mut self, why: End) -> bool {
        let epoch = self.servo.epoch() + 1;
        self.drive(RunEvent::End { why, epoch });
        self.state.is_idle()
    }

    /// Outputs are cancelled at once, the state follows when the machine rests.
    fn on_run_end(&mut self, why: End, epoch: u32) {
        self.ledger.cancel_all(self.shared.now(), why.cancel_reason());
        self.stock.clear();
        self.servo.stop(epoch, why.is_abort());
        // A jog changes nothing but the position.
        self.manual_goes_on &= self
            .run
            .as_ref()
            .is_some_and(|run| matches!(run.kind, Kind::Jog(_)));
        if let Some(run) = self.run.take() {
            let (outcome, reason) = why.into();
            let end = RunEnd::CutShort { outcome, reason };
            self.shared.record(self.number, Happened::End(end));
            self.remember_jog(&run);
            self.run_given_up(&run, why.into());
        }
        self.carry_out_effects();
    }

    fn on_servo_stopped(&mut self, epoch: u32, position: MachinePosition) {
        self.pipeline
            .restart(self.servo.epoch(), position, self.manual_goes_on);
        self.servo.finished_segment = self.pipeline.last_segment();
        self.drive(RunEvent::AtRest { epoch });
    }

    /// The machine rests after a run was ended.
    fn on_rest_after_end(&mut self, why: End) {
        if matches!(why, End::Reset { .. }) {
            self.pipeline.interpreter.reset();
            self.view.update(|place| place.transform = Transform::default());
            self.publish_modal(self.pipeline.interpreter.modal());
        }
        self.complete(&|awaiting| awaiting.is_end() || awaiting.is_of_run());
    }

    /// Raises an alarm: it stops this coordinate system and cancels its outputs.
    fn raise(&mut self, number: u16, text: String, origin: Option<tandem_model::Origin>) {
        let record = plc_api::types::machine::AlarmRecord {
            number,
            text,
            cs: Some(self.number),
            program: origin
                .map(|origin| origin.program)
                .filter(|program| *program != 0),
            line: origin.map(|origin| origin.line),
            column: origin.map(|origin| origin.column),
            ..Default::default()
        };
        let record = self.shared.raise(record);
        self.stop_by_alarm(RaisedAlarm::OfThis(Box::new(record)));
    }

    /// A sequence program raises an alarm; one of all is raised already.
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
        self.shared.record(self.number, Happened::Alarm(alarm));
        self.end_run(End::Alarm);
    }

    fn handle(&mut self, envelope: Envelope) {
        let Envelope {
            order,
            request,
            reply,
        } = envelope;
        if let Request::Command {
            command, meta, wait, ..
        } = request
        {
            return self.command(Deferred {
                order,
                command,
                meta,
                wait,
                reply,
            });
        }
        let answer = self.carry_out_request(request);
        self.carry_out_effects();
        self.publish_changes();
        // The asker may have gone; what was asked for is done all the same.
        let _ = reply.send(answer);
    }

    /// Carries out what is no command.
    fn carry_out_request(&mut self, request: Request) -> Result<Answer, Refusal> {
        let now = self.shared.now();
        match request {
            Request::Lease { request, meta, .. } => self.ask_lease(&request, &meta),
            Request::Claim(_, m, claim) => Ok(Answer::Handshake(self.claim(m, &claim))),
            Request::Reset(_, m, reset) => Ok(Answer::Handshake(self.reset_output(m, &reset))),
            Request::Progress(_, m, report) => {
                let status = self.ledger.progress(now, m, &report);
                Ok(outputs::handshake_answer(report.seq, &report.handler_id, status))
            }
            Request::Ask(_, m, ask) => self.ask(m, &ask),
            Request::AnswerQuestion(_, m, answer) => Ok(self.answer_question(m, &answer)),
            Request::ValidateResult(_, _, result) => {
                self.validated(&result);
                Ok(Answer::Done)
            }
            Request::Redeliver(_, m, redeliver) => {
                let status = self.ledger.redeliver(now, m, &redeliver);
                Ok(outputs::handshake_answer(redeliver.seq, "", status))
            }
            Request::Handler(id, presence) => {
                self.handler_changed(&id, &presence);
                Ok(Answer::Done)
            }
            Request::RaiseAlarm(raise) => self.raise_asked(&raise),
            Request::Input(_, input) => self.set_input(input).map(|()| Answer::Done),
            Request::Spindle(_, command) => self
                .command_spindle(command.direction, command.rpm)
                .map(|()| Answer::Done),
            Request::SkipInput(motor, value) => {
                self.servo.set_skip_input(motor, value);
                Ok(Answer::Done)
            }
            Request::Tool(_, id) => {
                self.inputs.tool = id;
                self.pipeline.bar_way_back();
                self.publish_tool();
                Ok(Answer::Done)
            }
            _ => Err(Refusal::new(
                RefusalCode::NotSupported,
                "not a request to a coordinate system",
            )),
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
                    self.inputs.optional_skip = if on {
                        self.inputs.optional_skip | bit
                    } else {
                        self.inputs.optional_skip & !bit
                    };
                }
                if self.run.is_none() {
                    self.inputs.take_over_skip(1);
                }
            }
            Input::OptionalStop(on) => self.inputs.optional_stop = on,
            Input::StartLock(lock) => self.inputs.start_lock = lock,
            Input::Override(change) => self.set_overrides(change)?,
            Input::SingleBlock(on) => self.set_single_block(on)?,
            Input::DryRun(on) => self.pipeline.set_dry_run(on),
            Input::Interlock(lock) => self.set_interlock(lock),
        }
        self.publish_inputs();
        Ok(())
    }

    fn set_overrides(&mut self, change: plc_api::types::request::OverrideChange) -> Result<(), Refusal> {
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

    fn topic(&self, topic: CsTopic) -> plc_api::types::topic::Topic {
        plc_api::types::topic::Topic::cs(self.number, topic)
    }
}
