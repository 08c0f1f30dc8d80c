//! Python dataclasses of all messages that a client receives over MQTT, from the schemas of the documents: the
//! package `clients/python` decodes messages into them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use plc_protocol::types::topic::Topic;
use serde_json::Value;

use super::outbound::{CS, M, outbound};
use super::schemas::Schemas;

/// Characters of a line.
const WIDTH: usize = 120;

/// Words that are enumerations, because the package and its handlers compare them. All other words are texts, so
/// that a word of a later runtime is no error.
const ENUMERATIONS: [&str; 4] = ["CancelReason", "Execution", "OutputState", "Redelivery"];

/// Classes whose methods are hand-written: each inherits them from this class of `message_methods.py`.
const METHODS: [(&str, &str); 4] = [
    ("AlarmWords", "AlarmWordsMethods"),
    ("IoDeclaration", "IoDeclarationMethods"),
    ("Params", "ParamsMethods"),
    ("Run", "RunMethods"),
];

/// Classes that users create with positional arguments.
const POSITIONAL: [&str; 1] = ["AlarmWords"];

/// Members of the envelope, which all messages inherit.
const ENVELOPE: [&str; 4] = ["v", "boot_id", "ts", "rev"];

/// Names of members that Python reserves.
const KEYWORDS: [&str; 2] = ["from", "in"];

const EMPTY_DICT: &str = "field(default_factory=dict)";

const HEAD: &str = r#""""Messages of the machine as frozen dataclasses. Lengths are in mm or degrees, feedrates in mm/min.

Generated from the types of the runtime: ``TANDEM_UPDATE=1 cargo test -p tandem-gateway contract`` generates them again.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any, Literal

from .message_methods import AlarmWordsMethods, IoDeclarationMethods, ParamsMethods, RunMethods
"#;

/// Returns the module `tandem_plc.messages`.
pub(super) fn messages(schemas: &Schemas) -> String {
    let classes = reachable(schemas);
    let (mut enumerations, mut dataclasses, mut aliases) = (String::new(), String::new(), Vec::new());
    for (name, (source, schema)) in &classes {
        if ENUMERATIONS.contains(name) {
            enumerations.push_str(&enumeration(name, schema));
        } else if schema["properties"].is_object() && !is_dict(schema) {
            let methods = METHODS.iter().find(|(of, _)| of == name);
            let base = match methods {
                Some((_, methods)) => format!("({methods})"),
                None if source == name => String::new(),
                None => "(Message)".to_owned(),
            };
            let is_own = |member: &str| source == name || !ENVELOPE.contains(&member);
            dataclasses.push_str(&dataclass(name, &base, schema, is_own));
        } else {
            aliases.push((*name, *schema));
        }
    }
    let envelope = |member: &str| ENVELOPE.contains(&member);
    let mut any_message = schemas["PresenceMessage"].clone();
    any_message["description"] = "Members that all messages have.".into();
    let message = dataclass("Message", "", &any_message, envelope);
    let mut text = format!("{HEAD}{enumerations}{message}{dataclasses}\n");
    for (name, schema) in in_order(aliases) {
        text.push_str(&alias(name, schema));
    }
    text.push_str("\nMESSAGE_OF: dict[str, type] = {\n");
    for (path, name) in topics() {
        writeln!(text, "    \"{path}\": {name},").unwrap();
    }
    text.push_str("}\n");
    text.push_str(&docstring(
        "Class of the messages of a topic, by the path below the machine; `+` stands for one level.",
        0,
    ));
    text
}

/// Returns each topic that a client receives over MQTT, with the class of its messages.
fn topics() -> Vec<(String, String)> {
    let presence = Topic::HandlerPresence("{id}".into());
    let topics = outbound().into_iter().chain([presence]).map(|topic| {
        let levels = topic.path();
        let levels = levels.split('/').map(|level| {
            let is_number = level == CS.to_string() || level == M.to_string();
            if is_number || level.starts_with('{') {
                "+"
            } else {
                level
            }
        });
        let name = (topic.form().name)();
        (levels.collect::<Vec<_>>().join("/"), class_name(&name).to_owned())
    });
    topics.collect()
}

/// Returns the class of a schema: a message has the name of its payload.
fn class_name(schema: &str) -> &str {
    schema.strip_suffix("Message").unwrap_or(schema)
}

