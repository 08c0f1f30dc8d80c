//! Commands: known ones are answered again, old ones refused, the others go to the task.

use std::time::Duration;

use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::{Command, CommandMeta, CommandReply, CommandStatus, Verb};
use plc_api::types::lease::LeaseRequest;
use plc_api::types::message::Payload;
use plc_api::types::request::{Answer, Refusal, RefusalCode, Request};
use plc_api::types::topic::Topic;

use super::{RuntimePort, check_id};

/// Characters of a command id.
const COMMAND_ID_MAX: usize = 128;

impl RuntimePort {
    pub(super) async fn command(
        &self,
        cs: CoordinateSystemNumber,
        command: Command,
        meta: CommandMeta,
        wait: bool,
    ) -> Result<Answer, Refusal> {
        check_ids(&meta)?;
        let handle = self.handle(cs).map_err(|refusal| self.reject(&meta, refusal))?;
        if let Some(reply) = self.replied_again(&meta)
            && !(wait && reply.status == CommandStatus::Accepted)
        {
            return Ok(Answer::Command(reply));
        }
        self.check_age(&meta)
            .map_err(|refusal| self.reject(&meta, refusal))?;
        if let Command::AlarmAcknowledge { id } = command
            && !self.shared.acknowledge_alarm(id, &meta.client_id)
        {
            return Err(self.reject(
                &meta,
                Refusal::new(RefusalCode::NotFound, format!("no alarm {id} is active")),
            ));
        }
        let urgent = matches!(command.verb(), Verb::Hold | Verb::Stop | Verb::Abort);
        let request = Request::Command {
            cs,
            command,
            meta,
            wait,
        };
        handle.desk.ask(request, urgent).await
    }

    pub(super) async fn lease(
        &self,
        cs: CoordinateSystemNumber,
        request: LeaseRequest,
        meta: CommandMeta,
    ) -> Result<Answer, Refusal> {
        check_ids(&meta)?;
        if let Some(reply) = self.replied_again(&meta) {
            return Ok(Answer::Command(reply));
        }
        let handle = self.handle(cs).map_err(|refusal| self.reject(&meta, refusal))?;
        let request = Request::Lease { cs, request, meta };
        handle.desk.ask(request, false).await
    }

    /// The reply to a command that came before; published again, since who asks again has not heard it.
    pub(super) fn replied_again(&self, meta: &CommandMeta) -> Option<CommandReply> {
        let reply = self.shared.replied(&meta.command_id)?;
        let topic = Topic::Reply(meta.client_id.clone());
        self.shared.publish(topic, Payload::Reply(reply.clone()));
        Some(reply)
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

    pub(super) fn reject(&self, meta: &CommandMeta, refusal: Refusal) -> Refusal {
        let code = serde_json::to_value(refusal.code).ok();
        let reply = CommandReply {
            command_id: meta.command_id.clone(),
            status: CommandStatus::Rejected,
            code: code
                .and_then(|code| code.as_str().map(str::to_owned))
                .unwrap_or_default(),
            text: refusal.text.clone(),
            state_rev: 0,
            variables: None,
            lease: None,
        };
        self.shared.reply(&meta.client_id, reply);
        refusal
    }
}

pub(super) fn check_ids(meta: &CommandMeta) -> Result<(), Refusal> {
    if meta.command_id.is_empty() || meta.command_id.chars().count() > COMMAND_ID_MAX {
        let text = format!("command_id: write 1 to {COMMAND_ID_MAX} characters");
        return Err(Refusal::new(RefusalCode::Invalid, text));
    }
    check_id("client_id", &meta.client_id)
}
