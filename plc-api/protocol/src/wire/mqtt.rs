//! Requests as MQTT messages, written by the client transport and read by the server end.

use std::borrow::Cow;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::PAYLOAD_MAX;
use super::age_limit::{args_of, names_urgent};
use super::json::{edited_json_object, json_object};
use super::message_sender::MessageSender;
use super::parameter::{Fault, QueryValues};
use super::pattern::{fill, take_apart};
use super::requests::{COMMAND, ROWS};
use super::right::Right;
use super::row::{
    Body, InboundTopic, IncomingRequest, NOT_AFTER, ParsedRequest, RequestParts, Row, Source, number,
};
use crate::names::unique_name;
use crate::types::CoordinateSystemNumber;
use crate::types::command::CommandMeta;
use crate::types::ids::{COMMAND_ID_MAX, check_command, is_client_id};
use crate::types::not_after::NotAfter;
use crate::types::output::{Claim, HandlerPresence, HandshakeResult, HandshakeStatus, OutputAct, Reset};
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::Request;

/// A message to send, with the event that completes its request.
#[derive(Debug, Clone, PartialEq)]
pub struct Outgoing {
    /// Path below the machine's root.
    pub path: String,
    /// Payload, as JSON.
    pub payload: String,
    /// Retain flag of the message.
    pub retain: bool,
    /// Event that completes the request.
    pub until: Until,
}

/// Event that completes a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Until {
    /// The broker acknowledges the message.
    Acknowledged,
    /// The `result` of the claim or reset arrives.
    Result {
        /// Coordinate system of the output.
        cs: CoordinateSystemNumber,
        /// M number of the output.
        m: u16,
        /// Sequence number of the output.
        seq: u64,
        /// Sender of the claim or reset.
        handler_id: String,
        /// Instance of the sender.
        instance: Option<String>,
        /// True for a reset, false for a claim.
        is_reset: bool,
    },
    /// The `result` of the presence arrives.
    Announced {
        /// Id of the handler.
        handler_id: String,
        /// Instance of the handler.
        instance: String,
    },
    /// The `reply` of the command arrives: accepted, or done.
    Reply {
        /// Id of the command.
        command_id: String,
        /// True to wait until the command is done.
        done: bool,
    },
}

impl Until {
    fn for_request(request: &Request) -> Self {
        match request {
            Request::Handler(
                id,
                HandlerPresence {
                    online: true,
                    instance: Some(instance),
                    ..
                },
            ) => Until::Announced {
                handler_id: id.clone(),
                instance: instance.clone(),
            },
            Request::Claim(
                cs,
                Some(m),
                Claim {
                    seq,
                    handler_id,
                    instance,
                    ..
                },
            )
            | Request::Reset(
                cs,
                Some(m),
                Reset {
                    seq,
                    handler_id,
                    instance,
                    ..
                },
            ) => Until::Result {
                cs: *cs,
                m: *m,
                seq: *seq,
                handler_id: handler_id.clone(),
                instance: instance.clone(),
                is_reset: matches!(request, Request::Reset(..)),
            },
            _ => match sender(request) {
                None => Until::Acknowledged,
                Some((_, meta)) => Until::Reply {
                    command_id: meta.command_id.clone(),
                    done: !matches!(request, Request::Command { wait: false, .. }),
                },
            },
        }
    }
}

/// Returns the sender of a request that is answered on `reply/{client_id}`, and the coordinate system of the
/// request; 0 means all coordinate systems.
pub fn sender(request: &Request) -> Option<(CoordinateSystemNumber, &CommandMeta)> {
    match request {
        Request::Command { cs, meta, .. } | Request::Lease { cs, meta, .. } => Some((*cs, meta)),
        Request::ReadVariables { area, meta, .. } | Request::WriteVariables { area, meta, .. } => {
            let cs = area.coordinate_system().unwrap_or(0);
            meta.as_ref().map(|meta| (cs, meta))
        }
        _ => None,
    }
}

