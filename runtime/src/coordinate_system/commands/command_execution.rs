//! Commands: validated and executed one after another. The urgent commands hold, stop and abort do not wait.

use std::sync::Arc;

use plc_protocol::types::command::{Command, CommandMeta, CommandStatus, Verb};
use plc_protocol::types::line_start::LineStart;
use plc_protocol::types::request::{Answer, Refusal, RefusalCode};
use plc_protocol::types::run::RunOrder;
use plc_protocol::types::upload::{Hashes, ProgramCondition};
use tandem_servo::Control;
use tandem_store::journal::Event;
use tandem_store::program_store::StoredProgram;

use super::pending_commands::{Awaiting, DeferredCommand};
use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::run::active_run::{ActiveRun, ActiveRunKind};
use crate::coordinate_system::run::causes::{Cause, EarlyEndCause, JogStop};
use crate::coordinate_system::run::conditions::RunStart;
use crate::coordinate_system::run::line_search::LineEntry;
use crate::coordinate_system::run::parts::OrderedParts;
use crate::coordinate_system::run::run_state::{Phase, RunEvent};
use plc_protocol::execution::{Situation, wire_name};

/// Accepted command with the data that it needs.
#[derive(Default)]
pub(crate) struct PreparedCommand {
    /// Note for the operator in the reply.
    note: String,
    pub run: Option<ActiveRun>,
    /// The line at which the run begins, unless it is line 1.
    entry: Option<LineEntry>,
    /// The program to load or start.
    program: Option<Arc<StoredProgram>>,
}

impl CoordinateSystem {
    pub(crate) fn command(&mut self, command: DeferredCommand) {
        let verb = command.command.verb();
        if command.command.is_urgent() {
            if matches!(verb, Verb::Stop | Verb::Abort) {
                self.commands.stopped_at = command.order;
            }
            self.execute_command(command);
        } else if let Err(command) = self.commands.defer(command) {
            let text = "too many commands wait; send the command again";
            let refusal = Refusal::new(RefusalCode::Unavailable, text);
            command.refuse(&self.context, refusal);
        } else {
            self.execute_deferred();
        }
        self.publish_changes();
    }

    /// Executes the deferred commands. Each is validated against the state that the commands before it have left.
    pub(crate) fn execute_deferred(&mut self) {
        while !self.is_in_transition() {
            let Some(command) = self.commands.deferred.pop_front() else {
                return;
            };
            self.execute_command(command);
        }
    }

    /// Returns true if a command is pending and no transition or validation delays it.
    pub(crate) fn has_ready_command(&self) -> bool {
        !self.commands.deferred.is_empty() && !self.is_in_transition()
    }

    pub(crate) fn is_in_transition(&self) -> bool {
        self.state.transition().is_some() || self.commands.validation.is_some()
    }

    fn execute_command(&mut self, command: DeferredCommand) {
        // A second copy of a command may arrive before the first is executed. Its caller receives the stored reply;
        // hold, stop and abort are executed twice instead.
        let said = self.context.shared.replied(&command.meta.memory);
        if let Some(said) = said.filter(|_| !command.command.is_urgent()) {
            if command.wait && self.commands.awaits(&command.meta.command_id) {
                // the caller of the second copy also waits until the command is done
                self.commands.awaiting.push(Awaiting {
                    verb: command.command.verb(),
                    ends_jog: false,
                    meta: command.meta,
                    note: said.text.clone(),
                    program: None,
                    run_id: said.run_id,
                    reply: Some(command.reply),
                });
                return;
            }
            let _ = command.reply.send(Ok(Answer::Command(said)));
            return;
        }
        if let Some(command) = self.validate_first(command) {
            self.accept_command(command, Vec::new());
        }
    }

