//! Requests as MQTT messages, written by the client transport and read by the server end.

use std::borrow::Cow;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use super::json::json_object;
use super::pattern::{fill, take_apart};
use super::requests::ROWS;
use super::row::{Body, Envelope, Fault, Parts, QueryValues, Received, Row, Topic, number};
use crate::names::unique_name;
use crate::types::command::{Command, CommandMeta, Expect};
use crate::types::data::{Number, VariableArea, VariableKind};
use crate::types::ids::{COMMAND_ID_MAX, check_command, is_client_id};
use crate::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use crate::types::output::{Claim, Reset};
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::Request;
use crate::types::{CoordinateSystemNumber, Timestamp};

/// Bytes of one payload; more is refused. Reason: the largest, a fault text, is far below.
const PAYLOAD_MAX: usize = 64 * 1024;

/// A message to be sent, and how its end is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Outgoing {
    /// Below the machine's root.
    pub path: String,
    /// JSON.
    pub payload: String,
    /// Its retain flag.
    pub retain: bool,
    /// What ends the request.
    pub until: Until,
}

/// What ends a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Until {
    /// The broker has it.
    Acknowledged,
    /// The `result` of a claim or reset.
    Result {
        /// Coordinate system of the output.
        cs: CoordinateSystemNumber,
        /// M number of the output.
        m: u16,
        /// Sequence number of the output.
        seq: u64,
        /// Who claims or resets.
        handler_id: String,
        /// False: it is a claim.
        is_reset: bool,
    },
    /// The `reply` of a command: accepted, or done.
    Reply {
        /// Of the command.
        command_id: String,
        /// True: done.
        done: bool,
    },
}