/// Creates the message of a request. Replies are sent to `client_id`, even if the request contains another
/// client id. `m_of` returns the M number of an open output, for a request that does not contain this number.
///
/// # Errors
/// Fails with `not_supported` if MQTT does not carry the request, and with `not_found` if the output is not
/// open.
pub fn encode(
    request: Request,
    client_id: &str,
    m_of: impl Fn(CoordinateSystemNumber, u64) -> Option<u16>,
) -> Result<Outgoing, Refusal> {
    encode_not_after(request, None, client_id, m_of)
}

/// Creates the message of a request with an age limit. The limit is left out if the request cannot cause a
/// motion.
///
/// # Errors
/// Fails like [`encode`].
pub fn encode_not_after(
    mut request: Request,
    not_after: Option<&NotAfter>,
    client_id: &str,
    m_of: impl Fn(CoordinateSystemNumber, u64) -> Option<u16>,
) -> Result<Outgoing, Refusal> {
    if let Some((cs, seq, m @ None)) = request.output_mut() {
        *m = Some(m_of(cs, seq).ok_or_else(|| {
            let text = format!("no output {seq} is open in coordinate system {cs}");
            Refusal::new(RefusalCode::NotFound, text)
        })?);
    }
    if let Request::ReadVariables { meta, .. } | Request::WriteVariables { meta, .. } = &mut request {
        meta.get_or_insert_with(|| CommandMeta {
            command_id: unique_name("variable"),
            ..CommandMeta::default()
        });
    }
    let until = Until::for_request(&request);
    let meta = sender(&request).map(|(_, meta)| CommandMeta {
        client_id: client_id.to_owned(),
        ..meta.clone()
    });
    for (row, topic) in topics() {
        match (row.write)(request) {
            Ok(mut parts) => {
                if row.takes_not_after {
                    parts.limit_age(not_after);
                }
                return topic.message(parts, meta, until);
            }
            Err(other) => request = other,
        }
    }
    let text = "MQTT does not carry this request; use REST";
    Err(Refusal::new(RefusalCode::NotSupported, text))
}

/// Returns the rows that have topics.
fn topics() -> impl Iterator<Item = (&'static Row, &'static InboundTopic)> {
    ROWS.iter().filter_map(|row| Some((row, row.topic.as_ref()?)))
}

impl InboundTopic {
    fn message(
        &self,
        parts: RequestParts,
        meta: Option<CommandMeta>,
        until: Until,
    ) -> Result<Outgoing, Refusal> {
        let mut payload = match (parts.payload, parts.body) {
            (Some(Value::Object(payload)), _) | (None, Body::Json(Value::Object(payload))) => payload,
            _ => Map::new(),
        };
        if let Value::Object(meta) = json!(meta.unwrap_or_default()) {
            let envelope = meta.into_iter();
            payload.extend(envelope.filter(|(name, _)| self.envelope.contains(&name.as_str())));
        }
        match fill(self.pattern, &parts.params, str::to_owned) {
            Some(path) => Ok(Outgoing {
                path,
                payload: Value::Object(payload).to_string(),
                retain: self.retained,
                until,
            }),
            None => Err(Refusal::new(
                RefusalCode::NotSupported,
                "the request lacks a value that its topic needs",
            )),
        }
    }

    /// Returns true for the topics of claims and resets, which a `result` answers.
    fn has_result(&self) -> bool {
        self.pattern.ends_with("/claim") || self.pattern.ends_with("/reset")
    }

    /// Reads the sender and the conditions from a payload.
    fn meta(&self, payload: &[u8], retained: bool, is_urgent: bool) -> Result<CommandMeta, Refusal> {
        // an invalid `not_after` must not prevent a hold, stop or abort
        let left_out = if is_urgent { &[NOT_AFTER][..] } else { &[] };
        let meta: CommandMeta = edited_json_object(payload, None, left_out)
            .map_err(|error| invalid(text_of(Fault::Json(error))))?;
        check_command(&meta.client_id, &meta.command_id)?;
        if retained {
            let what = if self.envelope == COMMAND {
                "a command"
            } else {
                "this"
            };
            let text = format!("{what} must not be retained; publish it without the retain flag");
            return Err(Refusal::new(RefusalCode::Retained, text));
        }
        // fields with these names that are not in the envelope belong to the request itself
        Ok(CommandMeta {
            ttl_ms: meta.ttl_ms.filter(|_| self.envelope.contains(&"ttl_ms")),
            not_after: meta.not_after.filter(|_| self.envelope.contains(&NOT_AFTER)),
            fence: meta.fence.filter(|_| self.envelope.contains(&"fence")),
            ..meta
        })
    }
}

