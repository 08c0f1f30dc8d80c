//! Commands: judged and carried out one after another; hold, stop and abort wait for nothing.

use std::sync::Arc;

use plc_api::types::command::{Command, CommandMeta, CommandStatus, Verb};
use plc_api::types::request::{Answer, Refusal, RefusalCode};
use plc_api::types::state::{Execution, Reason};
use tandem_servo::Control;

use super::CoordinateSystem;
use super::pending_commands::{Awaiting, Deferred, reject};
use super::run::{Kind, Run};
use super::run_state::{Cause, End, Phase, RunEvent};
use crate::journal::Event;
use plc_api::execution::{Situation, word};

impl CoordinateSystem {
    pub(super) fn command(&mut self, command: Deferred) {
        let verb = command.command.verb();
        if verb.is_urgent() {
            if matches!(verb, Verb::Stop | Verb::Abort) {
                self.commands.note_stop(command.order);
            }
            self.carry_out_command(command);
        } else if let Err(command) = self.commands.defer(command) {
            let refusal = Refusal::new(RefusalCode::Unavailable, "too many commands wait; try again");
            reject(&self.context, &command.meta, refusal, command.reply);
        } else {
            self.carry_out_deferred();
        }
        self.publish_changes();
    }

    /// Each command is judged against the state that those before it have left.
    pub(super) fn carry_out_deferred(&mut self) {
        while !self.is_in_transition() {
            let Some(command) = self.commands.next() else {
                return;
            };
            self.carry_out_command(command);
        }
    }

    /// True when a command waits, and no longer for a transition.
    pub(super) fn may_go_on_with_commands(&self) -> bool {
        !self.commands.is_empty() && !self.is_in_transition()
    }

    fn is_in_transition(&self) -> bool {
        self.state.transition().is_some() || self.validations.is_pending()
    }

    fn carry_out_command(&mut self, command: Deferred) {
        // The same command may have come twice before the first was carried out; hold, stop and abort may act twice.
        let said = self.context.shared.replied(&command.meta.command_id);
        if let Some(said) = said.filter(|_| !command.command.verb().is_urgent()) {
            if command.wait && self.commands.awaits(&command.meta.command_id) {
                // sent twice, and both senders wait until it is done
                self.commands.await_effect(Awaiting {
                    verb: command.command.verb(),
                    meta: command.meta,
                    note: said.text.clone(),
                    reply: Some(command.reply),
                });
                return;
            }
            let _ = command.reply.send(Ok(Answer::Command(said)));
            return;
        }
        if let Some(command) = self.validate_first(command) {
            self.accept_command(command, &[]);
        }
    }

    /// Judges a command, and carries it out if nothing speaks against it. `notes` are worth knowing and refuse nothing.
    pub(super) fn accept_command(&mut self, command: Deferred, notes: &[String]) {
        let Deferred {
            order,
            command,
            meta,
            wait,
            reply,
        } = command;
        let verb = command.verb();
        if self.judge_lease(verb, &meta).is_ok() && self.refresh_jog(&command) {
            let done = self.context.reply(&meta, CommandStatus::Done, "ok", "");
            let _ = reply.send(Ok(Answer::Command(done)));
            return;
        }
        let judged = self
            .commands
            .judge_order(verb, order)
            .and_then(|()| self.judge(verb, &meta))
            .and_then(|()| self.prepare_command(&command));
        let (text, start) = match judged {
            Ok(prepared) => prepared,
            Err(refusal) => {
                let refusal = self.in_situation(refusal, &meta);
                return reject(&self.context, &meta, refusal, reply);
            }
        };
        let text = notes.iter().fold(text, |text, note| join(&text, note));
        self.commands.last_id = Some(meta.command_id.clone());
        let event = Event::Command {
            verb,
            command_id: meta.command_id.clone(),
            client_id: meta.client_id.clone(),
        };
        self.context.record(event);
        let accepted = self.context.reply(&meta, CommandStatus::Accepted, "ok", &text);
        let mut reply = Some(reply);
        if !wait && let Some(reply) = reply.take() {
            // The asker may have gone; the command is carried out all the same.
            let _ = reply.send(Ok(Answer::Command(accepted)));
        }
        self.commands.await_effect(Awaiting {
            meta,
            verb,
            note: text,
            reply,
        });
        if self.take_effect(&command, start) {
            self.complete(&|awaiting| awaiting.verb == verb);
        }
    }

    pub(super) fn judge(&self, verb: Verb, meta: &CommandMeta) -> Result<(), Refusal> {
        let failed = |text: String| Err(Refusal::new(RefusalCode::PreconditionFailed, text));
        if let Some(expect) = &meta.expect {
            if expect
                .boot_id
                .as_ref()
                .is_some_and(|boot_id| *boot_id != self.context.shared.boot_id)
            {
                return failed("the runtime was started again since; read its state".into());
            }
            let rev = self.context.state_rev();
            if expect.state_rev.is_some_and(|expected| expected != rev) {
                return failed(format!("the state has changed since; its rev is {rev} now"));
            }
        }
        self.judge_lease(verb, meta)?;
        self.situation().judge(verb)?;
        self.judge_locks(verb)
    }

    /// Refuses what the interlock or the start lock prevents.
    fn judge_locks(&self, verb: Verb) -> Result<(), Refusal> {
        if verb.moves() {
            self.judge_interlock()?;
        }
        if matches!(verb, Verb::Start | Verb::Mdi) && self.inputs.start_lock.value {
            let why = &self.inputs.start_lock.text;
            return Err(Refusal::new(
                RefusalCode::StartLocked,
                format!("the start lock is on: {why}"),
            ));
        }
        Ok(())
    }

