//! Validation at a load: before any motion, the handlers of the program's M codes check the parameters of these codes.
//!
//! The load and all later commands wait for the answers of the handlers; hold, stop and abort do not wait. A start
//! validates again if a program has been rewritten since the load.

use std::collections::{BTreeMap, BTreeSet};

use plc_protocol::types::command::Command;
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::Params;
use plc_protocol::types::question::{Validate, ValidateResult};
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::topic::CsTopic;
use tandem_interp::written_outputs;
use tandem_model::alarm::PROGRAM_WARNING;

use super::pending_commands::{DeferredCommand, MCodeValidation, PATIENCE_S, Validation};
use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::run::programs::Texts;

/// Maximum number of M codes with different parameters that are validated per load. The others are not validated, and a
/// warning is raised. Reason: each M code is sent to each of its handlers, and thousands of messages would take longer
/// than two seconds.
pub(crate) const VALIDATED_MAX: usize = 1000;

/// Ids of the handlers that check parameters, by M code.
type Validators = BTreeMap<u16, BTreeSet<String>>;

impl CoordinateSystem {
    /// Delays a load while handlers check the parameters of its M codes; also a start, if a program was rewritten since
    /// the load. Returns the command if no handler has to check it.
    pub(crate) fn validate_first(&mut self, command: DeferredCommand) -> Option<DeferredCommand> {
        let program = match command.command {
            Command::Load { program } => Some(program),
            Command::Run(order) => order.program.or(self.commands.program),
            Command::Start | Command::StartFrom(_) => (self.commands.program)
                .filter(|program| !self.context.stand_as(*program, &self.commands.texts)),
            _ => None,
        };
        let Some(main) = program else { return Some(command) };
        let validators = self.validators();
        if validators.is_empty() || self.is_refused(&command, main) {
            return Some(command);
        }
        let texts = self.context.texts_of(main);
        let (asked, not_asked) = self.what_to_ask(&texts, &validators);
        if asked.is_empty() {
            return Some(command);
        }
        for MCodeValidation { m, request, .. } in &asked {
            self.context
                .publish(CsTopic::Validate(*m), Payload::Validate(request.clone()));
        }
        self.commands.validation = Some(Validation {
            command,
            main,
            texts,
            deadline_s: self.context.now_s() + PATIENCE_S,
            asked,
            refusals: Vec::new(),
            not_asked,
        });
        None
    }

    /// Returns true if a command is refused regardless of the handlers' answers. Such a command does not wait for
    /// answers.
    fn is_refused(&self, command: &DeferredCommand, main: u16) -> bool {
        let judged = self.check_preconditions(command.command.verb(), &command.meta);
        let main = judged.and_then(|()| self.context.stored(main));
        main.and_then(|main| self.context.check_called(&main)).is_err()
    }

    fn validators(&self) -> Validators {
        let mut validators = Validators::new();
        let handlers = self.context.shared.handlers();
        for (id, handler) in handlers
            .iter()
            .filter(|(_, handler)| handler.online && handler.validates)
        {
            let codes = handler
                .handles
                .iter()
                .filter(|code| code.cs == self.context.number);
            for code in codes {
                validators.entry(code.m).or_default().insert(id.clone());
            }
        }
        validators
    }

    /// Returns each M code with each set of parameters once, at its first line, and the number of those above the
    /// limit.
    fn what_to_ask(&mut self, texts: &Texts, validators: &Validators) -> (Vec<MCodeValidation>, usize) {
        let (mut asked, mut known, mut not_asked) = (Vec::new(), BTreeSet::new(), 0);
        for (number, program) in texts {
            for output in written_outputs(&program.tree, program.dialect) {
                let Some(by) = validators.get(&output.m) else {
                    continue;
                };
                let bits = output.params.map(|value| value.map(f64::to_bits));
                if !known.insert((output.m, bits)) {
                    continue;
                }
                if asked.len() >= VALIDATED_MAX {
                    not_asked += 1;
                    continue;
                }
                self.commands.validations += 1;
                asked.push(MCodeValidation {
                    m: output.m,
                    request: Validate {
                        request_id: format!("{}-{}", self.context.number, self.commands.validations),
                        program: *number,
                        line: output.line,
                        params: Params::from(output.params),
                    },
                    by: by.clone(),
                });
            }
        }
        (asked, not_asked)
    }

    /// Processes the answer of a handler. An answer to another load, or a repeated answer, changes nothing.
    pub(crate) fn on_validate_result(&mut self, result: &ValidateResult) {
        if let Some(validation) = &mut self.commands.validation {
            validation.receive_answer(result);
        }
        self.end_validation(Validation::is_answered);
    }

    /// Ends the wait for answers if its time limit has expired.
    pub(crate) fn expire_validation(&mut self, now_s: f64) {
        self.end_validation(|validation| validation.deadline_s <= now_s + 1e-9);
    }

    fn end_validation(&mut self, is_over: impl Fn(&Validation) -> bool) {
        let Some(validation) = self.commands.validation.take_if(|validation| is_over(validation)) else {
            return;
        };
        if !validation.refusals.is_empty() {
            let text = format!(
                "handlers refuse {} M codes of program {}",
                validation.refusals.len(),
                validation.main
            );
            let refusal = Refusal {
                diagnostics: validation.refusals,
                ..Refusal::new(RefusalCode::ProgramHasErrors, text)
            };
            return validation.command.refuse(&self.context, refusal);
        }
        if !self.context.stand_as(validation.main, &validation.texts) {
            // rewritten in the meantime: the validated text is not the text that would run
            if let Some(command) = self.validate_first(validation.command) {
                self.accept_command(command, Vec::new());
            }
            return;
        }
        let notes = validation.notes();
        for (origin, note) in &notes {
            self.context.warn(PROGRAM_WARNING.number, *origin, note.clone());
        }
        let notes = notes.into_iter().map(|(_, note)| note).collect();
        self.accept_command(validation.command, notes);
    }
}
