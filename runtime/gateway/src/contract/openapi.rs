//! The OpenAPI 3.1 document, from the table of routes.

use serde_json::{Map, Value, json};

use plc_api::types::planned::PATH_TOLERANCE_MM;
use plc_api::types::run::RUN_WAIT_MAX_S;
use plc_api::wire::right::Right;
use plc_api::wire::route::{Content, Headers, Query, Route};

use super::routes::ROUTES;
use super::schemas::{Schemas, body_of, reference};

pub(super) fn document(schemas: &Schemas) -> Value {
    let mut paths = Map::new();
    for (path, places) in ROUTES.iter() {
        let of_path = places.iter();
        let operations =
            of_path.map(|(route, serves)| (route.method.to_lowercase(), operation(route, serves.right())));
        paths.insert(path.clone(), operations.collect::<Map<_, _>>().into());
    }
    let mut schemas: Value = schemas.clone().into();
    for_generators(&mut schemas);
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Tandem",
            "version": "1",
            "description": "Programs, commands, states and values of one machine. Refusals are problem details (RFC 9457) with a machine-readable code. Where the machine has a token file each request carries a token; x-right is what it needs: read has every role, operate the roles operate and admin, handle the roles handler and admin, reset and raise the roles operate, handler and admin, set the same, but a handler only where it serves an M code, administrate the role admin.",
            "license": {"name": "Apache-2.0 OR MIT", "identifier": "Apache-2.0 OR MIT"},
        },
        "servers": [{"url": "/api/v1"}],
        "security": [{"token": []}, {}],
        "tags": TAGS.map(|(name, description)| json!({"name": name, "description": description})),
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    })
}

/// Says the same as generators of clients understand it: what some of them write otherwise does not run.
fn for_generators(schema: &mut Value) {
    match schema {
        Value::Object(fields) => {
            name_letters(fields);
            list_words(fields);
            fields.values_mut().for_each(for_generators);
        }
        Value::Array(items) => items.iter_mut().for_each(for_generators),
        _ => {}
    }
}

/// Of an object with a member for each letter, which names it may have: a member `D` clashes with a variable of generated code.
fn name_letters(fields: &mut Map<String, Value>) {
    const LETTERS: [&str; 8] = ["A", "B", "C", "D", "E", "F", "G", "H"];
    let members = fields.get("properties").and_then(Value::as_object);
    if !members.is_some_and(|members| members.keys().eq(LETTERS)) {
        return;
    }
    let mut member = fields["properties"]["A"].clone();
    if let Some(member) = member.as_object_mut() {
        member.remove("description");
    }
    fields.remove("properties");
    fields.insert("propertyNames".into(), json!({"enum": LETTERS}));
    fields.insert("additionalProperties".into(), member);
}

/// Of a choice between words, the words, and what they mean in the description: generated code takes the first of several constants
/// for the only one.
fn list_words(fields: &mut Map<String, Value>) {
    let choices = fields.get("oneOf").and_then(Value::as_array);
    let Some(choices) = choices.filter(|choices| choices.iter().all(|choice| choice["const"].is_string()))
    else {
        return;
    };
    let words: Vec<Value> = choices.iter().map(|choice| choice["const"].clone()).collect();
    let description = fields.get("description").and_then(Value::as_str);
    let meanings = choices.iter().filter_map(|choice| {
        let (word, meaning) = (choice["const"].as_str()?, choice["description"].as_str()?);
        Some(format!("\n- `{word}`: {}", meaning.replace('\n', " ")))
    });
    let description = description
        .map(str::to_owned)
        .into_iter()
        .chain(meanings)
        .collect::<String>();
    fields.remove("oneOf");
    fields.insert("type".into(), "string".into());
    fields.insert("enum".into(), words.into());
    fields.insert("description".into(), description.trim_start().into());
}

/// What routes are about, in the order of the document.
const TAGS: [(&str, &str); 8] = [
    (
        "commands",
        "What a coordinate system shall do, and who may command it.",
    ),
    ("states", "What a coordinate system does, and where it is."),
    ("m_codes", "Outputs of M codes, and the handlers that serve them."),
    (
        "inputs",
        "What the machine is told: inputs, overrides, spindle, tool, inputs and outputs of the plant, and clients that it watches.",
    ),
    ("programs", "The store of programs, and what they would do."),
    ("values", "Variables, tools and work offsets."),
    ("alarms", "Alarms and the journal."),
    ("machine", "The machine as a whole, its users and its documents."),
];

