//! Data and functions that each part of a coordinate system needs: number, settings and shared state, and functions to
//! publish, reply and warn.

use std::sync::Arc;

use plc_protocol::handshake::Now;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{CommandMeta, CommandReply, CommandStatus};
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::Refusal;
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_config::{ConfiguredSystem, MCodeSettings};
use tandem_model::alarm::AlarmEntry;
use tandem_model::{Origin, Variables};
use tandem_store::journal::Event;
use tandem_store::program_store::StoredProgram;

use super::publish::view::View;
use crate::shared::SharedState;

/// Number, settings and shared state of a coordinate system.
pub(crate) struct Context {
    pub number: CoordinateSystemNumber,
    pub configured: ConfiguredSystem,
    pub shared: Arc<SharedState>,
    pub view: Arc<View>,
    pub variables: Variables,
}

impl Context {
    pub fn now(&self) -> Now {
        self.shared.now()
    }

    /// Returns the seconds since the start of the runtime.
    pub fn now_s(&self) -> f64 {
        self.shared.clock.now_s()
    }

    /// Returns the name of the n-th run since the start of the runtime. No run of any earlier start has the same name.
    pub fn run_id(&self, n: u64) -> String {
        format!("{}-{}-{n}", self.shared.boot_id.0, self.number)
    }

    /// Writes a line to the journal.
    pub fn record(&self, event: Event) {
        self.shared.record(self.number, event);
    }

    /// Reports an internal event that no state expects: in the journal, and in a debug build also by a panic.
    pub fn report_inconsistency(&self, text: &str) {
        self.record(Event::Inconsistency {
            text: text.to_owned(),
        });
        debug_assert!(false, "{text}");
    }

    /// Publishes an event, or a state that has changed.
    pub fn publish(&self, topic: CsTopic, payload: Payload) {
        self.shared.publish(Topic::cs(self.number, topic), payload);
    }

    /// Returns the settings of an M code; `None` if it has no settings of its own.
    pub fn m_code(&self, m: u16) -> Option<&MCodeSettings> {
        self.shared.machine.m_codes.get(&m)
    }

    /// Returns the number of active alarms of this coordinate system and of the whole machine. Warnings do not count.
    pub fn alarm_count(&self) -> u32 {
        self.shared.alarm_count(self.number)
    }

    /// Returns a reply to a command, without publishing it.
    pub fn reply_to(
        &self,
        meta: &CommandMeta,
        status: CommandStatus,
        code: &str,
        text: &str,
    ) -> CommandReply {
        self.shared.reply_to(Some(self.number), meta, status, code, text)
    }

    /// Publishes a reply to a command and stores it for repeated requests.
    pub fn reply(&self, meta: &CommandMeta, status: CommandStatus, code: &str, text: &str) -> CommandReply {
        let reply = self.reply_to(meta, status, code, text);
        self.shared.reply(meta, reply)
    }

    /// Publishes and stores a reply to a command that loads or starts a program.
    pub fn reply_with_program(
        &self,
        meta: &CommandMeta,
        reply: CommandReply,
        program: Option<&StoredProgram>,
        run_id: Option<&str>,
    ) -> CommandReply {
        let reply = CommandReply {
            hash: program.map(|program| program.checksum().to_owned()),
            run_id: run_id.map(str::to_owned),
            ..reply
        };
        self.shared.reply(meta, reply)
    }

    /// Publishes and stores the refusal of a command, and returns it.
    pub fn reject(&self, meta: &CommandMeta, refusal: Refusal) -> Refusal {
        self.shared.reject(Some(self.number), meta, refusal)
    }

    /// Raises a warning with the number and title of a row of the alarm table.
    pub fn warn_of(&self, entry: &AlarmEntry, origin: Origin, text: &str) {
        self.warn(entry.number, origin, format!("{}: {text}", entry.title));
    }

    /// Raises a warning that stays active until a reset. `cs` is the coordinate system, or `None` for the whole
    /// machine.
    pub fn warn_standing(&self, entry: &AlarmEntry, cs: Option<CoordinateSystemNumber>, text: &str) {
        let record = self.shared.raise_standing(AlarmRecord {
            severity: AlarmSeverity::Warning,
            number: entry.number,
            text: format!("{}: {text}", entry.title),
            cs,
            ..AlarmRecord::default()
        });
        self.record(Event::Warning {
            program: None,
            line: None,
            text: record.text,
        });
    }

    /// Raises an alarm of severity warning, which stops nothing.
    pub fn warn(&self, number: u16, origin: Origin, text: String) {
        let record = self.shared.raise(AlarmRecord {
            severity: AlarmSeverity::Warning,
            number,
            text,
            cs: Some(self.number),
            program: Some(origin.program),
            line: Some(origin.line),
            column: Some(origin.column),
            ..AlarmRecord::default()
        });
        self.record(Event::Warning {
            program: record.program,
            line: record.line,
            text: record.text,
        });
    }
}