    /// Validates a command and executes it unless it is refused. `notes` inform the operator and never cause a refusal.
    pub(crate) fn accept_command(&mut self, command: DeferredCommand, notes: Vec<String>) {
        let verb = command.command.verb();
        if self.needs_no_run(&command.command, &command.meta) {
            let done = self.context.reply(&command.meta, CommandStatus::Done, "ok", "");
            let _ = command.reply.send(Ok(Answer::Command(done)));
            return;
        }
        let judged = match command.command {
            // the client that began the jog may end the jog in any state
            Command::JogEnd { .. } => Ok(PreparedCommand::default()),
            _ => (self.remember_jog(&command))
                .and_then(|()| self.commands.check_order(verb, command.order))
                .and_then(|()| self.check_preconditions(verb, &command.meta))
                .and_then(|()| self.prepare_command(&command.command, &command.meta)),
        };
        let PreparedCommand {
            note: text,
            run,
            entry,
            program,
        } = match judged {
            Ok(prepared) => prepared,
            Err(refusal) => {
                self.record_refusal(&command, &refusal);
                let refusal = self.in_situation(refusal, &command.meta);
                return command.refuse(&self.context, refusal);
            }
        };
        let DeferredCommand {
            command,
            meta,
            wait,
            reply,
            ..
        } = command;
        let texts = [text].into_iter().chain(notes).filter(|text| !text.is_empty());
        let note = texts.collect::<Vec<_>>().join("; ");
        self.note_command(verb, &meta, program.as_deref());
        self.give_up_parts(verb);
        let run_id = run
            .as_ref()
            .filter(|run| matches!(run.kind, ActiveRunKind::Program));
        let run_id = run_id.map(|run| run.id.clone());
        let accepted = self.context.reply_to(&meta, CommandStatus::Accepted, "ok", &note);
        let accepted =
            self.context
                .reply_with_program(&meta, accepted, program.as_deref(), run_id.as_deref());
        let mut reply = Some(reply);
        if !wait && let Some(reply) = reply.take() {
            // The caller may have stopped waiting for the reply. The command is executed regardless.
            let _ = reply.send(Ok(Answer::Command(accepted)));
        }
        if let (Command::Run(order), Some(run)) = (&command, &run) {
            self.commands.parts = Some(OrderedParts::new(*order, run, &meta));
        }
        self.commands.awaiting.push(Awaiting {
            meta,
            verb,
            ends_jog: matches!(command, Command::JogEnd { .. }),
            note,
            program,
            run_id,
            reply,
        });
        if self.take_effect(&command, run, entry) {
            self.complete(&|awaiting| awaiting.verb == verb);
        }
    }

    fn note_command(&mut self, verb: Verb, meta: &CommandMeta, program: Option<&StoredProgram>) {
        self.commands.last_id = Some(meta.command_id.clone());
        self.context.record(Event::Command {
            verb,
            command_id: meta.command_id.clone(),
            client_id: meta.client_id.clone(),
            program: program.map(|program| program.number),
            program_hash: program.map(|program| program.checksum().to_owned()),
        });
    }

    pub(crate) fn check_preconditions(&self, verb: Verb, meta: &CommandMeta) -> Result<(), Refusal> {
        let failed = |text: String| Err(Refusal::new(RefusalCode::PreconditionFailed, text));
        self.context.shared.check_not_after(meta.not_after.as_ref())?;
        if let Some(expect) = &meta.expect {
            let boot_id = &self.context.shared.boot_id;
            if expect
                .boot_id
                .as_ref()
                .is_some_and(|expected| expected != boot_id)
            {
                return failed("the runtime was restarted in the meantime; read its state".into());
            }
            let rev = self.context.shared.state_rev(Some(self.context.number));
            if expect.state_rev.is_some_and(|expected| expected != rev) {
                return failed(format!(
                    "the state has changed in the meantime; its rev is now {rev}"
                ));
            }
        }
        self.authorize_by_lease(verb, meta)?;
        if verb == Verb::Reset {
            self.check_servo()?;
        }
        self.situation().check_allowed(verb)?;
        self.check_locks(verb)
    }

    /// Refuses commands that the interlock or the start lock prevents.
    fn check_locks(&self, verb: Verb) -> Result<(), Refusal> {
        if verb.moves() {
            self.check_interlock()?;
        }
        self.check_start_lock(verb)
    }

    pub(crate) fn check_start_lock(&self, verb: Verb) -> Result<(), Refusal> {
        let starts = matches!(verb, Verb::Start | Verb::Run | Verb::Mdi);
        if starts && let Some(why) = self.context.shared.stored_data.lock().text() {
            let text = format!("stored files do not fit together: {why}");
            return Err(Refusal::new(RefusalCode::StartLocked, text));
        }
        if starts && self.inputs.start_lock.is_on() {
            let why = self.inputs.start_lock.text();
            return Err(Refusal::new(
                RefusalCode::StartLocked,
                format!("the start lock is on: {why}"),
            ));
        }
        Ok(())
    }