/// Returns the schemas of all topics and of all types within them with their names, by the name of the class. If a
/// payload also occurs within another message, its class has no envelope.
fn reachable(schemas: &Schemas) -> BTreeMap<&str, (&str, &Value)> {
    let of_topics = topics().into_iter().map(|(_, name)| match name.as_str() {
        // clients publish it, so it has no envelope
        "HandlerPresence" => name,
        _ => format!("{name}Message"),
    });
    let (mut found, mut open) = (BTreeMap::new(), of_topics.collect::<Vec<_>>());
    while let Some(name) = open.pop() {
        let (name, schema) = schemas.get_key_value(&name).unwrap();
        if found.insert(name.as_str(), schema).is_none() {
            collect_references(schema, &mut open);
        }
    }
    // a payload sorts before its message
    let mut classes = BTreeMap::new();
    for (name, schema) in found {
        classes.entry(class_name(name)).or_insert((name, schema));
    }
    classes
}

fn collect_references(value: &Value, names: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            if let Some(reference) = members.get("$ref").and_then(Value::as_str) {
                names.push(reference.rsplit('/').next().unwrap().to_owned());
            }
            members
                .values()
                .for_each(|member| collect_references(member, names));
        }
        Value::Array(items) => items.iter().for_each(|item| collect_references(item, names)),
        _ => {}
    }
}

/// Sorts aliases so that each follows the aliases that it names.
fn in_order<'a>(mut aliases: Vec<(&'a str, &'a Value)>) -> Vec<(&'a str, &'a Value)> {
    let mut sorted = Vec::new();
    while !aliases.is_empty() {
        let needs_none = |(_, schema): &(&str, &Value)| {
            let mut names = Vec::new();
            collect_references(schema, &mut names);
            !aliases
                .iter()
                .any(|(other, _)| names.iter().any(|name| name == other))
        };
        let next = aliases.iter().position(needs_none).unwrap();
        sorted.push(aliases.remove(next));
    }
    sorted
}

fn enumeration(name: &str, schema: &Value) -> String {
    let mut text = format!("\n\nclass {name}(str, enum.Enum):\n{}\n", described(schema, 4));
    for word in schema["oneOf"].as_array().unwrap() {
        let value = word["const"].as_str().unwrap();
        let (member, about) = (value.to_uppercase(), described(word, 4));
        write!(text, "    {member} = \"{value}\"\n{about}").unwrap();
    }
    text
}

fn dataclass(name: &str, base: &str, schema: &Value, is_own: impl Fn(&str) -> bool) -> String {
    let kw_only = if POSITIONAL.contains(&name) {
        ""
    } else {
        ", kw_only=True"
    };
    let about = described(schema, 4);
    let mut text = format!("\n\n@dataclass(frozen=True{kw_only})\nclass {name}{base}:\n{about}");
    // a member with one possible value, the version of the interface, carries no information
    let members = schema["properties"].as_object().unwrap().iter();
    let members = members.filter(|(name, member)| is_own(name) && member.get("const").is_none());
    let required: Vec<_> = schema["required"].as_array().into_iter().flatten().collect();
    let (first, last): (Vec<_>, Vec<_>) = members.partition(|(name, member)| {
        required.iter().any(|required| required == name) && empty_default(member).is_none()
    });
    let first = first
        .iter()
        .map(|(name, member)| (name, *member, type_of(member)));
    let last = last
        .iter()
        .map(|(name, member)| (name, *member, optional(member)));
    for (at, (name, member, kind)) in first.chain(last).enumerate() {
        let space = if at == 0 { "\n" } else { "" };
        let (name, about) = (python_name(name), described(member, 4));
        write!(text, "{space}    {name}: {kind}\n{about}").unwrap();
    }
    text
}

fn python_name(member: &str) -> String {
    let underscore = if KEYWORDS.contains(&member) { "_" } else { "" };
    format!("{member}{underscore}")
}

/// Returns type and default of a member that a message may omit.
fn optional(member: &Value) -> String {
    let kind = type_of(member);
    let default = match empty_default(member) {
        Some(default) => default,
        None if kind.starts_with("tuple[") => "()",
        None if kind.starts_with("dict[") && !kind.contains('|') => EMPTY_DICT,
        None if kind == "str" => "\"\"",
        None if kind == "bool" => "False",
        None if kind == "Any" || kind.ends_with("| None") => "None",
        None => return format!("{kind} | None = None"),
    };
    format!("{kind} = {default}")
}

/// Returns the default of a member in Python; `None` without a default, or with another one than an empty value.
fn empty_default(member: &Value) -> Option<&'static str> {
    match member.get("default")? {
        Value::Bool(false) => Some("False"),
        Value::String(text) if text.is_empty() => Some("\"\""),
        Value::Array(items) if items.is_empty() => Some("()"),
        Value::Object(members) if members.is_empty() && member.get("$ref").is_none() => Some(EMPTY_DICT),
        _ => None,
    }
}

