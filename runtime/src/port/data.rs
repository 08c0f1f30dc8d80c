//! Requests for variables, tools and work offsets.

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{CommandMeta, CommandReply, CommandStatus};
use plc_protocol::types::data::{JOURNAL_LINES_MAX, JournalFilter, VariableArea, VariableValues};
use plc_protocol::types::ids::check_command;
use plc_protocol::types::io::{IoPoint, IoSet, IoValue};
use plc_protocol::types::message::Payload;
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use plc_protocol::types::topic::Topic;
use tandem_store::journal::LineFilter;
use tandem_store::persistence::journal_folder::{JOURNAL_FOLDER, newest};
use tandem_store::persistence::journal_query::newest_of;
use tandem_store::tables::{KeptValues, Tables, Values, keep};

use super::RuntimePort;
use super::sender::Sender;
use crate::command_memory::CommandContent;
use crate::shared::SharedState;
use crate::state_writer::StateWriter;

impl RuntimePort {
    pub(super) fn last_run(&self, cs: CoordinateSystemNumber) -> Result<Answer, Refusal> {
        self.mailbox(cs)?;
        Ok(Answer::LastRun(
            self.last_runs.get(&cs).map(|kept| kept.run.clone()),
        ))
    }

    /// Reads journal lines from the disk. Lines of the last 20 ms may be missing.
    pub(super) async fn journal(
        &self,
        from: u32,
        count: u32,
        filter: JournalFilter,
        user: &str,
    ) -> Result<Answer, Refusal> {
        if !(1..=JOURNAL_LINES_MAX).contains(&count) {
            let text = format!("{count} lines of the journal: write 1 to {JOURNAL_LINES_MAX}");
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        let Some(folder) = &self.shared.machine.data_dir else {
            let text = "without data_dir the journal goes to the log only; set [machine] data_dir";
            return Err(Refusal::new(RefusalCode::NotFound, text));
        };
        let folder = self.shared.disk.at(folder).join(JOURNAL_FOLDER);
        let (from, count) = (from as usize, count as usize);
        if filter == JournalFilter::default() {
            let read = move |_: &SharedState| Ok(newest(&folder, from, count).lines);
            return self.on_disk(read).await.map(Answer::Journal);
        }
        let filter = LineFilter::new(&filter, self.shared.clock.wall());
        let mut filter = filter.map_err(|text| Refusal::new(RefusalCode::Invalid, text))?;
        let read = move || newest_of(&folder, &mut filter, from, count);
        self.search(user, read).await.map(Answer::Journal)
    }

    /// Changes tools or work offsets. The new values are on disk before they take effect, and take effect before the
    /// answer. If the request has become too old when they would take effect, the previous values are stored again.
    pub(super) async fn change(
        &self,
        not_after: Option<NotAfter>,
        changed: impl FnOnce(&Tables) -> Result<Values, Refusal> + Send + 'static,
    ) -> Result<Answer, Refusal> {
        let writer = self.writer.clone();
        let keep_and_set = move |shared: &SharedState| {
            let check = || shared.check_not_after(not_after.as_ref());
            let keep = |values, before| match &writer {
                Some(writer) => keep_unless_expired(values, before, |values| writer.write(values), check),
                None => check(),
            };
            let changed = shared.tables.change(changed, keep);
            shared.publish_tables();
            Ok(changed)
        };
        self.on_disk(keep_and_set).await?.map(|()| Answer::Done)
    }

    /// Writes an input or output of the plant. If its last value is kept, the value is on disk before it takes effect.
    /// If the request has become too old when it would take effect, the previous value is stored again.
    pub(super) async fn write_io(
        &self,
        point: IoPoint,
        set: IoSet,
        not_after: Option<NotAfter>,
    ) -> Result<Answer, Refusal> {
        let writer = self.writer.as_ref();
        let Some(writer) = writer.filter(|_| self.shared.machine.io.keeps_last(&point)) else {
            return self.shared.write_io(&point, set).map(|()| Answer::Done);
        };
        let _one_after_the_other = self.io_turn.lock().await;
        self.shared.check_not_after(not_after.as_ref())?;
        let before = self.shared.check_io(&point, &set)?;
        let (value, keep) = (set.value, |value| self.keep_output(writer, &point, value));
        let write = || {
            self.shared.check_not_after(not_after.as_ref())?;
            self.shared.write_io(&point, set)
        };
        write_after_keeping(value, before, keep, write).await?;
        Ok(Answer::Done)
    }

    async fn keep_output(
        &self,
        writer: &StateWriter,
        point: &IoPoint,
        value: IoValue,
    ) -> Result<(), Refusal> {
        let (writer, mut values) = (writer.clone(), KeptValues::new());
        keep(&mut values, point.to_string(), &value);
        let kept = self.on_disk(move |_| Ok(writer.write(values))).await?;
        kept.map_err(|text| unkept(&text))
    }

    /// Sets the tool in the spindle. The new number is on disk before the answer.
    pub(super) async fn tool(
        &self,
        cs: CoordinateSystemNumber,
        id: u16,
        not_after: Option<NotAfter>,
    ) -> Result<Answer, Refusal> {
        let answer = self
            .mailbox(cs)?
            .ask_not_after(CoordinateSystemRequest::Tool(id), not_after)
            .await?;
        if let Some(writer) = &self.writer {
            writer.flush().await.map_err(|text| unkept(&text))?;
        }
        Ok(answer)
    }

    pub(super) fn read_variables(
        &self,
        area: VariableArea,
        from: u32,
        count: u32,
        meta: Option<CommandMeta>,
    ) -> Result<Answer, Refusal> {
        let read = || self.shared.tables.read_variables(area, from, count);
        let Some(meta) = meta else {
            return read().map(Answer::Variables);
        };
        check_command(&meta.client_id, &meta.command_id)?;
        let values = self
            .check_age(&meta)
            .and_then(|()| read())
            .map_err(|refusal| self.shared.reject(area.coordinate_system(), &meta, refusal))?;
        let said = VariableValues::new(area.kind(), from, values.iter().copied());
        let reply = CommandReply {
            variables: Some(said),
            ..(self.shared).reply_to(area.coordinate_system(), &meta, CommandStatus::Done, "ok", "")
        };
        self.shared
            .publish(Topic::Reply(meta.client_id), Payload::Reply(reply));
        Ok(Answer::Variables(values))
    }

    pub(super) fn write_variables(
        &self,
        area: VariableArea,
        from: u32,
        values: &[f64],
        meta: Option<CommandMeta>,
        sender: Sender,
    ) -> Result<Answer, Refusal> {
        let write = || {
            self.shared.tables.write_variables(area, from, values)?;
            self.shared.publish_variables_simulated();
            Ok(())
        };
        let Some(meta) = meta else {
            return write().map(|()| Answer::Done);
        };
        let mut meta = meta.limited(sender.not_after);
        let asked = CommandContent::new("variable/set".to_owned(), &(area, from, values));
        meta.memory = asked.key(sender.user, &meta.command_id);
        if let Some(reply) = self.replied_again(&meta, area.coordinate_system(), asked)? {
            return Ok(Answer::Command(reply));
        }
        self.check_age(&meta)
            .and_then(|()| write())
            .map_err(|refusal| self.shared.reject(area.coordinate_system(), &meta, refusal))?;
        let reply = (self.shared).reply_to(area.coordinate_system(), &meta, CommandStatus::Done, "ok", "");
        Ok(Answer::Command(self.shared.reply(&meta, reply)))
    }
}

/// Stores the new value of an output, and then writes the output. If the write is refused, because the owner of the
/// point has changed or the request has become too old meanwhile, stores the value of `before` again.
async fn write_after_keeping<V, Kept: Future<Output = Result<(), Refusal>>>(
    value: V,
    before: V,
    keep: impl Fn(V) -> Kept,
    write: impl FnOnce() -> Result<(), Refusal>,
) -> Result<(), Refusal> {
    keep(value).await?;
    let written = write();
    if written.is_err() {
        keep(before).await?;
    }
    written
}

/// Writes values to disk. If the request has become too old during the write, writes the values of `before` instead.
fn keep_unless_expired<V>(
    values: V,
    before: V,
    write: impl Fn(V) -> Result<(), String>,
    check: impl Fn() -> Result<(), Refusal>,
) -> Result<(), Refusal> {
    let write = |values| write(values).map_err(|text| unkept(&text));
    check()?;
    write(values)?;
    match check() {
        Ok(()) => Ok(()),
        Err(refusal) => write(before).and(Err(refusal)),
    }
}

fn unkept(text: &str) -> Refusal {
    Refusal::new(
        RefusalCode::Unavailable,
        format!("the value cannot be stored: {text}"),
    )
}

#[cfg(test)]
mod tests {
    use std::cell::{Cell, RefCell};
    use std::future::ready;