/// Content of a received message.
#[expect(
    clippy::large_enum_variant,
    reason = "nearly every message is the large one, and it is moved once"
)]
#[derive(Debug, PartialEq)]
pub enum Inbound {
    /// A request to the port.
    Ask {
        /// The request.
        request: ParsedRequest,
        /// True for hold, stop, abort and a raised alarm, which bypass every queue.
        urgent: bool,
    },
    /// A command that is not a valid request: the server end notifies its sender.
    Reject {
        /// Coordinate system of the command.
        cs: CoordinateSystemNumber,
        /// Sender of the command.
        client_id: String,
        /// Id of the command.
        command_id: String,
        /// Reason.
        refusal: Refusal,
    },
    /// A claim or reset that is not a valid request: the server end notifies its sender by a `result`, if the
    /// sender has the right for this name.
    RefuseOutput {
        /// Coordinate system of the output.
        cs: CoordinateSystemNumber,
        /// M number of the output.
        m: u16,
        /// Result to publish for the sender.
        result: HandshakeResult,
        /// The right that the request needs.
        right: Right,
    },
    /// A message that cannot be answered because it names no sender; the text is for the log.
    Drop(String),
}

/// Parses a message. `retained` means that the broker sent the message with the retain flag. Such a message
/// is stale, and is executed only on topics that allow the flag.
pub fn decode(path: &str, payload: &[u8], retained: bool) -> Inbound {
    let (speaker, request) = MessageSender::split(path);
    let found = topics().find_map(|(row, topic)| Some((row, topic, take_apart(topic.pattern, request)?)));
    let read = match found {
        None if retained => Err("it is retained; publish it without the retain flag".to_owned()),
        None => Err("there is no such topic".to_owned()),
        Some((row, topic, params)) => row.message(topic, &params, payload, retained),
    };
    let read = read.and_then(|inbound| match &speaker {
        Some(speaker) => inbound.set_sender(speaker),
        None => Ok(inbound),
    });
    read.unwrap_or_else(|text| Inbound::Drop(format!("MQTT message on {path} refused: {text}")))
}

impl Row {
    fn message(
        &self,
        topic: &InboundTopic,
        params: &[(&str, &str)],
        payload: &[u8],
        retained: bool,
    ) -> Result<Inbound, String> {
        let read = |source| {
            self.parse(IncomingRequest {
                params,
                body: Cow::Borrowed(payload),
                query: QueryValues::default(),
                source,
                not_after_is_apart: false,
            })
        };
        let too_large = (payload.len() > PAYLOAD_MAX)
            .then(|| format!("its payload is larger than {PAYLOAD_MAX} bytes; send less"));
        if topic.envelope.is_empty() {
            let kept = "it is retained; publish it without the retain flag";
            let refused = too_large.or_else(|| (retained && !topic.retained).then(|| kept.to_owned()));
            let read = match refused {
                Some(text) => Err(text),
                None => read(Source::Message).map(Inbound::from_request).map_err(text_of),
            };
            return read.or_else(|text| refuse_output(self.right, topic, params, payload, text));
        }
        let mut named = params.iter();
        let (_, cs) = named.find(|(name, _)| *name == "cs").unwrap_or(&("cs", ""));
        let cs = number(cs).ok_or_else(|| text_of(Fault::Level((*cs).to_owned())))?;
        let within = too_large.map_or(Ok(()), |text| Err(invalid(text)));
        let request = within
            .and_then(|()| topic.meta(payload, retained, names_urgent(params, || args_of(payload))))
            .and_then(|meta| {
                read(Source::Command(meta, topic.envelope)).map_err(|fault| invalid(text_of(fault)))
            });
        Ok(request.map_or_else(|refusal| reject(cs, payload, refusal), Inbound::from_request))
    }
}