/// What a route is about.
fn tag(route: &Route) -> &'static str {
    let path = route.path();
    let mut levels = path.trim_start_matches('/').split('/');
    let first = levels.next().unwrap_or_default();
    let level = match first {
        "cs" => levels.nth(1).unwrap_or("machine"),
        first => first,
    };
    match level {
        "alarms" | "journal" => "alarms",
        _ if route.headers == Headers::Command => "commands",
        "lease" | "commands" => "commands",
        "m_codes" | "handlers" => "m_codes",
        "overrides" | "spindle" | "tool" if route.method == "GET" => "states",
        "inputs" | "overrides" | "spindle" | "tool" | "motors" | "clients" | "io" => "inputs",
        "programs" => "programs",
        "variables" | "tools" | "work_offsets" => "values",
        _ if first == "cs" && level != "machine" => "states",
        _ => "machine",
    }
}

fn operation(route: &Route, right: Option<Right>) -> Value {
    let mut operation = json!({
        "operationId": operation_id(route),
        "tags": [tag(route)],
        "summary": route.summary,
        "parameters": parameters(route),
        "responses": responses(route, right),
    });
    if let Some(right) = right {
        operation["x-right"] = right.wire_name().into();
    } else {
        operation["security"] = json!([]);
    }
    let body = match route.body {
        Content::Nothing => return operation,
        Content::Json(form) => {
            let (name, schema) = body_of(route, form);
            // no body is an empty object, where that is enough
            let required = schema["required"]
                .as_array()
                .is_some_and(|names| !names.is_empty());
            json!({"required": required, "content": {"application/json": {"schema": reference(&name)}}})
        }
        Content::Document => {
            json!({"required": true, "content": {"application/json": {"schema": {"type": "object"}}}})
        }
        Content::Text => {
            // the second is the same for generators that know no text
            let bytes = json!({"type": "string", "format": "binary"});
            json!({"required": false, "content": {
                "text/plain": {"schema": {"type": "string"}},
                "application/octet-stream": {"schema": bytes},
            }})
        }
        Content::Bytes => json!({"required": true, "content": {"application/octet-stream": {}}}),
    };
    operation["requestBody"] = body;
    operation
}

fn operation_id(route: &Route) -> String {
    let path = route.path().trim_start_matches('/').replace(['{', '}'], "");
    format!(
        "{}_{}",
        route.method.to_lowercase(),
        path.replace(['/', '.'], "_")
    )
}

fn parameters(route: &Route) -> Vec<Value> {
    let mut parameters: Vec<Value> = route
        .names()
        .map(|name| {
            let schema = match (name, route.headers) {
                ("cs", _) => json!({"type": "integer", "minimum": 1, "maximum": 255}),
                ("number", _) => json!({"type": "integer", "minimum": 1, "maximum": route.number_max}),
                ("name", _) => json!({"type": "string", "minLength": 1, "maxLength": 64}),
                ("id", Headers::Nothing) => json!({"type": "string", "minLength": 1, "maxLength": 128}),
                _ => json!({"type": "integer", "minimum": 0}),
            };
            json!({"name": name, "in": "path", "required": true, "schema": schema})
        })
        .collect();
    if route.headers.has_key() {
        parameters.push(json!({"name": "Idempotency-Key", "in": "header", "schema": {"type": "string", "minLength": 1, "maxLength": 128}, "description": "Id of the command; one seen before is answered as then."}));
    }
    let is_release = route.headers == Headers::KeyAndFence;
    let is_command = route.headers == Headers::Command;
    if is_command || is_release {
        parameters.push(json!({"name": "Lease-Fence", "in": "header", "required": is_release, "schema": {"type": "integer", "minimum": 0}, "description": "Number of the control lease under which it is sent."}));
    }
    if route.query == Query::Wait {
        parameters.push(json!({"name": "wait", "in": "query", "schema": {"type": "string", "enum": ["0", "1", "false", "true", ""]}, "description": "1, true or nothing: answers when it is done, or with 202 after a minute."}));
    }
    if is_command {
        let tag = "\"?([0-9]+|[0-9A-Fa-f]{64}|boot:[0-9A-Za-z]{1,64})\"?";
        let pattern = format!("^{tag}(, *{tag}){{0,2}}$");
        parameters.push(json!({"name": "If-Match", "in": "header", "schema": {"type": "string", "pattern": pattern}, "description": "Revision of the state that the sender has seen, the hash of the program that it means, boot: and the boot_id that it has seen, or several of them, which must all hold then."}));
    }
    if route.query == Query::Dialect {
        parameters.push(json!({"name": "dialect", "in": "query", "schema": {"type": "string", "enum": ["nj", "dgshape"]}, "description": "NC dialect of the text; without it that of the lowest coordinate system."}));
    }
    parameters.extend(of_programs(route.headers));
    if route.query == Query::Journal {
        parameters.extend(of_journal());
    }
    if route.query == Query::Seconds {
        parameters.push(json!({"name": "wait", "in": "query", "schema": {"type": "integer", "minimum": 0, "maximum": RUN_WAIT_MAX_S}, "description": "How many seconds its end is waited for at most; without it the answer comes at once."}));
    }
    if route.query == Query::Runs {
        parameters.push(json!({"name": "cs", "in": "query", "schema": {"type": "integer", "minimum": 1, "maximum": 255}, "description": "Of this coordinate system alone."}));
    }
    if matches!(route.query, Query::Path | Query::RunBy) {
        parameters.push(json!({"name": "cs", "in": "query", "schema": {"type": "integer", "minimum": 1, "maximum": 255}, "description": "The coordinate system that runs it; without it the first one in which it is loaded, or the first one of all."}));
    }
    if route.query == Query::Trace {
        parameters.push(json!({"name": "axes", "in": "query", "schema": {"type": "string", "maxLength": 9}, "description": "Letters of the axes, such as XZ; without it all."}));
    }
    if route.query == Query::Path {
        parameters.push(json!({"name": "tolerance", "in": "query", "schema": {"type": "number", "minimum": PATH_TOLERANCE_MM}, "description": "How far a point of the path may be from the lines, mm: levels of detail that are finer than needed are left out."}));
    }
    if route.method == "GET"
        && matches!(
            route.query,
            Query::Range | Query::Journal | Query::Path | Query::Runs | Query::Trace
        )
    {
        for (name, minimum) in [("from", 0), ("count", 1)] {
            parameters.push(
                json!({"name": name, "in": "query", "schema": {"type": "integer", "minimum": minimum}}),
            );
        }
    }
    parameters
}