    /// Adds the state, and the commands that would be accepted now, to a refusal caused by the state.
    fn in_situation(&self, refusal: Refusal, meta: &CommandMeta) -> Refusal {
        if !refusal.code.is_of_state() {
            return refusal;
        }
        let situation = self.situation();
        let mut allowed = situation.allowed();
        allowed.retain(|verb| {
            self.check_locks(*verb)
                .and_then(|()| self.authorize_by_lease(*verb, meta))
                .is_ok()
                && (*verb != Verb::BackTrace || self.check_back_trace(!self.state.retraces()).is_ok())
        });
        Refusal {
            state: Some(situation.execution),
            allowed,
            ..refusal
        }
    }

    pub(crate) fn situation(&self) -> Situation {
        Situation {
            execution: self.state.state_word_at_rest().0,
            program_loaded: self.commands.program.is_some(),
            alarm_active: self.context.alarm_count() > 0,
        }
    }

    /// Records a refusal in the journal if the program differs from the expected one or has no valid signature.
    fn record_refusal(&self, command: &DeferredCommand, refusal: &Refusal) {
        let code = refusal.code;
        if !matches!(code, RefusalCode::NotSigned | RefusalCode::PreconditionFailed) {
            return;
        }
        let program = match command.command {
            Command::Load { program } => Some(program),
            Command::Run(order) => order.program.or(self.commands.program),
            _ => self.commands.program,
        };
        self.context.record(Event::Refused {
            request: wire_name(&command.command.verb()),
            program,
            code,
            text: refusal.text.clone(),
            client_id: Some(command.meta.client_id.clone()),
        });
    }

    /// Performs the last checks of a command and collects the data that it needs. A refused command changes nothing.
    fn prepare_command(&self, command: &Command, meta: &CommandMeta) -> Result<PreparedCommand, Refusal> {
        let number = self.commands.program;
        if !matches!(
            command,
            Command::Load { .. } | Command::Start | Command::StartFrom(_) | Command::Run(_)
        ) {
            let main = self.main_program();
            check_expected_program(meta, number, main.as_ref().map(|main| main.checksum()))?;
        }
        let of_run = |(note, run)| PreparedCommand {
            note,
            run,
            ..PreparedCommand::default()
        };
        match command {
            Command::Load { program } => {
                let main = self.context.stored(*program)?;
                check_expected_program(meta, Some(*program), Some(main.checksum()))?;
                Ok(PreparedCommand {
                    note: self.context.check_called(&main)?,
                    program: Some(main),
                    ..PreparedCommand::default()
                })
            }
            Command::Start => self.prepare_start(self.next_run_id(), meta, None),
            Command::StartFrom(from) => self.prepare_start(self.next_run_id(), meta, Some(from)),
            Command::Run(order) => self.prepare_run(*order, meta),
            Command::BackTrace { on } => {
                self.check_back_trace(*on)?;
                Ok(PreparedCommand::default())
            }
            Command::Mdi { text, is_macro } => self.prepare_manual(text, *is_macro).map(of_run),
            Command::Home { axes } => self.prepare_home(axes).map(of_run),
            Command::Jog {
                axis,
                velocity,
                distance,
                refresh_id,
            } => {
                let run = self.prepare_jog(*axis, *velocity, *distance, refresh_id)?;
                Ok(of_run((String::new(), Some(run))))
            }
            _ => Ok(PreparedCommand::default()),
        }
    }

    /// Prepares the command `run`, which loads its program again.
    fn prepare_run(&self, order: RunOrder, meta: &CommandMeta) -> Result<PreparedCommand, Refusal> {
        let number = order.program.or(self.commands.program).ok_or_else(|| {
            let text = "run is not allowed: no program is loaded; name a program";
            Refusal::new(RefusalCode::NotAllowed, text)
        })?;
        let main = self.context.stored(number)?;
        check_expected_program(meta, Some(number), Some(main.checksum()))?;
        let note = self.context.check_called(&main)?;
        let (run, entry) = self.new_program_run(self.next_run_id(), &main, None)?;
        Ok(PreparedCommand {
            note,
            run: Some(run),
            entry,
            program: Some(main),
        })
    }

    pub(crate) fn next_run_id(&self) -> String {
        self.context.run_id(self.past.count + 1)
    }

    pub(crate) fn prepare_start(
        &self,
        run_id: String,
        meta: &CommandMeta,
        from: Option<&LineStart>,
    ) -> Result<PreparedCommand, Refusal> {
        let number = self.commands.program;
        let main = self.context.stored(number.unwrap_or_default())?;
        check_expected_program(meta, number, Some(main.checksum()))?;
        self.context.check_called(&main)?;
        self.context.check_loaded(main.number, &self.commands.texts)?;
        let (run, entry) = self.new_program_run(run_id, &main, from)?;
        Ok(PreparedCommand {
            note: String::new(),
            run: Some(run),
            entry,
            program: Some(main),
        })
    }

