//! What comes in over MQTT: topic and payload to a request. Pure: no I/O.

use std::collections::BTreeMap;

use plc_api::types::command::{Command, CommandMeta, Expect};
use plc_api::types::data::{Number, VariableArea, VariableKind};
use plc_api::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use plc_api::types::request::{Input, Refusal, RefusalCode, Request};
use plc_api::types::state::{Lock, Switch, Tool};
use plc_api::types::{CoordinateSystemNumber, Timestamp};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use plc_api::wire::json_object;

/// Bytes of one payload; more is refused. Reason: the largest, a fault text, is far below.
const PAYLOAD_MAX: usize = 64 * 1024;

/// What a message asks for.
#[derive(Debug, PartialEq)]
pub(crate) enum Inbound {
    /// Something for the port. `urgent`: hold, stop and abort pass every queue.
    Ask { request: Request, urgent: bool },
    /// A command that never becomes a request: its sender is told.
    Reject {
        cs: CoordinateSystemNumber,
        client_id: String,
        command_id: String,
        refusal: Refusal,
    },
    /// What cannot be answered, since nobody is named: for the log.
    Drop(String),
}
/// Reads a message. `retained`: it came with the retain flag, so that it is old, and is not carried out.
pub(crate) fn read(path: &str, payload: &[u8], retained: bool) -> Inbound {
    let levels: Vec<_> = path.split('/').collect();
    let read = if payload.len() > PAYLOAD_MAX {
        Err(format!("its payload is larger than {PAYLOAD_MAX} bytes"))
    } else {
        match levels.as_slice() {
            ["cs", cs, "command", verb] => number(cs).map(|cs| command(cs, verb, payload, retained)),
            ["cs", cs, "variable", what] => number(cs).and_then(|cs| variable(cs, what, payload, retained)),
            ["cs", cs, "lease", what] => number(cs).and_then(|cs| lease(cs, what, payload, retained)),
            ["handler", id, "presence"] => handler(id, payload),
            _ if retained => Err("it is retained; publish it without the retain flag".to_owned()),
            ["motor", motor, "skip_input", "set"] => skip_input(motor, payload),
            ["alarm", "raise"] => json(payload).map(|raise| Inbound::Ask {
                request: Request::RaiseAlarm(raise),
                urgent: true,
            }),
            ["cs", cs, rest @ ..] => number(cs).and_then(|cs| setting(cs, rest, payload)),
            _ => Err("there is no such topic".to_owned()),
        }
    };
    read.unwrap_or_else(|text| Inbound::Drop(format!("MQTT message on {path} refused: {text}")))
}

fn setting(cs: CoordinateSystemNumber, levels: &[&str], payload: &[u8]) -> Result<Inbound, String> {
    let request = match levels {
        ["m_code", m, what] => {
            let m = Some(number(m)?);
            match *what {
                "claim" => Request::Claim(cs, m, json(payload)?),
                "reset" => Request::Reset(cs, m, json(payload)?),
                "progress" => Request::Progress(cs, m, json(payload)?),
                "redeliver" => Request::Redeliver(cs, m, json(payload)?),
                "ask" => Request::Ask(cs, m, json(payload)?),
                "answer" => Request::AnswerQuestion(cs, m, json(payload)?),
                "validate_result" => Request::ValidateResult(cs, m, json(payload)?),
                _ => return Err("there is no such topic".to_owned()),
            }
        }
        ["input", input, "set"] => Request::Input(cs, self::input(input, payload)?),
        ["override", "set"] => Request::Input(cs, Input::Override(json(payload)?)),
        ["spindle", "set"] => Request::Spindle(cs, json(payload)?),
        ["tool", "set"] => Request::Tool(cs, json::<Tool>(payload)?.id),
        _ => return Err("there is no such topic".to_owned()),
    };
    Ok(Inbound::Ask {
        request,
        urgent: false,
    })
}

