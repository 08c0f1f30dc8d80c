//! Pages of routes, topics and configuration keys, written from the contract's documents and from the types' comments.

use std::fmt::Write;

use serde_json::Value;

use super::generated::check;
use super::page::read;

fn document(name: &str) -> Value {
    serde_json::from_str(&read(&format!("runtime/gateway/api/{name}.json"))).unwrap()
}

/// The name of the form that a schema refers to.
fn form(schema: &Value) -> &str {
    let reference = schema["$ref"].as_str().unwrap_or_default();
    reference.rsplit('/').next().unwrap_or_default()
}

/// The form of the JSON, or the type of what else a request or an answer holds.
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
         | topic | direction | right | message | retained |\n| --- | --- | --- | --- | --- |\n",
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
            "| `{topic}` | {direction} | {} | {} | {} |\n",
            operation["x-right"].as_str().unwrap_or_default(),
            messages.join(", "),
            if retained { "yes" } else { "" },
        ));
    }
    rows.sort();
    assert!(rows.len() > 30, "only {} topics", rows.len());
    page += &rows.concat();
    check("docs/src/reference/topics.md", &page);
}

/// A key of the configuration as its type declares it.
#[derive(Default)]
struct Key {
    comment: Vec<String>,
    attributes: String,
    /// Whether all keys of its table may be left out.
    is_of_default_table: bool,
}

impl Key {
    /// What it is where it is left out, as a configuration would write it.
    fn left_out(&self, source: &str, table: &str, name: &str, kind: &str) -> String {
        let after = |from: &str| source.split_once(from).map(|(_, rest)| rest);
        let is_optional = self.attributes.contains("serde(default") || kind.starts_with("Option<");
        let of_table = after(&format!("impl Default for {table} {{"))
            .and_then(|rest| rest.split_once(&format!(" {name}: ")))
            .and_then(|(_, rest)| rest.split(",\n").next());
        let of_function = self.attributes.split_once("default = \"").map(|(_, rest)| {
            let function = rest.split('"').next().unwrap();
            let body = after(&format!("fn {function}()")).expect("the function of a default");
            body.lines().nth(1).unwrap().trim()
        });
        let value = match (of_function.or(of_table), kind) {
            (Some("None"), _) => "",
            (Some("String::new()"), _) => "\"\"",
            (Some(value), _) => value,
            (None, "f64") if is_optional || self.is_of_default_table => "0.0",
            (None, "[f64; 4]") if is_optional => "[0.0, 0.0, 0.0, 0.0]",
            (None, _) if is_optional || self.is_of_default_table => "",
            (None, _) => return "needed".to_owned(),
        };
        let value = value
            .replace(".into()", "")
            .replace('_', if value.starts_with('"') { "_" } else { "" });
        if value.is_empty() {
            value
        } else {
            format!("`{value}`")
        }
    }
}

#[test]
fn the_page_of_the_configuration_is_that_of_its_types() {
    let source = read("runtime/src/config/mod.rs");
    let (types, _) = source.split_once("\nimpl Config {").unwrap();
    let mut page = String::from(
        "# Configuration\n\nEvery key, written from the types that read it. Units are mm for linear motors and degrees for rotary ones. \
         How to write and check\na configuration: [Describe a machine of your own](../how-to/machine.md).\n",
    );
    let (mut table, mut has_default, mut keys) = ("", false, 0);
    let mut key = Key::default();
    for line in types.lines() {
        if let Some(comment) = line.trim().strip_prefix("/// ") {
            key.comment.push(comment.to_owned());
            continue;
        }
        if line.trim().starts_with("#[") {
            key.attributes += line.trim();
            continue;
        }
        let mut key = std::mem::take(&mut key);
        if let Some(name) = line.strip_prefix("pub struct ") {
            table = name.split(' ').next().unwrap();
            has_default = key.attributes.contains(", default)]");
            if table != "Config" {
                let name = key.comment[0].trim_matches('`');
                write!(
                    page,
                    "\n## {name}\n\n| key | default | is |\n| --- | --- | --- |\n"
                )
                .unwrap();
            }
        } else if let Some((name, kind)) = line
            .strip_prefix("    pub ")
            .and_then(|field| field.split_once(": "))
            && table != "Config"
        {
            key.is_of_default_table = has_default;
            let default = key.left_out(&source, table, name, kind.trim_end_matches(','));
            assert!(!key.comment.is_empty(), "{table}.{name} says nothing");
            writeln!(page, "| `{name}` | {default} | {} |", key.comment.join(" ")).unwrap();
            keys += 1;
        }
    }
    assert!(keys > 60, "only {keys} keys");
    check("docs/src/reference/configuration.md", &page);
}
