//! Commands: repeated ones are answered from memory, expired ones refused, all others go to the task.

use std::time::Duration;

use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use plc_api::types::ids::check_command;
use plc_api::types::lease::LeaseRequest;
use plc_api::types::message::Payload;
use plc_api::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use plc_api::types::topic::Topic;

use super::RuntimePort;
use crate::command_memory::{Asked, Recalled};

impl RuntimePort {
    pub(super) async fn command(
        &self,
        cs: CoordinateSystemNumber,
        command: Command,
        meta: CommandMeta,
        wait: bool,
    ) -> Result<Answer, Refusal> {
        let asked = Asked::command(cs, &command, &meta.client_id);
        if let Some(reply) = self.replied_again(&meta, Some(cs), asked)?
            && !(wait && reply.status == CommandStatus::Accepted)
        {
            return Ok(Answer::Command(reply));
        }
        let reject = |refusal| self.shared.reject(Some(cs), &meta, refusal);
        let mailbox = self.mailbox(cs).map_err(reject)?;
        self.check_age(&meta).map_err(reject)?;
        if let Command::AlarmAcknowledge { id } = command
            && !self.shared.acknowledge_alarm(id, &meta.client_id)
        {
            let text = format!("no alarm {id} is active");
            return Err(reject(Refusal::new(RefusalCode::NotFound, text)));
        }
        let urgent = command.is_urgent();
        let request = CoordinateSystemRequest::Command { command, meta, wait };
        mailbox.ask(request, urgent).await
    }

    pub(super) async fn lease(
        &self,
        cs: CoordinateSystemNumber,
        request: LeaseRequest,
        meta: CommandMeta,
    ) -> Result<Answer, Refusal> {
        let asked = Asked::new(format!("the lease of coordinate system {cs}"), &(cs, &request));
        if let Some(reply) = self.replied_again(&meta, Some(cs), asked)? {
            return Ok(Answer::Command(reply));
        }
        let mailbox = self
            .mailbox(cs)
            .map_err(|refusal| self.shared.reject(Some(cs), &meta, refusal))?;
        let request = CoordinateSystemRequest::Lease { request, meta };
        mailbox.ask(request, false).await
    }

    /// The reply to a command that came before; published again, since a caller that repeats a command has not got it.
    ///
    /// # Errors
    /// The names are refused, or another command came before under its id, whose reply stays.
    pub(super) fn replied_again(
        &self,
        meta: &CommandMeta,
        cs: Option<CoordinateSystemNumber>,
        asked: Asked,
    ) -> Result<Option<CommandReply>, Refusal> {
        check_command(&meta.client_id, &meta.command_id)?;
        let (reply, answer) = match self.shared.recall(&meta.command_id, asked) {
            Recalled::New | Recalled::Again(None) => return Ok(None),
            Recalled::Again(Some(reply)) => (reply.clone(), Ok(Some(reply))),
            Recalled::OtherCommand(words) => {
                let text = format!(
                    "command_id \"{:.64}\" is that of another command: {words}; take a new one for each command",
                    meta.command_id
                );
                let refusal = Refusal::new(RefusalCode::CommandIdReused, text);
                (self.shared.rejection(cs, meta, &refusal), Err(refusal))
            }
        };
        let topic = Topic::Reply(meta.client_id.clone());
        self.shared.publish(topic, Payload::Reply(reply));
        answer
    }

    pub(super) fn check_age(&self, meta: &CommandMeta) -> Result<(), Refusal> {
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
