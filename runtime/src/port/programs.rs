//! Requests for programs. The text of a program that is running cannot be changed.

use std::sync::Arc;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::planned::ManualText;
use plc_protocol::types::program::{ProgramFolder, ProgramText};
use plc_protocol::types::request::{Answer, Refusal, RefusalCode};
use plc_protocol::types::state::RunKind;
use plc_protocol::types::upload::{ProgramCondition, ProgramUpload};
use tandem_config::ConfiguredSystem;
use tandem_interp::meaning::Role;
use tandem_model::limits::{M_CODE_MAX, MDI_BYTES_MAX, PROGRAM_BYTES_MAX};
use tandem_store::disk::DataFolderPart;
use tandem_store::journal::Event;
use tandem_store::program_store::{ChangeResult, Edit, EditKind, StoredProgram, called_by, signing};

use super::RuntimePort;
use super::background::CHECKS;
use crate::shared::SharedState;

// Stages and interface do not depend on each other, so each states the limit; this compares the values.
const _: () = assert!(PROGRAM_BYTES_MAX == plc_protocol::types::program::PROGRAM_BYTES_MAX);
const _: () = assert!(M_CODE_MAX == plc_protocol::types::m_code::M_CODE_MAX);

impl RuntimePort {
    pub(super) fn stored(&self, number: u16) -> Result<Arc<StoredProgram>, Refusal> {
        let store = &self.shared.store;
        let missing = || store.refuse_damaged(number).unwrap_or_else(|| no_program(number));
        store.get(number).ok_or_else(missing)
    }

    /// Returns a program for a plan. For an active program, returns the text that runs, even if its file has changed.
    pub(super) fn planned(
        &self,
        number: u16,
        cs: Option<CoordinateSystemNumber>,
    ) -> Result<Arc<StoredProgram>, Refusal> {
        let running = self.previews.running(number, cs);
        running.map_or_else(|| self.stored(number), Ok)
    }

