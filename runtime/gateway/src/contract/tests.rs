//! The documents of the interface are those of its tables and types.

use std::path::Path;

use plc_api::wire::route::Content;
use serde_json::Value;

use super::routes::ROUTES;
use super::topics::inbound_topics;
use super::{asyncapi, openapi, schemas};

/// Compares a document with the one that is checked in; with `TANDEM_UPDATE=1` writes it.
fn is_checked_in(name: &str, document: &Value) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("api").join(name);
    let text = serde_json::to_string_pretty(document).unwrap() + "\n";
    if std::env::var_os("TANDEM_UPDATE").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let known = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        known == text,
        "api/{name} is not what the types and tables say; run TANDEM_UPDATE=1 cargo test -p tandem-gateway contract"
    );
}

#[test]
fn the_openapi_document_is_that_of_the_routes() {
    is_checked_in("openapi.json", &openapi::document(&schemas::all()));
}

#[test]
fn the_asyncapi_document_is_that_of_the_topics() {
    is_checked_in("asyncapi.json", &asyncapi::document(&schemas::all()));
}

#[test]
fn every_form_that_a_table_names_has_a_schema() {
    let all = schemas::all();
    let of_routes = ROUTES.values().flatten().flat_map(|(route, _)| {
        std::iter::once(route.body).chain(route.answers.iter().map(|(_, content)| *content))
    });
    let names = of_routes.filter_map(|content| match content {
        Content::Json(name) => Some(name),
        _ => None,
    });
    for name in names.chain(inbound_topics().map(|topic| topic.schema)) {
        assert!(all.contains_key(name), "{name}");
    }
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
