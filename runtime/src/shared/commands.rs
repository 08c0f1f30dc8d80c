//! Commands of all coordinate systems: command memory, age limits and replies.

use std::collections::BTreeMap;

use plc_protocol::execution::wire_name;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{CommandMeta, CommandReply, CommandStatus, MemoryKey};
use plc_protocol::types::heartbeat::Heartbeat;
use plc_protocol::types::message::Payload;
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::topic::{CsTopic, Topic};

use super::SharedState;
use crate::command_memory::{CommandContent, CommandLookup};

impl SharedState {
    /// Looks up a command in the command memory, and stores it if it is new.
    pub fn recall(&self, key: &MemoryKey, asked: CommandContent) -> CommandLookup {
        self.commands.lock().recall(key, asked, self.clock.wall())
    }

    /// Looks up a command in the command memory.
    pub fn look_up(&self, key: &MemoryKey, asked: &CommandContent) -> CommandLookup {
        self.commands.lock().look_up(key, asked, self.clock.wall())
    }

    /// Records the time at which a heartbeat is sent, and returns the heartbeat.
    pub fn note_heartbeat(&self, heartbeat: Heartbeat) -> Heartbeat {
        let now = self.clock.real_time();
        self.heartbeats.lock().record_heartbeat(heartbeat.cycle, now);
        heartbeat
    }

    /// Refuses a request if it is older than its age limit, or was made before this start of the runtime.
    pub fn check_not_after(&self, not_after: Option<&NotAfter>) -> Result<(), Refusal> {
        let Some(not_after) = not_after else { return Ok(()) };
        let expired = |text: &str| Err(Refusal::new(RefusalCode::Expired, text));
        if not_after.boot_id != self.boot_id {
            return expired(
                "the runtime was restarted after the request was made: nothing was done; inspect the \
                 machine, then \
                 send a new request",
            );
        }
        let now = self.clock.real_time();
        let checked = self.heartbeats.lock().check(not_after, now);
        checked.or_else(|text| expired(&text))
    }

    /// Returns the revision of a coordinate system's state; 0 without a coordinate system or a state.
    pub fn state_rev(&self, cs: Option<CoordinateSystemNumber>) -> u64 {
        cs.and_then(|cs| self.hub.read(&Topic::cs(cs, CsTopic::State)))
            .and_then(|state| state.rev)
            .unwrap_or(0)
    }

    /// Returns a reply to a command. The reply contains the revision of the state of coordinate system `cs`.
    pub fn reply_to(
        &self,
        cs: Option<CoordinateSystemNumber>,
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
            state_rev: self.state_rev(cs),
            variables: None,
            lease: None,
            hash: None,
            run_id: None,
            moved: BTreeMap::new(),
        }
    }

    /// Returns the reply to a refused command.
    pub fn rejection(
        &self,
        cs: Option<CoordinateSystemNumber>,
        meta: &CommandMeta,
        refusal: &Refusal,
    ) -> CommandReply {
        let code = wire_name(&refusal.code);
        self.reply_to(cs, meta, CommandStatus::Rejected, &code, &refusal.text)
    }

    /// Stores and publishes the reply to a refused command, and returns the refusal.
    pub fn reject(
        &self,
        cs: Option<CoordinateSystemNumber>,
        meta: &CommandMeta,
        refusal: Refusal,
    ) -> Refusal {
        self.reply(meta, self.rejection(cs, meta, &refusal));
        refusal
    }

    /// Stores and publishes the reply to a command.
    pub fn reply(&self, meta: &CommandMeta, reply: CommandReply) -> CommandReply {
        self.commands
            .lock()
            .on_reply(&meta.memory, &reply, self.clock.wall());
        self.publish(
            Topic::Reply(meta.client_id.clone()),
            Payload::Reply(reply.clone()),
        );
        reply
    }

    /// Returns the last stored reply to a command.
    pub fn replied(&self, key: &MemoryKey) -> Option<CommandReply> {
        self.commands.lock().reply(key).cloned()
    }

    /// Returns the last reply to the command with this id: of this user, otherwise of any user.
    pub fn find_reply(&self, user: &str, command_id: &str) -> Option<CommandReply> {
        self.commands.lock().find_reply(user, command_id).cloned()
    }
}
