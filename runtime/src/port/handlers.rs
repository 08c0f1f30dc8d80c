//! Handlers that come online, replace another instance, or go offline.

use plc_protocol::handler_registry::{PresenceEffect, Reach};
use plc_protocol::types::handler::{Departure, HandlerResult};
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::request::{Answer, CoordinateSystemRequest, Refusal};

use super::RuntimePort;

impl RuntimePort {
    /// Processes a presence: registers a handler, replaces another instance of it, or marks it as offline.
    pub(super) async fn handler(
        &self,
        reach: Reach,
        id: String,
        presence: HandlerPresence,
    ) -> Result<Answer, Refusal> {
        let changed = match self.shared.set_handler(reach, &id, &presence) {
            Ok(changed) => changed,
            Err(refusal) => {
                if let Some(asked) = self.shared.asked_handler(&id) {
                    self.shared
                        .publish_handler_result(&id, HandlerResult::confirm(Some(asked)));
                }
                let result = HandlerResult::refused(presence.instance, &refusal);
                self.shared.publish_handler_result(&id, result);
                return Err(refusal);
            }
        };
        match changed {
            PresenceEffect::Nothing => return Ok(Answer::Done),
            PresenceEffect::Refreshed => {
                let result = HandlerResult::accepted(presence.instance);
                self.shared.publish_handler_result(&id, result);
                return Ok(Answer::Done);
            }
            PresenceEffect::Offline(departure) => {
                self.handler_left(&id, presence.instance, departure).await?;
            }
            PresenceEffect::Online {
                took_over,
                has_returned,
                ..
            } => {
                if let Some(displaced) = took_over {
                    let old = displaced.presence.instance;
                    self.handler_left(&id, old.clone(), displaced.departure).await?;
                    let result = HandlerResult::taken_over(old, displaced.text);
                    self.shared.publish_handler_result(&id, result);
                }
                self.shared.end_io_absence(&id);
                let instance = presence.instance.clone();
                self.pass_to_all(CoordinateSystemRequest::Handler(id.clone(), presence))
                    .await?;
                self.shared
                    .publish_handler_result(&id, HandlerResult::accepted(instance.clone()));
                if has_returned {
                    // the handler may not have noticed its loss, and its outputs have the values for a loss: ask it to
                    // confirm
                    self.shared
                        .publish_handler_result(&id, HandlerResult::confirm(instance));
                }
            }
        }
        Ok(Answer::Done)
    }

    /// Passes the departure of a handler instance to its points and to all coordinate systems.
    async fn handler_left(
        &self,
        id: &str,
        instance: Option<String>,
        departure: Departure,
    ) -> Result<(), Refusal> {
        self.shared.leave_io(id, departure);
        let request = CoordinateSystemRequest::HandlerLeft(id.to_owned(), instance, departure);
        self.pass_to_all(request).await
    }
}
