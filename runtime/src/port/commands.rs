//! Commands. Repeated commands are answered from memory, expired commands are refused, and all others go to the task.

use std::time::Duration;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use plc_protocol::types::ids::check_command;
use plc_protocol::types::lease::LeaseRequest;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use plc_protocol::types::run::RunOrder;
use plc_protocol::types::topic::Topic;
use tandem_store::order_key::OrderKey;

use super::RuntimePort;
use crate::command_memory::{CommandContent, CommandLookup, memory_is_full};

/// Knowledge about a received command from the command memory.
#[expect(
    clippy::large_enum_variant,
    reason = "the value lives only while one command is looked up"
)]
enum KnownCommand {
    New,
    /// The command is repeated and has no reply yet.
    Pending,
    /// The command is repeated; its stored reply.
    Replied(CommandReply),
}

impl RuntimePort {
    pub(super) async fn command(
        &self,
        cs: CoordinateSystemNumber,
        command: Command,
        mut meta: CommandMeta,
        wait: bool,
        user: String,
    ) -> Result<Answer, Refusal> {
        let asked = CommandContent::command(cs, &command, &meta.client_id);
        meta.memory = asked.key(user, &meta.command_id);
        meta.not_after = meta.not_after.filter(|_| !command.brings_to_rest());
        let known = self.replied_before(&command, &meta, cs, asked)?;
        if let KnownCommand::Replied(reply) = &known
            && !(wait && reply.status == CommandStatus::Accepted)
        {
            return Ok(Answer::Command(reply.clone()));
        }
        let reject = |refusal| self.shared.reject(Some(cs), &meta, refusal);
        let mailbox = self.mailbox(cs).map_err(reject)?;
        // The repetition of a command that is pending never replaces the reply to it, and has no second effect here.
        if matches!(known, KnownCommand::New) {
            self.check_age(&meta).map_err(reject)?;
            if let Command::AlarmAcknowledge { id } = command
                && !self.shared.acknowledge_alarm(id, &meta.client_id)
            {
                let text = format!("no alarm {id} is active");
                return Err(reject(Refusal::new(RefusalCode::NotFound, text)));
            }
        }
        let urgent = command.is_urgent();
        let request = CoordinateSystemRequest::Command { command, meta, wait };
        mailbox.ask(request, urgent).await
    }

    /// Returns the reply to a repeated command. Only the begin of a jog is stored. Its
    /// refreshes and its end are not stored, because they would fill the memory and their repetition has no effect. The
    /// order of a run is known as long as the run is stored.
    fn replied_before(
        &self,
        command: &Command,
        meta: &CommandMeta,
        cs: CoordinateSystemNumber,
        asked: CommandContent,
    ) -> Result<KnownCommand, Refusal> {
        check_command(&meta.client_id, &meta.command_id)?;
        if let Command::Run(order) = command
            && self.shared.look_up(&meta.memory, &asked) == CommandLookup::New
            && let Some(ordered) = self.ordered_before(cs, *order, meta)?
        {
            return Ok(KnownCommand::Replied(ordered));
        }
        match command {
            Command::JogEnd { .. } => Ok(KnownCommand::New),
            Command::Jog { .. } => {
                let recalled = self.shared.look_up(&meta.memory, &asked);
                self.reply_again(recalled, meta, Some(cs))
            }
            _ => self.reply_again(self.shared.recall(&meta.memory, asked), meta, Some(cs)),
        }
    }

    /// Returns the reply to an order that is no longer in the memory, if its run is stored. The run may be of an
    /// earlier start of the runtime.
    fn ordered_before(
        &self,
        cs: CoordinateSystemNumber,
        order: RunOrder,
        meta: &CommandMeta,
    ) -> Result<Option<CommandReply>, Refusal> {
        let key = OrderKey::new(order, meta);
        let ordered = self
            .shared
            .runs
            .lock()
            .ordered(&key)
            .map(|(run, order)| (run.id.clone(), run.hash.clone(), run.cs == cs && *order == key));
        let Some((run_id, hash, is_same)) = ordered else {
            return Ok(None);
        };
        if !is_same {
            let words = format!("the order of run {run_id}");
            return Err(self.refuse_reuse(&words, meta, Some(cs)));
        }
        let text = format!("this order already started run {run_id}; GET /runs/{run_id} shows its progress");
        let reply = self
            .shared
            .reply_to(Some(cs), meta, CommandStatus::Done, "ok", &text);
        let reply = CommandReply {
            run_id: Some(run_id),
            hash,
            ..reply
        };
        self.publish_reply(meta, &reply);
        Ok(Some(reply))
    }