/// What is said of a program that is read or changed.
fn of_programs(headers: Headers) -> Vec<Value> {
    let hashes = json!({"type": "string", "pattern": "^(\\*|(W/)?\"?[0-9A-Fa-f]{64}\"?(, *(W/)?\"?[0-9A-Fa-f]{64}\"?)*)$"});
    let header = |name: &str, schema: &Value, description: &str| json!({"name": name, "in": "header", "schema": schema, "description": description});
    let mut parameters = Vec::new();
    if matches!(headers, Headers::Condition | Headers::Upload) {
        parameters.push(header(
            "If-Match",
            &hashes,
            "The program is one of these, by their hashes, or any (*): else 412.",
        ));
        parameters.push(header(
            "If-None-Match",
            &hashes,
            "The program is none of these, or there is none (*): else 412.",
        ));
    }
    if headers == Headers::Cached {
        parameters.push(header(
            "If-None-Match",
            &json!({"type": "string"}),
            "Programs that the client has, by their hashes: 304 if it is one of these.",
        ));
    }
    if headers == Headers::Upload {
        let schema = json!({"type": "string", "pattern": "^[A-Za-z0-9+/]{86}==$"});
        parameters.push(header(
            "Program-Signature",
            &schema,
            "Ed25519 signature of the text's bytes, 64 bytes in Base64.",
        ));
    }
    parameters
}

/// What is asked of the journal.
fn of_journal() -> impl Iterator<Item = Value> {
    let fields = [
        (
            "since",
            json!({"type": "string"}),
            "From this time on: in UTC, such as 2026-11-25 or 2026-11-25T10:00, or how long ago, such as 2h or 30m.",
        ),
        (
            "until",
            json!({"type": "string"}),
            "Before this time, written in the same way.",
        ),
        (
            "cs",
            json!({"type": "integer", "minimum": 0, "maximum": 255}),
            "Of this coordinate system; 0: of the machine.",
        ),
        (
            "m",
            json!({"type": "integer", "minimum": 0, "maximum": 65535}),
            "Of outputs of this M number, and of stops by it.",
        ),
        (
            "user",
            json!({"type": "string"}),
            "Of this user, client or handler.",
        ),
        (
            "run",
            json!({"type": "string"}),
            "Of this run, such as 1-7, or BOOT/1-7 of that start of the runtime.",
        ),
    ];
    fields.into_iter().map(|(name, schema, description)| json!({"name": name, "in": "query", "schema": schema, "description": description}))
}

