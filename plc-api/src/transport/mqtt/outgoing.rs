//! Requests as MQTT messages. Pure: no I/O.

use serde::Serialize;
use serde_json::{Value, json};

use crate::names::unique_name;
use crate::types::CoordinateSystemNumber;
use crate::types::command::{Command, CommandMeta};
use crate::types::data::{Number, VariableArea};
use crate::types::lease::LeaseRequest;
use crate::types::request::{Input, Refusal, RefusalCode, Request};

/// A message to be sent, and how its end is known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Outgoing {
    /// Below the machine's root.
    pub(super) path: String,
    pub(super) payload: String,
    pub(super) retain: bool,
    pub(super) until: Until,
}

/// What ends a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Until {
    /// The broker has it.
    Acknowledged,
    /// The `result` of a claim or reset.
    Result {
        cs: CoordinateSystemNumber,
        m: u16,
        seq: u64,
        handler_id: String,
        is_reset: bool,
    },
    /// The `reply` of a command: accepted, or done.
    Reply { command_id: String, done: bool },
}

/// The message of a request. `m_of` finds the M number of an open output where the request does not name it.
pub(super) fn outgoing(
    request: Request,
    client_id: &str,
    m_of: impl Fn(CoordinateSystemNumber, u64) -> Option<u16>,
) -> Result<Outgoing, Refusal> {
    let m_code = |cs, m: Option<u16>, seq| {
        m.or_else(|| m_of(cs, seq)).ok_or_else(|| {
            let text = format!("no output {seq} is open in coordinate system {cs}");
            Refusal::new(RefusalCode::NotFound, text)
        })
    };
    match request {
        Request::Claim(cs, m, claim) => {
            let m = m_code(cs, m, claim.seq)?;
            let until = result_of(cs, m, claim.seq, &claim.handler_id, false);
            message(format!("cs/{cs}/m_code/{m}/claim"), &claim, until)
        }
        Request::Reset(cs, m, reset) => {
            let m = m_code(cs, m, reset.seq)?;
            let until = result_of(cs, m, reset.seq, &reset.handler_id, true);
            message(format!("cs/{cs}/m_code/{m}/reset"), &reset, until)
        }
        Request::Progress(cs, m, report) => {
            let m = m_code(cs, m, report.seq)?;
            told(cs, m, "progress", &report)
        }
        Request::Redeliver(cs, m, redeliver) => {
            let m = m_code(cs, m, redeliver.seq)?;
            told(cs, m, "redeliver", &redeliver)
        }
        Request::Ask(cs, m, ask) => {
            let m = m_code(cs, m, ask.seq)?;
            told(cs, m, "ask", &ask)
        }
        Request::AnswerQuestion(cs, m, answer) => {
            let m = m_code(cs, m, answer.seq)?;
            told(cs, m, "answer", &answer)
        }
        Request::ValidateResult(cs, Some(m), result) => told(cs, m, "validate_result", &result),
        Request::Handler(id, presence) => {
            let path = format!("handler/{id}/presence");
            let mut outgoing = message(path, &presence, Until::Acknowledged)?;
            outgoing.retain = true;
            Ok(outgoing)
        }
        Request::Command {
            cs,
            command,
            meta,
            wait,
        } => command_message(cs, &command, &meta, wait, client_id),
        Request::Lease { cs, request, meta } => lease_message(cs, &request, meta, client_id),
        Request::Input(cs, input) => input_message(cs, &input),
        Request::Spindle(cs, command) => set(format!("cs/{cs}/spindle"), &command),
        Request::Tool(cs, id) => set(format!("cs/{cs}/tool"), &json!({ "id": id })),
        Request::SkipInput(motor, value) => {
            set(format!("motor/{motor}/skip_input"), &json!({ "value": value }))
        }
        Request::RaiseAlarm(raise) => message("alarm/raise".to_owned(), &raise, Until::Acknowledged),
        Request::ReadVariables { .. } | Request::WriteVariables { .. } => {
            variable_message(request, client_id)
        }
        _ => {
            let text = "MQTT does not carry this request; use REST";
            Err(Refusal::new(RefusalCode::NotSupported, text))
        }
    }
}