    pub(super) async fn lease(
        &self,
        cs: CoordinateSystemNumber,
        request: LeaseRequest,
        mut meta: CommandMeta,
        user: String,
    ) -> Result<Answer, Refusal> {
        let asked = CommandContent::new(format!("the lease of coordinate system {cs}"), &(cs, &request));
        meta.memory = asked.key(user, &meta.command_id);
        if let Some(reply) = self.replied_again(&meta, Some(cs), asked)? {
            return Ok(Answer::Command(reply));
        }
        let mailbox = self
            .mailbox(cs)
            .map_err(|refusal| self.shared.reject(Some(cs), &meta, refusal))?;
        let request = CoordinateSystemRequest::Lease { request, meta };
        mailbox.ask(request, false).await
    }

    /// Returns the reply to a repeated command and publishes it again, because the client may not have received it.
    /// Stores a new command and returns `None`.
    ///
    /// # Errors
    /// Returns an error if the client id or the command id is invalid, or if the memory for commands is full. Also
    /// returns an error if a different earlier command has this command id; the reply to that command stays unchanged.
    pub(super) fn replied_again(
        &self,
        meta: &CommandMeta,
        cs: Option<CoordinateSystemNumber>,
        asked: CommandContent,
    ) -> Result<Option<CommandReply>, Refusal> {
        check_command(&meta.client_id, &meta.command_id)?;
        match self.reply_again(self.shared.recall(&meta.memory, asked), meta, cs)? {
            KnownCommand::Replied(reply) => Ok(Some(reply)),
            KnownCommand::New | KnownCommand::Pending => Ok(None),
        }
    }

    fn reply_again(
        &self,
        recalled: CommandLookup,
        meta: &CommandMeta,
        cs: Option<CoordinateSystemNumber>,
    ) -> Result<KnownCommand, Refusal> {
        match recalled {
            CommandLookup::New => Ok(KnownCommand::New),
            CommandLookup::Again(None) => Ok(KnownCommand::Pending),
            CommandLookup::Again(Some(reply)) => {
                self.publish_reply(meta, &reply);
                Ok(KnownCommand::Replied(reply))
            }
            CommandLookup::OtherCommand(words) => Err(self.refuse_reuse(&words, meta, cs)),
            CommandLookup::Full => {
                let refusal = memory_is_full();
                self.publish_reply(meta, &self.shared.rejection(cs, meta, &refusal));
                Err(refusal)
            }
        }
    }

    fn refuse_reuse(&self, words: &str, meta: &CommandMeta, cs: Option<CoordinateSystemNumber>) -> Refusal {
        let text = format!(
            "command_id \"{:.64}\" belongs to another command: {words}; use a new command_id for each command",
            meta.command_id
        );
        let refusal = Refusal::new(RefusalCode::CommandIdReused, text);
        self.publish_reply(meta, &self.shared.rejection(cs, meta, &refusal));
        refusal
    }

    /// Publishes a reply and leaves the stored one unchanged.
    fn publish_reply(&self, meta: &CommandMeta, reply: &CommandReply) {
        let topic = Topic::Reply(meta.client_id.clone());
        self.shared.publish(topic, Payload::Reply(reply.clone()));
    }

    pub(super) fn check_age(&self, meta: &CommandMeta) -> Result<(), Refusal> {
        self.shared.check_not_after(meta.not_after.as_ref())?;
        let invalid = |text: String| Err(Refusal::new(RefusalCode::Invalid, text));
        let Some(ttl_ms) = meta.ttl_ms else { return Ok(()) };
        let Some(issued_at) = &meta.issued_at else {
            return invalid("ttl_ms needs issued_at".into());
        };
        let Some(issued) = issued_at.to_system_time() else {
            return invalid(format!(
                "issued_at \"{:.64}\": write RFC 3339 in UTC",
                issued_at.0
            ));
        };
        let age = self
            .shared
            .clock
            .wall()
            .duration_since(issued)
            .unwrap_or_default();
        if age > Duration::from_millis(ttl_ms) {
            let text = format!(
                "the command is {} ms old, its ttl_ms is {ttl_ms}",
                age.as_millis()
            );
            return Err(Refusal::new(RefusalCode::Expired, text));
        }
        Ok(())
    }
}
