//! Real messages and answers against the documents that the machine serves. Stricter than these: a field that they do
//! not name is wrong, too.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

use jsonschema::Validator;
use serde_json::{Value, json};

struct Documents {
    openapi: Value,
    asyncapi: Value,
    validators: Mutex<HashMap<String, Arc<Validator>>>,
}

fn documents() -> &'static Documents {
    static READ: OnceLock<Documents> = OnceLock::new();
    READ.get_or_init(|| {
        let read = |text| {
            let mut document: Value = serde_json::from_str(text).expect("JSON");
            close(&mut document["components"]["schemas"]);
            document
        };
        Documents {
            openapi: read(include_str!("../../../runtime/gateway/api/openapi.json")),
            asyncapi: read(include_str!("../../../runtime/gateway/api/asyncapi.json")),
            validators: Mutex::default(),
        }
    })
}

/// Allows only the named fields in objects.
fn close(schema: &mut Value) {
    match schema {
        Value::Object(fields) => {
            if fields.contains_key("properties") && fields.get("type") == Some(&json!("object")) {
                fields.entry("additionalProperties").or_insert(json!(false));
            }
            fields.values_mut().for_each(close);
        }
        Value::Array(items) => items.iter_mut().for_each(close),
        _ => {}
    }
}

fn check(schema: &Value, value: &Value) -> Result<(), String> {
    let all = documents();
    let validator = {
        let mut validators = all.validators.lock().expect("not poisoned");
        let key = schema.to_string();
        let made = validators.entry(key).or_insert_with(|| {
            let mut whole = schema.clone();
            whole["components"] = all.openapi["components"].clone();
            let mut options = jsonschema::options();
            for width in ["uint8", "uint16", "uint32", "uint64"] {
                // the schema has their bounds
                options = options.with_format(width, |_: &str| true);
            }
            let options = options.should_validate_formats(true);
            Arc::new(options.build(&whole).expect("a schema"))
        });
        Arc::clone(made)
    };
    let errors: Vec<_> = validator
        .iter_errors(value)
        .map(|error| format!("{}: {error}", error.instance_path))
        .collect();
    if errors.is_empty() {
        Ok(())
    } else {
        Err(errors.join("; "))
    }
}

/// Returns true if a path matches a template with names in braces.
fn fits(template: &str, path: &str) -> bool {
    let (mut wanted, mut levels) = (template.split('/'), path.split('/'));
    loop {
        match (wanted.next(), levels.next()) {
            (None, None) => return true,
            (Some(wanted), Some(level)) if wanted == level || wanted.starts_with('{') => {}
            _ => return false,
        }
    }
}

/// Returns an error if a message on a path below the machine's root is invalid.
pub fn check_message(path: &str, message: &Value) -> Result<(), String> {
    let channels = documents().asyncapi["channels"].as_object().expect("channels");
    let address = format!("tandem/v1/{{machine}}/{path}");
    let channel = channels
        .values()
        .filter(|channel| fits(channel["address"].as_str().expect("an address"), &address))
        // a literal name has precedence over a name in braces
        .min_by_key(|channel| {
            channel["address"]
                .as_str()
                .map(|address| address.matches('{').count())
        })
        .ok_or_else(|| format!("no document names {path}"))?;
    let messages = channel["messages"].as_object().expect("messages");
    let schema = &messages.values().next().expect("one")["payload"];
    check(schema, message).map_err(|error| format!("{path}: {error} in {message}"))
}

/// A form by its name.
fn named(name: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{name}")})
}

/// Returns an error if a frame of a WebSocket's server is invalid.
pub fn check_frame(frame: &Value) -> Result<(), String> {
    let Some(topic) = frame["topic"].as_str() else {
        return check(&named("WebSocketError"), frame).map_err(|error| format!("{error} in {frame}"));
    };
    check(&named("WebSocketMessage"), frame).map_err(|error| format!("{error} in {frame}"))?;
    let mut message = frame.clone();
    if let Value::Object(fields) = &mut message {
        fields.remove("topic");
    }
    check_message(topic, &message)
}

/// Returns an error if a frame of a WebSocket's client is invalid.
pub fn check_asked(frame: &Value) -> Result<(), String> {
    check(&named("WebSocketRequest"), frame).map_err(|error| format!("{error} in {frame}"))
}

/// The operations of a path below `/api/v1`.
fn operations(path: &str) -> Option<&'static Value> {
    let path = path.split('?').next().unwrap_or(path);
    let paths = documents().openapi["paths"].as_object().expect("paths");
    let found = paths.iter().find(|(template, _)| fits(template, path));
    found.map(|(_, operations)| operations)
}

