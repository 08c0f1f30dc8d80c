//! Commands: judged and carried out one after another; hold, stop and abort wait for nothing.

use std::collections::BTreeSet;
use std::sync::Arc;

use plc_api::types::command::{Command, CommandMeta, CommandReply, CommandStatus, Verb};
use plc_api::types::program::ProgramDiagnostic;
use plc_api::types::request::{Answer, Refusal, RefusalCode};
use plc_api::types::state::{Execution, Reason};
use plc_api::types::topic::CsTopic;
use tokio::sync::oneshot;

use super::CoordinateSystem;
use super::run::{Kind, Run};
use super::run_state::{Cause, End, Phase, RunEvent};
use crate::journal::Event;
use crate::program_store::StoredProgram;
use plc_api::execution::{Situation, word};

/// Commands that wait for a transition to end. A further one is refused.
const DEFERRED_MAX: usize = 256;

type Reply = oneshot::Sender<Result<Answer, Refusal>>;

/// A command that is to be judged.
pub(super) struct Deferred {
    /// When it came, among all that is asked of this coordinate system.
    pub order: u64,
    pub command: Command,
    pub meta: CommandMeta,
    pub wait: bool,
    pub reply: Reply,
}

/// A command that was accepted and whose effect is still to come.
pub(super) struct Awaiting {
    meta: CommandMeta,
    verb: Verb,
    /// What was worth knowing when it was accepted.
    note: String,
    reply: Option<Reply>,
}

impl Awaiting {
    /// Done when the machine rests under feed hold.
    pub fn is_hold(&self) -> bool {
        self.verb == Verb::Hold
    }

    /// Done when a run has been ended and the machine rests. A hold that an end overtook is done then, too.
    pub fn is_end(&self) -> bool {
        matches!(self.verb, Verb::Hold | Verb::Stop | Verb::Abort | Verb::Reset)
    }

    /// Done when the run that it began has ended by itself.
    pub fn is_of_run(&self) -> bool {
        matches!(self.verb, Verb::Mdi | Verb::Home | Verb::Jog)
    }
}

impl CoordinateSystem {
    pub(super) fn command(&mut self, command: Deferred) {
        let verb = command.command.verb();
        if verb.is_urgent() {
            if matches!(verb, Verb::Stop | Verb::Abort) {
                self.stopped_at = command.order;
            }
            self.carry_out_command(command);
        } else if self.deferred.len() >= DEFERRED_MAX {
            let refusal = Refusal::new(RefusalCode::Unavailable, "too many commands wait; try again");
            self.reject(&command.meta, refusal, command.reply);
        } else {
            self.deferred.push_back(command);
            self.carry_out_deferred();
        }
        self.publish_changes();
    }

    /// Each command is judged against the state that those before it have left.
    pub(super) fn carry_out_deferred(&mut self) {
        while !self.is_in_transition() {
            let Some(command) = self.deferred.pop_front() else {
                return;
            };
            self.carry_out_command(command);
        }
    }

    /// True when a command waits, and no longer for a transition.
    pub(super) fn may_go_on_with_commands(&self) -> bool {
        !self.deferred.is_empty() && !self.is_in_transition()
    }

    fn is_in_transition(&self) -> bool {
        self.state.transition().is_some() || self.validation.is_some()
    }

