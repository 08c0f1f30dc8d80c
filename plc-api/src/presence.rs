//! That handlers are there, as the machine knows it: what they have claimed is given back when they are not.

use std::sync::Arc;
use std::time::Duration;

use crate::handshake::HANDLER_ID_MAX;
use crate::plc::{Plc, send_without_waiting};
use crate::types::output::{HandledCode, HandlerPresence, Redelivery};
use crate::types::request::{Refusal, RefusalCode, Request};

/// How long after a claim, reset or presence that could not be delivered it is sent again.
pub(crate) const RETRY: Duration = Duration::from_secs(1);

/// How often a presence that is refused is said again. Reason: a program before this one on the same connection may just
/// be ending.
const TRIES: u32 = 5;

/// What is wrong with the name of a handler, in words.
pub(crate) fn mistake_in_id(id: &str) -> Option<String> {
    let is_wrong = id.is_empty() || id.chars().count() > HANDLER_ID_MAX || id.contains(['/', '+', '#']);
    is_wrong.then(|| format!("handler_id {id:?}: write 1 to {HANDLER_ID_MAX} characters without / + #"))
}

pub(crate) fn here(handles: Vec<HandledCode>, validates: bool) -> HandlerPresence {
    HandlerPresence {
        online: true,
        handles,
        validates,
    }
}

pub(crate) fn gone() -> HandlerPresence {
    HandlerPresence {
        online: false,
        handles: Vec::new(),
        validates: false,
    }
}

/// Says it until the machine has heard of it.
///
/// # Errors
/// The machine, or the connection to it, refuses it for good.
pub(crate) async fn tell(plc: &Plc, id: &str, presence: HandlerPresence) -> Result<(), Refusal> {
    let mut tries = 0;
    loop {
        let request = Request::Handler(id.to_owned(), presence.clone());
        let Err(refusal) = plc.port().request(request).await else {
            return Ok(());
        };
        tries += u32::from(refusal.code != RefusalCode::Unavailable);
        if tries == TRIES {
            return Err(refusal);
        }
        tracing::warn!(%refusal, "handler presence not delivered yet");
        plc.sleep(RETRY).await;
    }
}

/// Tells the machine that the handlers have gone, however their work ends.
#[derive(Debug)]
pub(crate) struct Gone {
    pub(crate) plc: Plc,
    pub(crate) handler_id: Arc<str>,
}

impl Drop for Gone {
    fn drop(&mut self) {
        let request = Request::Handler(self.handler_id.to_string(), gone());
        let what_if_not = "the machine was not told that the handlers have gone";
        send_without_waiting(&self.plc, request, what_if_not);
    }
}

/// What becomes of an output: `None` leaves it to an operator, else whether the machine must be looked at first.
pub(crate) fn taken_up(lost: bool, told: Option<Redelivery>, on_redelivery: Redelivery) -> Option<bool> {
    match (lost, told) {
        (_, Some(Redelivery::Redo)) | (false, _) => Some(false),
        (_, Some(Redelivery::Verify)) => Some(true),
        (true, _) => match on_redelivery {
            Redelivery::Ask => None,
            Redelivery::Redo => Some(false),
            Redelivery::Verify => Some(true),
        },
    }
}
