//! What each part of a coordinate system needs: which one it is, what it shares with the others, and what is said of it.

use std::sync::Arc;

use plc_api::handshake::Now;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::{CommandMeta, CommandReply, CommandStatus};
use plc_api::types::machine::{AlarmRecord, AlarmSeverity};
use plc_api::types::message::Payload;
use plc_api::types::topic::{CsTopic, Topic};
use tandem_model::alarm::AlarmEntry;
use tandem_model::{Origin, Variables};

use super::view::View;
use crate::config::{CoordinateSystem as Configured, MCodeSettings};
use crate::journal::Event;
use crate::shared::Shared;

/// A coordinate system to those who speak for it.
pub(super) struct Context {
    pub number: CoordinateSystemNumber,
    pub configured: Configured,
    pub shared: Arc<Shared>,
    pub view: Arc<View>,
    pub variables: Variables,
}

impl Context {
    pub fn now(&self) -> Now {
        self.shared.now()
    }

    /// Seconds since the start.
    pub fn now_s(&self) -> f64 {
        self.shared.clock.now_s()
    }

    /// Writes a line of the journal.
    pub fn record(&self, event: Event) {
        self.shared.record(self.number, event);
    }

    /// Publishes an event, or a state that has changed.
    pub fn publish(&self, topic: CsTopic, payload: Payload) {
        self.shared.publish(Topic::cs(self.number, topic), payload);
    }

    /// Settings of an M code; `None`: those of any other.
    pub fn m_code(&self, m: u16) -> Option<&MCodeSettings> {
        self.shared.machine.m_codes.get(&m)
    }

    /// Active alarms of this coordinate system and of all.
    pub fn alarm_count(&self) -> u32 {
        self.shared.alarm_count(self.number)
    }

    /// Revision of the state that was published last.
    pub fn state_rev(&self) -> u64 {
        let state = self.shared.hub.read(&Topic::cs(self.number, CsTopic::State));
        state.and_then(|message| message.rev).unwrap_or(0)
    }

    /// A reply to a command.
    pub fn reply_to(
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

    /// Publishes a reply to a command, and keeps it.
    pub fn reply(&self, meta: &CommandMeta, status: CommandStatus, code: &str, text: &str) -> CommandReply {
        let reply = self.reply_to(meta, status, code, text);
        self.shared.reply(&meta.client_id, reply.clone());
        reply
    }

    /// A warning of the alarm table.
    pub fn warn_of(&self, entry: &AlarmEntry, origin: Origin, text: &str) {
        self.warn(entry.number, origin, format!("{}: {text}", entry.title));
    }

    /// An alarm of severity warning, which stops nothing.
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
