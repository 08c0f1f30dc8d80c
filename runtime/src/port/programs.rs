//! Requests for programs; a program that is running is not changed.

use std::sync::Arc;

use plc_api::types::request::{Answer, Refusal, RefusalCode};
use tandem_model::limits::{M_CODE_MAX, PROGRAM_BYTES_MAX};

use super::RuntimePort;
use crate::disk::Part;
use crate::program_store::{StoredProgram, called_by};
use crate::shared::Shared;

// The stages know no interface, and the interface knows no stage: what both state is the same.
const _: () = assert!(PROGRAM_BYTES_MAX == plc_api::types::program::PROGRAM_BYTES_MAX);
const _: () = assert!(M_CODE_MAX == plc_api::handlers::M_CODE_MAX);

impl RuntimePort {
    fn stored(&self, number: u16) -> Result<Arc<StoredProgram>, Refusal> {
        let store = &self.shared.store;
        let missing = || store.refuse_damaged(number).unwrap_or_else(|| no_program(number));
        store.get(number).ok_or_else(missing)
    }

    pub(super) fn read_program(&self, number: u16) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        Ok(Answer::ProgramText(program.text().to_owned()))
    }

    pub(super) async fn write_program(&self, number: u16, text: String) -> Result<Answer, Refusal> {
        if text.len() > PROGRAM_BYTES_MAX {
            let text = format!(
                "the program has {} bytes; at most {PROGRAM_BYTES_MAX} are read",
                text.len()
            );
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        self.refuse_while_running(number)?;
        let check = self
            .on_disk(move |shared| shared.note(Part::Programs, shared.store.write(number, &text)))
            .await?;
        Ok(Answer::Check(check))
    }

    pub(super) async fn delete_program(&self, number: u16) -> Result<Answer, Refusal> {
        self.refuse_while_running(number)?;
        let delete = move |shared: &Shared| shared.note(Part::Programs, shared.store.delete(number));
        if self.on_disk(delete).await? {
            Ok(Answer::Done)
        } else {
            Err(no_program(number))
        }
    }

    fn refuse_while_running(&self, number: u16) -> Result<(), Refusal> {
        for mailbox in &self.mailboxes {
            let main = self.running(mailbox.number).and_then(|state| state.program);
            if main.is_some_and(|main| called_by(&self.shared.store.all(), main).contains(&number)) {
                let text = format!(
                    "program {number} runs in coordinate system {}; stop it first",
                    mailbox.number
                );
                return Err(Refusal::new(RefusalCode::ProgramRuns, text));
            }
        }
        Ok(())
    }

    pub(super) fn check_program(&self, number: u16) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        Ok(Answer::Check(program.check.clone()))
    }

    pub(super) async fn intermediate_code(&self, number: u16) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        if program.has_errors() {
            let text = format!("program {number} has errors; correct them first");
            return Err(Refusal {
                diagnostics: program.check.diagnostics.clone(),
                ..Refusal::new(RefusalCode::ProgramHasErrors, text)
            });
        }
        let code = self.on_disk(move |_| Ok(program.intermediate_code())).await?;
        Ok(Answer::ProgramText(code))
    }
}

fn no_program(number: u16) -> Refusal {
    Refusal::new(
        RefusalCode::NotFound,
        format!("program {number} is not in the store"),
    )
}