    pub(super) fn read_program(&self, number: u16) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        Ok(Answer::ProgramText(program.text().to_owned()))
    }

    pub(super) fn fetch_program(&self, number: u16) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        Ok(Answer::Program(ProgramText {
            text: program.text().to_owned(),
            hash: program.checksum().to_owned(),
        }))
    }

    pub(super) async fn store_program(&self, number: u16, upload: ProgramUpload) -> Result<Answer, Refusal> {
        let ProgramUpload {
            text,
            condition,
            signature,
            dialect,
        } = upload;
        let rules = self.shared.store.rules_of(dialect.as_deref());
        let rules = rules.map_err(|why| Refusal::new(RefusalCode::Invalid, why))?;
        refuse_too_large(&text)?;
        let signature = signature.map(|text| {
            let refusal =
                "the signature must be 64 bytes in Base64, as from openssl pkeyutl -sign -rawin | base64 -w0";
            signing::decode_signature(&text).ok_or_else(|| Refusal::new(RefusalCode::Invalid, refusal))
        });
        let signature = signature.transpose()?;
        self.refuse_while_running(number)?;
        let store = move |shared: &SharedState| {
            let store = &shared.store;
            let program = StoredProgram::new(number, &text, rules).signed(signature, store.signers());
            noted(shared, store.store(program, &condition), |(_, edit)| {
                edit.what != EditKind::Unchanged
            })
        };
        let stored = self.on_disk(store).await?;
        let (check, edit) = stored.map_err(|refusal| self.refuse_edit("PUT", number, refusal))?;
        self.edited(edit);
        Ok(Answer::Check(check))
    }

    pub(super) async fn remove_program(
        &self,
        number: u16,
        condition: ProgramCondition,
    ) -> Result<Answer, Refusal> {
        self.refuse_while_running(number)?;
        let remove = move |shared: &SharedState| {
            let removed = shared.store.remove(number, &condition);
            noted(shared, removed, Option::is_some)
        };
        let removed = self.on_disk(remove).await?;
        let edit = removed.map_err(|refusal| self.refuse_edit("DELETE", number, refusal))?;
        let edit = edit.ok_or_else(|| no_program(number))?;
        self.edited(edit);
        Ok(Answer::Done)
    }

    /// Writes the change of a program to the journal, and makes all coordinate systems publish their states again.
    fn edited(&self, edit: Edit) {
        self.shared.record(0, Event::Program(edit));
        self.shared.wake_all();
    }

    fn refuse_edit(&self, method: &str, number: u16, refusal: Refusal) -> Refusal {
        let event = Event::Refused {
            request: format!("{method} /programs/{number}"),
            program: Some(number),
            code: refusal.code,
            text: refusal.text.clone(),
            client_id: None,
        };
        self.shared.record(0, event);
        refusal
    }

    fn refuse_while_running(&self, number: u16) -> Result<(), Refusal> {
        if let Some(refusal) = self.shared.store.refuse_because_of_run(number) {
            return Err(refusal);
        }
        for mailbox in &self.mailboxes {
            let Some(state) = self.running(mailbox.number) else {
                continue;
            };
            let is_called = |main| called_by(&self.shared.store.all(), main).contains(&number);
            if state.program.is_some_and(is_called) {
                let cs = mailbox.number;
                let text = if matches!(state.run_kind, None | Some(RunKind::Program)) {
                    format!("program {number} runs in coordinate system {cs}; stop it first")
                } else {
                    format!(
                        "program {number} belongs to the loaded program of coordinate system {cs}, which moves by hand \
                         now; wait for the end of this motion, or stop it"
                    )
                };
                return Err(Refusal::new(RefusalCode::ProgramRuns, text));
            }
        }
        Ok(())
    }

    pub(super) fn check_program(&self, number: u16) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        Ok(Answer::Check(program.check.clone()))
    }

    /// Checks a text as if it were a program of the store, without storing it.
    pub(super) async fn check_text(
        &self,
        number: u16,
        dialect: Option<&str>,
        text: String,
        user: &str,
    ) -> Result<Answer, Refusal> {
        let rules = self.shared.store.rules_of(dialect);
        let rules = rules.map_err(|why| Refusal::new(RefusalCode::Invalid, why))?;
        refuse_too_large(&text)?;
        let check = move || StoredProgram::new(number, &text, rules).check;
        let checked = if self.shared.clock.is_simulated() {
            check()
        } else {
            CHECKS.execute(&self.shared.supervisor, user, check).await?
        };
        Ok(Answer::Check(checked))
    }

    pub(super) async fn put_in_folder(&self, number: u16, folder: &ProgramFolder) -> Result<Answer, Refusal> {
        let ProgramFolder { folder } = folder
            .checked()
            .map_err(|why| Refusal::new(RefusalCode::Invalid, why))?;
        let put = move |shared: &SharedState| shared.store.put_in_folder(number, &folder);
        if self.on_disk(put).await? {
            return Ok(Answer::Done);
        }
        Err(no_program(number))
    }

    /// Parses a text as manual data input that begins in the start-up modal state.
    pub(super) fn manual(
        &self,
        cs: CoordinateSystemNumber,
        text: &ManualText,
    ) -> Result<Arc<StoredProgram>, Refusal> {
        self.mailbox(cs)?;
        if text.text.len() > MDI_BYTES_MAX {
            let text = format!(
                "the text has {} bytes; at most {MDI_BYTES_MAX} are read",
                text.text.len()
            );
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        let systems = &self.shared.machine.coordinate_systems;
        let system = systems.iter().find(|system| system.settings.number == cs);
        let rules = system.map(ConfiguredSystem::text_rules);
        let rules = rules.unwrap_or_else(|| self.shared.machine.text_rules());
        let end = rules.dialect.m_code(Role::End).map_or("", |code| code.code);
        let program = StoredProgram::manual(&format!("{}\n{end}\n", text.text), rules, false);
        Ok(Arc::new(program))
    }

    pub(super) async fn intermediate_code(&self, number: u16, user: &str) -> Result<Answer, Refusal> {
        let program = self.stored(number)?;
        if program.has_errors() {
            let text = format!("program {number} has errors; correct them first");
            return Err(Refusal {
                diagnostics: program.check.diagnostics.clone(),
                ..Refusal::new(RefusalCode::ProgramHasErrors, text)
            });
        }
        let code = self.search(user, move || program.intermediate_code()).await?;
        Ok(Answer::ProgramText(code))
    }
}

/// Records in the health of the program folder whether a write succeeded.
fn noted<T>(
    shared: &SharedState,
    changed: ChangeResult<T>,
    is_written: impl Fn(&T) -> bool,
) -> ChangeResult<T> {
    match &changed {
        Ok(Ok(done)) if is_written(done) => shared.record_attempt(DataFolderPart::Programs, Ok(()))?,
        Ok(_) => {}
        Err(_) => return shared.record_attempt(DataFolderPart::Programs, changed),
    }
    changed
}

fn refuse_too_large(text: &str) -> Result<(), Refusal> {
    if text.len() <= PROGRAM_BYTES_MAX {
        return Ok(());
    }
    let text = format!(
        "the program has {} bytes; at most {PROGRAM_BYTES_MAX} are read",
        text.len()
    );
    Err(Refusal::new(RefusalCode::TooLarge, text))
}

fn no_program(number: u16) -> Refusal {
    Refusal::new(
        RefusalCode::NotFound,
        format!("program {number} is not in the store"),
    )
}
