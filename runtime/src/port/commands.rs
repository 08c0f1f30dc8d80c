//! Commands: repeated ones are answered from memory, expired ones refused, all others go to the task.

use std::time::Duration;

use plc_api::execution::word;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use plc_api::types::ids::check_command;
use plc_api::types::lease::LeaseRequest;
use plc_api::types::message::Payload;
use plc_api::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use plc_api::types::topic::{CsTopic, Topic};

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
        check_command(&meta.client_id, &meta.command_id)?;
        let asked = Asked::command(cs, &command, &meta.client_id);
        if let Some(reply) = self.replied_again(&meta, Some(cs), asked)?
            && !(wait && reply.status == CommandStatus::Accepted)
        {
            return Ok(Answer::Command(reply));
        }
        let reject = |refusal| self.reject(&meta, Some(cs), refusal);
        let handle = self.handle(cs).map_err(reject)?;
        self.check_age(&meta).map_err(reject)?;
        if let Command::AlarmAcknowledge { id } = command
            && !self.shared.acknowledge_alarm(id, &meta.client_id)
        {
            let text = format!("no alarm {id} is active");
            return Err(reject(Refusal::new(RefusalCode::NotFound, text)));
        }
        let urgent = command.verb().is_urgent();
        let request = CoordinateSystemRequest::Command { command, meta, wait };
        handle.mailbox.ask(request, urgent).await
    }

    pub(super) async fn lease(
        &self,
        cs: CoordinateSystemNumber,
        request: LeaseRequest,
        meta: CommandMeta,
    ) -> Result<Answer, Refusal> {
        check_command(&meta.client_id, &meta.command_id)?;
        let asked = Asked::new(format!("the lease of coordinate system {cs}"), &(cs, &request));
        if let Some(reply) = self.replied_again(&meta, Some(cs), asked)? {
            return Ok(Answer::Command(reply));
        }
        let handle = self
            .handle(cs)
            .map_err(|refusal| self.reject(&meta, Some(cs), refusal))?;
        let request = CoordinateSystemRequest::Lease { request, meta };
        handle.mailbox.ask(request, false).await
    }

    /// The reply to a command that came before; published again, since who asks again has not heard it.
    ///
    /// # Errors
    /// Another command came before under its id, whose reply stays.
    pub(super) fn replied_again(
        &self,
        meta: &CommandMeta,
        cs: Option<CoordinateSystemNumber>,
        asked: Asked,
    ) -> Result<Option<CommandReply>, Refusal> {
        let (reply, answer) = match self.shared.recall(&meta.command_id, asked) {
            Recalled::New | Recalled::Again(None) => return Ok(None),
            Recalled::Again(Some(reply)) => (reply.clone(), Ok(Some(reply))),
            Recalled::OtherCommand(words) => {
                let text = format!(
                    "command_id \"{:.64}\" is that of another command: {words}; take a new one for each command",
                    meta.command_id
                );
                let refusal = Refusal::new(RefusalCode::CommandIdReused, text);
                (self.rejection(meta, cs, &refusal), Err(refusal))
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

    /// Says a refusal as the reply to a command; `cs` is the coordinate system whose state it tells.
    pub(super) fn reject(
        &self,
        meta: &CommandMeta,
        cs: Option<CoordinateSystemNumber>,
        refusal: Refusal,
    ) -> Refusal {
        let reply = self.rejection(meta, cs, &refusal);
        self.shared.reply(&meta.client_id, reply);
        refusal
    }

    fn rejection(
        &self,
        meta: &CommandMeta,
        cs: Option<CoordinateSystemNumber>,
        refusal: &Refusal,
    ) -> CommandReply {
        CommandReply {
            command_id: meta.command_id.clone(),
            status: CommandStatus::Rejected,
            code: word(&refusal.code),
            text: refusal.text.clone(),
            state_rev: self.state_rev(cs),
            variables: None,
            lease: None,
        }
    }

    /// Revision of a coordinate system's state; 0 for none.
    pub(super) fn state_rev(&self, cs: Option<CoordinateSystemNumber>) -> u64 {
        cs.and_then(|cs| self.shared.hub.read(&Topic::cs(cs, CsTopic::State)))
            .and_then(|state| state.rev)
            .unwrap_or(0)
    }
}
