//! Method calls, which the machine executes on behalf of the calling user.

use std::time::Duration;

use opcua::server::authenticator::UserToken;
use opcua::types::{DiagnosticInfo, StatusCode, UAString, Variant};
use plc_api::Plc;
use plc_protocol::types::command::Command;
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::{
    HandshakeResult, HandshakeStatus, Redeliver, Redelivery, Reset, ResetResult,
};
use plc_protocol::types::question::OperatorAnswer;
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::{Input, OverrideChange, Request, typed};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use serde_json::{Map, Value, json};

use crate::own::{Does, METHODS, Method, ROOT};

/// Time that a call waits for the effect of a command. Reason: clients wait for 4 s or more.
const PATIENCE: Duration = Duration::from_secs(2);

/// Result of a call.
pub struct Outcome {
    pub status: StatusCode,
    code: String,
    text: String,
}

impl Outcome {
    fn done() -> Self {
        Self::new(StatusCode::Good, "ok", "")
    }

    fn new(status: StatusCode, code: impl Into<String>, text: impl Into<String>) -> Self {
        Self {
            status,
            code: code.into(),
            text: text.into(),
        }
    }

    fn invalid(text: impl Into<String>) -> Self {
        Self::new(StatusCode::BadInvalidArgument, "invalid", text)
    }

    /// Returns the outcome for a client without a user.
    pub fn for_anonymous() -> Self {
        let text = "log in with a user name and a token of the machine: clients without a user only read";
        Self::new(StatusCode::BadUserAccessDenied, "forbidden", text)
    }

    /// Returns the outputs of the method.
    pub fn outputs(&self) -> Vec<Variant> {
        vec![self.code.as_str().into(), self.text.as_str().into()]
    }

    /// Returns the text for clients that request diagnostics: many do not show the outputs of a failed call.
    pub fn diagnostics(&self) -> DiagnosticInfo {
        DiagnosticInfo {
            additional_info: Some(UAString::from(self.text.as_str())),
            ..DiagnosticInfo::default()
        }
    }
}

impl From<plc_api::Error> for Outcome {
    fn from(error: plc_api::Error) -> Self {
        match error {
            plc_api::Error::Refused(refusal) => refusal.into(),
            plc_api::Error::CommandFailed { code, text, .. } => {
                Self::new(StatusCode::BadInvalidState, code, text)
            }
            plc_api::Error::NoAnswer { text, .. } => Self::new(StatusCode::BadTimeout, "no_answer", text),
            other => Self::new(StatusCode::BadNoCommunication, "unavailable", other.to_string()),
        }
    }
}

impl From<Refusal> for Outcome {
    fn from(refusal: Refusal) -> Self {
        let status = match refusal.code {
            RefusalCode::Forbidden => StatusCode::BadUserAccessDenied,
            RefusalCode::NotFound => StatusCode::BadNotFound,
            RefusalCode::Invalid | RefusalCode::TooLarge => StatusCode::BadInvalidArgument,
            RefusalCode::NoAnswer => StatusCode::BadTimeout,
            RefusalCode::Unavailable => StatusCode::BadNoCommunication,
            _ => StatusCode::BadInvalidState,
        };
        Self::new(
            status,
            plc_protocol::execution::wire_name(&refusal.code),
            refusal.text,
        )
    }
}

/// Returns the method at a path, and its coordinate system.
pub fn find(path: &str) -> Option<(CoordinateSystemNumber, &'static Method)> {
    let (number, name) = path.strip_prefix(ROOT)?.strip_prefix("/cs")?.split_once('/')?;
    let method = METHODS.iter().find(|method| method.name == name)?;
    Some((number.parse().ok()?, method))
}

/// Executes a call. A command that takes longer than clients wait continues, and the result of the call reports that.
pub async fn call(
    plc: Plc,
    user: &UserToken,
    cs: CoordinateSystemNumber,
    method: &'static Method,
    inputs: Vec<Variant>,
) -> Outcome {
    let name = user.0.rsplit_once('#').map_or("", |(name, _)| name).to_owned();
    let carried_out = tokio::spawn(execute_method(plc, name, cs, method, inputs));
    match tokio::time::timeout(PATIENCE, carried_out).await {
        Ok(Ok(outcome)) => outcome,
        Ok(Err(error)) => Outcome::new(StatusCode::BadUnexpectedError, "invalid", error.to_string()),
        Err(_) => Outcome::new(
            StatusCode::GoodCompletesAsynchronously,
            "accepted",
            "the command continues",
        ),
    }
}

async fn execute_method(
    plc: Plc,
    user: String,
    cs: CoordinateSystemNumber,
    method: &Method,
    inputs: Vec<Variant>,
) -> Outcome {
    let arguments = match arguments(method, &inputs) {
        Ok(arguments) => arguments,
        Err(text) => return Outcome::invalid(text),
    };
    let request = match method.does {
        Does::Command(verb) => return command(&plc, cs, verb, arguments).await,
        Does::SetOverrides => {
            let percent = |name: &str| arguments[name].as_f64();
            let change = OverrideChange {
                feed: percent("feed"),
                rapid: percent("rapid"),
                spindle: percent("spindle"),
            };
            Request::Input(cs, Input::Override(change))
        }
        Does::SetInput => {
            let value = arguments["value"] == true;
            let input = match arguments["input"].as_str() {
                Some("single_block") => Input::SingleBlock(value),
                Some("dry_run") => Input::DryRun(value),
                Some("optional_stop") => Input::OptionalStop(value),
                other => {
                    let other = other.unwrap_or_default();
                    return Outcome::invalid(format!(
                        "there is no input {other}; write single_block, dry_run or optional_stop"
                    ));
                }
            };
            Request::Input(cs, input)
        }
        Does::ResetMCode | Does::FailMCode | Does::RedeliverMCode | Does::Answer => {
            return about_m_code(&plc, user, cs, method.does, &arguments).await;
        }
    };
    match plc.port().request(request).await {
        Ok(_) => Outcome::done(),
        Err(refusal) => refusal.into(),
    }
}