    /// A refusal that comes from how things stand says how, and what would not be refused now.
    fn in_situation(&self, refusal: Refusal, meta: &CommandMeta) -> Refusal {
        if !refusal.code.is_of_state() {
            return refusal;
        }
        let situation = self.situation();
        let mut allowed = situation.allowed();
        allowed.retain(|verb| {
            self.judge_locks(*verb)
                .and_then(|()| self.judge_lease(*verb, meta))
                .is_ok()
                && (*verb != Verb::BackTrace || self.judge_back_trace(!self.state.retraces()).is_ok())
        });
        Refusal {
            state: Some(situation.execution),
            allowed,
            ..refusal
        }
    }

    pub(super) fn situation(&self) -> Situation {
        Situation {
            execution: self.state.word_at_rest().0,
            program_loaded: self.commands.program.is_some(),
            alarm_active: self.context.alarm_count() > 0,
        }
    }

    /// What can still refuse a command, and what it needs: nothing has changed when it does.
    fn prepare_command(&self, command: &Command) -> Result<(String, Option<Run>), Refusal> {
        match command {
            Command::Load { program } => {
                Ok((self.context.check_called(&self.context.stored(*program)?)?, None))
            }
            Command::Start => {
                let main = self.context.stored(self.commands.program.unwrap_or_default())?;
                self.context.check_called(&main)?;
                Ok((String::new(), Some(self.new_run(Kind::Program, main))))
            }
            Command::BackTrace { on } => self.judge_back_trace(*on).map(|()| (String::new(), None)),
            Command::Mdi { text } => self.prepare_manual(text).map(with_run),
            Command::Home { axes } => self.prepare_home(axes).map(with_run),
            Command::Jog {
                axis,
                velocity,
                distance,
                refresh_id,
            } => self
                .prepare_jog(*axis, *velocity, *distance, refresh_id)
                .map(with_run),
            _ => Ok((String::new(), None)),
        }
    }

    /// Carries a command out. True when its effect is reached at once.
    fn take_effect(&mut self, command: &Command, start: Option<Run>) -> bool {
        match command {
            Command::Load { program } => {
                self.commands.program = Some(*program);
                self.commands.texts = self.context.texts_of(*program);
                self.drive(RunEvent::Loaded);
                self.go_to_head();
                true
            }
            Command::Start => {
                if let Some(run) = start {
                    self.commands.texts = self.context.texts_of(run.main.number);
                    self.start(run);
                }
                true
            }
            Command::Mdi { .. } | Command::Home { .. } | Command::Jog { .. } => {
                if let Some(run) = start {
                    self.start(run);
                }
                false
            }
            Command::Hold => self.hold(Cause::Operator),
            Command::Resume | Command::BackTrace { on: false } => {
                self.drive(RunEvent::Resume);
                self.context.record(Event::Resume);
                true
            }
            Command::BackTrace { on: true } => {
                self.go_back();
                true
            }
            Command::Stop => self.end_run(End::Stop),
            Command::Abort => self.end_run(End::Abort),
            Command::Reset => {
                self.servo.control(Control::ResetDrives);
                self.context.shared.clear_alarms(self.context.number);
                let has_program = self.commands.program.is_some();
                let is_done = self.end_run(End::Reset { has_program });
                self.go_to_head();
                is_done
            }
            Command::AlarmAcknowledge { .. } => true,
        }
    }

    /// The program loaded is at its head.
    fn go_to_head(&self) {
        self.context.view.at_head(self.commands.program);
        self.publish_place();
    }

    fn start(&mut self, run: Run) {
        let number = run.main.number;
        let mut phase = Phase::Interpret;
        if let Kind::Jog(jog) = &run.kind {
            phase = self.start_jog(jog);
        } else {
            let goes_on = matches!(run.kind, Kind::Manual) && self.past.manual_goes_on;
            let tree = Arc::clone(&run.main.tree);
            self.pipeline.start(tree, number, self.servo.epoch(), goes_on);
            self.past.manual_goes_on = false;
        }
        self.past.count += 1;
        self.past.last_id = Some(run.id.clone());
        let manual = (number == 0).then(|| Arc::clone(&run.main));
        self.context.view.update(|place| place.manual = manual);
        let event = Event::Start {
            program: number,
            run_id: run.id.clone(),
        };
        self.context.record(event);
        self.inputs.take_over_skip(1);
        self.publish_inputs();
        self.run = Some(run);
        self.drive(RunEvent::Started(phase));
    }

    /// Tells those commands whose effect has been reached.
    pub(super) fn complete(&mut self, is_done: &dyn Fn(&Awaiting) -> bool) {
        self.publish_changes();
        self.commands
            .answer(&self.context, is_done, CommandStatus::Done, "ok", "");
    }

    /// Tells those who began a run by hand that it was ended before its end; of a jog that is what they wait for.
    pub(super) fn run_given_up(&mut self, run: &Run, into: (Execution, Option<Reason>)) {
        if matches!(run.kind, Kind::Jog(_)) && into.0 == Execution::Ready {
            return;
        }
        let reason = into.1.map(|reason| word(&reason)).unwrap_or_default();
        let text = format!("it was ended before its end: {} {reason}", word(&into.0));
        self.commands.answer(
            &self.context,
            &Awaiting::is_of_run,
            CommandStatus::Failed,
            &reason.to_lowercase(),
            &text,
        );
    }
}

fn with_run((text, run): (String, Run)) -> (String, Option<Run>) {
    (text, Some(run))
}

fn join(text: &str, note: &str) -> String {
    let mark = if text.is_empty() { "" } else { "; " };
    format!("{text}{mark}{note}")
}