/// Returns an error if a JSON body that the machine has accepted is invalid.
pub fn check_accepted(method: &str, path: &str, body: &str) -> Result<(), String> {
    let operations = path.strip_prefix("/api/v1").and_then(operations);
    let Some(operations) = operations.filter(|_| !body.is_empty()) else {
        return Ok(());
    };
    let content = &operations[method.to_lowercase()]["requestBody"]["content"];
    let Some(schema) = content["application/json"].get("schema") else {
        return Ok(());
    };
    let value: Value = serde_json::from_str(body).map_err(|error| format!("{method} {path}: {error}"))?;
    check(schema, &value).map_err(|error| format!("{method} {path} was accepted: {error} in {body}"))
}

/// Returns an error if an answer of `/api/v1` has a status or a form that the document does not name.
pub fn check_answer(method: &str, path: &str, status: u16, body: &str) -> Result<(), String> {
    let Some(path) = path.strip_prefix("/api/v1") else {
        return Ok(());
    };
    let Some(operations) = operations(path) else {
        return if status == 404 {
            Ok(())
        } else {
            Err(format!("no document names {path}"))
        };
    };
    let responses = &operations[method.to_lowercase()]["responses"];
    let content = match &responses[status.to_string()] {
        Value::Null if status == 405 => return Ok(()),
        Value::Null => return Err(format!("{method} {path}: no document names status {status}")),
        response => response["content"].as_object(),
    };
    let schema = content.and_then(|content| {
        let json = content.iter().find(|(kind, _)| kind.contains("json"));
        json.map(|(_, media)| media["schema"].clone())
    });
    let Some(schema) = schema else {
        return Ok(());
    };
    let value: Value = serde_json::from_str(body).map_err(|error| format!("{method} {path}: {error}"))?;
    check(&schema, &value).map_err(|error| format!("{method} {path} {status}: {error} in {body}"))
}

#[test]
fn a_message_that_is_not_of_its_form_is_found() {
    let good = json!({"v": 1, "boot_id": "b", "ts": "2026-01-01T00:00:00Z", "rev": 1, "value": true});
    let topic = "cs/1/input/dry_run/state";
    assert_eq!(check_message(topic, &good), Ok(()));
    for (key, wrong) in [
        ("value", json!("on")),
        ("other", json!(1)),
        ("v", json!(2)),
        ("boot_id", Value::Null),
        ("ts", json!("today")),
    ] {
        let mut message = good.clone();
        message[key] = wrong;
        assert!(check_message(topic, &message).is_err(), "{key}");
    }
    assert!(check_message("cs/1/nothing", &good).is_err());
    assert!(check_answer("GET", "/api/v1/health", 200, "{\"status\":\"ok\"}").is_ok());
    assert!(check_answer("GET", "/api/v1/health", 200, "{\"status\":\"bad\"}").is_err());
    assert!(check_answer("GET", "/api/v1/health", 418, "{}").is_err());
    assert!(check_answer("GET", "/api/v1/cs/1/state", 404, "{}").is_err());
    assert!(check_answer("GET", "/api/v1/cs/1/state", 500, "{}").is_err());
    assert!(check_answer("GET", "/api/v1/health", 302, "").is_err());
    assert!(check_accepted("POST", "/api/v1/cs/1/load?wait=1", "{\"program\":1}").is_ok());
    assert!(check_accepted("POST", "/api/v1/cs/1/load?wait=1", "{\"program\":\"1\"}").is_err());
}

#[test]
fn a_frame_that_is_not_of_its_form_is_found() {
    let mut frame = json!({"topic": "cs/1/input/dry_run/state", "v": 1, "boot_id": "b", "ts": "2026-01-01T00:00:00Z",
        "rev": 1, "value": true});
    assert_eq!(check_frame(&frame), Ok(()));
    assert_eq!(check_frame(&json!({"error": "there is no topic"})), Ok(()));
    frame["value"] = json!("on");
    assert!(check_frame(&frame).is_err());
    assert!(check_frame(&json!({"value": true})).is_err());
    assert_eq!(
        check_asked(&json!({"subscribe": ["#"], "unsubscribe": ["cs/1/state"]})),
        Ok(())
    );
    for wrong in [
        json!({"subscribe": "#"}),
        json!({"publish": []}),
        json!({"handler": {"id": "a"}}),
    ] {
        assert!(check_asked(&wrong).is_err(), "{wrong}");
    }
}