/// What is said of an output, and is over when the broker has it.
fn told(
    cs: CoordinateSystemNumber,
    m: u16,
    what: &str,
    payload: &impl Serialize,
) -> Result<Outgoing, Refusal> {
    message(format!("cs/{cs}/m_code/{m}/{what}"), payload, Until::Acknowledged)
}

/// A value of the machine that anyone may set.
fn set(path: String, payload: &impl Serialize) -> Result<Outgoing, Refusal> {
    message(path + "/set", payload, Until::Acknowledged)
}

fn result_of(cs: CoordinateSystemNumber, m: u16, seq: u64, handler_id: &str, is_reset: bool) -> Until {
    Until::Result {
        cs,
        m,
        seq,
        handler_id: handler_id.to_owned(),
        is_reset,
    }
}

fn message(path: String, payload: &impl Serialize, until: Until) -> Result<Outgoing, Refusal> {
    let payload = serde_json::to_string(payload)
        .map_err(|error| Refusal::new(RefusalCode::Invalid, format!("not JSON: {error}")))?;
    Ok(Outgoing {
        path,
        payload,
        retain: false,
        until,
    })
}

fn command_message(
    cs: CoordinateSystemNumber,
    command: &Command,
    meta: &CommandMeta,
    wait: bool,
    client_id: &str,
) -> Result<Outgoing, Refusal> {
    let words = |error: serde_json::Error| Refusal::new(RefusalCode::Invalid, error.to_string());
    // replies come to this connection's client id, whoever asked
    let meta = CommandMeta {
        client_id: client_id.to_owned(),
        ..meta.clone()
    };
    let mut payload = serde_json::to_value(&meta).map_err(words)?;
    payload["args"] = command.args();
    let verb = serde_json::to_value(command.verb()).map_err(words)?;
    let path = format!("cs/{cs}/command/{}", verb.as_str().unwrap_or_default());
    let until = Until::Reply {
        command_id: meta.command_id,
        done: wait,
    };
    message(path, &payload, until)
}

fn lease_message(
    cs: CoordinateSystemNumber,
    request: &LeaseRequest,
    meta: CommandMeta,
    client_id: &str,
) -> Result<Outgoing, Refusal> {
    let (what, mut payload) = match request {
        LeaseRequest::Take(take) => ("take", json!(take)),
        LeaseRequest::Release(release) => ("release", json!(release)),
        LeaseRequest::Break => ("break", json!({})),
    };
    payload["command_id"] = json!(meta.command_id);
    // replies come to this connection's client id, whoever asked
    payload["client_id"] = json!(client_id);
    let until = Until::Reply {
        command_id: meta.command_id,
        done: true,
    };
    message(format!("cs/{cs}/lease/{what}"), &payload, until)
}

/// P variables are the same on the topic of each coordinate system.
fn variable_message(request: Request, client_id: &str) -> Result<Outgoing, Refusal> {
    let (what, area, meta, mut payload) = match request {
        Request::ReadVariables {
            area,
            from,
            count,
            meta,
        } => ("get", area, meta, json!({"from": from, "count": count})),
        Request::WriteVariables {
            area,
            from,
            values,
            meta,
        } => {
            let values: Vec<Number> = values.into_iter().map(Number).collect();
            ("set", area, meta, json!({"from": from, "values": values}))
        }
        _ => {
            let text = "not a request for variables";
            return Err(Refusal::new(RefusalCode::NotSupported, text));
        }
    };
    let cs = match area {
        VariableArea::Global => 1,
        VariableArea::CoordinateSystem(cs) => cs,
    };
    let command_id = meta.map_or_else(|| unique_name("variable"), |meta| meta.command_id);
    payload["command_id"] = json!(command_id);
    // replies come to this connection's client id, whoever asked
    payload["client_id"] = json!(client_id);
    payload["kind"] = json!(area.kind());
    let until = Until::Reply {
        command_id,
        done: true,
    };
    message(format!("cs/{cs}/variable/{what}"), &payload, until)
}

