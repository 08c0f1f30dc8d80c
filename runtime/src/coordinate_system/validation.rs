//! At a load: the handlers of the program's M codes say whether they take the parameters, before anything moves.
//!
//! The load waits for their answers, and commands behind it wait with it; hold, stop and abort pass it as ever. A start
//! asks again when a program was written anew since.

use std::collections::BTreeSet;

use plc_api::types::command::Command;
use plc_api::types::message::Payload;
use plc_api::types::output::Params;
use plc_api::types::program::{DiagnosticSeverity, ProgramDiagnostic};
use plc_api::types::question::{Validate, ValidateResult};
use plc_api::types::request::{Refusal, RefusalCode};
use plc_api::types::topic::CsTopic;
use tandem_interp::written_outputs;
use tandem_model::Origin;
use tandem_model::alarm::PROGRAM_WARNING;
use tandem_syntax::diagnostics::HANDLER_REFUSES;

use super::CoordinateSystem;
use super::pending_commands::{Deferred, reject};
use super::programs::Texts;
use crate::program_store::called_by;

/// How long handlers may take to answer; then the program is loaded with a warning.
const PATIENCE_S: f64 = 2.0;

/// M codes with different parameters that one load asks for; the rest is not asked, with a warning. Reason: each asks
/// every handler of the code, and thousands of messages would outlast the two seconds.
pub(super) const VALIDATED_MAX: usize = 1000;

/// Characters of a handler's refusal; a longer one is cut.
const TEXT_MAX: usize = 200;

/// A load or start whose answers are awaited.
struct Validation {
    command: Deferred,
    main: u16,
    texts: Texts,
    deadline_s: f64,
    asked: Vec<Asked>,
    refusals: Vec<ProgramDiagnostic>,
    not_asked: usize,
}

/// What handlers are asked at a load.
#[derive(Default)]
pub(super) struct Validations {
    /// A load or start whose answers are awaited.
    pending: Option<Validation>,
    /// Requests so far.
    asked: u64,
}

impl Validations {
    pub fn is_pending(&self) -> bool {
        self.pending.is_some()
    }

    /// When the wait for answers ends, seconds since the start.
    pub fn deadline_s(&self) -> Option<f64> {
        self.pending.as_ref().map(|validation| validation.deadline_s)
    }
}

/// One M code with its parameters.
struct Asked {
    m: u16,
    request: Validate,
    /// Handlers that have not answered.
    by: BTreeSet<String>,
}

impl CoordinateSystem {
    /// Keeps a load back while handlers check the parameters of its M codes, and a start of what was written anew since;
    /// gives back what nobody has to check.
    pub(super) fn validate_first(&mut self, command: Deferred) -> Option<Deferred> {
        let program = match command.command {
            Command::Load { program } => program,
            Command::Start => match self.commands.program {
                Some(program) if !self.context.stand_as(program, &self.commands.texts) => program,
                _ => return Some(command),
            },
            _ => return Some(command),
        };
        let handlers = self.context.shared.handlers();
        if !handlers
            .values()
            .any(|handler| handler.online && handler.validates)
        {
            return Some(command);
        }
        let verb = command.command.verb();
        let has_errors = || {
            self.context
                .stored(program)
                .and_then(|main| self.context.check_called(&main))
                .is_err()
        };
        let is_good = self.judge(verb, &command.meta).is_ok() && !has_errors();
        // what is refused anyhow is refused at once
        if !is_good {
            return Some(command);
        }
        let (asked, not_asked) = self.what_to_ask(program);
        if asked.is_empty() {
            return Some(command);
        }
        for Asked { m, request, .. } in &asked {
            self.context
                .publish(CsTopic::Validate(*m), Payload::Validate(request.clone()));
        }
        self.validations.pending = Some(Validation {
            command,
            main: program,
            texts: self.context.texts_of(program),
            deadline_s: self.context.now_s() + PATIENCE_S,
            asked,
            refusals: Vec::new(),
            not_asked,
        });
        None
    }

