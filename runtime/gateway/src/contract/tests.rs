//! The documents of the interface are those of its tables and types.

use std::path::Path;

use serde_json::Value;

use super::routes::ROUTES;
use super::{asyncapi, openapi, schemas, typescript};

/// Compares a text with the file that is checked in; with `TANDEM_UPDATE=1` writes it.
fn is_checked_in(file: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    if std::env::var_os("TANDEM_UPDATE").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let known = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        known == text,
        "{file} is not what the types and tables say; run TANDEM_UPDATE=1 cargo test -p tandem-gateway contract"
    );
}

fn json_is_checked_in(file: &str, document: &Value) {
    is_checked_in(file, &(serde_json::to_string_pretty(document).unwrap() + "\n"));
}

#[test]
fn the_openapi_document_is_that_of_the_routes() {
    json_is_checked_in("api/openapi.json", &openapi::document(&schemas::all()));
}

#[test]
fn the_asyncapi_document_is_that_of_the_topics() {
    json_is_checked_in("api/asyncapi.json", &asyncapi::document(&schemas::all()));
}

#[test]
fn the_declarations_of_the_hmi_are_those_of_the_types() {
    is_checked_in(
        "../../web/types.d.ts",
        &typescript::declarations(&schemas::outgoing()),
    );
}

#[test]
fn every_reference_within_the_documents_leads_somewhere() {
    fn check(value: &Value, document: &Value) {
        match value {
            Value::Object(fields) => {
                if let Some(Value::String(target)) = fields.get("$ref") {
                    let pointer = target.strip_prefix('#').unwrap();
                    assert!(document.pointer(pointer).is_some(), "{target}");
                }
                fields.values().for_each(|value| check(value, document));
            }
            Value::Array(items) => items.iter().for_each(|value| check(value, document)),
            _ => {}
        }
    }
    let all = schemas::all();
    for document in [openapi::document(&all), asyncapi::document(&all)] {
        check(&document, &document);
    }
}

/// A name as generators of Python write it: `run_list` of `RunList`.
fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

#[test]
fn no_schema_has_a_member_of_its_own_name_which_generated_clients_confuse_with_it() {
    assert_eq!(snake_case("RunList"), "run_list");
    for (name, schema) in schemas::all() {
        assert_eq!(schema["properties"].get(snake_case(&name)), None, "{name}");
    }
}

#[test]
fn every_message_has_an_example() {
    let document = asyncapi::document(&schemas::all());
    for channel in document["channels"].as_object().unwrap().values() {
        for (name, message) in channel["messages"].as_object().unwrap() {
            let examples = message["examples"].as_array().map_or(0, Vec::len);
            assert!(
                examples > 0,
                "{} {name}: examples.json has none",
                channel["address"]
            );
        }
    }
}

#[test]
fn no_route_is_there_twice() {
    for (path, places) in ROUTES.iter() {
        for (at, (route, _)) in places.iter().enumerate() {
            let same = places[at + 1..]
                .iter()
                .any(|(other, _)| other.method == route.method);
            assert!(!same, "{} {path}", route.method);
        }
    }
}
