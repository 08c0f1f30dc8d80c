//! JSON Schemas of all that crosses a wire, from the types themselves.

use plc_api::types::{command, data, lease, machine, output, program, question, request, state};
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use crate::websocket::Asked;

/// Schemas by name.
pub(super) type Schemas = Map<String, Value>;

/// Which way something goes: what may be left out differs.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Out,
    In,
}

/// Every schema that the tables name, with those within them.
pub(super) fn all() -> Schemas {
    let mut schemas = Schemas::new();
    messages(&mut schemas);
    requests(&mut schemas);
    answers(&mut schemas);
    websocket(&mut schemas);
    schemas
}

fn messages(all: &mut Schemas) {
    message::<machine::Presence>(all, "Presence");
    message::<machine::Birth>(all, "Birth");
    message::<machine::AlarmRecord>(all, "AlarmRecord");
    message::<machine::ActiveAlarms>(all, "ActiveAlarms");
    message::<command::CommandReply>(all, "CommandReply");
    message::<state::State>(all, "State");
    message::<state::ProgramPlace>(all, "ProgramPlace");
    message::<state::Position>(all, "Position");
    message::<state::Modal>(all, "Modal");
    message::<output::Pending>(all, "Pending");
    message::<output::OutputNotice>(all, "OutputNotice");
    message::<output::HandshakeResult>(all, "HandshakeResult");
    message::<output::Cancel>(all, "Cancel");
    message::<question::Validate>(all, "Validate");
    message::<state::Captured>(all, "Captured");
    message::<state::OptionalSkip>(all, "OptionalSkip");
    message::<state::Switch>(all, "Switch");
    message::<state::Lock>(all, "Lock");
    message::<state::Spindle>(all, "Spindle");
    message::<state::Tool>(all, "Tool");
    message::<state::Overrides>(all, "Overrides");
    message::<lease::LeaseState>(all, "LeaseState");
}

fn requests(all: &mut Schemas) {
    let claim = plain::<output::Claim>(all, "Claim", Way::In);
    let reset = plain::<output::Reset>(all, "Reset", Way::In);
    let progress = plain::<output::ProgressReport>(all, "ProgressReport", Way::In);
    let redeliver = plain::<output::Redeliver>(all, "Redeliver", Way::In);
    let ask = plain::<question::Ask>(all, "Ask", Way::In);
    let answer = plain::<question::OperatorAnswer>(all, "OperatorAnswer", Way::In);
    plain::<question::ValidateResult>(all, "ValidateResult", Way::In);
    for (name, body) in [
        ("AskBody", ask),
        ("AnswerBody", answer),
        ("ClaimBody", claim),
        ("ResetBody", reset),
        ("ProgressBody", progress),
        ("RedeliverBody", redeliver),
    ] {
        put(all, name, without(body, "seq"));
    }
    plain::<machine::AlarmRaise>(all, "AlarmRaise", Way::In);
    plain::<output::HandlerPresence>(all, "HandlerPresence", Way::In);
    let switch = plain::<state::Switch>(all, "Switch", Way::In);
    let lock = plain::<state::Lock>(all, "Lock", Way::In);
    plain::<state::Tool>(all, "Tool", Way::In);
    plain::<request::OverrideChange>(all, "OverrideChange", Way::In);
    plain::<request::SpindleCommand>(all, "SpindleCommand", Way::In);
    let skips = object(
        json!({"set": {"type": "object", "propertyNames": {"pattern": "^([1-9]|[12][0-9]|3[01])$"}, "additionalProperties": {"type": "boolean"}}}),
        &["set"],
    );
    put(all, "InputSet", json!({"oneOf": [switch, lock, skips]}));
    commands(all);
    leases(all);
    variables(all);
}

fn commands(all: &mut Schemas) {
    let args = [
        ("NoArgs", object(json!({}), &[])),
        (
            "LoadArgs",
            object(
                json!({"program": {"type": "integer", "minimum": 1, "maximum": 9999}}),
                &["program"],
            ),
        ),
        ("MdiArgs", object(json!({"text": {"type": "string"}}), &["text"])),
        (
            "JogArgs",
            object(
                json!({"axis": {"type": "string"}, "velocity": {"type": "number"}, "distance": {"type": "number"}, "refresh_id": {"type": "string"}}),
                &["axis", "velocity", "refresh_id"],
            ),
        ),
        (
            "HomeArgs",
            object(
                json!({"axes": {"type": "array", "items": {"type": "string"}, "minItems": 1}}),
                &[],
            ),
        ),
        (
            "BackTraceArgs",
            object(json!({"on": {"type": "boolean"}}), &["on"]),
        ),
    ];
    for (name, schema) in args {
        put(all, name, schema);
    }
    let mut command = plain::<command::CommandMeta>(all, "CommandMeta", Way::In);
    command["properties"]["args"] = json!({"type": "object", "description": "Arguments of the verb."});
    put(all, "CommandMessage", command);
}