    /// Executes a command. Returns true if the command has already reached its effect.
    fn take_effect(&mut self, command: &Command, run: Option<ActiveRun>, entry: Option<LineEntry>) -> bool {
        if let Some(run) = run {
            if matches!(command, Command::Run(_)) {
                self.load(run.main.number);
            }
            self.start(run, entry);
            return matches!(command, Command::Start | Command::StartFrom(_) | Command::Run(_));
        }
        match command {
            Command::Load { program } => {
                self.load(*program);
                true
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
            Command::Stop => self.end_run(EarlyEndCause::Stop),
            Command::Abort => self.end_run(EarlyEndCause::Abort),
            Command::JogEnd { .. } => self.end_run(EarlyEndCause::JogEnded(JogStop::Commanded)),
            Command::Reset => {
                self.servo.control(Control::ResetDrives);
                self.context.shared.clear_alarms(self.context.number);
                let has_program = self.commands.program.is_some();
                let is_done = self.end_run(EarlyEndCause::Reset { has_program });
                self.go_to_head();
                is_done
            }
            _ => true,
        }
    }

    fn load(&mut self, program: u16) {
        self.commands.program = Some(program);
        self.commands.texts = self.context.texts_of(program);
        self.drive(RunEvent::Loaded);
        self.go_to_head();
    }

    /// Sets the loaded program to line 1.
    fn go_to_head(&self) {
        self.context.view.at_head(self.commands.program);
    }

    pub(crate) fn start(&mut self, mut run: ActiveRun, entry: Option<LineEntry>) {
        let number = run.main.number;
        let mut phase = Phase::Interpret;
        if matches!(run.kind, ActiveRunKind::Program) {
            self.commands.texts = self.context.texts_of(number);
        }
        if let ActiveRunKind::Jog(jog) = &run.kind {
            phase = self.start_jog(jog);
        } else if let Some(entry) = entry {
            run.arrival = Some(Box::new(self.begin_at_line(entry)));
        } else {
            let goes_on = matches!(run.kind, ActiveRunKind::Manual) && self.past.manual_goes_on;
            let tree = Arc::clone(&run.main.tree);
            self.pipeline.start(tree, number, self.servo.epoch(), goes_on);
            if run.restores.is_some() {
                self.pipeline.read_as_at_start_up();
            }
            self.past.manual_goes_on = false;
        }
        self.past.count += 1;
        self.past.last_id = Some(run.id.clone());
        let manual = (number == 0).then(|| Arc::clone(&run.main));
        let begun = run.conditions.as_ref().map(|conditions| {
            Arc::new(RunStart {
                run_id: run.id.clone(),
                conditions: Arc::clone(conditions),
            })
        });
        self.context.view.update(|place| {
            place.manual = manual;
            place.run = begun;
        });
        let event = Event::Start {
            program: number,
            run_id: run.id.clone(),
            program_hash: (number != 0).then(|| run.main.checksum().to_owned()),
            from_line: run.arrival.as_ref().map(|arrival| arrival.target.line),
            parts: self.commands.parts.as_ref().map(|parts| parts.ordered),
            order: self
                .commands
                .parts
                .as_ref()
                .and_then(|parts| parts.order_of(&run.id)),
        };
        self.context.record(event);
        self.inputs.take_over_skip(1);
        self.publish_inputs();
        self.drive(RunEvent::Started {
            phase,
            run: Box::new(run),
        });
        self.publish_carried();
    }

    /// Answers the commands for which `is_done` returns true: their effect has been reached.
    pub(crate) fn complete(&mut self, is_done: &dyn Fn(&Awaiting) -> bool) {
        self.publish_changes();
        self.commands.answer(&self.context, is_done, None);
    }
}

/// Refuses a command if the hash that it expects is not that of the loaded program.
fn check_expected_program(
    meta: &CommandMeta,
    number: Option<u16>,
    hash: Option<&str>,
) -> Result<(), Refusal> {
    let Some(expected) = meta.expect.as_ref().and_then(|expect| expect.hash.as_ref()) else {
        return Ok(());
    };
    let condition = ProgramCondition {
        if_match: Some(Hashes::OneOf(vec![expected.clone()])),
        if_none_match: None,
    };
    match number {
        Some(number) => condition.check_stored_hash(number, hash),
        None => Err(Refusal::new(
            RefusalCode::PreconditionFailed,
            "no program is loaded; load the expected program",
        )),
    }
}
