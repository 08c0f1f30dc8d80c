//! Sender of a message over MQTT, as named in its topic: `handler/{id}/...` and `client/{id}/...`.
//!
//! The access rules of any broker can restrict these topics to users. The sender in a payload must be the
//! sender in the topic.

use super::row::ParsedRequest;
use crate::types::request::{Input, Request};

/// Beginnings of the paths of requests that may follow the two levels with the sender.
const REQUESTS: [&str; 5] = ["cs/", "io/", "motor/", "alarm/raise", "stored_data/answer"];

/// The sender of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MessageSender {
    /// A handler, by its `handler_id`.
    Handler(String),
    /// A client, by its user name or its `client_id`.
    Client(String),
}

impl MessageSender {
    /// Filters of all topics that name their sender, below the machine's root.
    pub const FILTERS: [&'static str; 9] = [
        "handler/+/cs/#",
        "handler/+/io/#",
        "handler/+/motor/#",
        "handler/+/alarm/raise",
        "client/+/cs/#",
        "client/+/io/#",
        "client/+/motor/#",
        "client/+/alarm/raise",
        "client/+/stored_data/answer",
    ];

    /// Returns the id in the topic.
    pub fn id(&self) -> &str {
        match self {
            MessageSender::Handler(id) | MessageSender::Client(id) => id,
        }
    }

    /// Splits a path into its sender and the path of the request. The path of a presence or a heartbeat is
    /// not split, although it begins with the same levels.
    pub fn split(path: &str) -> (Option<Self>, &str) {
        let mut levels = path.splitn(3, '/');
        let (Some(kind), Some(id), Some(rest)) = (levels.next(), levels.next(), levels.next()) else {
            return (None, path);
        };
        let is_request = REQUESTS.iter().any(|begin| rest.starts_with(begin));
        match kind {
            "handler" if is_request && !id.is_empty() => (Some(MessageSender::Handler(id.to_owned())), rest),
            "client" if is_request && !id.is_empty() => (Some(MessageSender::Client(id.to_owned())), rest),
            _ => (None, path),
        }
    }

    /// Returns the path on which this sender publishes a request, whose own path is `path`.
    pub fn path(&self, path: &str) -> String {
        match self {
            MessageSender::Handler(id) => format!("handler/{id}/{path}"),
            MessageSender::Client(id) => format!("client/{id}/{path}"),
        }
    }

    /// Returns the sender of a request: the handler that the request names, otherwise `handler` if handlers
    /// send such requests, otherwise the client.
    pub fn of_request(request: &Request, handler: Option<&str>, client: &str) -> Self {
        let client = || MessageSender::Client(client.to_owned());
        match request {
            Request::Reset(_, _, reset) if reset.force == Some(true) => client(),
            Request::Claim(..)
            | Request::Reset(..)
            | Request::Progress(..)
            | Request::Checkpoint(..)
            | Request::Ask(..)
            | Request::ValidateResult(..) => named(request).map_or_else(client, MessageSender::Handler),
            Request::Input(_, Input::Interlock(_) | Input::StartLock(_)) | Request::WriteIo(..) => {
                named(request).map_or_else(client, MessageSender::Handler)
            }
            Request::Tool(..)
            | Request::Spindle(..)
            | Request::WriteVariables { .. }
            | Request::ReadVariables { .. }
            | Request::RaiseAlarm(_) => {
                handler.map_or_else(client, |handler| MessageSender::Handler(handler.to_owned()))
            }
            _ => client(),
        }
    }

    /// If the payload names no sender, sets the sender in the topic as the sender of the request. `client_id`
    /// is the client that the payload names.
    ///
    /// # Errors
    /// Fails if the payload names another sender; the text is for the sender.
    pub(super) fn identify(&self, parsed: &mut ParsedRequest, client_id: Option<&str>) -> Result<(), String> {
        if let Some(owner) = parsed.owner_mut().filter(|owner| owner.is_none()) {
            *owner = matches!(self, MessageSender::Handler(_)).then(|| self.id().to_owned());
        }
        let request = parsed.request();
        let by_force = matches!(request, Request::Reset(_, _, reset) if reset.force == Some(true));
        if let Some(named) = named(request)
            && named != self.id()
            && !(by_force && matches!(self, MessageSender::Client(_)))
        {
            return Err(format!(
                "its topic names {:?}, its handler_id is {named:?}; write the same id in both",
                self.id()
            ));
        }
        match (self, client_id) {
            (MessageSender::Client(id), Some(client_id)) if !is_of(client_id, id) => Err(format!(
                "its topic names {id:?}, its client_id is {client_id:?}; write the same id in both, or let client_id begin with {id}-"
            )),
            _ => Ok(()),
        }
    }
}

/// Returns true if a client id is equal to the id in the topic, or starts with this id and `-`.
fn is_of(client_id: &str, id: &str) -> bool {
    client_id == id
        || client_id
            .strip_prefix(id)
            .is_some_and(|rest| rest.starts_with('-'))
}

/// Returns the handler that a request names as its sender.
fn named(request: &Request) -> Option<String> {
    match request {
        Request::Claim(_, _, claim) => Some(claim.handler_id.clone()),
        Request::Reset(_, _, reset) => Some(reset.handler_id.clone()),
        Request::Progress(_, _, report) => Some(report.handler_id.clone()),
        Request::Checkpoint(_, _, report) => Some(report.handler_id.clone()),
        Request::Ask(_, _, ask) => Some(ask.handler_id.clone()),
        Request::ValidateResult(_, _, result) => Some(result.handler_id.clone()),
        Request::Input(_, Input::Interlock(set) | Input::StartLock(set)) => set.handler_id.clone(),
        Request::WriteIo(_, set) => set.handler_id.clone(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_names_its_sender_and_a_presence_stays_as_it_is() {
        let handler = |id: &str| Some(MessageSender::Handler(id.to_owned()));
        let client = |id: &str| Some(MessageSender::Client(id.to_owned()));
        for (path, speaker, rest) in [
            (
                "handler/clamp/cs/1/m_code/5/claim",
                handler("clamp"),
                "cs/1/m_code/5/claim",
            ),
            (
                "handler/clamp/io/out/lamp/set",
                handler("clamp"),
                "io/out/lamp/set",
            ),
            (
                "client/panel/cs/1/command/stop",
                client("panel"),
                "cs/1/command/stop",
            ),
            ("client/panel/alarm/raise", client("panel"), "alarm/raise"),
            (
                "client/panel/stored_data/answer",
                client("panel"),
                "stored_data/answer",
            ),
            ("handler/clamp/presence", None, "handler/clamp/presence"),
            ("client/panel/heartbeat", None, "client/panel/heartbeat"),
            (
                "handler//cs/1/m_code/5/claim",
                None,
                "handler//cs/1/m_code/5/claim",
            ),
            (
                "handler/a/handler/b/presence",
                None,
                "handler/a/handler/b/presence",
            ),
            ("cs/1/command/stop", None, "cs/1/command/stop"),
        ] {
            assert_eq!(MessageSender::split(path), (speaker.clone(), rest), "{path}");
            if let Some(speaker) = speaker {
                assert_eq!(speaker.path(rest), path);
            }
        }
    }
}
