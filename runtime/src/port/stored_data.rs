//! The decision of a person about stored files that are inconsistent.

use std::io;

use plc_protocol::types::request::{Answer, Refusal, RefusalCode};
use plc_protocol::types::stored_data::{StoredDataDecision, StoredDataFault};
use tandem_store::journal::Event;
use tandem_store::persistence::{Image, restore};
use tandem_store::stored_data::OpenQuestion;
use tandem_store::tables::Tables;

use super::RuntimePort;
use crate::shared::SharedState;

impl RuntimePort {
    /// Executes the decision. The accepted data are on disk and in effect before the question is closed.
    pub(super) async fn answer_stored_data(&self, decision: StoredDataDecision) -> Result<Answer, Refusal> {
        // a copy, because each start of a program needs the lock and must not wait for the disk
        let open = self.shared.stored_data.lock().clone();
        let Some(question) = open.question().cloned() else {
            let text = "no question about stored files is open; GET /stored_data shows it";
            return Err(Refusal::new(RefusalCode::NotAllowed, text));
        };
        if decision == StoredDataDecision::Accept {
            self.take_held_back(&open).await?;
        }
        self.on_disk(move |_| open.remove_files()).await?;
        *self.shared.stored_data.lock() = OpenQuestion::default();
        let event = Event::StoredData {
            decision: Some(decision),
            findings: question.texts(),
        };
        self.shared.record(0, event);
        self.shared.publish_stored_data();
        self.shared.report_question();
        self.shared.wake_all();
        Ok(Answer::Done)
    }

    /// Accepts the withheld data: stored values that replace lost values, programs, and folders.
    async fn take_held_back(&self, open: &OpenQuestion) -> Result<(), Refusal> {
        let (values, fault) = (open.clone(), open.fault_of_store());
        let read = move |shared: &SharedState| {
            let Some(fault) = fault else { return Ok(None) };
            match values.held_values(&shared.machine.name) {
                // if the question itself was damaged, there may be no withheld values
                Err(error)
                    if fault == StoredDataFault::NotVerified && error.kind() == io::ErrorKind::NotFound =>
                {
                    Ok(None)
                }
                read => read.map(Some),
            }
        };
        if let Some(image) = self.on_disk(read).await? {
            self.take_held_values(&image).await?;
        }
        let folders = open.held_folders();
        let confirm = self.on_disk(move |shared| shared.store.confirm_held_back(&folders));
        for edit in confirm.await? {
            self.shared.record(0, Event::Program(edit));
        }
        Ok(())
    }

    async fn take_held_values(&self, image: &Image) -> Result<(), Refusal> {
        let held = Tables::new(self.shared.machine.table_settings());
        let restored = restore(&held, image);
        let unknown = self.shared.tables.unknown_spindles();
        let values = held.read().clone();
        self.change(None, move |tables| Ok(tables.with_lost_from(&values)))
            .await?;
        self.shared.tables.take_lost_variables(&held);
        for (cs, tool) in restored.tools_in_spindle {
            if let Some(tool) = tool.filter(|_| unknown.contains(&cs)) {
                self.tool(cs, tool, None).await?;
            }
        }
        match &self.writer {
            Some(writer) => {
                let written = writer.flush().await;
                written.map_err(|text| Refusal::new(RefusalCode::Unavailable, text))
            }
            None => Ok(()),
        }
    }
}
