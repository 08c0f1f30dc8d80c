//! Frames of the WebSocket `/api/v1/ws`, written and read by the client transport and the server end.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::find_row::parsed;
use super::row::ParsedRequest;
use crate::types::CoordinateSystemNumber;
use crate::types::heartbeat::ClientHeartbeat;
use crate::types::message::Message;
use crate::types::output::HandlerPresence;
use crate::types::question::ValidateResult;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::Request;
use crate::types::topic::Topic;

/// Interval at which a machine sends pings.
pub const PING_INTERVAL: Duration = Duration::from_secs(15);

/// Silence after which the peer is lost: no message, ping or pong during three ping intervals.
pub const SILENCE_MAX: Duration = Duration::from_secs(45);

/// A frame of a client.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "WebSocketRequest"))]
#[serde(deny_unknown_fields)]
pub struct ClientFrame {
    /// Topics to subscribe, below the machine's root; `+` is one level, `#` at the end is all further levels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub subscribe: Vec<String>,
    /// Topics to unsubscribe, written as in their subscriptions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unsubscribe: Vec<String>,
    /// A handler that comes online, changes its M codes, or leaves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handler: Option<AnnouncedHandler>,
    /// A client that asks the machine to watch it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heartbeat: Option<WatchedClient>,
    /// The answer to a `validate` message.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub validate_result: Option<ValidatedCode>,
}

/// A handler that a client serves while the client is connected: presence and id.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AnnouncedHandler {
    id: String,
    #[serde(flatten)]
    presence: HandlerPresence,
}

/// A client that the machine watches, and the time within which the next heartbeat must follow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WatchedClient {
    id: String,
    ttl_ms: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cs: Option<CoordinateSystemNumber>,
}

/// Answer of a handler about an M code of a program that is being loaded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ValidatedCode {
    cs: CoordinateSystemNumber,
    m: u16,
    request_id: String,
    handler_id: String,
    ok: bool,
    text: Option<String>,
}

/// Creates the frame that carries a request.
///
/// # Errors
/// Fails with `not_supported` for requests that clients send over REST.
pub fn encode(request: Request) -> Result<ClientFrame, Refusal> {
    let mut frame = ClientFrame::default();
    match request {
        Request::Handler(id, presence) => frame.handler = Some(AnnouncedHandler { id, presence }),
        Request::Heartbeat(id, ClientHeartbeat { ttl_ms, cs }) => {
            frame.heartbeat = Some(WatchedClient { id, ttl_ms, cs });
        }
        Request::ValidateResult(cs, Some(m), result) => {
            frame.validate_result = Some(ValidatedCode {
                cs,
                m,
                request_id: result.request_id,
                handler_id: result.handler_id,
                ok: result.ok,
                text: result.text,
            });
        }
        _ => {
            let text = "no frame of the WebSocket carries this request; use REST";
            return Err(Refusal::new(RefusalCode::NotSupported, text));
        }
    }
    Ok(frame)
}

impl ClientFrame {
    /// Returns the requests of a frame.
    pub fn requests(self) -> impl Iterator<Item = ParsedRequest> {
        let handler = self
            .handler
            .map(|AnnouncedHandler { id, presence }| Request::Handler(id, presence));
        let watched = self
            .heartbeat
            .map(|WatchedClient { id, ttl_ms, cs }| Request::Heartbeat(id, ClientHeartbeat { ttl_ms, cs }));
        let validated = self.validate_result.map(|validated| {
            let result = ValidateResult {
                request_id: validated.request_id,
                handler_id: validated.handler_id,
                ok: validated.ok,
                text: validated.text,
            };
            Request::ValidateResult(validated.cs, Some(validated.m), result)
        });
        handler
            .into_iter()
            .chain(watched)
            .chain(validated)
            .filter_map(parsed)
    }

    /// Returns the frame as JSON.
    pub fn to_json(&self) -> String {
        json!(self).to_string()
    }
}

/// A frame that a server sends.
#[derive(Debug)]
pub enum ServerFrame {
    /// The message of a topic.
    Message(Box<Message>),
    /// Reason why a frame of the client is refused.
    Error(Refusal),
    /// A message of an unknown topic, or a message with a form that this version cannot read.
    Unknown(String),
}

/// The topic of a message; in the frame, the topic precedes the message.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "WebSocket"))]
pub struct FrameTopic {
    /// Path below the machine's root, as on MQTT.
    topic: String,
}

/// An error frame.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "WebSocketError"))]
pub struct ErrorFrame {
    error: String,
    /// Machine-readable reason, if the error is a refusal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    code: Option<RefusalCode>,
}

/// Creates the frame of a message, with its topic first.
pub fn message_frame(path: &str, message: &Message) -> String {
    let json = message.to_json();
    let rest = json.strip_prefix('{').unwrap_or("}");
    format!("{{\"topic\":{},{rest}", json!(path))
}

/// Creates the frame of an error.
pub fn error_frame(text: &str) -> String {
    frame_of(text, None)
}

/// Creates the frame of a refusal.
pub fn refusal_frame(refusal: &Refusal) -> String {
    frame_of(&refusal.text, Some(refusal.code))
}

fn frame_of(text: &str, code: Option<RefusalCode>) -> String {
    let error = text.to_owned();
    json!(ErrorFrame { error, code }).to_string()
}

impl ServerFrame {
    /// Reads a frame. A text that is not a frame becomes an error of at most 200 characters.
    pub fn read(text: &str) -> Self {
        let Ok(FrameTopic { topic: path }) = serde_json::from_str(text) else {
            let (code, text) = match serde_json::from_str(text) {
                Ok(ErrorFrame { error, code }) => (code, error),
                Err(_) => (None, text.chars().take(200).collect()),
            };
            return ServerFrame::Error(Refusal::new(code.unwrap_or(RefusalCode::Invalid), text));
        };
        let Some(topic) = Topic::parse(&path) else {
            return ServerFrame::Unknown(format!("topic {path} is unknown"));
        };
        match Message::from_json(topic, text.as_bytes()) {
            Ok(message) => ServerFrame::Message(Box::new(message)),
            Err(error) => ServerFrame::Unknown(format!("{path}: {error}")),
        }
    }
}
