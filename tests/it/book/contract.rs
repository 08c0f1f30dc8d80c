//! Pages of routes, topics and configuration keys, written from the contract's documents and from the types.

use std::fmt::Write;

use serde_json::Value;
use tandem_runtime::Config;

use super::generated::check;
use super::page::{blocks, pages, read};
use crate::support::schemas::{check_asked, check_frame, check_message};

fn document(name: &str) -> Value {
    serde_json::from_str(&read(&format!("runtime/gateway/api/{name}.json"))).unwrap()
}

/// Returns the name of the form to which a schema refers.
fn form(schema: &Value) -> &str {
    let reference = schema["$ref"].as_str().unwrap_or_default();
    reference.rsplit('/').next().unwrap_or_default()
}

/// Returns the form of the JSON, or the content type of a request or an answer without JSON.
fn content(holder: &Value) -> String {
    let Some(types) = holder["content"].as_object() else {
        return String::new();
    };
    let named = |(media, entry): (&String, &Value)| match form(&entry["schema"]) {
        "" => media.clone(),
        name => name.to_owned(),
    };
    types.iter().map(named).collect::<Vec<_>>().join(", ")
}

#[test]
fn the_page_of_routes_is_that_of_the_contract() {
    let mut page = String::from(
        "# All routes\n\nBelow `/api/v1`, written from the OpenAPI document, which has the forms in detail: `/api` of a served machine \
         shows them.\nThe right is that of a [role](users.md).\n\n| route | right | takes | answers | does |\n\
         | --- | --- | --- | --- | --- |\n",
    );
    let document = document("openapi");
    let mut routes = 0;
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, route) in methods.as_object().unwrap() {
            let Some(does) = route["summary"].as_str() else {
                continue;
            };
            let answers = route["responses"].as_object().unwrap();
            let good = answers.iter().find(|(code, _)| code.starts_with(['1', '2']));
            let right = route["x-right"].as_str().unwrap_or("none");
            writeln!(
                page,
                "| `{} {path}` | {right} | {} | {} | {does} |",
                method.to_uppercase(),
                content(&route["requestBody"]),
                good.map(|(_, answer)| content(answer)).unwrap_or_default(),
            )
            .unwrap();
            routes += 1;
        }
    }
    assert!(routes > 60, "only {routes} routes");
    check("docs/src/reference/routes.md", &page);
}

#[test]
fn the_page_of_topics_is_that_of_the_contract() {
    let mut page = String::from(
        "# All topics\n\nBelow `tandem/v1/{machine}/`, written from the AsyncAPI document, which has the forms in detail: `/api` of a \
         served machine\nshows them. *In* is what the runtime receives. The right is that of a [role](users.md).\n\n\
         | topic | direction | right | message | retained | says |\n| --- | --- | --- | --- | --- | --- |\n",
    );
    let document = document("asyncapi");
    let mut rows = Vec::new();
    for operation in document["operations"].as_object().unwrap().values() {
        let channel = form(&operation["channel"]);
        let channel = &document["channels"][channel];
        let address = channel["address"].as_str().unwrap();
        let Some(topic) = address.strip_prefix("tandem/v1/{machine}/") else {
            continue;
        };
        let direction = if operation["action"] == "receive" {
            "in"
        } else {
            "out"
        };
        let messages = channel["messages"].as_object().unwrap();
        let messages: Vec<&str> = messages.keys().map(String::as_str).collect();
        let retained = operation["bindings"]["mqtt"]["retain"] == true;
        rows.push(format!(
            "| `{topic}` | {direction} | {} | {} | {} | {} |\n",
            operation["x-right"].as_str().unwrap_or_default(),
            messages.join(", "),
            if retained { "yes" } else { "" },
            operation["summary"].as_str().unwrap(),
        ));
    }
    rows.sort();
    assert!(rows.len() > 30, "only {} topics", rows.len());
    page += &rows.concat();
    check("docs/src/reference/topics.md", &page);
}

/// Examples of the document: each channel's path, with a payload.
#[test]
fn every_example_of_a_message_is_of_its_form() {
    let document = document("asyncapi");
    let mut found = 0;
    for (name, message) in document["channels"]["websocket"]["messages"].as_object().unwrap() {
        let check = if name == "WebSocketRequest" {
            check_asked
        } else {
            check_frame
        };
        for example in message["examples"].as_array().unwrap() {
            assert_eq!(check(&example["payload"]), Ok(()), "{name}");
        }
    }
    for channel in document["channels"].as_object().unwrap().values() {
        let Some(topic) = channel["address"]
            .as_str()
            .unwrap()
            .strip_prefix("tandem/v1/{machine}/")
        else {
            continue;
        };
        let path = topic
            .replace("{cs}", "1")
            .replace("{m}", "6")
            .replace("{id}", "changer")
            .replace("{client_id}", "panel")
            .replace("{number}", "1")
            .replace("{verb}", "load")
            .replace("{input}", "interlock");
        for message in channel["messages"].as_object().unwrap().values() {
            for example in message["examples"].as_array().into_iter().flatten() {
                assert_eq!(check_message(&path, &example["payload"]), Ok(()), "{path}");
                found += 1;
            }
        }
    }
    assert!(found > 50, "only {found} examples");
}

/// A block `json,topic=PATH` of a page must be a valid message on that path.
#[test]
fn every_payload_on_a_page_is_of_its_topics_form() {
    let mut found = 0;
    for path in pages() {
        for block in blocks(&read(&path)) {
            let Some(topic) = block.info.strip_prefix("json,topic=") else {
                continue;
            };
            let payload = serde_json::from_str(&block.text)
                .unwrap_or_else(|error| panic!("{path}:{}: {error}", block.line));
            assert_eq!(check_message(topic, &payload), Ok(()), "{path}:{}", block.line);
            found += 1;
        }
    }
    assert!(found >= 10, "only {found} payloads");
}

#[test]
fn the_page_of_the_configuration_is_that_of_its_types() {
    let mut page = String::from(
        "# Configuration\n\nEvery key, written from the types that read it; `tandem explain KEY` prints the same. Units are mm for linear motors \
         and\ndegrees for rotary ones. How to write and check a configuration: [Describe a machine of your own](../how-to/machine.md).\n",
    );
    let keys = Config::keys();
    let mut table = "";
    for key in &keys {
        if key.table != table {
            table = &key.table;
            write!(
                page,
                "\n## {table}\n\n| key | type | unit | range | default | is |\n| --- | --- | --- | --- | --- | --- |\n"
            )
            .unwrap();
        }
        let default = match key.default.as_str() {
            _ if key.is_needed => "needed".to_owned(),
            "" => String::new(),
            default => format!("`{default}`"),
        };
        let words = key
            .words
            .iter()
            .map(|word| match word.text.trim_end_matches('.') {
                "" => format!(" `{}`.", word.word),
                text => format!(" `{}`: {text}.", word.word),
            });
        writeln!(
            page,
            "| `{}` | {} | {} | {} | {default} | {}{} |",
            key.path.rsplit('.').next().unwrap(),
            key.kind,
            key.unit,
            key.range_text(),
            key.text,
            words.collect::<String>()
        )
        .unwrap();
    }
    assert!(keys.len() > 60, "only {} keys", keys.len());
    check("docs/src/reference/configuration.md", &page);
}