    use super::*;

    #[tokio::test]
    async fn p4_output_whose_request_expires_during_the_disk_wait_is_undone() {
        for (is_expired, stored) in [(false, vec!["on"]), (true, vec!["on", "off"])] {
            let (disk, output) = (RefCell::new(Vec::new()), Cell::new("off"));
            let age_passed = Cell::new(false);
            let keep = |value| {
                disk.borrow_mut().push(value);
                age_passed.set(is_expired);
                ready(Ok(()))
            };
            let write = || {
                if age_passed.get() {
                    return Err(Refusal::new(RefusalCode::Expired, "too old"));
                }
                output.set("on");
                Ok(())
            };
            let written = write_after_keeping("on", "off", keep, write).await;
            let code = written.err().map(|refusal| refusal.code);
            assert_eq!(code, is_expired.then_some(RefusalCode::Expired));
            assert_eq!(*disk.borrow(), stored);
            assert_eq!(output.get(), if is_expired { "off" } else { "on" });
        }
    }

    #[test]
    fn p4_request_that_expires_during_a_disk_write_is_undone() {
        for (expires_after, written, is_kept) in [
            (9, vec!["new"], true),
            (1, vec!["new", "old"], false),
            (0, vec![], false),
        ] {
            let (checks, disk) = (Cell::new(0), RefCell::new(Vec::new()));
            let write = |values| {
                disk.borrow_mut().push(values);
                Ok(())
            };
            let check = || {
                let is_expired = checks.replace(checks.get() + 1) >= expires_after;
                if is_expired {
                    return Err(Refusal::new(RefusalCode::Expired, "too old"));
                }
                Ok(())
            };
            let kept = keep_unless_expired("new", "old", write, check);
            let code = kept.err().map(|refusal| refusal.code);
            assert_eq!(code, (!is_kept).then_some(RefusalCode::Expired));
            assert_eq!(*disk.borrow(), written);
        }
    }
}