fn alias(name: &str, schema: &Value) -> String {
    let kind = type_of(schema);
    let line = format!("{name} = {kind}\n");
    let line = match kind
        .strip_prefix("Literal[")
        .and_then(|words| words.strip_suffix(']'))
    {
        Some(words) if line.len() > WIDTH + 1 => {
            format!("{name} = Literal[\n    {},\n]\n", words.replace(", ", ",\n    "))
        }
        _ => line,
    };
    format!("\n{line}{}", described(schema, 0))
}

/// Returns true for an object with members of one type that Python cannot name: it becomes a dictionary.
fn is_dict(schema: &Value) -> bool {
    let members = schema["properties"].as_object().unwrap();
    let kinds: BTreeSet<_> = members.values().map(type_of).collect();
    kinds.len() == 1 && members.keys().any(|name| KEYWORDS.contains(&name.as_str()))
}

fn type_of(schema: &Value) -> String {
    if let Some(reference) = schema["$ref"].as_str() {
        return reference.rsplit('/').next().unwrap().to_owned();
    }
    let words = schema["enum"].as_array().or(schema["oneOf"].as_array());
    let words = words
        .into_iter()
        .flatten()
        .map(|word| word.get("const").unwrap_or(word));
    let words: Vec<_> = words.chain(schema.get("const")).map(Value::to_string).collect();
    if !words.is_empty() {
        return format!("Literal[{}]", words.join(", "));
    }
    if let Some(schemas) = schema["anyOf"].as_array() {
        let mut kinds: Vec<_> = schemas.iter().map(type_of).collect();
        kinds.dedup();
        return kinds.join(" | ");
    }
    match &schema["type"] {
        Value::Array(kinds) => {
            let kinds = kinds.iter().map(|kind| {
                let mut of_kind = schema.clone();
                of_kind["type"] = kind.clone();
                type_of(&of_kind)
            });
            kinds.collect::<Vec<_>>().join(" | ")
        }
        Value::String(kind) => match kind.as_str() {
            "integer" => "int".to_owned(),
            "number" => "float".to_owned(),
            "boolean" => "bool".to_owned(),
            "string" => "str".to_owned(),
            "null" => "None".to_owned(),
            "array" => tuple(schema),
            _ => dictionary(schema),
        },
        _ => "Any".to_owned(),
    }
}

fn tuple(schema: &Value) -> String {
    let item = type_of(&schema["items"]);
    match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
        (Some(least), Some(most)) if least == most => {
            format!("tuple[{}]", vec![item; usize::try_from(most).unwrap()].join(", "))
        }
        _ => format!("tuple[{item}, ...]"),
    }
}

/// Returns the type of an object without a class: its members have one type.
fn dictionary(schema: &Value) -> String {
    let member = |of: &str| schema[of].as_object().and_then(|members| members.values().next());
    let values = member("properties").or(member("patternProperties"));
    let values = values.or(schema.get("additionalProperties"));
    format!("dict[str, {}]", values.map_or("Any".to_owned(), type_of))
}

/// Returns the description of a schema as a docstring; none for a schema without description.
fn described(schema: &Value, indent: usize) -> String {
    let text = schema["description"].as_str();
    text.map_or(String::new(), |text| docstring(text, indent))
}

/// Returns a text of the documentation as a docstring in lines of at most [`WIDTH`].
fn docstring(text: &str, indent: usize) -> String {
    let margin = " ".repeat(indent);
    let text = text.replace('`', "``").replace('\\', "\\\\");
    let words = text.split_whitespace().map(|word| {
        let bare = word.trim_end_matches([',', ';', '.', ':']);
        match bare {
            "null" | "Null" => word.replacen(bare, "``None``", 1),
            _ => word.to_owned(),
        }
    });
    let (mut lines, mut line) = (Vec::new(), format!("{margin}\"\"\""));
    for (at, word) in words.enumerate() {
        if line.len() + 1 + word.len() > WIDTH {
            lines.push(std::mem::replace(&mut line, margin.clone()));
            line.push_str(&word);
        } else {
            let space = if at == 0 { "" } else { " " };
            line = format!("{line}{space}{word}");
        }
    }
    if lines.is_empty() && line.len() + 3 <= WIDTH {
        return format!("{line}\"\"\"\n");
    }
    lines.push(line);
    format!("{}\n{margin}\"\"\"\n", lines.join("\n"))
}