impl Until {
    fn of(request: &Request) -> Self {
        match request {
            Request::Claim(cs, Some(m), Claim { seq, handler_id, .. })
            | Request::Reset(cs, Some(m), Reset { seq, handler_id, .. }) => Until::Result {
                cs: *cs,
                m: *m,
                seq: *seq,
                handler_id: handler_id.clone(),
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

/// Who sends a request that is answered on `reply/{client_id}`, and to which coordinate system; 0: to all.
pub fn sender(request: &Request) -> Option<(CoordinateSystemNumber, &CommandMeta)> {
    match request {
        Request::Command { cs, meta, .. } | Request::Lease { cs, meta, .. } => Some((*cs, meta)),
        Request::ReadVariables { area, meta, .. } | Request::WriteVariables { area, meta, .. } => {
            let cs = match area {
                VariableArea::Global => 0,
                VariableArea::CoordinateSystem(cs) => *cs,
            };
            meta.as_ref().map(|meta| (cs, meta))
        }
        _ => None,
    }
}

/// The message of a request. Replies come to `client_id`, whoever asked. `m_of` finds the M number of an open output
/// where the request does not name it.
///
/// # Errors
/// `not_supported` for what MQTT does not carry; `not_found` for an output that is not open.
pub fn encode(
    mut request: Request,
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
    let until = Until::of(&request);
    let meta = sender(&request).map(|(_, meta)| CommandMeta {
        client_id: client_id.to_owned(),
        ..meta.clone()
    });
    for (row, topic) in topics() {
        match (row.write)(request) {
            Ok(parts) => return topic.message(parts, meta, until),
            Err(other) => request = other,
        }
    }
    let text = "MQTT does not carry this request; use REST";
    Err(Refusal::new(RefusalCode::NotSupported, text))
}

/// Rows with their topics.
fn topics() -> impl Iterator<Item = (&'static Row, &'static Topic)> {
    ROWS.iter().filter_map(|row| Some((row, row.topic.as_ref()?)))
}

impl Topic {
    fn message(
        &self,
        mut parts: Parts,
        meta: Option<CommandMeta>,
        until: Until,
    ) -> Result<Outgoing, Refusal> {
        let mut payload = match (parts.payload.take(), std::mem::take(&mut parts.body)) {
            (Some(Value::Object(payload)), _) | (None, Body::Json(Value::Object(payload))) => payload,
            _ => Map::new(),
        };
        let meta = meta.unwrap_or_default();
        match self.envelope {
            Envelope::Nothing => {}
            Envelope::Command => {
                let args = std::mem::take(&mut payload);
                if let Value::Object(meta) = json!(meta) {
                    payload = meta;
                }
                payload.insert("args".to_owned(), args.into());
            }
            Envelope::Lease | Envelope::Variables => {
                payload.insert("command_id".to_owned(), meta.command_id.into());
                payload.insert("client_id".to_owned(), meta.client_id.into());
            }
        }
        if matches!(self.envelope, Envelope::Variables) {
            let of_all = !parts.params.iter().any(|(name, _)| *name == "cs");
            if of_all {
                // P variables are the same on the topic of each coordinate system
                parts = parts.with("cs", 1);
            }
            payload.insert("kind".to_owned(), if of_all { "P" } else { "Q" }.into());
            payload.extend(
                parts
                    .query
                    .iter()
                    .map(|(name, value)| ((*name).to_owned(), (*value).into())),
            );
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
                "its topic names what it does not",
            )),
        }
    }
}

/// What a message asks for.
#[derive(Debug, PartialEq)]
pub enum Inbound {
    /// Something for the port.
    Ask {
        /// What.
        request: Request,
        /// Hold, stop and abort pass every queue, and so does an alarm.
        urgent: bool,
    },
    /// A command that never becomes a request: its sender is told.
    Reject {
        /// To which coordinate system.
        cs: CoordinateSystemNumber,
        /// Who sent it.
        client_id: String,
        /// Its id.
        command_id: String,
        /// Why.
        refusal: Refusal,
    },
    /// What cannot be answered, since nobody is named: for the log.
    Drop(String),
}

/// Reads a message. `retained`: it came with the retain flag, so that it is old, and is not carried out.
pub fn decode(path: &str, payload: &[u8], retained: bool) -> Inbound {
    let read = if payload.len() > PAYLOAD_MAX {
        Err(format!("its payload is larger than {PAYLOAD_MAX} bytes"))
    } else {
        let found = topics().find_map(|(row, topic)| Some((row, topic, take_apart(topic.pattern, path)?)));
        match found {
            None if retained => Err("it is retained; publish it without the retain flag".to_owned()),
            None => Err("there is no such topic".to_owned()),
            Some((row, topic, params)) => row.message(topic, &params, payload, retained),
        }
    };
    read.unwrap_or_else(|text| Inbound::Drop(format!("MQTT message on {path} refused: {text}")))
}

impl Row {
    fn message(
        &self,
        topic: &Topic,
        params: &[(&str, &str)],
        payload: &[u8],
        retained: bool,
    ) -> Result<Inbound, String> {
        let param = |name: &str| {
            let mut params = params.iter();
            params
                .find(|(known, _)| *known == name)
                .map_or("", |(_, value)| value)
        };
        let read = match topic.envelope {
            Envelope::Nothing if retained && !topic.retained => {
                return Err("it is retained; publish it without the retain flag".to_owned());
            }
            Envelope::Nothing => {
                let received = Received {
                    params,
                    body: Cow::Borrowed(payload),
                    query: QueryValues::default(),
                    sender: None,
                };
                let request = (self.read)(received).map_err(text_of)?;
                let urgent = matches!(request, Request::RaiseAlarm(_));
                return Ok(Inbound::Ask { request, urgent });
            }
            Envelope::Command => command,
            Envelope::Lease => lease,
            Envelope::Variables => variables,
        };
        let cs = number(param("cs")).ok_or_else(|| text_of(Fault::Level(param("cs").to_owned())))?;
        Ok(match read(cs, param("verb"), payload, retained) {
            Ok(request) => Inbound::Ask {
                urgent: matches!(&request, Request::Command { command, .. } if command.verb().is_urgent()),
                request,
            },
            Err(refusal) => reject(cs, payload, refusal),
        })
    }
}

fn text_of(fault: Fault) -> String {
    match fault {
        Fault::Level(level) => format!("{level} is not a number that can stand there"),
        Fault::Json(error) => format!("the JSON is not right: {error}"),
        Fault::NotFound(text) | Fault::Invalid(text) => text,
    }
}

fn invalid(text: impl Into<String>) -> Refusal {
    Refusal::new(RefusalCode::Invalid, text)
}

/// Reads a payload that says who sends it.
fn sent<T: DeserializeOwned>(
    payload: &[u8],
    retained: Option<&str>,
    ids: fn(&T) -> (&str, &str),
) -> Result<T, Refusal> {
    let sent = json_object(payload).map_err(|error| invalid(text_of(Fault::Json(error))))?;
    let (client_id, command_id) = ids(&sent);
    check_command(client_id, command_id)?;
    match retained {
        None => Ok(sent),
        Some(what) => {
            let text = format!("{what} must not be retained; publish it without the retain flag");
            Err(Refusal::new(RefusalCode::Retained, text))
        }
    }
}

/// Payload of `command/{verb}`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CommandIn {
    command_id: String,
    client_id: String,
    issued_at: Option<Timestamp>,
    ttl_ms: Option<u64>,
    expect: Option<Expect>,
    fence: Option<u64>,
    #[serde(default)]
    args: Value,
}

fn command(
    cs: CoordinateSystemNumber,
    verb: &str,
    payload: &[u8],
    retained: bool,
) -> Result<Request, Refusal> {
    let sent = sent(payload, retained.then_some("a command"), |sent: &CommandIn| {
        (&sent.client_id, &sent.command_id)
    })?;
    Ok(Request::Command {
        cs,
        command: Command::parse(verb, &sent.args).map_err(invalid)?,
        meta: CommandMeta {
            command_id: sent.command_id,
            client_id: sent.client_id,
            issued_at: sent.issued_at,
            ttl_ms: sent.ttl_ms,
            expect: sent.expect,
            fence: sent.fence,
        },
        wait: false,
    })
}

/// Payload of `lease/take`, `lease/release` and `lease/break`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LeaseIn {
    command_id: String,
    client_id: String,
    holder: Option<String>,
    ttl_ms: Option<u64>,
    fence: Option<u64>,
}