fn responses(route: &Route, right: Option<Right>) -> Value {
    let mut responses = Map::new();
    for (status, content) in route.answers() {
        let content = match content {
            Content::Nothing => None,
            Content::Json(form) => Some(json!({"application/json": {"schema": reference(&(form.name)())}})),
            Content::Document => Some(json!({"application/json": {"schema": {"type": "object"}}})),
            Content::Text => Some(json!({"text/plain": {"schema": {"type": "string"}}})),
            Content::Bytes => Some(
                json!({"application/octet-stream": {"schema": {"type": "string", "contentMediaType": "application/octet-stream"}}}),
            ),
        };
        let description = match status {
            101 => "The connection is a WebSocket.",
            201 => "New.",
            202 => "Accepted; Location tells where to ask for the rest.",
            204 => "Done.",
            _ => "As asked.",
        };
        let mut response = json!({"description": description});
        if let Some(content) = content {
            response["content"] = content;
        }
        if let Some(headers) = response_headers(route, status) {
            response["headers"] = headers;
        }
        responses.insert(status.to_string(), response);
    }
    if route.headers == Headers::Cached {
        let headers = response_headers(route, 200);
        responses.insert(
            "304".to_owned(),
            json!({"description": "The client has it.", "headers": headers}),
        );
    }
    for status in refusals(route, right) {
        let mut refusal = json!({
            "description": refusal_text(status),
            "content": {"application/problem+json": {"schema": reference("Problem")}},
        });
        if let Some(headers) = refusal_headers(status) {
            refusal["headers"] = headers;
        }
        responses.insert(status.to_string(), refusal);
    }
    responses.into()
}

/// What a refusal says in its head.
fn refusal_headers(status: u16) -> Option<Value> {
    match status {
        401 => Some(
            json!({"WWW-Authenticate": {"schema": {"type": "string", "enum": ["Bearer"]}, "description": "A token is needed."}}),
        ),
        429 => Some(
            json!({"Retry-After": {"schema": {"type": "integer", "minimum": 1}, "description": "Seconds after which it is worth another try."}}),
        ),
        _ => None,
    }
}

/// What an answer says in its head.
fn response_headers(route: &Route, status: u16) -> Option<Value> {
    let says = |description: &str| {
        let header = json!({"schema": {"type": "string"}, "description": description});
        Some(json!({"ETag": header}))
    };
    let is_path = matches!(route.query, Query::Path);
    match status {
        201 if route.headers == Headers::Command => {
            Some(json!({"Location": {"schema": {"type": "string"}, "description": "Where it can be read."}}))
        }
        202 => Some(
            json!({"Location": {"schema": {"type": "string"}, "description": "Where to ask how far the command is."}}),
        ),
        200 | 201 if matches!(route.headers, Headers::Cached | Headers::Upload) => {
            says("The hash of the program in quotes.")
        }
        200 if is_path => says("Tells this path from others, in quotes."),
        200 if is_state(route) => says("The revision of the state in quotes."),
        _ => None,
    }
}

/// True where a message of the machine is given as it is.
fn is_state(route: &Route) -> bool {
    plc_api::wire::states::STATES
        .iter()
        .any(|state| state.route.pattern == route.pattern)
}

/// The statuses of a route's refusals, each problem details.
fn refusals(route: &Route, right: Option<Right>) -> Vec<u16> {
    let changes = !matches!(right, None | Some(Right::Read));
    let of = [
        (true, &[403][..]),
        (right.is_some(), &[401, 429, 503]),
        (route.names().next().is_some(), &[404]),
        (!matches!(route.body, Content::Nothing), &[400, 408, 413, 415]),
        (changes, &[404, 409]),
        // what was answered to the same key before may be a command's answer
        (route.headers.has_key(), &[400, 412, 422]),
        (
            matches!(route.headers, Headers::Condition | Headers::Upload),
            &[400, 412],
        ),
        (true, route.refusals),
    ];
    let all = of.iter().filter(|(does, _)| *does);
    all.flat_map(|(_, statuses)| statuses.iter().copied()).collect()
}

fn refusal_text(status: u16) -> &'static str {
    match status {
        400 => "Not well-formed, or a value out of its range.",
        401 => "A token is needed.",
        403 => "Not for this role, or a foreign Origin or Host.",
        404 => "There is no such thing.",
        408 => "The body did not come in time.",
        409 => "The state does not allow it.",
        412 => "The condition does not hold.",
        413 => "Larger than the limit.",
        415 => "The body is of another type.",
        422 => "The program has errors, is not signed, or is of another dialect.",
        426 => "This is for a WebSocket.",
        429 => "Too many requests.",
        _ => "The machine cannot do it now.",
    }
}