    /// Each M code with each set of parameters once, at its first line, and how many were left out.
    fn what_to_ask(&mut self, main: u16) -> (Vec<Asked>, usize) {
        let all = self.context.shared.store.all();
        let handlers = self.context.shared.handlers();
        let validators = |m: u16| -> BTreeSet<String> {
            let serves = handlers.iter().filter(|(_, handler)| {
                let handles = |code: &plc_api::types::output::HandledCode| {
                    (code.cs, code.m) == (self.context.number, m)
                };
                handler.online && handler.validates && handler.handles.iter().any(handles)
            });
            serves.map(|(id, _)| id.clone()).collect()
        };
        let (mut asked, mut known, mut not_asked) = (Vec::new(), BTreeSet::new(), 0);
        for number in called_by(&all, main) {
            let Some(program) = all.get(&number) else { continue };
            for output in written_outputs(&program.tree, program.dialect) {
                let bits = output.params.map(|value| value.map(f64::to_bits));
                if !known.insert((output.m, bits)) {
                    continue;
                }
                let by = validators(output.m);
                if by.is_empty() {
                    continue;
                }
                if asked.len() >= VALIDATED_MAX {
                    not_asked += 1;
                    continue;
                }
                self.validations.asked += 1;
                asked.push(Asked {
                    m: output.m,
                    request: Validate {
                        request_id: format!("{}-{}", self.context.number, self.validations.asked),
                        program: number,
                        line: output.line,
                        params: Params::from(output.params),
                    },
                    by,
                });
            }
        }
        (asked, not_asked)
    }

    /// A handler has answered. An answer to another load, or a second one, changes nothing.
    pub(super) fn on_validate_result(&mut self, result: &ValidateResult) {
        let Some(validation) = &mut self.validations.pending else {
            return;
        };
        validation.take(result);
        if validation.asked.iter().all(|asked| asked.by.is_empty()) {
            self.end_validation();
        }
    }

    /// Ends the wait for answers whose time is over.
    pub(super) fn expire_validation(&mut self, now_s: f64) {
        if self
            .validations
            .deadline_s()
            .is_some_and(|deadline_s| deadline_s <= now_s + 1e-9)
        {
            self.end_validation();
        }
    }

    fn end_validation(&mut self) {
        let Some(validation) = self.validations.pending.take() else {
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
            return reject(
                &self.context,
                &validation.command.meta,
                refusal,
                validation.command.reply,
            );
        }
        if !self.context.stand_as(validation.main, &validation.texts) {
            // written anew meanwhile: what was asked is not what would run
            if let Some(command) = self.validate_first(validation.command) {
                self.accept_command(command, &[]);
            }
            return;
        }
        let mut notes = validation.unanswered();
        if validation.not_asked > 0 {
            let count = validation.not_asked;
            let origin = Origin {
                program: validation.main,
                line: 1,
                column: 1,
            };
            let note = format!("the parameters of {count} more M codes were not checked by their handlers");
            notes.push((origin, note));
        }
        for (origin, note) in &notes {
            self.context.warn(PROGRAM_WARNING.number, *origin, note.clone());
        }
        let notes: Vec<String> = notes.into_iter().map(|(_, note)| note).collect();
        self.accept_command(validation.command, &notes);
    }
}

impl Validation {
    fn take(&mut self, result: &ValidateResult) {
        let mut asked = self.asked.iter_mut();
        let Some(asked) = asked.find(|asked| asked.request.request_id == result.request_id) else {
            return;
        };
        if !asked.by.remove(&result.handler_id) || result.ok {
            return;
        }
        let why = result.text.as_deref().unwrap_or("it gives no reason");
        let why: String = why.chars().take(TEXT_MAX).collect();
        let (m, line) = (asked.m, asked.request.line);
        let called = match asked.request.program {
            main if main == self.main => String::new(),
            called => format!("in program {called}, which is called: "),
        };
        self.refusals.push(ProgramDiagnostic {
            code: HANDLER_REFUSES.code.to_owned(),
            severity: DiagnosticSeverity::Error,
            line,
            column: 1,
            end_line: line,
            end_column: 1,
            message: format!("{called}M{m:02}: {why}"),
            help: format!(
                "Handler {} refuses the parameters; correct them.",
                result.handler_id
            ),
        });
    }

    /// Who has not answered, at the first line of each.
    fn unanswered(&self) -> Vec<(Origin, String)> {
        let mut silent: Vec<(Origin, String)> = Vec::new();
        let mut named = BTreeSet::new();
        for asked in &self.asked {
            for handler in asked.by.iter().filter(|handler| named.insert(handler.as_str())) {
                let Validate { program, line, .. } = asked.request;
                let note = format!(
                    "handler {handler} did not answer within {PATIENCE_S} s whether it takes M{:02} of line {line}",
                    asked.m
                );
                let origin = Origin {
                    program,
                    line,
                    column: 1,
                };
                silent.push((origin, note));
            }
        }
        silent
    }
}
