//! Recovery of a coordinate system after an internal fault: a panic in its turn, or in a request to it.
//!
//! The servo is stopped first, because no other part is reliable: motion stops on its path. Then the stages are
//! replaced, outputs are cancelled, and an alarm stays active until a reset. A second fault before that reset, or a
//! fault in the recovery, leaves the coordinate system stopped: it executes no turns. Hold, stop and abort still brake
//! the motion, values from outside are still accepted, and a reset recovers again. All other requests are refused.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use plc_protocol::types::command::{Command, CommandStatus, Verb};
use plc_protocol::types::machine::AlarmRecord;
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::{CancelReason, Pending};
use plc_protocol::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use plc_protocol::types::state::{Execution, Reason, State};
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_model::alarm::{FAULT_LASTS, RUNTIME_FAULT, SERVO_FAILED};
use tandem_servo::Event as ServoEvent;
use tandem_store::journal::{Event, RaisedAlarm, RunEnd};

use super::CoordinateSystem;
use super::commands::pending_commands::{Awaiting, CommandFailure};
use super::mailbox::Envelope;
use super::publish::published_values::PublishedValues;
use super::run::causes::EarlyEndCause;
use super::run::replanning::Replanning;

impl CoordinateSystem {
    /// Stops the motion: on its path, or with `abort` by the shortest path. Uses only the servo link.
    pub(crate) fn brake_at_once(&mut self, abort: bool) {
        self.servo.stop_at_once(abort);
    }

    /// Rebuilds the coordinate system in the state after an alarm, so that a reset clears the fault. Commands, inputs,
    /// the control lease and the numbers of outputs are kept; levels that sequence programs set stay valid.
    pub(crate) fn recover(&mut self, why: &str) {
        self.renew_stages();
        let origin = Some(self.context.view.executing()).filter(|at| self.state.has_run() && at.line > 0);
        let text = format!(
            "{}: {why}. Motion stopped on its path and outputs were cancelled; other coordinate systems continue. Check the \
             machine, then reset",
            RUNTIME_FAULT.title
        );
        self.raise(RUNTIME_FAULT.number, text.clone(), origin);
        let is_stuck = |awaiting: &Awaiting| !awaiting.is_end();
        let failure = CommandFailure {
            code: "alarm",
            text,
            moved: BTreeMap::new(),
        };
        self.commands.answer(&self.context, &is_stuck, Some(&failure));
        self.publish_all();
    }

    fn renew_stages(&mut self) {
        let configured = &self.context.configured;
        let at = self.servo.commanded();
        self.pipeline.renew(&configured.settings, configured.dialect, at);
        self.replanning = Replanning::default();
        let captured = self.published.captured;
        self.published = PublishedValues::default();
        self.published.captured = captured;
    }

    /// Returns true if a reset has cleared the alarms of [`CoordinateSystem::recover`] and
    /// [`CoordinateSystem::give_up`].
    pub(crate) fn has_recovered(&self) -> bool {
        let is_active = |number| {
            let shared = &self.context.shared;
            shared.is_alarm_active(number, self.context.number)
        };
        !is_active(RUNTIME_FAULT.number) && !is_active(FAULT_LASTS.number)
    }

    /// Rebuilds a coordinate system that stays stopped, so that a reset can be executed. The reset itself stops the
    /// servo, clears the alarms and sets the state. Panics if the fault persists.
    pub(crate) fn recover_for_reset(&mut self) {
        self.state.give_up();
        self.renew_stages();
        self.outputs.cancel_all(self.context.now(), CancelReason::Alarm);
        self.apply_effects();
    }

    /// Leaves the coordinate system stopped until [`CoordinateSystem::recover_for_reset`]. If a step fails, the next
    /// steps are still executed.
    pub(crate) fn give_up(&mut self, why: &str) {
        let text = format!(
            "{}: {why}. Motion stopped and outputs were cancelled; hold, stop and abort still answer. Make the machine safe, \
             then reset; if this alarm returns, restart the runtime",
            FAULT_LASTS.title
        );
        let steps: [&mut dyn FnMut(&mut Self); 9] = [
            &mut |system| {
                let (shared, number) = (&system.context.shared, system.context.number);
                if !shared.is_alarm_active(FAULT_LASTS.number, number) {
                    shared.raise(system.lasting_alarm(text.clone()));
                }
            },
            &mut |system| {
                let alarm = RaisedAlarm::OfThis(Box::new(system.lasting_alarm(text.clone())));
                system.context.record(Event::Alarm(alarm));
            },
            &mut |system| {
                let context = &system.context;
                context.shared.store.end_run_of(context.number);
            },
            &mut |system| {
                let end = RunEnd::CutShort {
                    outcome: Execution::Stopped,
                    reason: Some(Reason::Alarm),
                    program: None,
                    line: None,
                };
                if system.state.give_up() {
                    system.context.record(Event::End(end));
                }
            },
            &mut |system| {
                system
                    .outputs
                    .cancel_all(system.context.now(), CancelReason::Alarm);
                system.end_parts_by(EarlyEndCause::Alarm);
                system.apply_effects();
            },
            &mut |system| {
                let refusal = system.refusal();
                system.commands.refuse_waiting(&system.context, &refusal);
            },
            &mut |system| {
                let refusal = system.refusal();
                system.commands.refuse_validation(&system.context, refusal);
            },
            &mut |system| {
                let failure = CommandFailure {
                    code: "alarm",
                    text: text.clone(),
                    moved: BTreeMap::new(),
                };
                system.commands.answer(&system.context, &|_| true, Some(&failure));
            },
            &mut Self::publish_given_up,
        ];
        for step in steps {
            // a failing step is skipped; the servo is already stopped and the alarm is active
            let _ = catch_unwind(AssertUnwindSafe(|| step(self)));
        }
    }

