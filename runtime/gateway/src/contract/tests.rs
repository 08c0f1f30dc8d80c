//! The documents of the interface are those of its tables and types.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::LazyLock;

use serde_json::Value;

use super::routes::ROUTES;
use super::{asyncapi, openapi, python, schemas, typescript};

/// Names of the parameters that the OpenAPI document lists for a route, of the query, the path or the header.
pub(crate) fn parameters_in_document(method: &str, path: &str, place: &str) -> BTreeSet<String> {
    static DOCUMENT: LazyLock<Value> = LazyLock::new(|| openapi::document(&schemas::all()));
    let parameters = &DOCUMENT["paths"][path][method.to_lowercase()]["parameters"];
    let parameters = parameters.as_array().unwrap().iter();
    let of_place = parameters.filter(|parameter| parameter["in"] == place);
    of_place
        .map(|parameter| parameter["name"].as_str().unwrap().to_owned())
        .collect()
}

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

/// Source files of responses of the server itself, in addition to the rows of the wire.
const OWN_SOURCES: [(&str, &str); 4] = [
    ("rest/states.rs", include_str!("../rest/states.rs")),
    ("rest/documents.rs", include_str!("../rest/documents.rs")),
    ("rest/login.rs", include_str!("../rest/login.rs")),
    ("websocket.rs", include_str!("../websocket.rs")),
];

#[test]
fn what_the_server_answers_itself_reads_no_query_and_no_header_of_ours() {
    for (file, source) in OWN_SOURCES {
        for reads in [
            "extract::Query",
            "RawQuery",
            ".query()",
            ".headers.get",
            "headers().get",
        ] {
            assert!(
                !source.contains(reads),
                "{file}: {reads}: list it as a parameter of the route"
            );
        }
        let read = source.matches("headers.get(").count();
        let of_host = source.matches("headers.get(header::HOST)").count();
        assert_eq!(
            read, of_host,
            "{file} reads a header: list it as a parameter of the route"
        );
    }
}

#[test]
fn each_header_that_a_row_reads_is_in_the_document_of_a_route() {
    let known = [
        "Idempotency-Key",
        "Lease-Fence",
        "If-Match",
        "If-None-Match",
        "Program-Signature",
    ];
    for (path, places) in ROUTES.iter() {
        for (route, _) in places {
            let read = known.iter().filter(|name| route.headers.reads(name));
            let read: BTreeSet<String> = read.map(|name| (*name).to_owned()).collect();
            let mut listed = parameters_in_document(route.method, path, "header");
            listed.remove("Sec-WebSocket-Protocol");
            assert_eq!(read, listed, "{} {path}", route.method);
        }
    }
}

#[test]
fn no_write_has_a_default_address() {
    let document = openapi::document(&schemas::all());
    for (path, operations) in document["paths"].as_object().unwrap() {
        for method in ["put", "post", "delete"] {
            let parameters = operations[method]["parameters"].as_array();
            let mut addresses = parameters.into_iter().flatten();
            let optional =
                addresses.find(|parameter| parameter["name"] == "from" && parameter["required"] != true);
            assert_eq!(optional, None, "{method} {path}");
        }
    }
}

#[test]
fn the_asyncapi_document_is_that_of_the_topics() {
    json_is_checked_in("api/asyncapi.json", &asyncapi::document(&schemas::all()));
}

#[test]
fn each_variable_level_of_a_topic_is_described() {
    let document = asyncapi::document(&schemas::all());
    let channels = &document["channels"];
    for (name, channel) in channels.as_object().unwrap() {
        let parameters = channel["parameters"].as_object();
        for (level, parameter) in parameters.into_iter().flatten() {
            assert!(parameter["description"].is_string(), "{level} of {name}");
        }
    }
}

#[test]
fn the_declarations_of_the_hmi_are_those_of_the_types() {
    is_checked_in(
        "../../web/types.d.ts",
        &typescript::declarations(&schemas::outgoing()),
    );
}

#[test]
fn the_messages_of_the_python_package_are_those_of_the_types() {
    is_checked_in(
        "../../clients/python/src/tandem_plc/messages.py",
        &python::messages(&schemas::outgoing()),
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
fn no_schema_has_a_member_of_its_own_name_that_confuses_generators() {
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

#[test]
fn each_name_in_a_path_has_a_parameter_with_its_values() {
    for (path, places) in ROUTES.iter() {
        let levels = path.split('/');
        let in_path = levels.filter_map(|level| level.strip_prefix('{')?.strip_suffix('}'));
        let in_path: Vec<_> = in_path.collect();
        for (route, _) in places {
            assert_eq!(
                route.names().collect::<Vec<_>>(),
                in_path,
                "{} {path}",
                route.method
            );
        }
    }
}