async fn command(
    plc: &Plc,
    cs: CoordinateSystemNumber,
    verb: &str,
    arguments: Map<String, Value>,
) -> Outcome {
    let command = match Command::parse(verb, &Value::Object(arguments)) {
        Ok(command) => command,
        Err(text) => return Outcome::invalid(text),
    };
    match plc.coordinate_system(cs).command(command).await {
        Ok(()) => Outcome::done(),
        Err(error) => error.into(),
    }
}

/// Executes an operator's decision about an M code.
async fn about_m_code(
    plc: &Plc,
    user: String,
    cs: CoordinateSystemNumber,
    does: Does,
    arguments: &Map<String, Value>,
) -> Outcome {
    let text = |name: &str| arguments[name].as_str().unwrap_or_default().to_owned();
    let boot_id = BootId(text("boot_id"));
    let seq = arguments["seq"].as_u64().unwrap_or_default();
    let m = m_of(plc, cs, seq).await;
    let asked = match does {
        Does::RedeliverMCode => {
            let how = match &*text("how") {
                "verify" => Redelivery::Verify,
                "redo" => Redelivery::Redo,
                other => return Outcome::invalid(format!("how is {other:?}; write verify or redo")),
            };
            let request = typed::Redeliver(cs, m, Redeliver { boot_id, seq, how });
            plc.port().ask(request).await
        }
        Does::Answer => {
            let answer = OperatorAnswer {
                boot_id,
                seq,
                question_id: text("question_id"),
                choice: text("choice"),
                client_id: Some(user),
            };
            plc.port().ask(typed::AnswerQuestion(cs, m, answer)).await
        }
        _ => {
            let is_fault = does == Does::FailMCode;
            let code = arguments.get("code").and_then(Value::as_u64);
            let reset = Reset {
                boot_id,
                seq,
                handler_id: user,
                instance: None,
                result: if is_fault {
                    ResetResult::Fault
                } else {
                    ResetResult::Ok
                },
                code: code.and_then(|code| u16::try_from(code).ok()),
                text: is_fault.then(|| text("text")),
                force: Some(true),
            };
            plc.port().ask(typed::Reset(cs, m, reset)).await.map(Some)
        }
    };
    match asked {
        Ok(result) => result.map_or_else(Outcome::done, handshake),
        Err(refusal) => refusal.into(),
    }
}

fn handshake(result: HandshakeResult) -> Outcome {
    let status = match result.status {
        HandshakeStatus::Accepted | HandshakeStatus::Duplicate => StatusCode::Good,
        HandshakeStatus::Unknown => StatusCode::BadNotFound,
        HandshakeStatus::Refused => StatusCode::BadInvalidArgument,
        _ => StatusCode::BadInvalidState,
    };
    let code = plc_protocol::execution::wire_name(&result.status);
    Outcome::new(status, code, result.text.unwrap_or_default())
}

/// Returns the M number of a pending M code.
async fn m_of(plc: &Plc, cs: CoordinateSystemNumber, seq: u64) -> Option<u16> {
    let said = plc.port().read(&Topic::cs(cs, CsTopic::Pending)).await?;
    let Payload::Pending(pending) = &said.payload else {
        return None;
    };
    let mut open = pending.outputs.iter();
    open.find(|open| open.output.seq == seq).map(|open| open.output.m)
}

/// Returns the inputs by name, as JSON.
fn arguments(method: &Method, inputs: &[Variant]) -> Result<Map<String, Value>, String> {
    let mut said = Map::new();
    for (input, value) in method.inputs.iter().zip(inputs) {
        let (name, ..) = *input;
        let value = json_of(value)
            .ok_or_else(|| format!("{name}: a value of type {:?} cannot be read", value.type_id()))?;
        // an empty list means all axes
        if !matches!(&value, Value::Array(all) if all.is_empty()) {
            said.insert(name.to_owned(), value);
        }
    }
    Ok(said)
}

fn json_of(value: &Variant) -> Option<Value> {
    Some(match value {
        Variant::Boolean(value) => json!(value),
        Variant::Byte(value) => json!(value),
        Variant::SByte(value) => json!(value),
        Variant::Int16(value) => json!(value),
        Variant::UInt16(value) => json!(value),
        Variant::Int32(value) => json!(value),
        Variant::UInt32(value) => json!(value),
        Variant::Int64(value) => json!(value),
        Variant::UInt64(value) => json!(value),
        Variant::Float(value) => json!(value),
        Variant::Double(value) => json!(value),
        Variant::String(value) => json!(value.as_ref()),
        Variant::Empty => json!([]),
        Variant::Array(values) => values
            .values
            .iter()
            .map(json_of)
            .collect::<Option<Vec<Value>>>()?
            .into(),
        _ => return None,
    })
}