fn lease(cs: CoordinateSystemNumber, verb: &str, payload: &[u8], retained: bool) -> Result<Request, Refusal> {
    let sent = sent(payload, retained.then_some("this"), |sent: &LeaseIn| {
        (&sent.client_id, &sent.command_id)
    })?;
    let request = match (verb, sent.holder, sent.ttl_ms, sent.fence) {
        ("take", holder, ttl_ms, fence) => LeaseRequest::Take(LeaseTake {
            holder,
            ttl_ms,
            fence,
        }),
        ("release", None, None, Some(fence)) => LeaseRequest::Release(LeaseRelease { fence }),
        ("break", None, None, None) => LeaseRequest::Break,
        ("release", ..) => return Err(invalid("lease/release takes the fence alone")),
        _ => return Err(invalid("lease/break takes nothing more")),
    };
    let meta = CommandMeta {
        command_id: sent.command_id,
        client_id: sent.client_id,
        ..CommandMeta::default()
    };
    Ok(Request::Lease { cs, request, meta })
}

/// Payload of `variable/get` and `variable/set`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VariableIn {
    command_id: String,
    client_id: String,
    issued_at: Option<Timestamp>,
    ttl_ms: Option<u64>,
    kind: VariableKind,
    from: u32,
    count: Option<u32>,
    values: Option<Vec<Number>>,
}

fn variables(
    cs: CoordinateSystemNumber,
    verb: &str,
    payload: &[u8],
    retained: bool,
) -> Result<Request, Refusal> {
    let sent = sent(payload, retained.then_some("this"), |sent: &VariableIn| {
        (&sent.client_id, &sent.command_id)
    })?;
    let (area, from) = (VariableArea::of(sent.kind, cs), sent.from);
    let meta = Some(CommandMeta {
        command_id: sent.command_id,
        client_id: sent.client_id,
        issued_at: sent.issued_at,
        ttl_ms: sent.ttl_ms,
        ..CommandMeta::default()
    });
    match (verb, sent.count, sent.values) {
        ("get", Some(count), None) => Ok(Request::ReadVariables {
            area,
            from,
            count,
            meta,
        }),
        ("set", None, Some(values)) => {
            let values = values.into_iter().map(|number| number.0).collect();
            Ok(Request::WriteVariables {
                area,
                from,
                values,
                meta,
            })
        }
        ("get", ..) => Err(invalid("variable/get takes kind, from and count")),
        _ => Err(invalid("variable/set takes kind, from and values")),
    }
}

/// Tells the sender when it can be read who that is, else the log.
fn reject(cs: CoordinateSystemNumber, payload: &[u8], refusal: Refusal) -> Inbound {
    let value: Value = serde_json::from_slice(payload).unwrap_or_default();
    let text = |key: &str| value.get(key).and_then(Value::as_str).unwrap_or_default();
    let (client_id, command_id) = (text("client_id"), text("command_id"));
    if is_client_id(client_id) {
        Inbound::Reject {
            cs,
            client_id: client_id.to_owned(),
            command_id: command_id.chars().take(COMMAND_ID_MAX).collect(),
            refusal,
        }
    } else {
        let text = refusal.text;
        Inbound::Drop(format!("MQTT command refused, and nobody to tell: {text}"))
    }
}

#[cfg(test)]
mod tests;