impl Inbound {
    /// Sets the sender that the topic names in the request.
    fn set_sender(mut self, speaker: &MessageSender) -> Result<Self, String> {
        let Inbound::Ask { request, .. } = &mut self else {
            return Ok(self);
        };
        let client_id = sender(request.request()).map(|(_, meta)| meta.client_id.clone());
        let Err(text) = speaker.identify(request, client_id.as_deref()) else {
            return Ok(self);
        };
        let Some((cs, meta)) = sender(request.request()) else {
            return Err(text);
        };
        Ok(Inbound::Reject {
            cs,
            client_id: meta.client_id.clone(),
            command_id: meta.command_id.clone(),
            refusal: Refusal::new(RefusalCode::Forbidden, text),
        })
    }

    fn from_request(request: ParsedRequest) -> Self {
        let urgent = match request.request() {
            Request::Command { command, .. } => command.is_urgent(),
            Request::RaiseAlarm(_) => true,
            _ => false,
        };
        Inbound::Ask { request, urgent }
    }
}

fn text_of(fault: Fault) -> String {
    match fault {
        Fault::Level(level) => format!("{level} is not a valid number at this level"),
        Fault::Json(error) => format!("the JSON is not valid: {error}"),
        Fault::NotFound(text) | Fault::Invalid(text) => text,
    }
}

/// Creates the `result` that refuses a claim or reset, if the message names its sender and its output.
fn refuse_output(
    right: Right,
    topic: &InboundTopic,
    params: &[(&str, &str)],
    payload: &[u8],
    text: String,
) -> Result<Inbound, String> {
    #[derive(Default, Deserialize)]
    #[serde(default)]
    struct OutputIds {
        seq: Value,
        handler_id: Value,
        instance: Value,
    }
    if !topic.has_result() {
        return Err(text);
    }
    let level = |wanted: &str| {
        params
            .iter()
            .find(|(name, _)| *name == wanted)
            .map(|(_, level)| *level)
    };
    // the payload may be too large: only these fields are stored
    let named: OutputIds = json_object(payload).unwrap_or_default();
    let handler_id = named.handler_id.as_str().unwrap_or_default();
    let instance = named.instance.as_str().filter(|named| is_client_id(named));
    match (
        level("cs").and_then(number),
        level("m").and_then(number),
        named.seq.as_u64(),
    ) {
        (Some(cs), Some(m), Some(seq)) if is_client_id(handler_id) => Ok(Inbound::RefuseOutput {
            cs,
            m,
            right,
            result: HandshakeResult {
                of: Some(if topic.pattern.ends_with("/claim") {
                    OutputAct::Claim
                } else {
                    OutputAct::Reset
                }),
                instance: instance.map(ToOwned::to_owned),
                text: Some(text),
                ..HandshakeResult::new(seq, handler_id, HandshakeStatus::Refused)
            },
        }),
        _ => Err(text),
    }
}

fn invalid(text: impl Into<String>) -> Refusal {
    Refusal::new(RefusalCode::Invalid, text)
}

/// Creates the rejection of a command; if the message names no sender, its text goes to the log.
fn reject(cs: CoordinateSystemNumber, payload: &[u8], refusal: Refusal) -> Inbound {
    #[derive(Default, Deserialize)]
    #[serde(default)]
    struct CommandIds {
        client_id: Value,
        command_id: Value,
    }
    // the payload may be too large: only these fields are stored
    let named: CommandIds = json_object(payload).unwrap_or_default();
    let client_id = named.client_id.as_str().unwrap_or_default();
    let command_id = named.command_id.as_str().unwrap_or_default();
    if is_client_id(client_id) {
        Inbound::Reject {
            cs,
            client_id: client_id.to_owned(),
            command_id: command_id.chars().take(COMMAND_ID_MAX).collect(),
            refusal,
        }
    } else {
        let text = refusal.text;
        Inbound::Drop(format!("MQTT command without a sender refused: {text}"))
    }
}

#[cfg(test)]
mod tests;
