//! TypeScript declarations of all messages of the server and the runtime, from the schemas of the documents: the HMI is
//! checked against them.

use std::fmt::Write;

use serde_json::Value;

use super::outbound::{CS, M, outbound};
use super::schemas::Schemas;

/// Characters of a line.
const WIDTH: usize = 120;

pub(super) fn declarations(schemas: &Schemas) -> String {
    let mut text = String::from(
        "// Shapes of the interface, version 1: messages of the runtime over WebSocket and REST. Generated \
         from the types;\n\
         // TANDEM_UPDATE=1 cargo test -p tandem-gateway contract generates them again.\n",
    );
    for (name, schema) in schemas {
        if let Some(description) = schema["description"].as_str() {
            write!(text, "\n/** {} */", description.replace('\n', "\n * ")).unwrap();
        }
        text.push('\n');
        if schema["properties"].is_object() {
            let fields = fields(schema);
            let short = format!("export interface {name} {{ {}; }}", fields.join("; "));
            if short.len() <= WIDTH && !fields.is_empty() {
                text.push_str(&short);
                text.push('\n');
                continue;
            }
            write!(text, "export interface {name} {{").unwrap();
            push_filled(&mut text, fields);
            text.push_str("}\n");
        } else {
            writeln!(text, "export type {name} = {};", type_of(schema)).unwrap();
        }
    }
    push_messages(&mut text);
    text
}

/// Writes the type that maps a topic to its message.
fn push_messages(text: &mut String) {
    text.push_str(
        "\n/** The message of a topic, such as `cs/1/state`; for an unknown topic, any message. */\n\
         export type MessageOf<Topic extends string> =\n",
    );
    for topic in outbound() {
        let names = [CS.to_string(), M.to_string()];
        let path = names
            .iter()
            .fold(topic.path(), |path, name| path.replace(name, "${number}"));
        let path = path
            .replace("{client_id}", "${string}")
            .replace("{id}", "${string}")
            .replace("{name}", "${string}");
        let message = (topic.form().name)();
        writeln!(text, "  Topic extends `{path}` ? {message} :").unwrap();
    }
    text.push_str("  WebSocketMessage;\n");
}

/// Writes fields one after another, in lines of at most [`WIDTH`].
fn push_filled(text: &mut String, fields: Vec<String>) {
    let mut width = WIDTH;
    for field in fields {
        if width + field.len() + 2 > WIDTH {
            text.push_str("\n ");
            width = 1;
        }
        write!(text, " {field};").unwrap();
        width += field.len() + 2;
    }
    text.push('\n');
}

/// Returns the fields of an object.
fn fields(schema: &Value) -> Vec<String> {
    let required: Vec<_> = schema["required"].as_array().into_iter().flatten().collect();
    let properties = schema["properties"].as_object().unwrap().iter();
    let fields = properties.map(|(name, schema)| {
        let kind = type_of(schema);
        if required.iter().any(|required| *required == name) {
            return format!("{name}: {kind}");
        }
        // an optional field is omitted if it is null
        format!("{name}?: {}", kind.trim_end_matches(" | null"))
    });
    let more = (schema["additionalProperties"] == true).then(|| "[name: string]: unknown".to_owned());
    fields.chain(more).collect()
}

fn type_of(schema: &Value) -> String {
    let union = |schemas: &Vec<Value>| {
        let mut types: Vec<_> = schemas.iter().map(type_of).collect();
        types.dedup();
        types.join(" | ")
    };
    if let Some(reference) = schema["$ref"].as_str() {
        return reference.rsplit('/').next().unwrap().to_owned();
    }
    if let Some(value) = schema.get("const") {
        return value.to_string();
    }
    if let Some(values) = schema["enum"].as_array() {
        let values: Vec<_> = values.iter().map(Value::to_string).collect();
        return values.join(" | ");
    }
    if let Some(schemas) = schema["oneOf"].as_array().or(schema["anyOf"].as_array()) {
        return union(schemas);
    }
    match &schema["type"] {
        Value::Array(kinds) => {
            let types = kinds.iter().map(|kind| {
                let mut of_kind = schema.clone();
                of_kind["type"] = kind.clone();
                type_of(&of_kind)
            });
            types.collect::<Vec<_>>().join(" | ")
        }
        Value::String(kind) => match kind.as_str() {
            "integer" | "number" => "number".to_owned(),
            "array" => list(schema),
            "object" => object(schema),
            plain => plain.to_owned(),
        },
        _ => "unknown".to_owned(),
    }
}

fn list(schema: &Value) -> String {
    let item = type_of(&schema["items"]);
    match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
        (Some(least), Some(most)) if least == most => {
            format!("[{}]", vec![item; usize::try_from(most).unwrap()].join(", "))
        }
        _ if item.contains(' ') => format!("({item})[]"),
        _ => format!("{item}[]"),
    }
}

fn object(schema: &Value) -> String {
    if schema["properties"].is_object() {
        return format!("{{ {} }}", fields(schema).join("; "));
    }
    let of_pattern = schema["patternProperties"].as_object();
    let of_pattern = of_pattern.and_then(|patterns| patterns.values().next());
    let values = of_pattern.or(schema.get("additionalProperties"));
    format!("Record<string, {}>", values.map_or("unknown".to_owned(), type_of))
}