    fn lasting_alarm(&self, text: String) -> AlarmRecord {
        AlarmRecord {
            number: FAULT_LASTS.number,
            text,
            cs: Some(self.context.number),
            ..AlarmRecord::default()
        }
    }

    fn publish_given_up(&mut self) {
        let shared = &self.context.shared;
        let last = shared.hub.read(&Topic::cs(self.context.number, CsTopic::State));
        let Some(Payload::State(last)) = last.as_ref().map(|message| &message.payload) else {
            return;
        };
        let state = State {
            execution: Execution::Stopped,
            reason: Some(Reason::Alarm),
            transition: None,
            wait_state: None,
            waiting_on: None,
            run_kind: None,
            alarm_count: self.context.alarm_count(),
            ..last.clone()
        };
        self.context.publish(CsTopic::State, Payload::State(state));
        self.context
            .publish(CsTopic::Pending, Payload::Pending(Pending::default()));
    }

    /// Answers a request to a coordinate system that stays stopped. Hold, stop and abort brake the motion, and values
    /// from outside, such as an interlock and the loss of its handler, are accepted. Requests that also go to other
    /// coordinate systems are accepted without an effect here, and all others are refused.
    pub(crate) fn answer_given_up(&mut self, envelope: Envelope) {
        if envelope.sets_value() {
            return self.handle(envelope);
        }
        let answer = match &envelope.request {
            CoordinateSystemRequest::Command { command, meta, .. } if command.is_urgent() => {
                self.brake_at_once(command.verb() == Verb::Abort);
                let (cs, shared) = (Some(self.context.number), &self.context.shared);
                let done = shared.reply_to(cs, meta, CommandStatus::Done, "ok", "");
                Ok(Answer::Command(shared.reply(meta, done)))
            }
            CoordinateSystemRequest::Command {
                command: Command::JogEnd { .. },
                ..
            }
            | CoordinateSystemRequest::Republish
            | CoordinateSystemRequest::ValidateResult(..) => Ok(Answer::Done),
            CoordinateSystemRequest::RaiseAlarm(raise) => raise.alarm().map(|alarm| {
                if raise.cs.is_some() {
                    self.raise_given_up(alarm.number, alarm.text);
                }
                Answer::Done
            }),
            CoordinateSystemRequest::Command { meta, .. } => Err(self.context.reject(meta, self.refusal())),
            _ => Err(self.refusal()),
        };
        // The caller may have stopped waiting for the reply.
        let _ = envelope.reply.send(answer);
    }

    fn refusal(&self) -> Refusal {
        let text = format!(
            "coordinate system {} stays stopped after an internal fault (alarm {}); make the machine safe, then reset it. If \
             the alarm returns, restart the runtime",
            self.context.number, FAULT_LASTS.number
        );
        Refusal::new(RefusalCode::Unavailable, text)
    }

    /// If the servo has failed, ends the run and answers every request that waits for the machine to rest. Reason: no
    /// further servo event will arrive.
    pub(crate) fn follow_servo_failure(&mut self) {
        let Some(why) = self.context.shared.servo.failure().map(str::to_owned) else {
            return;
        };
        if self.servo.fail() {
            let number = SERVO_FAILED.number;
            self.stop_by_alarm(RaisedAlarm::OfAll { number, text: why });
        }
        if self.state.is_ending() {
            self.on_servo_stopped(self.servo.epoch(), self.servo.commanded());
        }
    }

    /// Refuses a reset after a failure of the servo.
    pub(crate) fn check_servo(&self) -> Result<(), Refusal> {
        if self.context.shared.servo.failure().is_none() {
            return Ok(());
        }
        let text = format!(
            "the servo has failed and the drives are off (alarm {}); make the machine safe and restart the runtime",
            SERVO_FAILED.number
        );
        Err(Refusal::new(RefusalCode::Unavailable, text))
    }

    /// Processes the servo's events that a stopped coordinate system needs, which are drive faults and the answers to
    /// new plans, and sends delayed controls to the servo. Returns true if some controls must still wait.
    pub(crate) fn follow_servo_given_up(&mut self) -> bool {
        while let Some(event) = self.servo.next_event() {
            match event {
                ServoEvent::Spliced { taken } => self.servo.on_spliced(taken),
                ServoEvent::Fault(fault) => {
                    let alarm = fault.alarm();
                    self.raise_given_up(alarm.entry.number, alarm.text);
                }
                _ => {}
            }
        }
        self.servo.is_backlogged()
    }

    /// Raises an alarm without ending a run, because a coordinate system that stays stopped has none.
    fn raise_given_up(&self, number: u16, text: String) {
        let alarm = AlarmRecord {
            number,
            text,
            cs: Some(self.context.number),
            ..AlarmRecord::default()
        };
        self.context.shared.raise(alarm);
    }
}