    fn carry_out_command(&mut self, command: Deferred) {
        // The same command may have come twice before the first was carried out; hold, stop and abort may act twice.
        let said = self.shared.replied(&command.meta.command_id);
        if let Some(said) = said.filter(|_| !command.command.verb().is_urgent()) {
            let id = &command.meta.command_id;
            if command.wait
                && self
                    .awaiting
                    .iter()
                    .any(|awaiting| awaiting.meta.command_id == *id)
            {
                // sent twice, and both senders wait until it is done
                self.awaiting.push(Awaiting {
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
            let done = self.say(&meta, CommandStatus::Done, "ok", "");
            let _ = reply.send(Ok(Answer::Command(done)));
            return;
        }
        let judged = self
            .judge_order(verb, order)
            .and_then(|()| self.judge(verb, &meta))
            .and_then(|()| self.prepare_command(&command));
        let (text, start) = match judged {
            Ok(prepared) => prepared,
            Err(refusal) => {
                let refusal = self.in_situation(refusal, &meta);
                return self.reject(&meta, refusal, reply);
            }
        };
        let text = notes.iter().fold(text, |text, note| join(&text, note));
        self.last_command_id = Some(meta.command_id.clone());
        let event = Event::Command {
            verb,
            command_id: meta.command_id.clone(),
            client_id: meta.client_id.clone(),
        };
        self.shared.record(self.number, event);
        let accepted = self.say(&meta, CommandStatus::Accepted, "ok", &text);
        let mut reply = Some(reply);
        if !wait && let Some(reply) = reply.take() {
            // The asker may have gone; the command is carried out all the same.
            let _ = reply.send(Ok(Answer::Command(accepted)));
        }
        self.awaiting.push(Awaiting {
            meta,
            verb,
            note: text,
            reply,
        });
        if self.take_effect(&command, start) {
            self.complete(&|awaiting| awaiting.verb == verb);
        }
    }

    /// A stop or abort passes those that wait; what was to move before it must not move behind it.
    fn judge_order(&self, verb: Verb, order: u64) -> Result<(), Refusal> {
        if verb.moves() && order < self.stopped_at {
            let text = "a stop or abort that came after it has been carried out before it; command it again";
            return Err(Refusal::new(RefusalCode::NotAllowed, text));
        }
        Ok(())
    }

    pub(super) fn judge(&self, verb: Verb, meta: &CommandMeta) -> Result<(), Refusal> {
        let failed = |text: String| Err(Refusal::new(RefusalCode::PreconditionFailed, text));
        if let Some(expect) = &meta.expect {
            if expect
                .boot_id
                .as_ref()
                .is_some_and(|boot_id| *boot_id != self.shared.boot_id)
            {
                return failed("the runtime was started again since; read its state".into());
            }
            let rev = self.state_rev();
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
            program_loaded: self.program.is_some(),
            alarm_active: self.shared.alarm_count(self.number) > 0,
        }
    }

    /// What can still refuse a command, and what it needs: nothing has changed when it does.
    fn prepare_command(&self, command: &Command) -> Result<(String, Option<Run>), Refusal> {
        match command {
            Command::Load { program } => Ok((self.check_called(&self.stored(*program)?)?, None)),
            Command::Start => {
                let main = self.stored(self.program.unwrap_or_default())?;
                self.check_called(&main)?;
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
                self.program = Some(*program);
                self.loaded = self.texts_of(*program);
                self.drive(RunEvent::Loaded);
                self.go_to_head();
                true
            }
            Command::Start => {
                if let Some(run) = start {
                    self.loaded = self.texts_of(run.main.number);
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
                self.shared.record(self.number, Event::Resume);
                true
            }
            Command::BackTrace { on: true } => {
                self.go_back();
                true
            }
            Command::Stop => self.end_run(End::Stop),
            Command::Abort => self.end_run(End::Abort),
            Command::Reset => {
                self.shared.clear_alarms(self.number);
                let has_program = self.program.is_some();
                let is_done = self.end_run(End::Reset { has_program });
                self.go_to_head();
                is_done
            }
            Command::AlarmAcknowledge { .. } => true,
        }
    }

    /// The program loaded is at its head.
    fn go_to_head(&self) {
        self.view.at_head(self.program);
        self.publish_place();
    }

    fn start(&mut self, run: Run) {
        let number = run.main.number;
        let mut phase = Phase::Interpret;
        if let Kind::Jog(jog) = &run.kind {
            phase = self.start_jog(jog);
        } else {
            let goes_on = matches!(run.kind, Kind::Manual) && self.manual_goes_on;
            let tree = Arc::clone(&run.main.tree);
            self.pipeline.start(tree, number, self.servo.epoch(), goes_on);
            self.manual_goes_on = false;
        }
        self.runs += 1;
        self.run_id = Some(run.id.clone());
        let manual = (number == 0).then(|| Arc::clone(&run.main));
        self.view.update(|place| place.manual = manual);
        let event = Event::Start {
            program: number,
            run_id: run.id.clone(),
        };
        self.shared.record(self.number, event);
        self.inputs.take_over_skip(1);
        self.publish_inputs();
        self.run = Some(run);
        self.drive(RunEvent::Started(phase));
    }

    pub(super) fn stored(&self, number: u16) -> Result<Arc<StoredProgram>, Refusal> {
        self.shared.store.get(number).ok_or_else(|| {
            let text = format!("program {number} is not in the store; write it first");
            Refusal::new(RefusalCode::NotFound, text)
        })
    }

    /// Refuses a program that has errors, its subprograms included; says what is worth knowing.
    pub(super) fn check_called(&self, main: &Arc<StoredProgram>) -> Result<String, Refusal> {
        let all = self.shared.store.all();
        let number = main.number;
        let mut errors = Vec::new();
        let mut m_codes = BTreeSet::new();
        let (mut seen, mut left) = (BTreeSet::from([number]), vec![Arc::clone(main)]);
        while let Some(program) = left.pop() {
            let here = program.check_in(&self.configured.settings);
            m_codes.extend(here.m_codes.iter().copied());
            errors.extend(
                here.errors
                    .iter()
                    .cloned()
                    .map(|diagnostic| match program.number {
                        main if main == number => diagnostic,
                        called => {
                            let message =
                                format!("in program {called}, which is called: {}", diagnostic.message);
                            ProgramDiagnostic {
                                message,
                                ..diagnostic
                            }
                        }
                    }),
            );
            let called = program.check.programs.iter().filter_map(|called| all.get(called));
            left.extend(called.filter(|called| seen.insert(called.number)).cloned());
        }
        if !errors.is_empty() {
            let what = match number {
                0 => "the text".to_owned(),
                number => format!("program {number}"),
            };
            let text = format!("{what} has {} errors", errors.len());
            return Err(Refusal {
                diagnostics: errors,
                ..Refusal::new(RefusalCode::ProgramHasErrors, text)
            });
        }
        let unhandled: Vec<String> = m_codes
            .into_iter()
            .filter(|m| !self.is_served(*m))
            .map(|m| format!("M{m:02}"))
            .collect();
        if unhandled.is_empty() {
            Ok(String::new())
        } else {
            Ok(format!("no handler is registered for {}", unhandled.join(", ")))
        }
    }

    fn state_rev(&self) -> u64 {
        let state = self.shared.hub.read(&self.topic(CsTopic::State));
        state.and_then(|message| message.rev).unwrap_or(0)
    }

    pub(super) fn reject(&mut self, meta: &CommandMeta, refusal: Refusal, reply: Reply) {
        let code = word(&refusal.code);
        self.say(meta, CommandStatus::Rejected, &code, &refusal.text);
        // The asker may have gone; the reply is published, too.
        let _ = reply.send(Err(refusal));
    }

    fn say(&self, meta: &CommandMeta, status: CommandStatus, code: &str, text: &str) -> CommandReply {
        let reply = self.reply_to(meta, status, code, text);
        self.shared.reply(&meta.client_id, reply.clone());
        reply
    }

    pub(super) fn reply_to(
        &self,
        meta: &CommandMeta,
        status: CommandStatus,
        code: &str,
        text: &str,
    ) -> CommandReply {
        CommandReply {
            command_id: meta.command_id.clone(),
            status,
            code: code.to_owned(),
            text: text.to_owned(),
            state_rev: self.state_rev(),
            variables: None,
            lease: None,
        }
    }

    /// Tells those commands whose effect has been reached.
    pub(super) fn complete(&mut self, is_done: &dyn Fn(&Awaiting) -> bool) {
        self.publish_changes();
        self.answer(is_done, CommandStatus::Done, "ok", "");
    }

    /// Tells those who began a run by hand that it was ended before its end; of a jog that is what they wait for.
    pub(super) fn run_given_up(&mut self, run: &Run, into: (Execution, Option<Reason>)) {
        if matches!(run.kind, Kind::Jog(_)) && into.0 == Execution::Ready {
            return;
        }
        let reason = into.1.map(|reason| word(&reason)).unwrap_or_default();
        let text = format!("it was ended before its end: {} {reason}", word(&into.0));
        self.answer(
            &Awaiting::is_of_run,
            CommandStatus::Failed,
            &reason.to_lowercase(),
            &text,
        );
    }

    fn answer(&mut self, is_it: &dyn Fn(&Awaiting) -> bool, status: CommandStatus, code: &str, text: &str) {
        let (answered, left): (Vec<_>, Vec<_>) = self.awaiting.drain(..).partition(is_it);
        self.awaiting = left;
        for Awaiting {
            meta, note, reply, ..
        } in answered
        {
            // who waits for the end only must hear of it, too
            let text = if status == CommandStatus::Done {
                &note
            } else {
                text
            };
            let said = self.say(&meta, status, code, text);
            if let Some(reply) = reply {
                // The asker may have gone; the reply is published, too.
                let _ = reply.send(Ok(Answer::Command(said)));
            }
        }
    }
}

fn with_run((text, run): (String, Run)) -> (String, Option<Run>) {
    (text, Some(run))
}

fn join(text: &str, note: &str) -> String {
    let mark = if text.is_empty() { "" } else { "; " };
    format!("{text}{mark}{note}")
}
