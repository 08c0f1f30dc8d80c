//! Pending commands: deferred commands, a command whose parameters handlers validate, and commands whose effect is
//! awaited.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use plc_protocol::types::command::{Command, CommandMeta, CommandReply, CommandStatus, Verb};
use plc_protocol::types::program::{DiagnosticSeverity, ProgramDiagnostic};
use plc_protocol::types::question::{Validate, ValidateResult};
use plc_protocol::types::request::{Answer, Refusal, RefusalCode};
use tandem_model::Origin;
use tandem_store::program_store::StoredProgram;
use tandem_syntax::diagnostics::HANDLER_REFUSES;
use tokio::sync::oneshot;

use crate::coordinate_system::context::Context;
use crate::coordinate_system::run::parts::OrderedParts;
use crate::coordinate_system::run::programs::{Texts, program_prefix};

/// Maximum number of commands that wait for a transition to end. A further command is refused.
const DEFERRED_MAX: usize = 256;

/// Time limit in s for the answers of handlers to a validation. Afterwards the program is loaded with a warning.
pub(crate) const PATIENCE_S: f64 = 2.0;

/// Maximum length of a handler's refusal text in characters. A longer text is cut.
const TEXT_MAX: usize = 200;

pub(crate) type Reply = oneshot::Sender<Result<Answer, Refusal>>;

/// Command that waits for its validation.
pub(crate) struct DeferredCommand {
    /// Sequence number of the command among all requests to this coordinate system.
    pub order: u64,
    pub command: Command,
    pub meta: CommandMeta,
    pub wait: bool,
    pub reply: Reply,
}

impl DeferredCommand {
    /// Refuses the command.
    pub fn refuse(self, context: &Context, refusal: Refusal) {
        // The caller may have stopped waiting; the refusal is also published.
        let _ = self.reply.send(Err(context.reject(&self.meta, refusal)));
    }
}

/// Accepted command that has not reached its effect yet.
pub(crate) struct Awaiting {
    pub meta: CommandMeta,
    pub verb: Verb,
    /// True if the command ends a jog.
    pub ends_jog: bool,
    /// Note for the operator from the acceptance of the command.
    pub note: String,
    /// The program that the command loaded or started.
    pub program: Option<Arc<StoredProgram>>,
    /// The run that the command started.
    pub run_id: Option<String>,
    pub reply: Option<Reply>,
}

impl Awaiting {
    /// Returns true if the command is done when the machine rests under feed hold.
    pub fn is_hold(&self) -> bool {
        self.verb == Verb::Hold
    }

    /// Returns true if the command is done when a run has ended and the machine rests. This includes a hold, because
    /// the run may end during it.
    pub fn is_end(&self) -> bool {
        self.ends_jog || matches!(self.verb, Verb::Hold | Verb::Stop | Verb::Abort | Verb::Reset)
    }

    /// Returns true if the command is done when the run that it started is completed.
    pub fn is_of_run(&self) -> bool {
        !self.ends_jog && matches!(self.verb, Verb::Mdi | Verb::Home | Verb::Jog)
    }
}

/// Failure that prevented the effect of an accepted command.
#[derive(Debug)]
pub(crate) struct CommandFailure {
    /// Code of the reply.
    pub code: &'static str,
    /// Text for the operator.
    pub text: String,
    /// Distance covered in mm or degrees, by axis letter.
    pub moved: BTreeMap<char, f64>,
}

/// Load or start that waits for the answers of handlers about the parameters of M codes.
pub(crate) struct Validation {
    pub command: DeferredCommand,
    pub main: u16,
    pub texts: Texts,
    /// Time in s since the start at which the wait for answers ends.
    pub deadline_s: f64,
    pub asked: Vec<MCodeValidation>,
    pub refusals: Vec<ProgramDiagnostic>,
    pub not_asked: usize,
}

/// Validation of one M code with its parameters.
pub(crate) struct MCodeValidation {
    pub m: u16,
    pub request: Validate,
    /// Handlers that have not answered yet.
    pub by: BTreeSet<String>,
}

impl Validation {
    /// Processes the answer of a handler to a validation.
    pub fn receive_answer(&mut self, result: &ValidateResult) {
        let mut asked = self.asked.iter_mut();
        let Some(asked) = asked.find(|asked| asked.request.request_id == result.request_id) else {
            return;
        };
        if !asked.by.remove(&result.handler_id) || result.ok {
            return;
        }
        let why = result.text.as_deref().unwrap_or("no reason given");
        let why: String = why.chars().take(TEXT_MAX).collect();
        let (m, line) = (asked.m, asked.request.line);
        let place = program_prefix(asked.request.program, self.main);
        self.refusals.push(ProgramDiagnostic {
            code: HANDLER_REFUSES.code.to_owned(),
            severity: DiagnosticSeverity::Error,
            line,
            column: 1,
            end_line: line,
            end_column: 1,
            message: format!("{place}M{m:02}: {why}"),
            help: format!(
                "Handler {} refuses the parameters; correct them.",
                result.handler_id
            ),
        });
    }

    pub fn is_answered(&self) -> bool {
        self.asked.iter().all(|asked| asked.by.is_empty())
    }