fn leases(all: &mut Schemas) {
    let take = plain::<lease::LeaseTake>(all, "LeaseTake", Way::In);
    let release = plain::<lease::LeaseRelease>(all, "LeaseRelease", Way::In);
    let names = [
        ("LeaseTakeMessage", take),
        ("LeaseReleaseMessage", release),
        ("LeaseBreakMessage", object(json!({}), &[])),
    ];
    for (name, mut schema) in names {
        let mut required = schema["required"].as_array().cloned().unwrap_or_default();
        for id in ["command_id", "client_id"] {
            schema["properties"][id] = json!({"type": "string"});
            required.push(id.into());
        }
        schema["required"] = required.into();
        put(all, name, schema);
    }
}

fn variables(all: &mut Schemas) {
    let ids = json!({"command_id": {"type": "string"}, "client_id": {"type": "string"}, "kind": {"enum": ["P", "Q"]}, "from": {"type": "integer", "minimum": 0}, "count": {"type": "integer", "minimum": 1, "maximum": 1024}});
    let names = ["command_id", "client_id", "kind", "from"];
    put(
        all,
        "VariableGet",
        object(ids.clone(), &[&names[..], &["count"]].concat()),
    );
    let mut set = object(ids, &[&names[..], &["values"]].concat());
    set["properties"]["values"] = values(all);
    put(all, "VariableSet", set);
    let write = object(json!({"values": values(all)}), &["values"]);
    put(all, "VariableWrite", write);
    plain::<data::ToolChange>(all, "ToolChange", Way::In);
    plain::<data::WorkOffsetTable>(all, "WorkOffsetTable", Way::In);
}

fn answers(all: &mut Schemas) {
    plain::<command::CommandReply>(all, "CommandReply", Way::Out);
    plain::<output::HandshakeResult>(all, "HandshakeResult", Way::Out);
    plain::<program::ProgramCheck>(all, "ProgramCheck", Way::Out);
    plain::<program::ProgramInfo>(all, "ProgramInfo", Way::Out);
    plain::<machine::AlarmRecord>(all, "AlarmRecord", Way::Out);
    let list = |of: &str| json!({"type": "array", "items": reference(of)});
    let text = json!({"type": "string"});
    put(
        all,
        "CommandAccepted",
        object(json!({"command_id": text}), &["command_id"]),
    );
    put(
        all,
        "Programs",
        object(json!({"programs": list("ProgramInfo")}), &["programs"]),
    );
    put(
        all,
        "AlarmHistory",
        object(json!({"alarms": list("AlarmRecord")}), &["alarms"]),
    );
    let handlers = json!({"type": "object", "additionalProperties": reference("HandlerPresence")});
    put(
        all,
        "Handlers",
        object(json!({"handlers": handlers}), &["handlers"]),
    );
    put(
        all,
        "Health",
        object(json!({"status": {"const": "ok"}}), &["status"]),
    );
    plain::<data::VariableValues>(all, "VariableValues", Way::Out);
    plain::<data::ToolTable>(all, "ToolTable", Way::In);
    plain::<data::LastRun>(all, "LastRun", Way::Out);
    let last_run = json!({"oneOf": [reference("LastRun"), {"type": "null"}]});
    put(
        all,
        "LastRunAnswer",
        object(json!({"last_run": last_run}), &["last_run"]),
    );
    put(all, "JournalAnswer", journal());
    let inputs = json!({"optional_skip": reference("OptionalSkipMessage"), "optional_stop": reference("SwitchMessage"), "single_block": reference("SwitchMessage"), "dry_run": reference("SwitchMessage"), "interlock": reference("LockMessage"), "start_lock": reference("LockMessage")});
    put(all, "Inputs", object(inputs, &[]));
    let mut entry = plain::<machine::CoordinateSystemInfo>(all, "CoordinateSystemInfo", Way::Out);
    entry["properties"]["state"] = json!({"oneOf": [reference("StateMessage"), {"type": "null"}]});
    let systems = json!({"coordinate_systems": {"type": "array", "items": entry}});
    put(all, "CoordinateSystems", object(systems, &["coordinate_systems"]));
    let details = json!({
        "type": text, "title": text, "status": {"type": "integer"}, "code": {"type": "string", "description": "Machine-readable."}, "detail": text,
        "state": reference("Execution"), "allowed": list("Verb"), "diagnostics": list("ProgramDiagnostic"),
    });
    plain::<state::Execution>(all, "Execution", Way::Out);
    plain::<command::Verb>(all, "Verb", Way::Out);
    put(
        all,
        "Problem",
        object(details, &["type", "title", "status", "code", "detail"]),
    );
}