fn input(name: &str, payload: &[u8]) -> Result<Input, String> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct SkipSet {
        set: BTreeMap<u8, bool>,
    }
    let switch = || json::<Switch>(payload).map(|switch| switch.value);
    Ok(match name {
        "optional_skip" => Input::OptionalSkip(json::<SkipSet>(payload)?.set),
        "optional_stop" => Input::OptionalStop(switch()?),
        "single_block" => Input::SingleBlock(switch()?),
        "dry_run" => Input::DryRun(switch()?),
        "interlock" => Input::Interlock(json::<Lock>(payload)?),
        "start_lock" => Input::StartLock(json::<Lock>(payload)?),
        _ => return Err("there is no such input".to_owned()),
    })
}

fn skip_input(motor: &str, payload: &[u8]) -> Result<Inbound, String> {
    Ok(Inbound::Ask {
        request: Request::SkipInput(number(motor)?, json::<Switch>(payload)?.value),
        urgent: false,
    })
}

fn handler(id: &str, payload: &[u8]) -> Result<Inbound, String> {
    Ok(Inbound::Ask {
        request: Request::Handler(id.to_owned(), json(payload)?),
        urgent: false,
    })
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

fn command(cs: CoordinateSystemNumber, verb: &str, payload: &[u8], retained: bool) -> Inbound {
    let read: Result<CommandIn, Refusal> =
        json(payload).map_err(|text| Refusal::new(RefusalCode::Invalid, text));
    let checked = read.and_then(|command| {
        check_ids(&command.client_id, &command.command_id)
            .map_err(|text| Refusal::new(RefusalCode::Invalid, text))?;
        if retained {
            let text = "a command must not be retained; publish it without the retain flag";
            return Err(Refusal::new(RefusalCode::Retained, text));
        }
        let parsed =
            Command::parse(verb, &command.args).map_err(|text| Refusal::new(RefusalCode::Invalid, text))?;
        Ok((command, parsed))
    });
    match checked {
        Ok((command_in, command)) => Inbound::Ask {
            urgent: matches!(command, Command::Hold | Command::Stop | Command::Abort),
            request: Request::Command {
                cs,
                command,
                meta: CommandMeta {
                    command_id: command_in.command_id,
                    client_id: command_in.client_id,
                    issued_at: command_in.issued_at,
                    ttl_ms: command_in.ttl_ms,
                    expect: command_in.expect,
                    fence: command_in.fence,
                },
                wait: false,
            },
        },
        Err(refusal) => reject(cs, payload, refusal),
    }
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

fn lease(cs: CoordinateSystemNumber, what: &str, payload: &[u8], retained: bool) -> Result<Inbound, String> {
    if !["take", "release", "break"].contains(&what) {
        return Err("there is no such topic".to_owned());
    }
    let refused = |code, text: &str| Ok(reject(cs, payload, Refusal::new(code, text)));
    let read = json::<LeaseIn>(payload).and_then(|read| {
        check_ids(&read.client_id, &read.command_id)?;
        Ok(read)
    });
    let read = match read {
        Ok(_) if retained => {
            let text = "this must not be retained; publish it without the retain flag";
            return refused(RefusalCode::Retained, text);
        }
        Ok(read) => read,
        Err(text) => return refused(RefusalCode::Invalid, &text),
    };
    let request = match (what, read.holder, read.ttl_ms, read.fence) {
        ("take", holder, ttl_ms, fence) => LeaseRequest::Take(LeaseTake {
            holder,
            ttl_ms,
            fence,
        }),
        ("release", None, None, Some(fence)) => LeaseRequest::Release(LeaseRelease { fence }),
        ("break", None, None, None) => LeaseRequest::Break,
        ("release", ..) => return refused(RefusalCode::Invalid, "lease/release takes the fence alone"),
        _ => return refused(RefusalCode::Invalid, "lease/break takes nothing more"),
    };
    Ok(Inbound::Ask {
        request: Request::Lease {
            cs,
            request,
            meta: CommandMeta {
                command_id: read.command_id,
                client_id: read.client_id,
                ..CommandMeta::default()
            },
        },
        urgent: false,
    })
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

fn variable(
    cs: CoordinateSystemNumber,
    what: &str,
    payload: &[u8],
    retained: bool,
) -> Result<Inbound, String> {
    if !["get", "set"].contains(&what) {
        return Err("there is no such topic".to_owned());
    }
    let refused = |text: String| reject(cs, payload, Refusal::new(RefusalCode::Invalid, text));
    let read = json::<VariableIn>(payload).and_then(|read| {
        check_ids(&read.client_id, &read.command_id)?;
        Ok(read)
    });
    let read = match read {
        Ok(_) if retained => {
            let text = "this must not be retained; publish it without the retain flag";
            return Ok(reject(cs, payload, Refusal::new(RefusalCode::Retained, text)));
        }
        Ok(read) => read,
        Err(text) => return Ok(refused(text)),
    };
    let (area, from) = (VariableArea::of(read.kind, cs), read.from);
    let meta = Some(CommandMeta {
        command_id: read.command_id,
        client_id: read.client_id,
        issued_at: read.issued_at,
        ttl_ms: read.ttl_ms,
        ..CommandMeta::default()
    });
    let request = match (what, read.count, read.values) {
        ("get", Some(count), None) => Request::ReadVariables {
            area,
            from,
            count,
            meta,
        },
        ("set", None, Some(values)) => Request::WriteVariables {
            area,
            from,
            values: values.into_iter().map(|number| number.0).collect(),
            meta,
        },
        ("get", ..) => return Ok(refused("variable/get takes kind, from and count".to_owned())),
        _ => return Ok(refused("variable/set takes kind, from and values".to_owned())),
    };
    Ok(Inbound::Ask {
        request,
        urgent: false,
    })
}

/// Tells the sender when it can be read who that is, else the log.
fn reject(cs: CoordinateSystemNumber, payload: &[u8], refusal: Refusal) -> Inbound {
    let value: Value = serde_json::from_slice(payload).unwrap_or_default();
    let text = |key: &str| value.get(key).and_then(Value::as_str).unwrap_or_default();
    let (client_id, command_id) = (text("client_id"), text("command_id"));
    if check_client_id(client_id).is_ok() {
        Inbound::Reject {
            cs,
            client_id: client_id.to_owned(),
            command_id: command_id.chars().take(ID_MAX).collect(),
            refusal,
        }
    } else {
        Inbound::Drop(format!(
            "MQTT command refused, and nobody to tell: {}",
            refusal.text
        ))
    }
}

/// Characters of a command id.
const ID_MAX: usize = 128;

fn check_ids(client_id: &str, command_id: &str) -> Result<(), String> {
    check_client_id(client_id)?;
    if (1..=ID_MAX).contains(&command_id.chars().count()) {
        Ok(())
    } else {
        Err(format!("command_id: write 1 to {ID_MAX} characters"))
    }
}

fn check_client_id(client_id: &str) -> Result<(), String> {
    if (1..=64).contains(&client_id.chars().count()) && !client_id.contains(['/', '+', '#', '\0']) {
        Ok(())
    } else {
        Err("client_id: write 1 to 64 characters without / + #".to_owned())
    }
}

fn number<T: std::str::FromStr + ToString>(level: &str) -> Result<T, String> {
    let number = level.parse().ok();
    number
        .filter(|number: &T| number.to_string() == level)
        .ok_or_else(|| format!("{level} is not a number that can stand there"))
}

fn json<T: DeserializeOwned>(payload: &[u8]) -> Result<T, String> {
    json_object(payload).map_err(|error| format!("the JSON is not right: {error}"))
}

#[cfg(test)]
mod tests;