fn input_message(cs: CoordinateSystemNumber, input: &Input) -> Result<Outgoing, Refusal> {
    let (path, payload): (&str, Value) = match input {
        Input::OptionalSkip(set) => ("input/optional_skip", json!({ "set": set })),
        Input::OptionalStop(value) => ("input/optional_stop", json!({ "value": value })),
        Input::SingleBlock(value) => ("input/single_block", json!({ "value": value })),
        Input::DryRun(value) => ("input/dry_run", json!({ "value": value })),
        Input::Interlock(lock) => ("input/interlock", json!(lock)),
        Input::StartLock(lock) => ("input/start_lock", json!(lock)),
        Input::Override(change) => ("override", json!(change)),
    };
    set(format!("cs/{cs}/{path}"), &payload)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::claim::reset_of;
    use crate::types::BootId;
    use crate::types::machine::AlarmRaise;
    use crate::types::output::HandlerPresence;

    fn sent(request: Request) -> (String, Value, bool) {
        let outgoing = outgoing(request, "plc-1", |_, _| None).unwrap();
        (
            outgoing.path,
            serde_json::from_str(&outgoing.payload).unwrap(),
            outgoing.retain,
        )
    }

    #[test]
    fn requests_have_the_topics_and_payloads_of_section_4() {
        let reset = reset_of(&BootId("b".into()), 7, "h", None);
        let json = json!({"boot_id": "b", "seq": 7, "handler_id": "h", "result": "ok"});
        assert_eq!(
            sent(Request::Reset(2, Some(100), reset)),
            ("cs/2/m_code/100/reset".to_owned(), json, false)
        );
        let gone = HandlerPresence {
            online: false,
            handles: Vec::new(),
            validates: false,
        };
        let json = json!({"online": false, "handles": [], "validates": false});
        assert_eq!(
            sent(Request::Handler("h".into(), gone)),
            ("handler/h/presence".to_owned(), json, true)
        );
        let skip = Input::OptionalSkip([(3, true)].into());
        assert_eq!(
            sent(Request::Input(1, skip)),
            (
                "cs/1/input/optional_skip/set".to_owned(),
                json!({"set": {"3": true}}),
                false
            )
        );
        assert_eq!(
            sent(Request::Tool(1, 4)),
            ("cs/1/tool/set".to_owned(), json!({"id": 4}), false)
        );
        assert_eq!(
            sent(Request::SkipInput(3, true)),
            ("motor/3/skip_input/set".to_owned(), json!({"value": true}), false)
        );
        let raise = AlarmRaise {
            cs: None,
            code: 20,
            text: "low".into(),
        };
        let json = json!({"cs": null, "code": 20, "text": "low"});
        assert_eq!(
            sent(Request::RaiseAlarm(raise)),
            ("alarm/raise".to_owned(), json, false)
        );
    }

    #[test]
    fn a_command_is_replied_to_the_connection_that_sends_it() {
        let meta = CommandMeta {
            command_id: "c1".into(),
            client_id: "other".into(),
            ..CommandMeta::default()
        };
        let command = Command::Load { program: 12 };
        let request = Request::Command {
            cs: 1,
            command,
            meta,
            wait: true,
        };
        let json = json!({"command_id": "c1", "client_id": "plc-1", "args": {"program": 12}});
        assert_eq!(sent(request), ("cs/1/command/load".to_owned(), json, false));
    }

    #[test]
    fn variables_are_read_and_written_under_a_command_id_of_the_connection() {
        let meta = |id: &str| {
            Some(CommandMeta {
                command_id: id.into(),
                client_id: "other".into(),
                ..CommandMeta::default()
            })
        };
        let get = Request::ReadVariables {
            area: VariableArea::CoordinateSystem(2),
            from: 10,
            count: 3,
            meta: meta("v1"),
        };
        let json = json!({"command_id": "v1", "client_id": "plc-1", "kind": "Q", "from": 10, "count": 3});
        assert_eq!(sent(get), ("cs/2/variable/get".to_owned(), json, false));
        let set = Request::WriteVariables {
            area: VariableArea::Global,
            from: 0,
            values: vec![1.5, f64::INFINITY],
            meta: meta("v2"),
        };
        let json =
            json!({"command_id": "v2", "client_id": "plc-1", "kind": "P", "from": 0, "values": [1.5, "inf"]});
        assert_eq!(sent(set), ("cs/1/variable/set".to_owned(), json, false));
    }

    #[test]
    fn what_mqtt_does_not_carry_is_refused() {
        let refusal = outgoing(Request::Programs, "c", |_, _| None).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NotSupported);
    }
}
