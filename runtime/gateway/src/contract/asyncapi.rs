//! The AsyncAPI 3 document, from the topics that the runtime publishes and the table of incoming topics.

use std::sync::LazyLock;

use plc_protocol::types::topic::Topic;
use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::right::Right;
use plc_protocol::wire::topic_level::TOPIC_LEVELS;
use serde_json::{Map, Value, json};

use super::outbound::{CS, M, outbound};
use super::schemas::{Schemas, payload_of, reference};
use super::topics::inbound_topics;
use crate::access::Role;

fn path_of(topic: &Topic) -> String {
    let path = topic.path().replace(&CS.to_string(), "{cs}");
    path.replace(&M.to_string(), "{m}")
}

pub(super) fn document(schemas: &Schemas) -> Value {
    let mut channels = Map::new();
    let mut operations = Map::new();
    let mut add = |path: &str, action: &str, schema: &str, operation: Value| {
        let channel = channel_name(path);
        let mut parameters = Map::new();
        parameters.insert("machine".into(), json!({"description": "Name of the machine."}));
        for level in path.split('/') {
            if let Some(name) = level.strip_prefix('{').and_then(|level| level.strip_suffix('}')) {
                parameters.insert(name.into(), parameter(name));
            }
        }
        channels.insert(
            channel.clone(),
            json!({
                "address": format!("tandem/v1/{{machine}}/{path}"),
                "servers": [{"$ref": "#/servers/machine"}],
                "parameters": parameters,
                "messages": {schema: message(path, schema)},
            }),
        );
        let mut operation = operation;
        operation["action"] = action.into();
        operation["channel"] = json!({"$ref": format!("#/channels/{channel}")});
        operations.insert(format!("{action}_{channel}"), operation);
    };
    for topic in outbound() {
        let bindings = json!({"mqtt": {"qos": topic.qos(), "retain": topic.is_retained()}});
        let operation = json!({"summary": topic.summary(), "bindings": bindings});
        add(&path_of(&topic), "send", &(topic.form().name)(), operation);
    }
    for (topic, right) in inbound_topics() {
        let bindings = json!({"mqtt": {"qos": 1, "retain": topic.retained}});
        let mut operation =
            json!({"summary": topic.summary, "bindings": bindings, "x-right": right.wire_name()});
        if let Some(answer) = topic.answer {
            operation["reply"] = json!({"channel": {"$ref": format!("#/channels/{}", channel_name(answer))}});
        }
        let (path, schema) = (topic.path(), payload_of(topic).0);
        for named in named_paths(&path, right) {
            add(&named, "receive", &schema, operation.clone());
        }
        add(&path, "receive", &schema, operation);
    }
    add_websocket(&mut channels, &mut operations);
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "Tandem over MQTT and WebSocket",
            "version": "1",
            "description": "Messages that the runtime sends and receives. Addresses begin with the topic \
                            prefix, if the configuration has one. x-right is the right that a sender needs \
                            if the machine has a token file.",
            "license": {"name": "Apache-2.0 OR MIT"},
        },
        "defaultContentType": "application/json",
        "servers": {
            "machine": {"host": "127.0.0.1:1883", "protocol": "mqtt"},
            "websocket": {"host": "127.0.0.1:8080", "protocol": "ws"},
        },
        "channels": channels,
        "operations": operations,
        "components": {"schemas": schemas},
    })
}

/// Returns the paths on which the senders of a request name themselves: handlers, clients, or both, by the right that
/// it needs.
fn named_paths(path: &str, right: Right) -> Vec<String> {
    let speakers = [
        (MessageSender::Handler("{id}".into()), Role::Handler),
        (MessageSender::Client("{id}".into()), Role::Operate),
        (MessageSender::Client("{id}".into()), Role::Admin),
    ];
    let able = speakers.iter().filter(|(_, role)| role.has(right));
    let mut paths: Vec<_> = able.map(|(speaker, _)| speaker.path(path)).collect();
    paths.dedup();
    // only handlers send these, so they need no other sender, and a presence names its own
    if right == Right::Handle {
        paths.truncate(1);
    }
    paths.retain(|named| MessageSender::split(named).0.is_some());
    paths
}

fn channel_name(path: &str) -> String {
    path.replace(['{', '}'], "").replace('/', "_")
}

/// Describes a variable level of a path; `null` if [`TOPIC_LEVELS`] does not contain it.
fn parameter(name: &str) -> Value {
    let Some(level) = TOPIC_LEVELS.iter().find(|level| level.name == name) else {
        return Value::Null;
    };
    let mut parameter = json!({"description": level.description, "examples": level.examples});
    if !level.values.is_empty() {
        parameter["enum"] = json!(level.values);
    }
    parameter
}

/// Creates a message with its examples, which are stored under the path of its topic or, for a frame of the WebSocket,
/// under its name.
fn message(of: &str, schema: &str) -> Value {
    let mut message = json!({"payload": reference(schema)});
    let (_, path) = MessageSender::split(of);
    if let Some(payloads) = EXAMPLES[path].as_array() {
        let examples = payloads.iter().map(|payload| json!({"payload": payload}));
        message["examples"] = examples.collect();
    }
    message
}

/// Payloads as they cross the wire.
static EXAMPLES: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("examples.json")).unwrap_or_default());

/// Adds the channel of the WebSocket, which carries the messages of all topics that its client names.
fn add_websocket(channels: &mut Map<String, Value>, operations: &mut Map<String, Value>) {
    const RECEIVED: [&str; 1] = ["WebSocketRequest"];
    const SENT: [&str; 2] = ["WebSocketMessage", "WebSocketError"];
    let messages = RECEIVED.into_iter().chain(SENT);
    let messages: Map<_, _> = messages
        .map(|name| (name.to_owned(), message(name, name)))
        .collect();
    channels.insert(
        "websocket".into(),
        json!({
            "address": "/api/v1/ws",
            "description": "JSON as text frames. A frame of the client may contain several requests; each \
                            refusal is a separate frame.",
            "servers": [{"$ref": "#/servers/websocket"}],
            "messages": messages,
            "bindings": {"ws": {"method": "GET"}},
        }),
    );
    for (action, names) in [("receive", &RECEIVED[..]), ("send", &SENT[..])] {
        let messages: Vec<_> = names
            .iter()
            .map(|name| json!({"$ref": format!("#/channels/websocket/messages/{name}")}))
            .collect();
        let mut operation = json!({
            "action": action,
            "channel": {"$ref": "#/channels/websocket"},
            "messages": messages,
        });
        if action == "receive" {
            operation["x-right"] = Right::Read.wire_name().into();
        }
        operations.insert(format!("{action}_websocket"), operation);
    }
}