fn journal() -> Value {
    let mut line = object(
        json!({
            "ts": {"type": "string", "format": "date-time", "description": "When it was."},
            "t_s": {"type": "number", "description": "Seconds since the start of the runtime."},
            "cs": {"type": "integer", "minimum": 0},
            "event": {"type": "string"},
        }),
        &["event"],
    );
    line["additionalProperties"] = json!(true);
    object(json!({"lines": {"type": "array", "items": line}}), &["lines"])
}

fn websocket(all: &mut Schemas) {
    plain::<Asked>(all, "WebSocketRequest", Way::In);
    let text = json!({"type": "string"});
    put(all, "WebSocketError", object(json!({"error": text}), &["error"]));
    let mut message = object(
        json!({"topic": {"type": "string", "description": "Path below the machine's root, as on MQTT."}, "v": {"const": plc_api::types::message::INTERFACE_VERSION}, "boot_id": text, "ts": {"type": "string", "format": "date-time"}}),
        &["topic", "v", "boot_id", "ts"],
    );
    message["description"] =
        "The message of the topic, with its path in front; see the topic's channel for the other fields."
            .into();
    message["additionalProperties"] = true.into();
    put(all, "WebSocketMessage", message);
}

fn values(all: &mut Schemas) -> Value {
    plain::<data::Number>(all, "Number", Way::In);
    json!({"type": "array", "items": reference("Number"), "minItems": 1, "maxItems": data::VARIABLES_AT_ONCE_MAX})
}

pub(super) fn reference(name: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{name}")})
}

#[allow(clippy::needless_pass_by_value, reason = "literals read better so")]
fn object(properties: Value, required: &[&str]) -> Value {
    json!({"type": "object", "properties": properties, "required": required})
}

fn without(mut schema: Value, name: &str) -> Value {
    if let Some(properties) = schema["properties"].as_object_mut() {
        properties.remove(name);
    }
    if let Some(required) = schema["required"].as_array_mut() {
        required.retain(|known| known != name);
    }
    schema
}

/// A type by its name; gives its schema.
fn plain<T: JsonSchema>(all: &mut Schemas, name: &str, way: Way) -> Value {
    let schema = schema_of::<T>(all, way);
    put(all, name, schema.clone());
    schema
}

/// A payload in the envelope of every message, as `{name}Message`.
fn message<T: JsonSchema>(all: &mut Schemas, name: &str) {
    let mut schema = schema_of::<T>(all, Way::Out);
    let envelope = json!({
        "v": {"const": plc_api::types::message::INTERFACE_VERSION, "description": "Version of the interface."},
        "boot_id": {"type": "string", "description": "The boot that says it."},
        "ts": {"type": "string", "format": "date-time", "description": "When it was said."},
        "rev": {"type": "integer", "minimum": 0, "description": "For state: grows with each change of this topic."},
    });
    for (key, value) in envelope.as_object().unwrap() {
        schema["properties"][key] = value.clone();
    }
    let required = schema["required"].as_array().cloned().unwrap_or_default();
    let envelope = ["v", "boot_id", "ts"].map(Value::from);
    schema["required"] = envelope.into_iter().chain(required).collect();
    put(all, &format!("{name}Message"), schema);
}

/// The schema of a type; those within it go to the others.
fn schema_of<T: JsonSchema>(all: &mut Schemas, way: Way) -> Value {
    let settings = SchemaSettings::draft2020_12().with(|settings| {
        settings.definitions_path = "/components/schemas".into();
        settings.meta_schema = None;
    });
    let settings = match way {
        Way::Out => settings.for_serialize(),
        Way::In => settings.for_deserialize(),
    };
    let mut schema = settings.into_generator().into_root_schema_for::<T>().to_value();
    let fields = schema.as_object_mut().unwrap();
    fields.remove("title");
    if let Some(mut within) = fields.remove("components") {
        for (name, schema) in std::mem::take(within["schemas"].as_object_mut().unwrap()) {
            put(all, &name, schema);
        }
    }
    schema
}

/// One name means one thing.
fn put(all: &mut Schemas, name: &str, schema: Value) {
    match all.get(name) {
        Some(known) => assert_eq!(*known, schema, "two schemas of the name {name}"),
        None => {
            all.insert(name.to_owned(), schema);
        }
    }
}