    /// Returns notes for the operator: one for each handler that has not answered, and one with the number of M codes
    /// that no handler checked.
    pub fn notes(&self) -> Vec<(Origin, String)> {
        let at = |program, line| Origin {
            program,
            line,
            column: 1,
        };
        let mut notes = Vec::new();
        let mut named = BTreeSet::new();
        for asked in &self.asked {
            for handler in asked.by.iter().filter(|handler| named.insert(handler.as_str())) {
                let Validate { program, line, .. } = asked.request;
                let note = format!(
                    "handler {handler} did not answer within {PATIENCE_S} s whether it accepts M{:02} of \
                     line {line}",
                    asked.m
                );
                notes.push((at(program, line), note));
            }
        }
        if self.not_asked > 0 {
            let count = self.not_asked;
            let note = format!("handlers did not check the parameters of {count} more M codes");
            notes.push((at(self.main, 1), note));
        }
        notes
    }
}

/// Commands to one coordinate system, and the program that they have loaded.
#[derive(Default)]
pub(crate) struct Commands {
    /// Commands that wait for their validation, in order.
    pub deferred: VecDeque<DeferredCommand>,
    pub awaiting: Vec<Awaiting>,
    /// Sequence number of the last stop or abort, which may have overtaken waiting commands.
    pub stopped_at: u64,
    /// A load or start whose parameters handlers check.
    pub validation: Option<Validation>,
    /// Number of validation requests to handlers so far.
    pub validations: u64,
    /// Id of the command that was accepted last.
    pub last_id: Option<String>,
    /// Number of the loaded program.
    pub program: Option<u16>,
    /// The loaded program and the programs that it calls, with their texts at the load.
    pub texts: Texts,
    /// Parts of the active run, if several were ordered.
    pub parts: Option<OrderedParts>,
}

impl Commands {
    /// Queues a command until the commands before it have reached their effect.
    ///
    /// # Errors
    /// Returns the command as an error if [`DEFERRED_MAX`] commands already wait.
    pub fn defer(&mut self, command: DeferredCommand) -> Result<(), Box<DeferredCommand>> {
        if self.deferred.len() >= DEFERRED_MAX {
            return Err(Box::new(command));
        }
        self.deferred.push_back(command);
        Ok(())
    }

    /// Refuses a command to move if a later stop or abort has overtaken it.
    pub fn check_order(&self, verb: Verb, order: u64) -> Result<(), Refusal> {
        if verb.moves() && order < self.stopped_at {
            let text = "a later stop or abort was executed before this command; send the command again";
            return Err(Refusal::new(RefusalCode::NotAllowed, text));
        }
        Ok(())
    }

    /// Refuses the commands that wait for their validation.
    pub fn refuse_waiting(&mut self, context: &Context, refusal: &Refusal) {
        while let Some(command) = self.deferred.pop_front() {
            command.refuse(context, refusal.clone());
        }
    }

    /// Refuses the command whose parameters handlers check.
    pub fn refuse_validation(&mut self, context: &Context, refusal: Refusal) {
        if let Some(validation) = self.validation.take() {
            validation.command.refuse(context, refusal);
        }
    }

    /// Returns true if the effect of the command with this id is still pending.
    pub fn awaits(&self, command_id: &str) -> bool {
        let mut awaiting = self.awaiting.iter();
        awaiting.any(|awaiting| awaiting.meta.command_id == command_id)
    }

    /// Answers the commands for which `is_it` returns true: `done` with their own note, or `failed` with the reason
    /// that prevented their effect.
    pub fn answer(
        &mut self,
        context: &Context,
        is_it: &dyn Fn(&Awaiting) -> bool,
        failure: Option<&CommandFailure>,
    ) {
        let answered = self.awaiting.extract_if(.., |awaiting| is_it(awaiting));
        for awaiting in answered {
            let meta = &awaiting.meta;
            let said = match failure {
                None => context.reply_to(meta, CommandStatus::Done, "ok", &awaiting.note),
                Some(failure) => CommandReply {
                    moved: failure.moved.clone(),
                    ..context.reply_to(meta, CommandStatus::Failed, failure.code, &failure.text)
                },
            };
            let said = context.reply_with_program(
                &awaiting.meta,
                said,
                awaiting.program.as_deref(),
                awaiting.run_id.as_deref(),
            );
            if let Some(reply) = awaiting.reply {
                // The caller may have stopped waiting; the reply is also published.
                let _ = reply.send(Ok(Answer::Command(said)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(order: u64) -> DeferredCommand {
        DeferredCommand {
            order,
            command: Command::Start,
            meta: CommandMeta::default(),
            wait: false,
            reply: oneshot::channel().0,
        }
    }

    #[test]
    fn commands_are_judged_in_their_order_and_one_too_many_is_given_back() {
        let mut commands = Commands::default();
        for order in 0..DEFERRED_MAX as u64 {
            assert!(commands.defer(command(order)).is_ok());
        }
        assert_eq!(commands.defer(command(999)).unwrap_err().order, 999);
        let orders = commands.deferred.iter().map(|command| command.order);
        assert!(orders.eq(0..DEFERRED_MAX as u64));
    }

    #[test]
    fn what_was_to_move_before_a_stop_that_has_passed_it_is_refused() {
        let mut commands = Commands::default();
        assert_eq!(commands.check_order(Verb::Start, 4), Ok(()));
        commands.stopped_at = 5;
        let refusal = commands.check_order(Verb::Start, 4).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NotAllowed);
        assert_eq!(commands.check_order(Verb::Reset, 4), Ok(()), "it moves nothing");
        assert_eq!(commands.check_order(Verb::Start, 6), Ok(()));
    }
}
